"""Things in the world: distances against closed forms, rates, and what is refused."""

from __future__ import annotations

import os
from pathlib import Path

import laws
import numpy as np
import pytest
from example_limits import SHELF, empty_rows, least
from laws import DT, LIMITS, run

from coopqp.base.errors import InvalidValueError, ScenarioError, UnknownNameError
from coopqp.base.qp import names_of
from coopqp.controllers import QPController
from coopqp.limits import Obstacle, Obstacles
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.marker import SolidMarker
from coopqp.model.profile import Profile
from coopqp.model.state import State
from coopqp.robot_files import meshes
from coopqp.scenario.loader import load
from coopqp.tasks import PointOnPoint

#: A pyramid over a square of 10 cm, 8 cm high, and a flat square.
PYRAMID = """\
v -0.05 -0.05 0\nv 0.05 -0.05 0\nv 0.05 0.05 0\nv -0.05 0.05 0\nv 0 0 0.08
f 1 2 5\nf 2 3 5\nf 3 4 5\nf 4 1 5\nf 1 3 2\nf 1 4 3
"""
FLAT = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1 2 3\nf 1 3 4\n"

SCENARIO = """\
robot: nao_t14
grasp: rigid
object: {size: [0.08, 0.19, 0.08]}
start: {right: [0.7, -0.2, 1.2, 0.9, 0.1], left: [0.7, 0.2, -1.2, -0.9, -0.1]}
tasks: [{point_on_point: {goal: [0.16, 0.0, 0.1]}}]
duration: 1.0
limits:
  - obstacles: {distance: 0.02, shapes: {ball: SHAPE}}
"""


def of(thing: Obstacle, **keys: float) -> Obstacles:
    return Obstacles(shapes={"thing": thing}, **keys)  # type: ignore[arg-type]


def row_of(limit: Obstacles, chain: ClosedChain, body: str) -> int:
    return names_of(limit.rows(chain)).index(f"limit.obstacles[{body}|thing]")


def distance(limit: Obstacles, chain: ClosedChain, body: str) -> float:
    """At the start [m]."""
    q = np.vstack([chain.q_start] * 2)
    margins = limit.margins(chain, q, np.zeros((1, chain.n)), DT)
    (margin,) = (m[0] for row, m in margins.items() if row.name.endswith(f"[{body}|thing]"))
    return float(margin) + limit.distance


def test_distances_from_the_object_are_those_of_closed_forms(
    held_box: ClosedChain, tmp_path: Path
) -> None:
    p, (x, _, z) = State(held_box).p_WO, held_box.held.size
    ahead, above = np.array([0.3, 0.0, 0.0]), np.array([0.0, 0.0, 0.25])
    mesh = tmp_path / "pyramid.obj"
    mesh.write_text(PYRAMID)
    apart = {
        0.3 - x / 2 - 0.1: Obstacle(sphere=0.1, position=tuple(p + ahead)),
        0.25 - z / 2 - 0.05: Obstacle(box=(1, 1, 0.1), position=tuple(p + above)),
        0.3 - x / 2 - 0.02: Obstacle(
            cylinder={"radius": 0.02, "length": 1.0},  # type: ignore[arg-type]
            position=tuple(p + ahead),
        ),
        0.25 - z / 2: Obstacle(mesh=mesh, position=tuple(p + above)),
        # Upside down and twice as high: its tip is 16 cm below its base.
        0.25 - z / 2 - 0.16: Obstacle(
            mesh=mesh, scale=(1, 1, 2), position=tuple(p + above), rpy_deg=(180, 0, 0)
        ),
    }
    for wanted, thing in apart.items():
        assert distance(of(thing), held_box, "object") == pytest.approx(wanted, abs=2e-6), thing


def test_rows_are_the_rate_of_the_distances(held_box: ClosedChain, tmp_path: Path) -> None:
    mesh = tmp_path / "pyramid.obj"
    mesh.write_text(PYRAMID)
    things = {**SHELF.shapes, "roof": Obstacle(mesh=mesh, position=(0.15, 0.0, 0.2))}
    limit = Obstacles(shapes=things, distance=0.0, within=10.0)
    state, rows, step = State(held_box), empty_rows(held_box, limit), 1e-5
    tighten, rng, off = limit.bind(held_box, DT), np.random.default_rng(4), []
    for q in held_box.sample(rng, 40):
        state.q[:] = q
        state.update()
        tighten(state, rows)
        v = rng.normal(size=held_box.n)
        path = np.vstack([q, q + step * v, q - step * v])
        margins = limit.margins(held_box, path, np.zeros((2, held_box.n)), DT)
        slope = np.array([(m[0] - m[1]) / (2 * step) for m in margins.values()])
        off.append(np.abs(slope + rows.G[: len(slope)] @ v))
    assert np.median(off) < 1e-5  # coal iterates to 1e-6 m
    assert np.mean(np.array(off) < 2e-2) > 0.98  # but where nearest points jump


def test_far_things_bind_nothing(held_box: ClosedChain) -> None:
    limit = of(Obstacle(sphere=0.1, position=(3.0, 0.0, 0.0)))
    rows = empty_rows(held_box, limit)
    limit.bind(held_box, DT)(State(held_box), rows)
    assert not rows.G.any()
    assert rows.h.min() > 1.0


def test_a_face_that_lies_along_another_has_its_corners_held(held_box: ClosedChain) -> None:
    """A slab just below the box: the box's lower corners, with their heights above the slab."""
    state = State(held_box)
    below = state.p_WO - np.array([0.0, 0.0, held_box.held.size[2] / 2 + 0.012 + 0.05])
    limit = of(Obstacle(box=(1.0, 1.0, 0.1), position=tuple(below)), distance=0.01)
    rows, names = empty_rows(held_box, limit), names_of(limit.rows(held_box))
    limit.bind(held_box, DT)(state, rows)
    assert rows.h[row_of(limit, held_box, "object")] == pytest.approx(10.0 * 0.002, abs=1e-4)
    corners = [i for i, name in enumerate(names) if ".corner[" in name and rows.G[i].any()]
    assert len(corners) >= 3
    assert rows.h[corners[:3]] == pytest.approx(10.0 * 0.002, abs=1e-4)
    half, J = 0.5 * np.array(held_box.held.size), held_box.object_jacobians(state.q)[0]
    lowering = [
        -(J[2] + np.cross(np.eye(3), s * half)[:, 2] @ J[3:])
        for s in ((1, 1, -1), (1, -1, -1), (-1, 1, -1), (-1, -1, -1))
    ]
    for i in corners[:3]:
        assert min(np.abs(rows.G[i] - row).max() for row in lowering) < 1e-3


def test_no_corner_that_appears_stops_the_joints_at_once(held_box: ClosedChain) -> None:
    """Corners on the far side of a slab that turns away come nearer by four times the gain."""
    state, size = State(held_box), np.array(held_box.held.size)
    corner = np.array([0.5, 0.0, -0.5]) * size
    for behind in (0.0, 0.0005, 0.001, 0.0019):
        turned = float(np.arcsin(behind / size[0]))
        up = np.array([-np.sin(turned), 0.0, np.cos(turned)])
        below = state.p_WO + state.R_WO @ corner - (0.012 + 0.05) * up
        slab = Obstacle(box=(1.0, 1.0, 0.1), position=tuple(below), rpy=(0.0, -turned, 0.0))
        limit = of(slab, distance=0.01)
        rows, names = empty_rows(held_box, limit), names_of(limit.rows(held_box))
        limit.bind(held_box, DT)(state, rows)
        held = rows.h[[".corner[" in name and rows.G[i].any() for i, name in enumerate(names)]]
        assert held.min() == pytest.approx(10.0 * 0.002, abs=1e-4)
        assert held.max() == pytest.approx(10.0 * 0.002 + 40.0 * behind, abs=2e-4)


def test_what_is_pulled_into_a_ball_stops_before_it(held_box: ClosedChain) -> None:
    ball = Obstacle(sphere=0.03, position=tuple(State(held_box).p_WO + np.array([0.0, 0.0, 0.12])))
    limit = of(ball, distance=0.02)
    pull = PointOnPoint(goal=ball.position, profile=Profile(duration=0.5))
    done = run(QPController(), laws.problem(held_box, pull, limits=[*LIMITS, limit]), 200)
    assert -1e-4 <= least(limit, held_box, done) < 1e-3


def test_pictures_show_the_things() -> None:
    marks = SHELF.marks(0.0)
    assert [mark.kind for mark in marks if isinstance(mark, SolidMarker)] == [
        "box", "cylinder", "sphere"
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("shape", "message"),
    [
        ("{cone: 0.1}", "unknown key 'cone'"),
        ("{sphere: -0.1}", "greater than 0"),
        ("{sphere: 0.1, box: [1, 1, 1]}", "found box and sphere"),
        ("{position: [1, 0, 0]}", "needs one of box, sphere, cylinder, mesh; found none"),
        ("{mesh: nowhere.stl}", "cannot be read: No such file"),
        ("{mesh: .}", "is of no kind that is read: .stl, .obj, .dae"),
        ("{mesh: folder.stl}", "cannot be read: is a folder"),
        ("{mesh: pipe.stl}", "cannot be read: is a pipe or a device"),
        ("{mesh: flat.obj}", "is flat"),
        ("{mesh: text.obj}", "no surface"),
        ("{sphere: 0.1, position: [0.12, 0, 0.05]}", "object is [0-9.]+ mm in ball at the start"),
    ],
)
def test_a_bad_thing_is_one_line(tmp_path: Path, shape: str, message: str) -> None:
    (tmp_path / "flat.obj").write_text(FLAT)
    (tmp_path / "text.obj").write_text("no mesh\n")
    (tmp_path / "folder.stl").mkdir()
    os.mkfifo(tmp_path / "pipe.stl")
    file = tmp_path / "scenario.yaml"
    file.write_text(SCENARIO.replace("SHAPE", shape))
    with pytest.raises(ScenarioError, match=message) as caught:
        load(file)
    assert ":8: limits[0]" in str(caught.value)


def test_a_mesh_that_is_too_large_is_not_read(
    held_box: ClosedChain, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    mesh = tmp_path / "pyramid.obj"
    mesh.write_text(PYRAMID)
    monkeypatch.setattr(meshes, "LARGEST", 50)
    with pytest.raises(InvalidValueError, match=r"thing: mesh .*pyramid.obj: is larger than"):
        of(Obstacle(mesh=mesh)).rows(held_box)


@pytest.mark.parametrize("sides", [250, 300])
def test_a_corner_with_more_edges_than_coal_counts_is_told(
    sides: int, held_box: ClosedChain, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The tip of a cone has as many edges as its rim has sides."""
    turns = np.linspace(0.0, 2.0 * np.pi, sides, endpoint=False)
    rim = [f"v {0.04 * np.cos(turn):.9f} {0.04 * np.sin(turn):.9f} 0" for turn in turns]
    faces = [f"f 1 {2 + i} {2 + (i + 1) % sides}" for i in range(sides)]
    mesh = tmp_path / "cone.obj"
    mesh.write_text("\n".join(["v 0 0 0.05", *rim, *faces]))
    cone = of(Obstacle(mesh=mesh, position=(1.0, 0.0, 0.0)))
    if sides > 255:
        with pytest.raises(InvalidValueError, match="over 255 edges meet in a corner; simplify"):
            cone.rows(held_box)
    else:
        assert cone.rows(held_box)
    monkeypatch.setattr("coopqp.limits._bodies.MAX_CORNERS", sides)
    mesh.write_text("\n".join(["v 0 0 0.06", *rim, *faces, ""]))  # another file, read anew
    with pytest.raises(InvalidValueError, match=f"hull has {sides + 1} corners, at most {sides} "):
        cone.rows(held_box)


def test_bodies_are_chosen_by_name(held_box: ClosedChain) -> None:
    ball = {"ball": Obstacle(sphere=0.1, position=(1, 0, 0))}
    rows = names_of(Obstacles(shapes=ball, bodies=("R*", "object")).rows(held_box))
    named = [name for name in rows if "|" in name]
    assert named == [
        f"limit.obstacles[{body}|ball]" for body in ("RUpperArm", "RForearm", "RHand", "object")
    ]
    with pytest.raises(UnknownNameError, match="did you mean 'RHand'"):
        Obstacles(shapes=ball, bodies=("RHond",)).rows(held_box)
    with pytest.raises(InvalidValueError, match="needs more than distance"):
        Obstacles(shapes=ball, distance=0.2)
