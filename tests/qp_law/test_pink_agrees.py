"""Baxter, both arms on one object: Pink and coopqp state the same QP and get the same velocities.

Pink solves for the displacement dq = v dt, coopqp for v; with dq = v dt the two costs differ by
the factor dt^2, so weights and damping are the same numbers. What else has to be made equal:

* the task. Pink's FrameTask with position costs alone weighs the first three rows of log6, which
  contain orientation; a point's plain position is a Pink task of three lines, written here. It
  gets the reference's motion as its error: dt (rate - gain e), gain 1.
* the loop. RelativeFrameTask says Jlog6(E) J_rel dq = -log6(E), E the pose of the object as carried
  by one arm in that of the other, axes of the object; coopqp says J_rel v = -kappa e, e = positions
  and rotation vector, axes of the world. With gain 1 and kappa = 1/dt they are the same rows up to
  a rotation when E = 1, and differ by the order of |e| |v| else. E is the identity to 1e-12 in the
  first run, whose loop is closed by Newton after every step; the second runs as it comes.
* the object. Pink's task follows arm 0, coopqp's the mean of the arms, |e| / 2 away. That is
  the same only when e = 0, or when task and loop have one gain, as in the second run.
* the damping. coopqp's error_damping is off; Pink's lm_damping, off too, is for a step's error.
* the tolerance. daqp's own primal_tol of 1e-6, which Pink hands on, is 1e-6 of dq: 2.5e-4 rad/s
  at dt = 4 ms. When limits are active it shows (see below), so Pink gets a tighter one.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from laws import step
from numpy.typing import NDArray

from coopqp.base.errors import MissingDependencyError
from coopqp.base.spec import Array
from coopqp.controller import ControlProblem
from coopqp.controllers import QPController
from coopqp.grasps import Rigid
from coopqp.limits import JointPosition, JointVelocity
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.grasp_configuration import HeldObject
from coopqp.model.profile import Profile
from coopqp.model.state import State
from coopqp.robots import ExampleRobot, example_robot
from coopqp.solvers import Daqp
from coopqp.tasks import PointOnPoint

pink = pytest.importorskip("pink")
from pink.limits import ConfigurationLimit, VelocityLimit  # noqa: E402
from pink.tasks import RelativeFrameTask, Task  # noqa: E402

try:
    example_robot.robots()
except MissingDependencyError:
    pytest.skip("needs coopqp[robots]", allow_module_level=True)


TICKS = 500
SAME = 1e-6  # [rad/s]
DAMPING, WEIGHT = 1e-6, 2.0
TIGHT = {"primal_tol": 1e-12, "dual_tol": 1e-12}

RIGHT = np.array([-0.4, -0.6, 0.0, 1.3, 0.0, 0.8, 0.0])  # forward and down
LEFT = RIGHT * np.array([-1.0, 1.0, -1.0, 1.0, -1.0, 1.0, -1.0])


class PointTask(Task):  # type: ignore[misc]
    """Position of a frame's origin, world axes: what FrameTask is only when nothing turns."""

    def __init__(self, frame: str) -> None:
        super().__init__(cost=float(np.sqrt(WEIGHT)), gain=1.0)
        self.frame, self.step = frame, np.zeros(3)

    def compute_error(self, configuration: Any) -> Array:
        return self.step

    def compute_jacobian(self, configuration: Any) -> Array:
        R = configuration.get_transform_frame_to_world(self.frame).rotation
        return -np.asarray(R @ configuration.get_frame_jacobian(self.frame)[:3], float)

    def __repr__(self) -> str:
        return f"PointTask({self.frame})"


@dataclass
class Baxter:
    """One problem for both."""

    goal: tuple[float, float, float]  # from the start [m]
    dt: float
    gain: float
    lowest_elbow: float = -0.05

    def __post_init__(self) -> None:
        robot = ExampleRobot(
            name="baxter",
            arms={"right": "right_gripper", "left": "left_gripper"},
            joint_limits={"*_e1": {"lower": self.lowest_elbow}},
        ).build()
        q = robot.configuration({"right": RIGHT, "left": LEFT})
        self.chain = ClosedChain.attach(robot, q, Rigid(), HeldObject())
        self.way = np.array(self.goal)
        self.task = PointOnPoint(
            goal=tuple(self.chain.start_position + self.way),
            gain=self.gain,
            weight=WEIGHT,
            profile=Profile(duration=TICKS * self.dt),
        )
        self.problem = ControlProblem(
            chain=self.chain,
            tasks=[self.task],
            limits=[JointPosition(), JointVelocity()],
            dt=self.dt,
            kappa=1.0 / self.dt,
            solver=Daqp(),
        )

    def at_limit(self, q: Array) -> NDArray[np.bool_]:
        """Which joints have arrived at a position limit."""
        at: NDArray[np.bool_] = (q < self.chain.lower + 1e-9) | (q > self.chain.upper - 1e-9)
        return at

    def close(self, state: State) -> None:
        """Close the loops by the joints that are not at a limit, which must not be exceeded."""
        free = ~self.at_limit(state.q)
        for _ in range(2):
            J = state.J_loop[:, free]
            state.q[free] -= np.linalg.lstsq(J, state.e_loop, rcond=None)[0]
            state.update()


class Pink:
    """The same problem in Pink."""

    def __init__(self, baxter: Baxter, **tolerances: float) -> None:
        chain, self._baxter, self._tolerances = baxter.chain, baxter, tolerances
        arm_0, arm_1 = (f"object[{arm.name}]" for arm in chain.arms)
        self._configuration = pink.Configuration(
            chain.model, chain.model.createData(), chain.q_start
        )
        self._start = self._place(arm_0)
        self._reach = PointTask(arm_0)
        self._loop = RelativeFrameTask(arm_1, arm_0, position_cost=1.0, orientation_cost=1.0)
        self._loop.set_target(pin.SE3.Identity())
        self._limits = [
            ConfigurationLimit(chain.model, config_limit_gain=1.0),
            VelocityLimit(chain.model),
        ]

    def _place(self, frame: str) -> Array:
        p: Array = self._configuration.get_transform_frame_to_world(frame).translation.copy()
        return p

    def velocity(self, q: Array, t: float) -> Array:
        """Its answer for a configuration."""
        baxter = self._baxter
        self._configuration.update(q)
        share, speed = baxter.task.profile.at(t)
        e = self._place(self._reach.frame) - self._start - share * baxter.way
        self._reach.step = baxter.dt * (speed * baxter.way - baxter.gain * e)
        v: Array = pink.solve_ik(
            self._configuration, [self._reach], baxter.dt, solver="daqp", limits=self._limits,
            constraints=[self._loop], damping=DAMPING, **self._tolerances,
        )  # fmt: skip
        return v


@dataclass
class Run:
    """What 500 ticks gave, shape (TICKS,) each."""

    apart: Array  # largest difference of a joint's velocity [rad/s]
    loop_error: Array  # largest entry [m, rad]
    speed: Array  # largest joint velocity [rad/s]
    at_position: NDArray[np.bool_]  # a position limit was active
    at_velocity: NDArray[np.bool_]  # a velocity limit was active


def run(baxter: Baxter, theirs: Pink, *, closed: bool) -> Run:
    """Both at the same configuration, tick by tick; coopqp's velocity is the one that is made."""
    chain = baxter.chain
    law = QPController(damping=DAMPING, error_damping=0.0).build(baxter.problem)
    state = law.start()
    rows = []
    for k in range(TICKS):
        state.t = k * baxter.dt
        command = law.tick(state)
        assert command.status.usable
        assert not command.status.relaxed
        v = command.v.copy()
        rows.append(
            (
                np.abs(theirs.velocity(state.q, state.t) - v).max(),
                np.abs(state.loop_error).max(),
                np.abs(v).max(),
                baxter.at_limit(state.q).any(),
                (np.abs(v) > chain.velocity - 1e-9).any(),
            )
        )
        step(state, v, baxter.dt)
        state.update()
        if closed:
            baxter.close(state)
    apart, loop_error, speed, at_position, at_velocity = np.array(rows).T
    return Run(apart, loop_error, speed, at_position.astype(bool), at_velocity.astype(bool))


def unreachable() -> Baxter:
    """Too fast for the joints, and beyond where the elbows stop."""
    return Baxter(goal=(0.5, 0.3, 0.5), dt=0.004, gain=5.0, lowest_elbow=0.9)


def test_pink_and_coopqp_agree_with_limits_active() -> None:
    baxter = unreachable()
    both = run(baxter, Pink(baxter, **TIGHT), closed=True)
    assert both.loop_error.max() < 1e-12
    assert both.at_velocity.sum() > 100
    assert both.at_position.sum() > 100
    assert not (both.at_velocity | both.at_position).all()
    assert both.apart.max() < 0.01 * SAME  # measured: 4e-10


def test_pink_and_coopqp_agree_while_the_loop_drifts() -> None:
    baxter = Baxter(goal=(0.2, 0.1, 0.2), dt=0.01, gain=100.0)
    both = run(baxter, Pink(baxter, **TIGHT), closed=False)
    assert both.loop_error.max() > 1e-7  # it does drift
    assert both.apart.max() < SAME
    # And what is left is of the order of |e| |v|: 1.6 times it at most.
    assert (both.apart <= 5.0 * both.loop_error * both.speed + 1e-9).all()


def test_the_tolerance_that_pink_hands_on_is_too_wide() -> None:
    baxter = Baxter(goal=(0.4, 0.2, 0.2), dt=0.004, gain=5.0, lowest_elbow=0.9)
    assert run(baxter, Pink(baxter, **TIGHT), closed=True).apart.max() < SAME
    loose = run(baxter, Pink(baxter), closed=True)
    assert loose.at_position.any()
    assert SAME < loose.apart.max() < 1e-2
