"""What a start is solved for: where each arm carries the object, and where joints may be.

See :mod:`coopqp.scenario.start_solver` for the letters.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pinocchio as pin

from coopqp.checked import Array
from coopqp.closed_loop.screw import LENGTH
from coopqp.grasp import Grasp, pose_matrix
from coopqp.held_object import HeldObject
from coopqp.hold import add_object_frame, object_at_end, with_passive_joints
from coopqp.robot import RobotModel

#: How far a joint without limits is turned at random [rad or m].
UNLIMITED = np.pi

#: Starts keep this far off the limits, so that rounded values are inside them too [rad or m].
INSIDE = 1e-7


class StartProblem:
    """The robot with its passive joints, and where each arm carries the object.

    Attributes:
        frames: the object as carried by each arm, by arm; ids of frames.
        columns: the joints that move each arm, by arm; indices into q.
        middle: configuration half-way between the limits; zero without limits, shape (n,).
        half: half the range; infinite without limits, shape (n,).
        near: joints that have a posture to be near, which is their middle then; indices into q.
    """

    def __init__(
        self,
        robot: RobotModel,
        grasps: Mapping[str, Grasp],
        held: HeldObject,
        near: Mapping[str, float | Sequence[float]],
    ) -> None:
        assert held.pose is not None
        self.robot = robot
        X_WO = pose_matrix(held.pose)
        joints = {}
        for name, grasp in grasps.items():
            assert grasp.object_in_hand is not None
            # An axis given in the world is the same in the hand wherever the hinge has turned it.
            R_WT = X_WO.rotation @ pose_matrix(grasp.object_in_hand).rotation.T
            joints[name] = grasp.passive_joints(R_WT)
        self.model, ends = with_passive_joints(robot, joints)
        model = self.model
        self.frames, self.columns = {}, {}
        for arm in robot.arms:
            end, tip = model.getFrameId(ends[arm.name]), model.getFrameId(arm.tip)
            X_EO = object_at_end(model, end, tip, grasps[arm.name])
            self.frames[arm.name] = add_object_frame(model, arm.name, ends[arm.name], X_EO)
            way = model.supports[model.frames[end].parentJoint]
            self.columns[arm.name] = [model.idx_vs[j] for j in way if j > 0]
        self._data = model.createData()
        self._p, self._RT = X_WO.translation.copy(), X_WO.rotation.T.copy()
        self.lower = np.array(model.lowerPositionLimit) + INSIDE
        self.upper = np.array(model.upperPositionLimit) - INSIDE
        self._center()
        self._place(near)

    def _place(self, near: Mapping[str, float | Sequence[float]]) -> None:
        """Let a posture take the place of the middle."""
        model, robot = self.model, self.robot
        arms = {arm.name: robot.arm_joints(arm) for arm in robot.arms}
        q = robot.configuration(near)
        self.near = np.zeros(0, int)
        for joint in dict.fromkeys(name for key in near for name in arms.get(key, (key,))):
            i = model.idx_qs[model.getJointId(joint)]
            value = float(q[robot.model.idx_qs[robot.model.getJointId(joint)]])
            self.middle[i] = min(max(value, self.lower[i]), self.upper[i])
            self.half[i], self.near = self._reach[i], np.append(self.near, i)

    def _center(self) -> None:
        """Middle of the ranges; with one end open, as far from the other as a joint is turned."""
        low, high = np.isfinite(self.lower), np.isfinite(self.upper)
        lower = np.where(low, self.lower, np.where(high, self.upper - 2 * UNLIMITED, -UNLIMITED))
        upper = np.where(high, self.upper, np.where(low, self.lower + 2 * UNLIMITED, UNLIMITED))
        self.middle, self._reach = (lower + upper) / 2, (upper - lower) / 2
        self._sampled = self.middle.copy()
        turns = [kind.shortname().startswith("JointModelR") for kind in list(self.model.joints)[1:]]
        self._endless = np.array(turns) & ~low & ~high
        self.half = np.where(low & high, self._reach, np.inf)

    def sample(self, rng: np.random.Generator) -> Array:
        """A random configuration inside the limits."""
        return self._sampled + self._reach * rng.uniform(-1.0, 1.0, len(self.middle))

    def residual(self, q: Array, arms: Sequence[str]) -> tuple[Array, Array]:
        """Stacked r and its Jacobian, shapes (6 N,) and (6 N, n)."""
        model, data = self.model, self._data
        pin.computeJointJacobians(model, data, q)
        r, J = np.zeros(6 * len(arms)), np.zeros((6 * len(arms), len(q)))
        for i, arm in enumerate(arms):
            frame, at = self.frames[arm], 6 * i
            X = pin.updateFramePlacement(model, data, frame)
            turned = X.rotation @ self._RT
            r[at : at + 3] = X.translation - self._p
            r[at + 3 : at + 6] = LENGTH * pin.log3(turned)
            J_i = pin.getFrameJacobian(model, data, frame, pin.LOCAL_WORLD_ALIGNED)
            J[at : at + 3] = J_i[:3]
            J[at + 3 : at + 6] = LENGTH * pin.Jlog3(turned).T @ J_i[3:]
        return r, J

    def unwind(self, q: Array) -> None:
        """Take whole turns off joints that turn without limits."""
        turns = np.round((q - self.middle) / (2.0 * np.pi))
        q -= np.where(self._endless, 2.0 * np.pi * turns, 0.0)

    def worth(self, q: Array, columns: Sequence[int]) -> float:
        """How good a start is: its margin, or its distance to the posture to be near."""
        asked = [i for i in columns if i in self.near]
        if not asked:
            return self.margin(q, columns)
        return -float(np.linalg.norm((q - self.middle)[asked]))

    def margin(self, q: Array, columns: Sequence[int]) -> float:
        """Least distance to a limit [rad or m]."""
        room = np.minimum(q - self.lower, self.upper - q)[list(columns)]
        return float(room.min(initial=np.inf))
