"""The adapter of robosuite on a stand-in for its environments: an object lies on two hands."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from coopqp.adapters.robosuite import RobosuiteWorld
from coopqp.base.errors import InvalidValueError
from coopqp.base.spec import Pose
from coopqp.controllers import QPController
from coopqp.grasps import Rigid
from coopqp.model.grasp_configuration import HeldObject
from coopqp.model.loop_observer import Observer
from coopqp.online.loop import OnlineLoop
from coopqp.robots import Mjcf
from coopqp.scenario.scenario import Scenario
from coopqp.tasks import PointOnPoint

MASS = 2.0
HAND = """
<body name="robot{i}_base" pos="0 {y} 0">
  <body name="robot{i}_link"><joint name="robot{i}_joint1" type="slide" axis="0 0 1" range="-1 1"/>
    <body name="gripper{i}"><geom name="pad{i}" type="box" size=".1 .1 .01" mass="1"/>
      <site name="gripper{i}_grip_site"/></body></body></body>
"""
SCENE = f"""
<mujoco><option timestep="0.002" cone="elliptic"/><worldbody>
  {HAND.format(i=0, y=-0.3)}{HAND.format(i=1, y=0.3)}
  <body name="pot_root" pos="0 0.1 0.06"><freejoint/>
    <geom type="box" size=".05 .45 .05" mass="{MASS}"/></body>
</worldbody><actuator>
  <motor name="m0" joint="robot0_joint1" ctrlrange="-50 50"/>
  <motor name="m1" joint="robot1_joint1" ctrlrange="-70 70"/>
</actuator></mujoco>
"""


class _Env:
    """What the adapter uses of an environment with two one-armed robots, by torques."""

    def __init__(self, scene: str = SCENE) -> None:
        self.mujoco: Any = pytest.importorskip("mujoco")
        model = self.mujoco.MjModel.from_xml_string(scene)
        data = self.mujoco.MjData(model)
        self.sim = SimpleNamespace(
            model=SimpleNamespace(_model=model, get_xml=lambda: scene),
            data=SimpleNamespace(_data=data),
            forward=lambda: self.mujoco.mj_forward(model, data),
        )
        self.robots = [self._robot(i) for i in range(2)]
        self.grips: list[float] = []
        self.control_freq = 100.0

    def _robot(self, i: int) -> Any:
        sites = {"grip_site": f"gripper{i}_grip_site"}
        geoms = {"left_fingerpad": [f"pad{i}"], "right_fingerpad": []}
        gripper = SimpleNamespace(
            root_body=f"gripper{i}", important_sites=sites, important_geoms=geoms, dof=1
        )
        return SimpleNamespace(
            arms=["right"],
            gripper={"right": gripper},
            robot_model=SimpleNamespace(joints=[f"robot{i}_joint1"]),
            create_action_vector=lambda a: np.concatenate([a["right"], a["right_gripper"]]),
        )

    def step(self, action: Any) -> tuple[dict[str, Any], float, bool, dict[str, Any]]:
        model, data = self.sim.model._model, self.sim.data._data
        data.ctrl[:], self.grips = action[::2], action[1::2].tolist()
        for _ in range(5):
            self.mujoco.mj_step(model, data)
        return {}, 0.0, False, {}


@pytest.fixture
def world() -> RobosuiteWorld:
    return RobosuiteWorld(_Env(), by_torques=True, kp=900.0)


def test_hands_bear_the_weight_by_their_contacts(world: RobosuiteWorld) -> None:
    weight = MASS * 9.81
    share = weight * np.array([0.2, 0.4]) / 0.6  # of an object that lies 0.1 m off the middle
    for _ in range(300):
        world.write(np.zeros(2), np.zeros(2), share)
    w = world.hand_wrench().reshape(2, 6)
    np.testing.assert_allclose(w[:, :3].sum(axis=0), [0.0, 0.0, weight], atol=0.02 * weight)
    moment = sum(np.cross(world.hand(arm).translation - world.object.translation, f[:3]) + f[3:]
                 for arm, f in zip(world.arms, w, strict=True))  # fmt: skip
    np.testing.assert_allclose(moment, 0.0, atol=0.1)
    assert np.abs(world.read()).max() < 5e-3


def test_hands_that_give_way_go_on_where_they_are_pushed_to(world: RobosuiteWorld) -> None:
    for _ in range(100):
        world.write(np.zeros(2), np.zeros(2))
    stays = world.read()[0]
    world.give_way(20)
    gone = world.read()[0] - stays
    assert (gone < 0.5 * stays).all()  # they hold the object's weight no longer
    assert (gone > -0.04).all()  # not faster than 0.2 m/s, as their damping has it


def test_a_first_link_that_is_freed_touches_all_but_its_base() -> None:
    scene, block = SCENE, '<geom type="box" size=".05 .05 .05" pos="0 0 0"/>'
    for i in range(2):
        link = f'<body name="robot{i}_link">'
        hand = f'<body name="gripper{i}">'
        scene = scene.replace(link, block + link).replace(hand, block + hand)
    world = RobosuiteWorld(_Env(scene))

    def touching() -> set[frozenset[str]]:
        model, data = world.model, world.data
        world.env.mujoco.mj_forward(model, data)
        bodies = model.geom_bodyid[data.contact.geom].tolist()
        return {frozenset(model.body(body).name for body in pair) for pair in bodies}

    held = {frozenset({f"robot{i}_link", "pot_root"}) for i in range(2)}
    stuck = {frozenset({f"robot{i}_base", f"robot{i}_link"}) for i in range(2)}
    world.data.qpos[-5] = 0.09
    assert held | stuck <= touching()
    world.free_first_joints()
    assert held <= touching()
    assert not stuck & touching()


def test_the_robot_has_the_motors_limits_and_robosuites_names(
    world: RobosuiteWorld, tmp_path: Path
) -> None:
    robot = world.robot(tmp_path, speed=1.5).build()
    assert robot.joint_names == world.joints == ("robot0_joint1", "robot1_joint1")
    assert [arm.name for arm in robot.arms] == list(world.arms) == ["robot0", "robot1"]
    np.testing.assert_allclose(robot.model.effortLimit, [50.0, 70.0])
    np.testing.assert_allclose(robot.model.velocityLimit, 1.5)


def test_each_gripper_is_told_its_own(world: RobosuiteWorld) -> None:
    world.grip["robot1"] = 1.0
    world.apply(np.zeros(2))
    assert world.env.grips == [-1.0, 1.0]


def test_pads_are_those_of_each_hand(world: RobosuiteWorld) -> None:
    assert world.pads == [[world.model.geom(f"pad{i}").id] for i in range(2)]


def test_joints_stand_off_by_what_friction_bears_of_their_servos() -> None:
    hand = 'axis="0 0 1"'
    for friction, off in ((0.2, 0.0), (3.0, 0.01)):  # at kp = 300 and 1 kg
        scene = SCENE.replace(hand, f'{hand} frictionloss="{friction}"')
        band = RobosuiteWorld(_Env(scene)).dead_band
        assert band == pytest.approx({f"robot{i}_joint1": off for i in range(2)} if off else {})


def test_a_loop_begins_with_hands_that_hold_the_object_at_the_environments_rate(
    world: RobosuiteWorld, tmp_path: Path
) -> None:
    robot = world.robot(tmp_path)
    given = {
        "name": "lift", "robot": robot, "grasps": Rigid(), "duration": 1.0,
        "start": dict.fromkeys(world.joints, 0.0), "controllers": {"qp": QPController()},
        "held": HeldObject(mass=MASS, pose=Pose(position=(0.0, 0.1, 0.06))),
        "tasks": (PointOnPoint(goal=(0.0, 0.1, 0.07)),),
    }  # fmt: skip

    def loop(dt: float = 0.01, **more: Any) -> OnlineLoop:
        return world.loop(Scenario(**{**given, **more}, dt=dt))

    world.data.qpos[-5] = 0.08
    world.env.sim.forward()
    with pytest.raises(InvalidValueError, match=r"^grasps: .* robot0 .* does not touch"):
        loop()
    for _ in range(100):
        world.write(np.zeros(2), np.zeros(2))
    with pytest.raises(InvalidValueError, match=r"^dt: found 0.005; .* control_freq=200"):
        loop(dt=0.005)
    arms = dict(zip(("left", "right"), robot.arms.values(), strict=True))
    with pytest.raises(InvalidValueError, match=r"^robot: has .* of (left|right), .*take world"):
        loop(robot=Mjcf(path=robot.path, arms=arms, joint_limits=robot.joint_limits))
    begun = loop(observer=Observer(most=0.02, stiffness=80.0))
    assert begun.law.observer.settings == Observer(
        most=0.02, inertial_stiffness=900.0, dead_band={}
    )
    for _ in range(60):
        begun.tick(world.read()[0])
        world.write(begun.setpoint, begun.command.v, 0.5 * MASS * 9.81 * np.ones(2))
    assert not begun.stopped
    assert world.object.translation[2] > 0.06
    world.env.sim.data = SimpleNamespace(_data=world.env.mujoco.MjData(world.model))
    with pytest.raises(InvalidValueError, match=r"^env: was reset since; call world.find"):
        loop()


def test_robosuite_is_not_imported() -> None:
    code = "import coopqp.adapters.robosuite, sys; sys.exit('robosuite' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
