"""robosuite's TwoArmLift from reset to put-down: reach, take hold, lift, put down, let go.

    sh benchmarks/robosuite_env.sh                                  # once, 1.8 GB
    .robosuite/bin/python examples/robosuite_two_arm_lift.py --robots Panda Panda --seed 0

The hands go to the handles each by itself; from there on the QP moves both arms, on its servos.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable

import numpy as np
import pinocchio as pin

import coopqp
from coopqp.adapters.robosuite import RobosuiteWorld, controllers
from coopqp.base.spec import Array, Pose
from coopqp.controllers import Pseudoinverse, QPController, TorqueQp
from coopqp.grasps import Rigid
from coopqp.model.grasp_configuration import HeldObject
from coopqp.scenario.scenario import Scenario
from coopqp.signals import Waypoints
from coopqp.tasks import Pose as PoseTask

DT, ABOVE, YIELD = 0.01, 0.08, 1.0  # s; m, from where hands go down; s, while closed ones give way
LAWS = QPController(name="qp"), TorqueQp(name="torque_qp"), Pseudoinverse(name="pseudoinverse")
Way = Callable[[float], pin.SE3]


def minimum_jerk(s: float) -> float:
    s = min(max(s, 0.0), 1.0)
    return s**3 * (10.0 - 15.0 * s + 6.0 * s**2)


def grasp_poses(world: RobosuiteWorld) -> list[pin.SE3]:
    """Of the hands with the bars amid their pads: z down, fingers closing across, the pot's y."""
    found, z = [], np.array([0.0, 0.0, -1.0])
    across = world.object.rotation[:, 1] * [1.0, 1.0, 0.0]
    for i, arm in enumerate(world.arms):
        x = across * np.sign(across @ world.hand(arm).rotation[:, 0]) / np.linalg.norm(across)
        pads = world.data.geom_xpos[world.pads[i]].mean(axis=0)
        place = world.data.site(f"pot_handle{i}").xpos - world.hand(arm).actInv(pads)[2] * z
        found.append(pin.SE3(np.column_stack([x, np.cross(z, x), z]), place))
    return found


def reaching(robot: coopqp.RobotModel, hands: list[pin.SE3], q: Array, steps: int = 300) -> Array:
    """Joints with the hands there, by damped least squares from q."""
    model, q, rest = robot.model, q.copy(), q.copy()
    data, frames = model.createData(), [model.getFrameId(arm.tip) for arm in robot.arms]
    least, most = model.lowerPositionLimit + 0.02, model.upperPositionLimit - 0.02
    for _ in range(steps):
        pin.computeJointJacobians(model, data, q)
        pin.updateFramePlacements(model, data)
        J = np.vstack([pin.getFrameJacobian(model, data, f, pin.LOCAL) for f in frames])
        errors = [data.oMf[f].actInv(X) for f, X in zip(frames, hands, strict=True)]
        e, to_rest = np.concatenate([pin.log6(X).vector for X in errors]), 0.015 * (rest - q)
        back = J.T @ np.linalg.inv(J @ J.T + 1e-4 * np.eye(len(e)))
        q = np.clip(q + to_rest + back @ (0.3 * e - J @ to_rest), least, most)
    return q


def go(world: RobosuiteWorld, q: Array, time: float, dt: float = DT) -> Array:
    """Move all joints there, from where they are, and wait for them a second at most; returns q."""
    began, ticks = np.atleast_2d(world.read())[0], round(time / dt)
    for k in range(ticks + round(1.0 / dt)):
        if k >= ticks and np.abs(q - np.atleast_2d(world.read())[0]).max() < 1e-3:
            break  # hands that stop short hold less of the bar
        world.write(began + minimum_jerk((k + 1) / ticks) * (q - began), np.zeros_like(q))
    return q


def take_hold(world: RobosuiteWorld, robot: coopqp.RobotModel, dt: float = DT) -> None:
    """Reach from above, look, go down, close, and give way, so that hands no longer press."""
    at, data = grasp_poses(world), robot.model.createData()
    up = pin.SE3(np.eye(3), np.array([0.0, 0.0, ABOVE]))
    over = go(world, reaching(robot, [up * X for X in at], np.atleast_2d(world.read())[0]), 1.0, dt)
    pin.framesForwardKinematics(robot.model, data, np.atleast_2d(world.read())[0])
    hands = [data.oMf[robot.model.getFrameId(name)] for name in world.sites]  # as believed to be
    at = [H * world.hand(a).inverse() * X for a, H, X in zip(world.arms, hands, at, strict=True)]
    q = go(world, reaching(robot, at, over), 0.7, dt)
    world.grip = dict.fromkeys(world.arms, 1.0)
    go(world, q, 0.5, dt)
    world.give_way(round(YIELD / dt))


def scenario_of(
    world: RobosuiteWorld, robot: object, way: Way, duration: float, *, mass: float, dt: float = DT
) -> Scenario:
    """The pot goes along a way, held by both hands where they hold it now."""
    pot, place = world.model.body("pot_root"), world.object
    times = np.arange(0.0, duration - 0.01, 0.05)
    ways = [Pose(position=tuple(X.translation), rpy=tuple(pin.rpy.matrixToRpy(X.rotation)))
            for X in map(way, times)]  # fmt: skip
    R = pin.Quaternion(*pot.iquat).matrix()
    J, q = mass / pot.mass[0] * R @ np.diag(pot.inertia) @ R.T, np.atleast_2d(world.read())[0]
    return Scenario(
        name="two_arm_lift", robot=robot, grasps=Rigid(),
        start=dict(zip(world.joints, q.tolist(), strict=True)),
        held=HeldObject(
            size=(0.14, 0.14, 0.14), mass=mass, com=tuple(pot.ipos),
            inertia=tuple(J[np.triu_indices(3)]),
            pose=Pose(position=tuple(place.translation),
                      rpy=tuple(pin.rpy.matrixToRpy(place.rotation))),
        ),
        tasks=(PoseTask(goal=Waypoints(times=times.tolist(), values=ways), gain=5.0),),
        controllers={law.name: law for law in LAWS},
        dt=dt, duration=duration,
    )  # fmt: skip


def main() -> None:
    import robosuite

    ask = argparse.ArgumentParser()
    ask.add_argument("--robots", nargs="+", default=["Panda", "Panda"])
    ask.add_argument("--seed", type=int, default=0)
    given = ask.parse_args()
    env = robosuite.make(
        "TwoArmLift", robots=given.robots, env_configuration="opposed", seed=given.seed,
        controller_configs=[controllers(name) for name in given.robots], control_freq=round(1 / DT),
        has_renderer=False, has_offscreen_renderer=False, use_camera_obs=False, horizon=10_000,
    )  # fmt: skip
    world = RobosuiteWorld(env)
    world.free_first_joints()
    take_hold(world, (robot := world.robot("out")).build())
    begun, mass = world.object, float(world.model.body("pot_root").mass[0])

    def way(t: float) -> pin.SE3:
        up = minimum_jerk(t / 1.5) - minimum_jerk((t - 2.0) / 1.5)
        return pin.SE3(begun.rotation, begun.translation + np.array([0.0, 0.0, 0.15 * up]))

    scenario = scenario_of(world, robot, way, 4.0, mass=mass)
    loop, lifted = world.loop(scenario, "qp"), False
    for _ in range(scenario.ticks):
        command = loop.tick(world.read())
        world.write(loop.setpoint, command.v)
        lifted |= bool(env._check_success())
    world.grip = dict.fromkeys(world.arms, -1.0)
    go(world, loop.setpoint.copy(), 0.5)
    off = 1e3 * np.linalg.norm(world.object.translation - begun.translation)
    print(f"{loop.ticks} ticks, lifted: {lifted}, put down within {off:.1f} mm; {loop.note}")


if __name__ == "__main__":
    main()
