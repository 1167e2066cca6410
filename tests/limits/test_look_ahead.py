"""Distances are kept however coarse the control period and however small ``within``.

Two arms of boxes in a URDF file fall onto a plate as fast as their joints can. pinocchio reads the
file by itself, coal alone measures.
"""

from __future__ import annotations

from pathlib import Path

import coal
import numpy as np
import pinocchio as pin
import pytest
from example_limits import empty_rows

import coopqp
from coopqp.base.spec import Array
from coopqp.limits import Obstacle, Obstacles, SelfCollision
from coopqp.limits._keep_apart import distances_along, max_closing_speeds
from coopqp.model.closed_chain import ClosedChain
from coopqp.scenario.loader import load
from coopqp.trace import Trace

LINK = """<link name="{n}"><inertial><mass value="1"/>
<inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial>
<collision><origin xyz="0.1 0 0"/><geometry><box size="0.14 0.04 0.04"/></geometry></collision>
</link>
"""
JOINT = """<joint name="{side}{i}" type="revolute"><parent link="{parent}"/><child link="{n}"/>
<origin xyz="0.2 {y} 0"/><axis xyz="{axis}"/>
<limit lower="-2" upper="2" velocity="3" effort="10"/></joint>
"""
SCENARIO = """\
robot: {{urdf: {{path: boxes.urdf, arms: {{right: r_3, left: l_3}}}}}}
start: {{right: [0.1, 0.2, -0.1], left: [0.1, 0.2, -0.1]}}
tasks:
  - point_on_plane: {{normal: [0, 0, 1], through: [0, 0, -0.5], profile: {{kind: step}}, gain: 10}}
limits:
  - joint_position
  - joint_velocity
  - obstacles:
      shapes: {{plate: {{box: [2, 2, {thick}], position: [0.5, 0, {z}]}}}}
      gain: {gain}
      within: {within}
      distance: 0.01
controllers: [qp]
duration: 1.0
dt: {dt}
"""


def urdf() -> str:
    """Two arms that turn down, and then sideways twice."""
    parts = ['<link name="base"/>\n']
    for side, y in (("r", -0.15), ("l", 0.15)):
        for i, axis in ((1, "0 1 0"), (2, "0 0 1"), (3, "0 0 1")):
            parent, name = (f"{side}_{i - 1}" if i > 1 else "base"), f"{side}_{i}"
            parts.append(LINK.format(n=name))
            offset = y if i == 1 else 0.0
            parts.append(JOINT.format(side=side, i=i, parent=parent, n=name, y=offset, axis=axis))
    return f'<?xml version="1.0"?>\n<robot name="boxes">\n{"".join(parts)}</robot>\n'


def least_by_coal(file: Path, trace: Trace, plate: tuple[float, float]) -> float:
    """The nearest that any link came to the plate at any instant [m]."""
    model = pin.buildModelFromUrdf(str(file))
    links = pin.buildGeomFromUrdf(model, str(file), pin.GeometryType.COLLISION)
    data, placed = model.createData(), links.createData()
    thick, z = plate
    box = coal.Box(2.0, 2.0, thick)
    at = coal.Transform3s(np.eye(3), np.array([0.5, 0.0, z]))
    columns = [model.joints[model.getJointId(name)].idx_q for name in trace.joints]
    least = np.inf
    for row in trace.q:
        q = pin.neutral(model)
        q[columns] = row
        pin.updateGeometryPlacements(model, data, links, placed, q)
        for part, X in zip(links.geometryObjects, placed.oMg, strict=True):
            where = coal.Transform3s(X.rotation, X.translation)
            request, result = coal.DistanceRequest(), coal.DistanceResult()
            least = min(least, coal.distance(part.geometry, where, box, at, request, result))
    return float(least)


@pytest.mark.parametrize(
    ("dt", "gain", "within", "plate"),
    [
        (0.1, 10, 0.1, (0.1, -0.25)),
        (0.1, 5, 0.1, (0.1, -0.25)),
        (0.1, 10, 0.1, (0.001, -0.2)),
        (0.05, 10, 0.02, (0.001, -0.15)),
        (0.02, 10, 0.0101, (0.001, -0.15)),
        (0.01, 10, 0.0101, (0.1, -0.25)),
        (0.01, 100, 0.1, (0.1, -0.25)),
    ],
)
def test_a_distance_is_kept_whatever_dt_and_within_are(
    tmp_path: Path, dt: float, gain: float, within: float, plate: tuple[float, float]
) -> None:
    """Before, the arms came up to 49 mm nearer, or through the plate, with every tick optimal."""
    robot, file = tmp_path / "boxes.urdf", tmp_path / "s.yaml"
    robot.write_text(urdf(), encoding="utf-8")
    thick, z = plate
    text = SCENARIO.format(thick=thick, z=z, gain=gain, within=within, dt=dt)
    file.write_text(text, encoding="utf-8")
    trace = coopqp.run(load(file), controller="qp")
    assert set(trace.status) == {"OPTIMAL"}
    least = least_by_coal(robot, trace, plate)
    assert 0.01 - 1e-4 < least < 0.011  # they come to rest at the distance


def test_no_pair_closes_faster_than_is_looked_ahead(held_box: ClosedChain) -> None:
    """Random poses and speeds: the ways in a tick are below the bound, and not far below it."""
    pairs = SelfCollision().watched(held_box)
    ways, rng, dt = max_closing_speeds(held_box, pairs), np.random.default_rng(0), 1e-3
    shares = []
    for q in held_box.sample(rng, 30):
        v = rng.choice((-1.0, 1.0), held_box.n) * held_box.velocity
        before, after = distances_along(held_box, pairs, np.array([q, q + dt * v]))
        shares.append((before - after) / (dt * ways @ np.abs(v)))
    assert np.max(shares) < 1.0
    assert np.max(shares) > 0.2


def test_what_is_far_is_looked_at_as_far_as_joints_are_fast(held_box: ClosedChain) -> None:
    """A ball out of ``within``: a row where joints could be there in a tick, and else none."""
    ball = Obstacle(sphere=0.05, position=tuple(held_box.start_position + np.array([0.4, 0, 0])))
    limit = Obstacles(shapes={"ball": ball})

    def rows_at(speed: float, dt: float) -> Array:
        rows = empty_rows(held_box, limit)
        rows.lb[:], rows.ub[:] = -speed, speed
        limit.bind(held_box, dt)(coopqp.State(held_box), rows)
        assert np.isfinite(rows.G).all()
        return np.abs(rows.G).sum(axis=1)

    assert not rows_at(1.0, 0.01).any()
    assert rows_at(8.0, 0.1).any()
    assert rows_at(np.inf, 0.01).any()  # nothing bounds the joints
