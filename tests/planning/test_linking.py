"""Windings of two arms that no free motion undoes."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from pathlib import Path

import linking
import numpy as np
import pytest
from side_by_side import needs_kernel

from coopqp.base.spec import Array
from coopqp.limits import Obstacles, SelfCollision
from coopqp.planning.closed_space import Budget, ClosedSpace
from coopqp.planning.linking import closed_line, writhe
from coopqp.planning.plan import Planner
from coopqp.planning.reach import WOUND, cut_off
from coopqp.scenario.loader import load
from coopqp.scenario.scenario import Scenario

pytestmark = needs_kernel

#: Of an arm that stands straight up: the heights of its joints, which twist and bend it in turns,
#: and how far a bend goes.
HEIGHTS, BEND = (0.2, 0.4, 0.6, 0.8, 1.0, 1.2, 1.35), 2.0


def _urdf(width: float) -> str:
    """An arm of boxes from a little below each joint to a little beyond the next one."""
    parts = [_link(0, 0.0, HEIGHTS[0], width)]
    for k, (z, end) in enumerate(zip(HEIGHTS, (*HEIGHTS[1:], 1.43), strict=True)):
        before, bends = (*HEIGHTS, 0.0)[k - 1], k % 2 == 1
        most, axis = (BEND, "0 1 0") if bends else (2.9, "0 0 1")
        parts.append(
            f'<joint name="j{k + 1}" type="revolute"><parent link="link{k}"/>'
            f'<child link="link{k + 1}"/><origin xyz="0 0 {z - before:.3f}"/><axis xyz="{axis}"/>'
            f'<limit lower="{-most}" upper="{most}" velocity="2" effort="100"/></joint>'
            + _link(k + 1, -0.05, end - z + 0.02, width)
        )
    return f'<robot name="boxes">{"".join(parts)}</robot>'


def _link(k: int, low: float, high: float, width: float) -> str:
    box = f'<box size="{width} {width} {high - low:.3f}"/>'
    origin = f'<origin xyz="0 0 {0.5 * (low + high):.3f}"/>'
    return f'<link name="link{k}"><collision>{origin}<geometry>{box}</geometry></collision></link>'


def _scenario(folder: Path, width: float = 0.08, bar: float = 0.22) -> Scenario:
    """Two such arms on a floor, which hold a bar."""
    (folder / "boxes.urdf").write_text(_urdf(width))
    path = folder / "boxes.yaml"
    path.write_text(
        """\
robot:
  several:
    robots:
      left: {robot: {urdf: {path: boxes.urdf, arms: {arm: link7}}}, position: [0, -0.4, 0]}
      right: {robot: {urdf: {path: boxes.urdf, arms: {arm: link7}}}, position: [0, 0.4, 0]}
object: {size: [BAR, 0.06, 0.06], pose: {position: [0.55, 0, 0.5], rpy_deg: [0, 0, 90]}}
grasps:
  left/arm: {rigid: {object_in_hand: {position: [0, 0, 0.2], rpy_deg: [0, -90, 0]}}}
  right/arm: {rigid: {object_in_hand: {position: [0, 0, 0.2], rpy_deg: [0, 90, 0]}}}
start: solve
tasks: [{point_on_point: {goal: [0.5, 0, 0.7]}}]
limits:
  - joint_position
  - self_collision
  - obstacles: {shapes: {floor: {box: [4, 4, 0.1], position: [0, 0, -0.05]}}}
controllers: [qp]
dt: 0.01
duration: 4.0
""".replace("BAR", str(bar))
    )
    return load(str(path))


def _free(space: ClosedSpace, count: int) -> Array:
    q = space.sample(np.random.default_rng(3), count)
    q = q[space.project(q)]
    return np.asarray(q[space.is_free(q)], float)


def test_all_pieces_of_the_line_are_held_apart(tmp_path: Path) -> None:
    scenario = _scenario(tmp_path)
    line = closed_line(scenario.chain, ClosedSpace(scenario.problem()).programs)
    assert line
    assert line.proven
    why = Counter(held.why for held in line.held())
    # of ten pieces, five fixed to the world or the object, those of each three in turn
    assert why == {"fixed": 2, "bend": 6, "bodies": 33}
    least = min(held.margin for held in line.held() if held.why == "bodies")
    assert least == pytest.approx(0.03, abs=1e-3)  # up to the bar's half width


@pytest.mark.full
def test_windings_of_two_turns_are_proven_unreachable(tmp_path: Path) -> None:
    problem = _scenario(tmp_path).problem()
    planner = Planner(problem, 4.0)
    space = planner.space
    q = _free(space, 6000)
    q = q[~cut_off(space.chain, q)]
    assert space.line
    turns = space.line.differs(np.vstack([space.chain.q_start, q]))[1:]
    assert set(np.unique(turns)) >= {-2, 0, 2}
    found = planner.plan(Budget(seconds=60.0), q[turns != 0])
    assert found.proven
    assert found.sentence == f"proven unreachable: no motion leads there: {WOUND}"
    start, budget = space.chain.q_start[None], Budget(seconds=1.0, shortcuts=0)
    assert not len(space.way(start, q[turns != 0], budget))  # which knows nothing of turns
    for row in q[turns == 0][:10]:
        way = planner.path(Budget(seconds=60.0), row)
        assert way.success
        assert not space.line.differs(way.q).any()


def test_nothing_is_proven_where_bodies_may_pass_each_other(tmp_path: Path) -> None:
    scenario = _scenario(tmp_path)
    no_floor = [limit for limit in scenario.limits if not isinstance(limit, Obstacles)]
    through = [
        replace(limit, ignore=(("left/link3", "right/link5"),))
        if isinstance(limit, SelfCollision) else limit
        for limit in scenario.limits
    ]  # fmt: skip
    for limits in (no_floor, through):
        assert not ClosedSpace(replace(scenario, limits=tuple(limits)).problem()).line


@pytest.mark.parametrize(("bar", "proven"), [(0.1, True), (0.02, False)])
def test_a_gap_between_hand_and_object_is_too_narrow_for_an_arm(
    tmp_path: Path, bar: float, proven: bool
) -> None:
    """Arms are 80 mm wide, the gaps 50 and 90 mm."""
    scenario = _scenario(tmp_path, bar=bar)
    line = closed_line(scenario.chain, ClosedSpace(scenario.problem()).programs)
    assert line
    assert line.proven is proven
    gaps = [held.margin for held in line.held() if held.why == "gap"]
    assert min(gaps) == pytest.approx(0.04 - 0.025 if proven else -0.045, abs=1e-3)


def test_writhes_are_those_of_another_formula() -> None:
    rng = np.random.default_rng(0)
    for _ in range(50):
        corners = rng.normal(size=(9, 3))
        assert writhe(corners) == pytest.approx(linking.writhe(corners), abs=1e-9)
