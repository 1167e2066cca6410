"""What self_collision and obstacles cannot watch is said wherever a run is said to be good."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from collision_robots import bodies_of_rows

import coopqp
from coopqp.execution.comparison import Comparison
from coopqp.grasps import Rigid
from coopqp.limits import SelfCollision
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.grasp_configuration import HeldObject
from coopqp.report.page import render
from coopqp.robots import Mjcf

WORLD = """<mujoco model="duo"><compiler angle="degree"/>
<default><default class="col"><geom group="3"/></default></default>
<asset><mesh name="palm" vertex="0 0 0 .1 0 0 0 .1 0 0 0 .1"/>
<mesh name="lost" file="lost.stl"/><hfield name="hills" nrow="2" ncol="2" size="1 1 1 1"/></asset>
<worldbody>
<geom name="floor" type="plane" size="2 2 .1"/>
<geom name="column" type="box" size=".05 .05 .2" pos="0 0 .2"/>
<geom type="sphere" size=".05" pos="0 0 1"/>
<geom name="{clash}" type="sphere" size=".05" pos="0 0 2"/>
<geom name="ground" type="hfield" hfield="hills" pos="0 0 -2"/>
{arms}
</worldbody></mujoco>"""
ARM = """<body name="{s}_base" pos="0 {y} .4"><joint name="{s}_pan" axis="0 0 1" range="-90 90"/>
<geom type="capsule" size=".03" fromto="0 0 0 .2 0 0"/>
<body name="{s}_hand" pos=".3 0 0"><joint name="{s}_lift" axis="0 1 0" range="-90 90"/>
<geom class="col" size=".04" pos=".05 0 0"/>{more}</body></body>"""


def write(folder: Path, more: str = "") -> Path:
    arms = "".join(ARM.format(s=s, y=y, more=more) for s, y in (("right", -0.3), ("left", 0.3)))
    path = folder / "duo.xml"
    path.write_text(WORLD.format(arms=arms, clash="right_hand"), encoding="utf-8")
    return path


def chain_of(path: Path) -> ClosedChain:
    robot = Mjcf(path=path, arms={"right": "right_hand", "left": "left_hand"}).build()
    held = HeldObject(size=(0.02, 0.02, 0.02))
    return ClosedChain.attach(robot, np.zeros(robot.model.nq), Rigid(), held)


def test_geoms_of_the_world_have_their_own_names(tmp_path: Path) -> None:
    """All of them were one body, 'world/', and could not be told apart."""
    chain = chain_of(write(tmp_path))
    pairs = SelfCollision(pairs=(("right_hand", "column"), ("left_hand", "geom_3")))
    assert bodies_of_rows(pairs, chain) == [("right_hand", "column"), ("left_hand", "geom_3")]
    q = np.zeros((2, chain.n))
    to_column, to_ball = pairs.margins(chain, q, np.zeros((1, chain.n)), 0.01).values()
    # The hand's middle is at (0.35, -0.3, 0.4); the column's top is at z = 0.4, its edge at 0.05.
    assert to_column[0] + 0.01 == pytest.approx(np.hypot(0.3, 0.25) - 0.04, abs=2e-6)
    assert to_ball[0] + 0.01 == pytest.approx(np.hypot(np.hypot(0.35, 0.3), 0.6) - 0.09, abs=2e-6)
    ignored = SelfCollision(ignore=(("column", "*"),))
    assert not any("column" in pair for pair in bodies_of_rows(ignored, chain))
    # What has the name of a body already is told apart from it.
    assert any("world/right_hand" in pair for pair in bodies_of_rows(SelfCollision(), chain))


def test_what_no_body_is_made_of_is_told(tmp_path: Path) -> None:
    more = '<geom type="mesh" mesh="{}"/>'
    notes = SelfCollision().notes(chain_of(write(tmp_path, more.format("palm"))))
    assert "self_collision does not see ground: a geom of type hfield is not read" in notes
    assert (
        sum("_hand: mesh palm: is given by vertices, which are not read" in n for n in notes) == 2
    )
    notes = SelfCollision().notes(chain_of(write(tmp_path, more.format("lost"))))
    path = tmp_path.resolve() / "lost.stl"
    why = f"mesh {path}: cannot be read: No such file or directory"
    assert f"self_collision does not see left_hand: {why}" in notes


def test_geoms_that_only_look_are_no_loss(tmp_path: Path) -> None:
    looks = '<geom type="mesh" mesh="palm" contype="0" conaffinity="0"/>'
    notes = SelfCollision().notes(chain_of(write(tmp_path, looks)))
    assert not any("palm" in note for note in notes)


def test_bodies_that_are_not_drawn_are_told(tmp_path: Path) -> None:
    robot = Mjcf(path=write(tmp_path), arms={"right": "right_hand", "left": "left_hand"}).build()
    assert any("groups above 2 (right_hand, left_hand)" in line for line in robot.warnings)


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Comparison:
    """A mesh behind a package that is nowhere."""
    folder = tmp_path_factory.mktemp("unseen")
    arms = "".join(
        f'<link name="{s}0"><collision><geometry><sphere radius="0.02"/></geometry></collision>'
        f'<collision><geometry><mesh filename="package://{s}/hand.stl"/></geometry></collision>'
        f'</link><joint name="{s}" type="revolute"><parent link="base"/><child link="{s}0"/>'
        f'<origin xyz="0 {y} 0"/><axis xyz="1 0 0"/>'
        '<limit lower="-1" upper="1" velocity="1" effort="1"/></joint>'
        for s, y in (("r", -0.3), ("l", 0.3))
    )
    wall = (
        '<link name="base"/><link name="wall"><collision><geometry><box size="1 1 0.1"/></geometry>'
        '</collision></link><joint name="fixed" type="fixed"><parent link="base"/>'
        '<child link="wall"/><origin xyz="0 0 -1"/></joint>'
    )
    (folder / "r.urdf").write_text(f'<robot name="r">{wall}{arms}</robot>', "utf-8")
    (folder / "s.yaml").write_text(
        "robot: {urdf: {path: r.urdf, arms: {right: r0, left: l0}}}\n"
        "start: {right: [0], left: [0]}\nobject: {size: [0.1, 0.1, 0.1]}\n"
        "tasks: [minimum_velocity]\ncontrollers: [qp]\nduration: 0.02\n"
        "limits: [joint_position, joint_velocity, self_collision]\n",
        "utf-8",
    )
    return coopqp.compare(coopqp.load(folder / "s.yaml"))


def test_a_verdict_does_not_say_that_every_limit_is_kept_where_some_is_not_watched(
    run: Comparison,
) -> None:
    said = run.verdicts["qp"]
    assert "keeps every limit as far as it is watched: self_collision does not see r0" in said
    assert "and 1 more, see the notes" in said


def test_the_page_and_the_metrics_have_the_notes(run: Comparison) -> None:
    note = "self_collision does not see r0: mesh package://r/hand.stl: there is no such file"
    assert [line for line in run.as_json()["notes"] if line.startswith(note)]
    assert note in render(run)
