"""robosuite's TwoArmLift by six laws in nine variants, on seeds of robosuite's own: a table.

    sh benchmarks/robosuite_env.sh                                           # once
    .robosuite/bin/python benchmarks/two_arm_lift.py --seeds 5
    .robosuite/bin/python benchmarks/two_arm_lift.py --seeds 5 --robots Baxter

Runs that the file of ``--out`` has are not made again, so that a table can be gone on with.

A run is some 5 s of the simulation: hands reach and take hold as in
examples/robosuite_two_arm_lift.py, once for all laws and variants that do it alike, then lift the
pot by 15 cm in 1.5 s and hold it for 1 s. Printed are, of all seeds: successes by robosuite's own
check at the end; medians of the internal force, (f_1 - f_2)/2 by contacts (95th percentile over a
run), of the slip of the pads on the bar, of the shift of a hand, which is mostly the travel of its
fingers, and of the tilt, at worst; share of steps with a motor at its limit, or a joint outside its
range. Then the differences of qp from the other laws, seed by seed.

    qp, pseudoinverse  the loop on joint servos (JOINT_POSITION, kp 300), which knows kp
    qp, no observer    without the observer of the loop-closure offset
    torque_qp          the loop on motors (JOINT_TORQUE), 200 times a second
    IK                 each arm by damped least squares, on the same servos
    OSC                robosuite's own, kp 150, each hand's path given

Steps of 20 mm arrive at the loop as an input, whose own bounds hold; IK and OSC go there at once.

All but torque_qp know the object's mass as half of its weight on each hand, which their
servos bear; OSC by as much as its springs need. Hands of IK and OSC follow the pot's way as rigidly
held by it.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import logging
import sys
import time
import warnings
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "examples"))
from robosuite_two_arm_lift import DT, YIELD, go, minimum_jerk, reaching, scenario_of, take_hold

import coopqp
from coopqp.adapters.robosuite import KP, RobosuiteWorld, controllers
from coopqp.base.spec import Array
from coopqp.model.loop_observer import Observer
from coopqp.robots import Mjcf
from coopqp.signals import Input
from coopqp.tasks import Pose as PoseTask

NO_OBSERVER = "qp, no observer"
LAWS = ("qp", NO_OBSERVER, "torque_qp", "pseudoinverse", "IK", "OSC")
VARIANTS = {
    "as shipped": {}, "pot x4, known": {"heavy": 4.0, "known": True},
    "pot x4, unknown": {"heavy": 4.0}, "friction 0.3": {"friction": 0.3},
    "20 mm a step": {"fast": True}, "servos kp 3000": {"kp": 3000.0},
    "base 10 mm, 15 mrad off": {"off": True}, "circle with yaw": {"circle": True},
    "push of 20 N": {"push": 20.0},
}  # fmt: skip
HEIGHT, LIFT, HOLD = 0.15, 1.5, 1.0  # m, s, s
OSC_KP = 150.0
POT = "pot"  #: The input.
#: From where robosuite has Baxter begin, reaching ends with the elbows at the torso: out with them
#: first. Joints of the right arm, those of the left are its mirror image [rad].
ELBOWS_OUT, MIRROR = np.array([0.1, -0.75, 1.2, 1.6, -1.2, 1.2, -0.5]), np.array([-1.0, 1.0])
#: What of a variant counts before the lift: in others hands reach and take hold alike.
BEFORE = "heavy", "friction", "off"
MEANT = 10  # seeds, of fewer a mean says little
CHANGED = "body_mass", "body_inertia", "geom_friction", "body_pos", "body_quat"


def main() -> None:
    ask = argparse.ArgumentParser()
    ask.add_argument("--robots", nargs="+", default=["Panda", "Panda"])
    ask.add_argument("--seeds", type=int, default=5)
    ask.add_argument("--first", type=int, default=0)
    ask.add_argument("--laws", nargs="+", default=LAWS)
    ask.add_argument("--variants", nargs="+", default=list(VARIANTS))
    ask.add_argument("--out", type=Path, default=Path("out/two_arm_lift.jsonl"))
    given = ask.parse_args()
    given.out.parent.mkdir(parents=True, exist_ok=True)
    warnings.filterwarnings("ignore")
    logging.disable(logging.CRITICAL)
    found = []
    with given.out.open("a+") as file:
        file.seek(0)
        kept = {key_of(done): done for done in map(json.loads, file)}
        for seed in range(given.first, given.first + given.seeds):
            for variant in given.variants:
                for law in given.laws:
                    key = *given.robots, law, variant, seed
                    if key not in kept:
                        kept[key] = run(given.robots, law, variant, seed)
                        file.write(json.dumps(kept[key]) + "\n")
                        file.flush()
                    found.append(kept[key])
    print(table(found))
    print(differences(found))


def key_of(done: dict[str, Any]) -> tuple[Any, ...]:
    return *done["robots"], done["law"], done["variant"], done["seed"]


class Made(NamedTuple):
    """An environment, and what is kept of it.

    Attributes:
        dt: its period [s].
        was: its model as made.
        robot, model: its arms as the laws know them.
        held: how hands hold in it, by seed and by what is otherwise before the lift.
    """

    env: Any
    dt: float
    was: dict[str, Array]
    robot: Mjcf
    model: coopqp.RobotModel
    held: dict[tuple[Any, ...], tuple[Array, list[tuple[Array, Array]]]]


@lru_cache(maxsize=4)
def made(robots: tuple[str, ...], law: str, kp: float) -> Made:
    """Without observations and rewards, which nothing here asks for."""
    import robosuite

    kind, dt = ("torques", 0.005) if law == "torque_qp" else ("positions", DT)
    settings = [controllers(name, kind, kp=kp) for name in robots]
    for own in settings if law == "OSC" else ():
        parts = own["body_parts"].get("arms", own["body_parts"])
        for arm in parts:
            parts[arm] = {
                "type": "OSC_POSE", "input_max": 1, "input_min": -1, "output_max": 1,
                "output_min": -1, "kp": OSC_KP, "kp_limits": [0, 1e5], "damping_ratio": 1,
                "damping_ratio_limits": [0, 10], "impedance_mode": "fixed",
                "position_limits": None, "orientation_limits": None, "uncouple_pos_ori": True,
                "input_type": "absolute", "input_ref_frame": "world", "interpolation": None,
                "ramp_ratio": 0.2, "gripper": {"type": "GRIP"},
            }  # fmt: skip
    one = len(robots) == 1
    with contextlib.redirect_stdout(io.StringIO()):
        env = robosuite.make(
            "TwoArmLift", robots=robots[0] if one else list(robots), seed=0,
            env_configuration="single-robot" if one else "opposed",
            controller_configs=settings[0] if one else settings, control_freq=round(1 / dt),
            has_renderer=False, has_offscreen_renderer=False, use_camera_obs=False, horizon=10**6,
            hard_reset=False,
        )  # fmt: skip
    env._observables.clear()
    env.reward = lambda action: 0.0
    world = RobosuiteWorld(env)
    world.free_first_joints()
    robot = world.robot(Path("out") / "_".join((*robots, law)))  # for runs side by side
    was = {name: getattr(world.model, name).copy() for name in CHANGED}
    return Made(env, dt, was, robot, robot.build(), {})


def as_made(env: Any, was: dict[str, Array], seed: int) -> None:
    """As ``make(seed=seed)`` leaves it, which draws the same, without building it anew."""
    import mujoco

    env.rng.bit_generator.state = np.random.default_rng(seed).bit_generator.state
    env.reset()
    model, data = env.sim.model._model, env.sim.data._data
    for name, values in was.items():
        getattr(model, name)[:] = values
    mujoco.mj_setConst(model, mujoco.MjData(model))
    data.qvel[:], data.qacc_warmstart[:], data.xfrc_applied[:] = 0.0, 0.0, 0.0
    mujoco.mj_forward(model, data)


def hold_of(world: RobosuiteWorld) -> tuple[Array, list[tuple[Array, Array]]]:
    """The simulation's state, and of each arm what its gripper and its controller remember."""
    import mujoco

    state = np.empty(mujoco.mj_stateSize(world.model, mujoco.mjtState.mjSTATE_INTEGRATION))
    mujoco.mj_getState(world.model, world.data, state, mujoco.mjtState.mjSTATE_INTEGRATION)
    arms = [(world.env.robots[i], arm) for i, arm in world._of.values()]
    return state, [(robot.gripper[arm].current_action.copy(),
                    robot.part_controllers[arm].initial_joint.copy())
                   for robot, arm in arms]  # fmt: skip


def take_up(world: RobosuiteWorld, held: tuple[Array, list[tuple[Array, Array]]]) -> None:
    """Go on from there."""
    import mujoco

    state, arms = held
    mujoco.mj_setState(world.model, world.data, state, mujoco.mjtState.mjSTATE_INTEGRATION)
    world.env.sim.forward()
    for (i, arm), (gripped, begun) in zip(world._of.values(), arms, strict=True):
        robot = world.env.robots[i]
        robot.gripper[arm].current_action = gripped.copy()
        robot.part_controllers[arm].initial_joint = begun.copy()
        robot.part_controllers[arm].new_update = True  # what it knows of the arm is of the reset
    world.grip = dict.fromkeys(world.arms, 1.0)


def run(robots: list[str], law: str, variant: str, seed: int) -> dict[str, Any]:
    """One run, and what is measured in it."""
    began, what = time.process_time(), dict(VARIANTS[variant])
    kp = float(what.get("kp", KP))
    kind = law if law in ("torque_qp", "OSC") else "positions"
    own = made(tuple(robots), kind, kp if kind == "positions" else KP)
    env, dt, robot = own.env, own.dt, own.robot
    as_made(env, own.was, seed)
    world = RobosuiteWorld(env, kp=kp, by_torques=law == "torque_qp")
    change(world, what)
    mass = float(world.model.body("pot_root").mass[0])
    if not what.get("known"):
        mass /= float(what.get("heavy", 1.0))
    hands = Hands(world, own.model)
    before = seed, kp if law != "OSC" else 0.0, *(what.get(key) for key in BEFORE)
    if before not in own.held:
        if robots == ["Baxter"]:
            hands.elbows_out(dt, osc=law == "OSC")
        if law == "OSC":
            hands.take_hold(dt)
        else:
            take_hold(world, own.model, dt)
        own.held[before] = hold_of(world)
    take_up(world, own.held[before])
    watch, start = Watch(world), world.object
    way, duration = way_of(what, start)
    scenario = scenario_of(world, robot, way, duration, mass=mass, dt=dt)
    if what.get("fast"):  # steps arrive one by one, as a policy's
        goes = PoseTask(goal=Input(name=POT))
        scenario = scenario.changed(tasks=(goes,), inputs={POT: coopqp.InputSettings()})
    step, loop = follower(law, world, hands, scenario, way, mass)
    pot, ticks = world.model.body("pot_root").id, round(duration / dt)
    error = ""
    for k in range(ticks):
        pushed = duration - 0.9 <= k * dt < duration - 0.6
        world.data.xfrc_applied[pot, 0] = what.get("push", 0.0) * pushed
        try:
            step(k * dt)
        except Exception as fault:  # noqa: BLE001 - a law that gives up has lost
            error = f"{type(fault).__name__}: {fault}"
            break
        watch.look()
    found = watch.found(bool(env._check_success()) and not error)
    return {"robots": robots, "law": law, "variant": variant, "seed": seed, **found,
            "faults": [fault.note for fault in loop.faults] if loop else [],
            "error": error[:200], "cpu": time.process_time() - began}  # fmt: skip


def change(world: RobosuiteWorld, what: dict[str, Any]) -> None:
    """What is otherwise than the laws know."""
    import mujoco

    model, pot = world.model, world.model.body("pot_root").id
    if heavy := what.get("heavy"):
        model.body_mass[pot] *= heavy
        model.body_inertia[pot] *= heavy
    if friction := what.get("friction"):
        names = [model.geom(i).name for i in range(model.ngeom)]
        touch = [i for i, name in enumerate(names) if name.startswith(("pot", "gripper"))]
        model.geom_friction[touch, 0] = friction
    if what.get("off"):
        two = len(world.env.robots) > 1
        base = model.body("robot1_base" if two else "robot0_left_upper_shoulder").id
        model.body_pos[base] += [0.01, 0.0, 0.0]
        turned = pin.Quaternion(*model.body_quat[base]) * pin.Quaternion(
            pin.rpy.rpyToMatrix(0, 0, 0.015)
        )
        model.body_quat[base] = [turned.w, turned.x, turned.y, turned.z]
    mujoco.mj_setConst(model, mujoco.MjData(model))  # which leaves no data as they were
    mujoco.mj_forward(model, world.data)


def way_of(what: dict[str, Any], start: pin.SE3) -> tuple[Any, float]:
    """Where the pot shall be at a time [s], and how long."""
    lift = HEIGHT / 0.4 if what.get("fast") else LIFT  # 20 mm each 50 ms
    turn = 4.0 if what.get("circle") else 0.0

    def way(t: float) -> pin.SE3:
        s = min(t / lift, 1.0) if what.get("fast") else minimum_jerk(t / lift)
        p, yaw = start.translation + np.array([0.0, 0.0, HEIGHT * s]), 0.0
        if turn and t > lift:
            phi = 2.0 * np.pi * minimum_jerk((t - lift) / turn)
            p = p + 0.05 * np.array([np.cos(phi) - 1.0, np.sin(phi), 0.0])
            yaw = np.radians(15.0) * np.sin(phi)
        return pin.SE3(pin.rpy.rpyToMatrix(0.0, 0.0, yaw) @ start.rotation, p)

    return way, lift + turn + HOLD


class Hands:
    """Two arms each by itself: paths of the hands, as rigidly held by the pot."""

    def __init__(self, world: RobosuiteWorld, robot: coopqp.RobotModel) -> None:
        self.world, self.robot = world, robot
        self.data = robot.model.createData()
        self.frames = [robot.model.getFrameId(arm.tip) for arm in robot.arms]

    def jacobian(self, q: Array) -> tuple[list[pin.SE3], Array]:
        model, data = self.robot.model, self.data
        pin.computeJointJacobians(model, data, q)
        pin.updateFramePlacements(model, data)
        axes = pin.LOCAL_WORLD_ALIGNED
        rows = [pin.getFrameJacobian(model, data, frame, axes) for frame in self.frames]
        return [data.oMf[frame].copy() for frame in self.frames], np.vstack(rows)

    def load(self, q: Array, mass: float) -> Array:
        """Torques of half of the weight on each hand, shape (n,)."""
        _, J = self.jacobian(q)
        return np.asarray(
            J.T @ np.tile([0, 0, mass * 9.81 / len(self.frames), 0, 0, 0], len(self.frames))
        )

    def elbows_out(self, dt: float, *, osc: bool) -> None:
        """From where the robot begins, not yet over the handles."""
        world, ticks = self.world, round(3.0 / dt)
        q, begun = np.tile(ELBOWS_OUT, 2), np.atleast_2d(world.read())[0]
        q[7:] *= np.resize(MIRROR, 7)
        if not osc:
            go(world, q, 3.0, dt)
            return
        for half, arm in zip((q[:7], q[7:]), world.arms, strict=True):
            world.env.robots[0].part_controllers[arm].update_initial_joints(half)
        for k in range(ticks):
            self.osc(self.jacobian(begun + minimum_jerk((k + 1) / ticks) * (q - begun))[0])

    def take_hold(self, dt: float) -> None:
        """By OSC."""
        from robosuite_two_arm_lift import ABOVE, grasp_poses

        world, at = self.world, grasp_poses(self.world)
        above = [pin.SE3(X.rotation, X.translation + np.array([0.0, 0.0, ABOVE])) for X in at]
        for goals, lasts in ((above, 1.0), (at, 0.7)):
            begun = [world.hand(arm) for arm in world.arms]
            for k in range(round((lasts + 3.0) / dt)):
                hands = zip(world.arms, goals, strict=True)
                off = [np.linalg.norm(world.hand(a).translation - X.translation) for a, X in hands]
                if k * dt >= lasts and max(off) < 1e-3:
                    break  # until then they lag behind
                s = minimum_jerk((k + 1) * dt / lasts)
                self.osc([pin.SE3.Interpolate(a, b, s) for a, b in zip(begun, goals, strict=True)])
        world.grip = dict.fromkeys(world.arms, 1.0)
        for _ in range(round(0.5 / dt)):
            self.osc(at)
        for _ in range(round(YIELD / dt)):
            self.osc([world.hand(arm) for arm in world.arms])

    def osc(self, goals: list[pin.SE3], mass: float = 0.0) -> None:
        """A step of robosuite's OSC; its springs are drawn out by half of the weight."""
        M, action = self.world.inertia(), []
        _, J = self.jacobian(np.atleast_2d(self.world.read())[0])
        for i, X in enumerate(goals):
            up = J[6 * i : 6 * i + 3] @ np.linalg.solve(M, J[6 * i : 6 * i + 3].T)
            p = X.translation + up @ [0.0, 0.0, mass * 9.81 / len(goals) / OSC_KP]
            action += [*p, *pin.log3(X.rotation)]
        self.world.step(np.array(action))


def follower(
    law: str, world: RobosuiteWorld, hands: Hands, scenario: Any, way: Any, mass: float
) -> tuple[Any, coopqp.OnlineLoop | None]:
    """A function that does one step of a law at a time, and the loop, if it is one of ours."""
    q = np.atleast_2d(world.read())[0].copy()
    if law in ("qp", NO_OBSERVER, "pseudoinverse", "torque_qp"):
        observer = Observer(
            enabled=law != NO_OBSERVER, inertial_stiffness=world.kp, object_compensated=1.0,
            dead_band=world.dead_band,
        )  # fmt: skip
        law = law.removesuffix(", no observer")
        loop = world.loop(scenario, law, observer=observer)

        def ours(t: float) -> None:
            command = loop.tick(world.read(), {POT: way(t)} if scenario.inputs else None)
            if loop.stopped:
                raise RuntimeError(loop.stopped)
            if command.tau is not None:
                world.apply(command.tau)
            else:
                world.write(loop.setpoint, command.v, hands.load(loop.setpoint, mass))

        return ours, loop
    held = [world.object.actInv(world.hand(arm)) for arm in world.arms]

    def goals(t: float) -> list[pin.SE3]:
        return [way(t) * X for X in held]

    if law == "OSC":
        return (lambda t: hands.osc(goals(t), mass)), None

    def each(t: float) -> None:
        q[:] = reaching(hands.robot, goals(t), q, steps=3)
        world.write(q, np.zeros_like(q), hands.load(q, mass))

    return each, None


class Watch:
    """What is measured while the pot is carried."""

    def __init__(self, world: RobosuiteWorld) -> None:
        self.world, self.begun = world, world.object
        self.held = [world.object.actInv(world.hand(arm)) for arm in world.arms]
        self.touched = self.touching()
        self.force, self.slip, self.shift, self.tilt, self.over = [], 0.0, 0.0, 0.0, []
        motors = range(world.model.nu)
        own = [i for i in motors if "gripper" not in world.model.actuator(i).name]
        self.motors, self.range = own, world.model.actuator_ctrlrange[own]
        rows = [world.model.joint(name) for name in world.joints]
        self.q = [row.qposadr[0] for row in rows]
        self.limits = np.array([row.range for row in rows])

    def touching(self) -> Array:
        """Where each hand's pads are at the pot, in its axes, shape (N, 3)."""
        places, pot = self.world.data.geom_xpos, self.world.object
        middles = [places[pads].mean(axis=0) for pads in self.world.pads]
        return np.asarray((middles - pot.translation) @ pot.rotation)

    def look(self) -> None:
        world, pot = self.world, self.world.object
        one, two = world.hand_wrench().reshape(-1, 6)[:, :3]
        self.force.append(float(np.linalg.norm(one - two)) / 2.0)
        for arm, X in zip(world.arms, self.held, strict=True):
            off = pot.actInv(world.hand(arm)).translation - X.translation
            self.shift = max(self.shift, float(np.linalg.norm(off)))
        slid = np.linalg.norm(self.touching() - self.touched, axis=1)
        self.slip = max(self.slip, float(slid.max()))
        up = float(np.clip(pot.rotation[2] @ self.begun.rotation[2], -1.0, 1.0))
        self.tilt = max(self.tilt, float(np.degrees(np.arccos(up))))
        u, q = world.data.ctrl[self.motors], world.data.qpos[self.q]
        full = (np.abs(u) >= 0.999 * np.abs(self.range[:, 1])).any()
        self.over.append(
            bool(full or (q < self.limits[:, 0]).any() or (q > self.limits[:, 1]).any())
        )

    def found(self, success: bool) -> dict[str, Any]:
        force = float(np.percentile(self.force, 95)) if self.force else np.nan
        return {"success": success, "force": force, "slip": 1e3 * self.slip,
                "shift": 1e3 * self.shift, "tilt": self.tilt,
                "over": 100.0 * float(np.mean(self.over)) if self.over else np.nan}  # fmt: skip


def table(found: list[dict[str, Any]]) -> str:
    """In Markdown."""
    lines = ["| variant | law | lifted | internal force N | slip mm | shift mm | tilt deg "
             "| at limits % |", "|---|---|---|---|---|---|---|---|"]  # fmt: skip
    for variant in VARIANTS:
        for law in LAWS:
            runs = [x for x in found if (x["variant"], x["law"]) == (variant, law)]
            if runs:
                kinds = "force", "slip", "shift", "tilt", "over"
                middle = {kind: np.median([x[kind] for x in runs]) for kind in kinds}
                lines.append(
                    f"| {variant} | {law} | {sum(x['success'] for x in runs)}/{len(runs)} "
                    f"| {middle['force']:.1f} | {middle['slip']:.2f} "
                    f"| {middle['shift']:.1f} | {middle['tilt']:.1f} "
                    f"| {middle['over']:.0f} |"
                )
    return "\n".join(lines)


def differences(found: list[dict[str, Any]]) -> str:
    """Of qp from the others on the same seeds: means with their 95 % intervals, by bootstrap.

    An interval beyond zero says that qp has less, or more.
    """
    rng, by = np.random.default_rng(0), {(x["variant"], x["law"], x["seed"]): x for x in found}
    lines = ["", "| variant | qp - | seeds | force N | slip mm |", "|---|---|---|---|---|"]
    for variant in VARIANTS:
        for law in LAWS:
            pairs = [(x, by[variant, law, seed]) for (v, own, seed), x in by.items()
                     if (v, own) == (variant, "qp") and (variant, law, seed) in by]  # fmt: skip
            if law == "qp" or len(pairs) < MEANT:
                continue
            drawn, cells = rng.integers(len(pairs), size=(4000, len(pairs))), []
            for kind in ("force", "slip"):
                off = np.array([x[kind] - other[kind] for x, other in pairs])
                low, high = np.percentile(off[drawn].mean(axis=1), [2.5, 97.5])
                cells.append(f"{off.mean():+.2f} ({low:+.2f} to {high:+.2f})")
            lines.append(f"| {variant} | {law} | {len(pairs)} | {' | '.join(cells)} |")
    return "\n".join(lines)


if __name__ == "__main__":
    main()
