"""Bodies of robots from files: distances against coal alone, pairs, notes, and that they hold.

The long versions, 1,000 poses and 500 goals a robot, are ``benchmarks/collisions.py``.
"""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from collision_robots import CASES, Oracle, bodies_of_rows
from scenario_files import needs_robots

from coopqp.base.errors import InvalidValueError
from coopqp.base.qp import names_of
from coopqp.grasps import Rigid
from coopqp.limits import SelfCollision
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.grasp_configuration import HeldObject
from coopqp.robot import RobotModel
from coopqp.robot_files.selection import ArmJoints
from coopqp.robots import Mjcf, Urdf

BENCHMARK = Path(__file__).parents[2] / "benchmarks" / "collisions.py"


def benchmark() -> ModuleType:
    spec = importlib.util.spec_from_file_location("collisions", BENCHMARK)
    assert spec
    assert spec.loader
    module = sys.modules["collisions"] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


# ---- robots from their own files -------------------------------------------------------------


@needs_robots
@pytest.mark.parametrize("name", CASES)
def test_distances_are_those_of_coal_alone(name: str) -> None:
    case = CASES[name]
    chain = case.chain()
    limit, oracle = SelfCollision(distance=0.0, ignore=case.ignore), Oracle(case, chain)
    pairs = bodies_of_rows(limit, chain)
    q = chain.sample(np.random.default_rng(7), 6)
    margins = limit.margins(chain, q, np.zeros((5, chain.n)), 0.01)
    assert len(pairs) == len(margins) > 100
    for row, d in zip(q[1:], np.array(list(margins.values())).T, strict=True):
        oracle.place(row)
        by_coal = [oracle.distance(*pair) for pair in pairs]
        assert d == pytest.approx(by_coal, abs=5e-6)


@pytest.mark.few(1)
@needs_robots
@pytest.mark.parametrize(
    ("name", "kind", "goals"),
    [("two UR5", "free", 2), ("two UR5", "holding", 2), ("PR2", "free", 1)],
)
def test_arms_driven_together_stay_apart(name: str, kind: str, goals: int) -> None:
    """Nearer than asked by what a tick bends the path: a millimetre at full speed at most."""
    found = getattr(benchmark(), kind)(name, goals, 10.0, 60)
    assert -1e-3 < min(found.margin) < 2e-3  # they did meet
    assert found.by_coal == pytest.approx(found.margin, abs=5e-6)
    assert found.stuck == 0


# ---- which pairs there are -------------------------------------------------------------------


@needs_robots
def test_pairs_of_two_robots_carry_their_names() -> None:
    chain = CASES["two UR5"].chain()
    pairs = {frozenset(pair) for pair in bodies_of_rows(SelfCollision(), chain)}
    assert frozenset(("left/forearm_link", "right/base_link")) in pairs
    assert frozenset(("left/wrist_2_link", "right/wrist_2_link")) in pairs
    assert frozenset(("left/shoulder_link", "right/base_link")) in pairs  # each other's bases
    assert frozenset(("left/shoulder_link", "left/base_link")) not in pairs  # neighbours
    assert frozenset(("left/wrist_3_link", "right/wrist_3_link")) not in pairs  # fixed by grasps
    assert frozenset(("object", "left/forearm_link")) in pairs
    assert frozenset(("object", "left/wrist_2_link")) not in pairs  # before the hand


@needs_robots
def test_what_touches_by_construction_is_left_out_and_said() -> None:
    chain = CASES["PR2"].chain()
    (note,) = SelfCollision().notes(chain)
    assert "10 pairs that touch by construction (l_forearm_link and l_gripper_palm_link" in note
    pairs = {frozenset(pair) for pair in bodies_of_rows(SelfCollision(), chain)}
    assert frozenset(("l_forearm_link", "l_gripper_palm_link")) not in pairs
    assert frozenset(("torso_lift_link", "l_forearm_link")) in pairs
    everything = SelfCollision(pairs=(("l_forearm_link", "l_gripper_palm_link"),))
    assert len(bodies_of_rows(everything, chain)) == 1


@needs_robots
def test_bodies_that_start_in_each_other_are_told_with_a_line_to_paste() -> None:
    case = CASES["Baxter"]
    (fault,) = SelfCollision().start_faults(case.chain())
    assert "left_upper_forearm_visual and left_wrist 28.4 mm" in fault
    assert "'ignore: [[left_upper_forearm_visual, left_wrist], [right_upper" in fault
    assert not SelfCollision(ignore=case.ignore).start_faults(case.chain())


@needs_robots
def test_pairs_and_ignored_pairs_may_be_patterns() -> None:
    chain = CASES["PR2"].chain()
    without = SelfCollision(ignore=(("*finger*", "*"), ("object", "*")))
    names = {name for pair in bodies_of_rows(without, chain) for name in pair}
    assert not any("finger" in name or name == "object" for name in names)
    some = bodies_of_rows(SelfCollision(pairs=(("l_*forearm*", "r_*forearm*"),)), chain)
    assert len(some) == 4
    with pytest.raises(InvalidValueError, match="fixed to each other"):
        SelfCollision(pairs=(("l_gripper_l_finger*", "l_gripper_palm_link"),)).rows(chain)


# ---- files -----------------------------------------------------------------------------------

TWO_LINKS = """
<robot name="pair">
  <link name="base"><collision><geometry><box size="0.2 0.2 0.1"/></geometry></collision></link>
  {arms}
</robot>
"""
ARM = """
<link name="{s}_one"/><link name="{s}_two">
  <collision><origin xyz="0 0 0.2"/><geometry><sphere radius="0.05"/></geometry></collision>
  <collision><origin xyz="0 0 0.4"/><geometry><cylinder radius="0.02" length="0.1"/></geometry>
  </collision>
  <collision><geometry><mesh filename="lost.stl"/></geometry></collision>
  <collision><geometry><box size="0.1 0 0.1"/></geometry></collision>
</link>
<joint name="{s}_a" type="revolute"><parent link="base"/><child link="{s}_one"/>
  <origin xyz="0 {y} 0.3"/><axis xyz="0 0 1"/><limit lower="-2" upper="2" effort="1" velocity="1"/>
</joint>
<joint name="{s}_b" type="revolute"><parent link="{s}_one"/><child link="{s}_two"/>
  <axis xyz="1 0 0"/><limit lower="-2" upper="2" effort="1" velocity="1"/></joint>
"""


def held(robot: RobotModel) -> ClosedChain:
    q = np.zeros(robot.model.nq)
    return ClosedChain.attach(robot, q, Rigid(), HeldObject(size=(0.02, 0.02, 0.02)))


def urdf(folder: Path, arm: str = ARM) -> RobotModel:
    file = folder / "pair.urdf"
    arms = "".join(arm.format(s=side, y=y) for side, y in (("r", -0.3), ("l", 0.3)))
    file.write_text(TWO_LINKS.format(arms=arms))
    arms_of = {side: ArmJoints(tip=f"{side}_two") for side in ("r", "l")}
    return Urdf(path=file, arms=arms_of).build()


def test_parts_of_a_link_have_numbers_and_what_cannot_be_one_is_said(tmp_path: Path) -> None:
    chain, limit = held(urdf(tmp_path)), SelfCollision(pairs=(("r_two", "base"),))
    assert bodies_of_rows(limit, chain) == [("r_two", "base"), ("r_two[2]", "base")]
    notes = limit.notes(chain)
    assert any("does not see r_two: mesh lost.stl: there is no such file" in n for n in notes)
    assert any("r_two: box: found size [0.1, 0.0, 0.1], needs more than 0" in n for n in notes)
    q = np.zeros((2, chain.n))
    ball, rod = limit.margins(chain, q, np.zeros((1, chain.n)), 0.01).values()
    # The ball's middle is 0.45 m above the base's upper side, 0.2 m beside its edge.
    assert ball[0] + 0.01 == pytest.approx(np.hypot(0.45, 0.2) - 0.05, abs=2e-6)
    assert rod[0] + 0.01 == pytest.approx(np.hypot(0.6, 0.18), abs=2e-6)


def test_a_robot_without_collision_geometry_is_refused(tmp_path: Path) -> None:
    bare = ARM.split("<collision>")[0] + "</link>" + ARM.split("</link>")[1]
    robot = urdf(tmp_path, bare)
    chain = held(RobotModel(name="bare", model=robot.model, arms=robot.arms))
    with pytest.raises(InvalidValueError, match="robot bare has no collision geometry; leave"):
        SelfCollision().rows(chain)


def test_geoms_of_mjcf_are_bodies(tmp_path: Path) -> None:
    """Those that only collide too, but none that are only looked at."""
    body = """
    <body name="{s}_one" pos="0 {y} 0.3">
      <joint name="{s}_a" axis="1 0 0" range="-90 90"/>
      <geom type="capsule" fromto="0 0 0.1 0 0 0.3" size="0.03" group="3"/>
      <geom type="sphere" size="0.5" contype="0" conaffinity="0"/>
      <body name="{s}_two" pos="0 0 0.4">
        <joint name="{s}_b" axis="1 0 0" range="-90 90"/><geom type="box" size="0.05 0.05 0.1"/>
      </body>
    </body>"""
    bodies = "".join(body.format(s=side, y=y) for side, y in (("r", -0.3), ("l", 0.3)))
    file = tmp_path / "pair.xml"
    file.write_text(
        f'<mujoco><worldbody><geom name="floor" type="plane" size="1 1 1"/>{bodies}</worldbody>'
        "</mujoco>"
    )
    arms = {side: ArmJoints(tip=f"{side}_two") for side in ("r", "l")}
    chain = held(Mjcf(path=file, arms=arms).build())
    limit = SelfCollision(pairs=(("r_one", "l_one"), ("r_one", "l_two")))
    margins = limit.margins(chain, np.zeros((2, chain.n)), np.zeros((1, chain.n)), 0.01)
    found = [float(d[0]) + 0.01 for d in margins.values()]
    assert found == pytest.approx([0.6 - 0.06, np.hypot(0.6 - 0.05, 0.0) - 0.03], abs=2e-6)


def test_meshes_of_one_link_are_one_hull(tmp_path: Path) -> None:
    """Two cubes, one 60 cm above the other: what lies between them counts too."""
    corners = [(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]
    sides = [(1, 2, 4), (1, 4, 3), (5, 6, 8), (5, 8, 7), (1, 2, 6), (1, 6, 5)]
    lines = [f"v {x} {y} {z}" for x, y, z in corners] + [f"f {a} {b} {c}" for a, b, c in sides]
    (tmp_path / "cube.obj").write_text("\n".join(lines))
    cube = '<geometry><mesh filename="cube.obj" scale="0.05 0.05 0.05"/></geometry></collision>'
    at = [f'<collision><origin xyz="0 0 {z}"/>{cube}' for z in (-0.3, 0.3)]
    arm = ARM.split("<collision>")[0] + "".join(at) + "</link>" + ARM.split("</link>")[1]
    chain, limit = held(urdf(tmp_path, arm)), SelfCollision(pairs=(("r_two", "l_two"),))
    assert bodies_of_rows(limit, chain) == [("r_two", "l_two")]
    (d,) = limit.margins(chain, np.zeros((2, chain.n)), np.zeros((1, chain.n)), 0.01).values()
    assert d[0] + 0.01 == pytest.approx(0.6 - 0.1, abs=2e-6)
    q = np.zeros(chain.n)
    q[chain.joint_names.index("l_b")] = np.pi / 2  # its end now points at the other's middle
    (d,) = limit.margins(chain, np.vstack([q, q]), np.zeros((1, chain.n)), 0.01).values()
    assert d[0] + 0.01 == pytest.approx(0.6 - 0.35 - 0.05, abs=2e-6)


def test_one_arm_of_a_robot_can_let_go(chain: ClosedChain) -> None:
    """Hands that both hold are fixed to each other, those of which one has let go are not."""
    both, one = (names_of(SelfCollision().rows(c)) for c in (
        chain, chain.handed_over(chain.q_start, ["left"])
    ))  # fmt: skip
    assert set(one) - set(both) == {"limit.self_collision[RHand|LHand]"}
