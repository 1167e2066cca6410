"""A robosuite environment whose two arms hold one object, as a robot of the loop.

    env = robosuite.make("TwoArmLift", robots=["Panda", "Panda"],
                         controller_configs=[controllers("Panda"), controllers("Panda")], ...)
    world = RobosuiteWorld(env, held="pot_root")
    world.find()                                   # again after each reset of the environment
    robot = world.robot(folder)                    # for a Scenario, with the motors' limits
    loop = world.loop(scenario)                    # once the hands hold the object
    loop.tick(world.read()); world.write(loop.setpoint, loop.command.v)

Arms are named as robosuite's robots, those of one robot as its arms: robot0, robot1; right, left.
The file that robosuite itself simulates is read, so that joints have its names, and motors the
limits of their ``ctrlrange``, by which robosuite clips. Each write is one step of the environment:
its ``control_freq`` must be 1/dt. Quaternions are xyzw in robosuite's observations and wxyz
in MuJoCo; here poses are pinocchio's.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pinocchio as pin

from coopqp.base.errors import InvalidValueError
from coopqp.base.spec import Array
from coopqp.online.loop import OnlineLoop
from coopqp.robot_files.selection import JointLimits
from coopqp.robots import Mjcf
from coopqp.scenario.scenario import Scenario

SPEED = 2.0  # velocity limit where none is given: robosuite and MJCF have none [rad/s]
SHOWS = 1e-3  # errors of joints from which on readings show them [rad]
KP = 300.0  # stiffness of robosuite's position servos, torque over inertia and error [1/s2]


def controllers(
    robot: str, kind: Literal["positions", "torques"] = "positions", *, kp: float = KP
) -> dict[str, Any]:
    """Settings of robosuite's own controllers, by which its arms do what the loop says.

    Args:
        robot: its name in robosuite.
        kind: joint angles [rad], by servos that compensate gravity; or torques [N m], gravity's
            among them, as of laws by torques.
        kp: stiffness of the servos [1/s2].

    Raises:
        InvalidValueError: kind is none.
    """
    from robosuite.controllers import load_composite_controller_config

    if kind not in ("positions", "torques"):
        raise InvalidValueError(f"kind: found {kind!r}; needs positions or torques")
    settings: dict[str, Any] = load_composite_controller_config(controller=None, robot=robot)
    unlimited = 1e4  # scaled one to one; the motors' limits clip
    own: dict[str, Any] = {
        "type": "JOINT_POSITION", "kp": kp, "kp_limits": [0, 1e5], "input_type": "absolute",
        "damping_ratio": 1, "impedance_mode": "fixed",
    } if kind == "positions" else {
        "type": "JOINT_TORQUE", "input_max": unlimited, "input_min": -unlimited,
        "output_max": unlimited, "output_min": -unlimited, "use_torque_compensation": False,
    }  # fmt: skip
    parts = settings["body_parts"].get("arms", settings["body_parts"])
    for arm in parts:
        parts[arm] = {**own, "interpolation": None, "ramp_ratio": 0.2, "gripper": {"type": "GRIP"}}
    return settings


class RobosuiteWorld:
    """Arms, grippers and the held object of an environment.

    Args:
        env: as ``robosuite.make`` gives it; not wrapped.
        held: body of the object.
        kp: of the servos, see :func:`controllers`.
        by_torques: whether :meth:`read` gives velocities, too.

    Attributes:
        arms: their names. sites: of their hands, likewise. joints: of all arms, shape (n,).
        grip: of each arm, -1 open to 1 closed. obs, reward: of the last step.
        kp: as given; ``Observer(inertial_stiffness=world.kp, dead_band=world.dead_band)``, as
            :meth:`loop` has it, knows how these servos sag and stick.
    """

    def __init__(
        self, env: Any, held: str = "pot_root", *, kp: float = KP, by_torques: bool = False
    ) -> None:
        self.env, self._held, self.kp, self._by_torques = env, held, kp, by_torques
        self.grip: dict[str, float] = {}
        self.find()

    def find(self) -> None:
        """Take the handles anew, which a reset of the environment changes."""
        sim, robots = self.env.sim, self.env.robots
        self.model, self.data = sim.model._model, sim.data._data
        sim.forward()  # make leaves the poses of bodies as they were before it placed them
        single = len(robots) == 1
        self._of = {(a if single else f"robot{i}"): (i, a)
                    for i, robot in enumerate(robots) for a in robot.arms}  # fmt: skip
        self.arms = tuple(self._of)
        grippers = [robots[i].gripper[a] for i, a in self._of.values()]
        self.sites = tuple(gripper.important_sites["grip_site"] for gripper in grippers)
        halves = [
            [name for name in robots[i].robot_model.joints if not single or f"_{arm}_" in name]
            for i, arm in self._of.values()
        ]
        self.joints = tuple(name for half in halves for name in half)
        rows = [self.model.joint(name) for name in self.joints]
        self._q = np.array([row.qposadr[0] for row in rows])
        self._v = np.array([row.dofadr[0] for row in rows])
        ends = np.cumsum([len(half) for half in halves])[:-1]
        self._halves = np.split(np.arange(len(self.joints)), ends)
        roots = (*(gripper.root_body for gripper in grippers), self._held)
        self._bodies = [self._below(self.model.body(name).id) for name in roots]
        self.grip = dict.fromkeys(self.arms, -1.0)

    def free_first_joints(self) -> None:
        """Let no arm's first link touch what it turns on; again after each reset.

        MuJoCo leaves out contacts of a link with its parent, but not with one that is fixed to the
        world. Sawyer's first link stands on its base without a gap: where rounding has them touch,
        they press with 1800 N, and 100 N m of friction hold the joint.
        """
        model = self.model
        firsts = [model.joint(self.joints[half[0]]).id for half in self._halves]
        links = model.jnt_bodyid[firsts]
        pairs = np.isin(model.geom_bodyid, [*links, *model.body_parentid[links]])
        model.geom_conaffinity[pairs] = 0  # they still touch all else, which has its own

    def _below(self, root: int) -> frozenset[int]:
        found, parents = {root}, self.model.body_parentid
        for body in range(root + 1, self.model.nbody):
            if parents[body] in found:
                found.add(body)
        return frozenset(found)

    def robot(self, folder: Path | str, *, speed: float = SPEED) -> Mjcf:
        """The arms for a scenario, read from the file that robosuite simulates, written there."""
        path = Path(folder) / "robosuite.xml"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(self.env.sim.model.get_xml(), encoding="utf-8")
        limits = {name: JointLimits(velocity=speed) for name in self.joints}
        tips = dict(zip(self.arms, self.sites, strict=True))
        return Mjcf(path=path, arms=tips, joint_limits=limits)

    def loop(self, scenario: Scenario, controller: str = "qp", **given: Any) -> OnlineLoop:
        """A loop without a clock that knows these servos, for hands that hold the object.

        Its observer is the scenario's but for these servos.

        Args:
            scenario: with the robot that :meth:`robot` gives.
            controller: its name.
            **given: more of :class:`coopqp.OnlineLoop`'s.

        Raises:
            InvalidValueError: the environment was reset, its step is not dt, the robot's joints or
                arms are others, or a hand that is to hold the object does not touch it.
        """
        step, chain = 1.0 / self.env.control_freq, scenario.chain
        arms = sorted(arm.name for arm in chain.robot.arms)
        if self.data is not self.env.sim.data._data:
            raise InvalidValueError("env: was reset since; call world.find() after each reset")
        if abs(scenario.dt - step) > 1e-6 * step:
            raise InvalidValueError(
                f"dt: found {scenario.dt:g}; one write takes the environment {step:g} s further; "
                f"make it with control_freq={1.0 / scenario.dt:g}"
            )
        if chain.joint_names != self.joints or arms != sorted(self.arms):
            raise InvalidValueError(
                f"robot: has {', '.join(chain.joint_names)} of {', '.join(arms)}; read() has "
                f"{', '.join(self.joints)} of {', '.join(self.arms)}; take world.robot(folder)"
            )
        holding = chain.arms[: chain.holding]
        wrenches = dict(zip(self.arms, self.hand_wrench().reshape(-1, 6), strict=True))
        for name in (arm.name for arm in holding if not wrenches[arm.name].any()):
            raise InvalidValueError(
                f"grasps: the hand of {name} is to hold {self._held} and does not touch it; close "
                "it around it first (world.grip, and some steps)"
            )
        servos: Any = {"inertial_stiffness": self.kp, "dead_band": self.dead_band}
        known = replace(scenario.observer, stiffness=None, **servos)
        return OnlineLoop(scenario, controller, **{"clock": None, "observer": known, **given})

    def read(self) -> Array:
        """Joints, shape (n,) [rad], and by torques their velocities, too, shape (2, n)."""
        q = self.data.qpos[self._q].copy()
        return np.stack([q, self.data.qvel[self._v]]) if self._by_torques else q

    def write(self, q: Array, v: Array, load: Array | None = None) -> None:
        """Go to joint angles; ``load`` are torques of the object that the servos bear, (n,).

        Where robosuite takes torques they are those of its servos.
        """
        M, n = self.inertia(), len(q)
        ahead = np.zeros(n) if load is None else np.linalg.solve(M, load) / self.kp
        if not self._by_torques:
            return self.step(q + ahead)
        now, rate = self.read()
        a = self.kp * (q + ahead - now) - 2.0 * np.sqrt(self.kp) * rate
        return self.step(M @ a + self.data.qfrc_bias[self._v])

    def give_way(self, steps: int) -> None:
        """Hold the joints where they are pushed to, so that hands that closed press no longer."""
        for _ in range(steps):
            q = np.atleast_2d(self.read())[0]
            self.write(q, np.zeros_like(q))

    def apply(self, tau: Array) -> None:
        """Apply torques, shape (n,) [N m]."""
        self.step(tau)

    def inertia(self) -> Array:
        """Of each arm, as robosuite's controllers know it, shape (n, n) [kg m2]."""
        import mujoco

        full, M = np.zeros((self.model.nv, self.model.nv)), np.zeros((len(self._v),) * 2)
        if hasattr(self.data, "qM"):
            mujoco.mj_fullM(self.model, full, self.data.qM)
        else:  # MuJoCo 4, which robosuite 1.5.2 does not take
            mujoco.mj_fullM(self.model, self.data, full)
        for half in self._halves:
            M[np.ix_(half, half)] = full[np.ix_(self._v[half], self._v[half])]
        return M

    @property
    def dead_band(self) -> dict[str, float]:
        """How far friction keeps joints off, for ``Observer(dead_band=...)`` [rad].

        Of no joint where that is less than a milliradian in all, of which readings show nothing.
        """
        off = self.model.dof_frictionloss[self._v] / (self.kp * self.inertia().diagonal())
        return dict(zip(self.joints, off.tolist(), strict=True)) if off.max() > SHOWS else {}

    def step(self, action: Array) -> None:
        """One step with the same number of values for each arm, those of its controller."""
        given: dict[int, dict[str, Any]] = {}
        parts = np.split(np.asarray(action), len(self.arms))
        for part, (name, (i, arm)) in zip(parts, self._of.items(), strict=True):
            hand = np.full(self.env.robots[i].gripper[arm].dof, self.grip[name])
            given.setdefault(i, {}).update({arm: part, f"{arm}_gripper": hand})
        robots = self.env.robots
        action = np.concatenate([robots[i].create_action_vector(given[i]) for i in sorted(given)])
        self.obs, self.reward, _, _ = self.env.step(action)

    def hand(self, arm: str) -> pin.SE3:
        """Pose of a hand's site."""
        i = self.model.site(self.sites[self.arms.index(arm)]).id
        return pin.SE3(self.data.site_xmat[i].reshape(3, 3).copy(), self.data.site_xpos[i].copy())

    @property
    def pads(self) -> list[list[int]]:
        """Geoms of each hand's finger pads, by their ids."""
        geoms = [self.env.robots[i].gripper[arm].important_geoms for i, arm in self._of.values()]
        sides = "left_fingerpad", "right_fingerpad"
        return [[self.model.geom(name).id for side in sides for name in own[side]] for own in geoms]

    @property
    def object(self) -> pin.SE3:
        """Pose of the held body."""
        body = self.model.body(self._held).id
        return pin.SE3(self.data.xmat[body].reshape(3, 3).copy(), self.data.xpos[body].copy())

    def hand_wrench(self) -> Array:
        """Wrenches of the hands on the object by the sums of their contacts, shape (6 N,) [N, N m].

        At the hands' sites, in world axes: the loop's input of that name, once nothing else bears
        the object.
        """
        import mujoco

        w, contact_wrench = np.zeros((len(self.arms), 6)), np.zeros(6)
        points = [self.hand(arm).translation for arm in self.arms]
        pairs, held = self.model.geom_bodyid[self.data.contact.geom].tolist(), self._bodies[-1]
        for k, (one, two) in enumerate(pairs):
            if (one in held) == (two in held):
                continue
            other, sign = (one, 1.0) if two in held else (two, -1.0)  # acts on the second geom
            for i, hand in enumerate(self._bodies[:-1]):
                if other in hand:
                    mujoco.mj_contactForce(self.model, self.data, k, contact_wrench)
                    contact = self.data.contact[k]
                    R = contact.frame.reshape(3, 3)
                    force, torque = sign * contact_wrench[:3] @ R, sign * contact_wrench[3:] @ R
                    w[i, :3] += force
                    w[i, 3:] += torque + pin.skew(contact.pos - points[i]) @ force
        return w.ravel()
