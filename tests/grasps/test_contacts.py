"""Cones of contacts against linear programs over forces at corners, and Coulomb's law."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from numpy.typing import ArrayLike
from pads import friction_for
from scipy.optimize import linprog, nnls

from coopqp.base.spec import Array
from coopqp.grasp import NO_CONTACT, Contact
from coopqp.grasps import PointContact, SurfaceContact
from coopqp.grasps.surface_contact import Pad, corners_hold, pad_rows

WRENCHES = 4_000
#: Nearer to the edge of the cone, as a share of the normal force, both answers are right.
EDGE = 1e-9


def used(contact: Contact, wrench: ArrayLike, friction: float) -> float:
    """Share of the inner cone that a wrench uses: 0 normal force alone, 1 its edge, or inf."""
    w, rows = np.asarray(wrench, float), contact.rows(friction)
    normal = -rows[:, 2] * w[2]
    bound = normal > 0.0
    share = float(np.max((rows[bound] @ w + normal[bound]) / normal[bound], initial=0.0))
    return share if w[2] > NO_CONTACT else np.inf


def corner_maps(X: float, Y: float) -> Array:
    """From forces at four corners, one after the other, to the wrench, written out; (6, 12)."""
    blocks = []
    for x, y in ((X, Y), (X, -Y), (-X, Y), (-X, -Y)):
        blocks.append(np.vstack([np.eye(3), [[0, 0, y], [0, 0, -x], [-y, x, 0]]]))
    return np.hstack(blocks)


def random_wrench(rng: np.random.Generator, m: float, X: float, Y: float) -> Array:
    """About half of them inside: corner forces near the edges of their cones, with noise."""
    f = rng.uniform(-1.2, 1.2, (4, 2)) * m
    normal = rng.uniform(0.05, 1.0, 4)
    forces = np.column_stack([f * normal[:, None], normal]).ravel()
    w = corner_maps(X, Y) @ forces
    spread = np.array([m, m, 0.0, Y, X, m * (X + Y)]) * normal.sum()
    return np.asarray(w + rng.uniform(-0.6, 0.6, 6) * spread)


def test_the_16_rows_are_what_forces_at_the_corners_can_do() -> None:
    """Whether forces in the corners' square cones sum up to a wrench: nonnegative least squares.

    Every hundredth by a linear program as well; both are scaled so that their tolerances mean the
    same for every pad.
    """
    rng, inside = np.random.default_rng(2015), 0
    for k in range(WRENCHES):
        m, X, Y = rng.uniform(0.1, 1.0), rng.uniform(0.01, 0.1), rng.uniform(0.01, 0.1)
        w = random_wrench(rng, m, X, Y)
        excess = float((pad_rows(m, X, Y) @ w).max() / (w[2] * max(m, X, Y)))
        if abs(excess) < EDGE:
            continue
        edges = np.array([[a * m, b * m, 1.0] for a in (-1, 1) for b in (-1, 1)]).T
        scale = np.array([m, m, 1.0, Y, X, m * (X + Y)])
        rays = corner_maps(X, Y) @ np.kron(np.eye(4), edges) / scale[:, None]
        wanted = w / w[2] / scale
        inside += excess < 0.0
        assert (nnls(rays, wanted)[1] < 1e-9) == (excess < 0.0)
        if k % 100 == 0:
            found = linprog(np.zeros(16), A_eq=rays, b_eq=wanted, method="highs")
            assert (found.status == 0) == (excess < 0.0)
    assert 0.4 * WRENCHES < inside < 0.7 * WRENCHES


def test_nothing_is_inside_that_coulomb_forbids_at_the_corners() -> None:
    """Every extreme ray of the inner square's corners lies on the round cone."""
    mu = 0.5
    m = mu / math.sqrt(2.0)
    edges = np.array([[a * m, b * m, 1.0] for a in (-1, 1) for b in (-1, 1)])
    assert np.allclose(np.hypot(edges[:, 0], edges[:, 1]), mu * edges[:, 2])
    pad = pad_of(SurfaceContact(friction=mu, half_lengths=(0.02, 0.05)))
    rng = np.random.default_rng(1)
    for _ in range(300):
        w = random_wrench(rng, m, 0.02, 0.05)
        if (pad.rows(mu) @ w <= 0.0).all():
            assert friction_for(pad, w) <= mu
            assert used(pad, w, mu) <= 1.0 + 1e-12
        else:
            assert used(pad, w, mu) > 1.0


def test_the_outer_square_allows_what_friction_does_not_bear() -> None:
    """The notes' trap: with m = mu the corner of the square is 1.41 mu away."""
    w = np.array([0.49, 0.49, 1.0, 0.0, 0.0, 0.0])
    pad = pad_of(SurfaceContact(friction=0.5))
    assert (pad_rows(0.5, 0.03, 0.03) @ w <= 0.0).all()
    assert friction_for(pad, w) > 0.5
    assert not (pad.rows(0.5) @ w <= 0.0).all()


def test_between_the_squares_the_round_cones_decide() -> None:
    pad = pad_of(SurfaceContact(friction=0.5))
    along = np.array([0.45, 0.0, 1.0, 0.0, 0.0, 0.0])  # outside the inner square, 90 % of mu
    assert used(pad, along, 0.5) == pytest.approx(0.9 * math.sqrt(2.0))
    assert friction_for(pad, along) <= 0.5
    assert friction_for(pad, np.array([0.51, 0.0, 1.0, 0.0, 0.0, 0.0])) > 0.5
    assert corners_hold(along, (0.03, 0.03), 0.5)
    # Turned by 45 degrees the square loses nothing.
    diagonal = np.array([0.5, 0.5, 0.0, 0.0, 0.0, 0.0]) / math.sqrt(2.0) + [0, 0, 1, 0, 0, 0]
    assert used(pad, diagonal, 0.5) == pytest.approx(1.0)


def test_a_soft_pad_bears_less_yaw() -> None:
    """Corners bear mu f_z sqrt(X^2 + Y^2) of yaw; on a square pad the inner square loses none."""
    yaw = np.array([0.0, 0.0, 1.0, 0.0, 0.0, 1.0])
    hard, soft = (pad_of(SurfaceContact(friction=0.5, torsion=t)) for t in (1.0, 0.5))
    corners = 0.5 * 0.03 * math.sqrt(2.0)
    yaw[5] = 0.99 * corners
    assert used(hard, yaw, 0.5) == pytest.approx(0.99)
    yaw[5] = 0.49 * corners
    assert used(soft, yaw, 0.5) == pytest.approx(0.98)
    yaw[5] = 0.51 * corners
    assert not (soft.rows(0.5) @ yaw <= 0.0).all()


def test_what_tilts_a_pad_is_counted_on_short_of_its_edge() -> None:
    """|t_x| <= reach Y (f_z - least), while all of the pad bears |t_x| <= Y f_z."""
    pad = pad_of(SurfaceContact(half_lengths=(0.02, 0.05), reach=0.9, least=2.0))
    kept = pad.force_rows(1.5)
    for axis, half in ((3, 0.05), (4, 0.02)):
        for share, counted_on in ((0.999, True), (1.001, False)):
            w = np.array([0.0, 0.0, 10.0, 0.0, 0.0, 0.0])
            w[axis] = -share * 0.9 * half * (10.0 - 2.0)
            assert (kept.rows @ w <= kept.upper).all() == counted_on
            w[axis] = share * half * 10.0
            assert (friction_for(pad, w) <= 0.5) == counted_on
    left = [label for label in kept.labels if label.startswith("edge")]
    assert len(left) == 4
    # Without tilt, friction and normal force are what they are on the whole pad.
    w = np.array([0.0, 0.999 * 10.0 * 0.5 / 1.5 / math.sqrt(2.0), 10.0, 0.0, 0.0, 0.0])
    assert (kept.rows @ w <= kept.upper).all()


def test_beyond_a_pads_edge_friction_is_told_as_on_it_and_the_edge_by_itself() -> None:
    """A linear program over forces at the corners, with the pressure moved on to the edge."""
    pad, (X, Y), rng = (
        pad_of(SurfaceContact(half_lengths=(0.04, 0.025))),
        (0.04, 0.025),
        np.random.default_rng(5),
    )
    for x, y in ((1.002, 0.1), (-1.05, -0.6), (0.3, 1.01), (0.2, -0.4)):
        force = 50.0 * np.array([*rng.uniform(-0.3, 0.3, 2), 1.0])
        twist = rng.uniform(-0.2, 0.2)  # about the pressure [N m]
        wrench, moved = (
            np.append(force, np.cross([a * X, b * Y, 0.0], force) + np.array([0.0, 0.0, twist]))
            for a, b in ((x, y), (np.clip(x, -1.0, 1.0), np.clip(y, -1.0, 1.0)))
        )
        assert pad.edge_use(wrench) == pytest.approx(max(abs(x), abs(y)))
        assert math.isinf(friction_for(pad, wrench)) == (max(abs(x), abs(y)) > 1.0)
        assert pad.friction_needed(wrench) == pytest.approx(least_friction(moved, X, Y), rel=0.02)
    assert math.isnan(pad.edge_use([0.0] * 6))


def least_friction(w: Array, X: float, Y: float) -> float:
    """The least friction with which forces at the corners sum up to a wrench."""
    angles = np.linspace(0.0, 2.0 * np.pi, 65)[:-1]
    columns = []
    for x, y in ((X, Y), (X, -Y), (-X, Y), (-X, -Y)):
        columns.append([0.0, 0.0, 1.0, y, -x, 0.0])
        columns += [
            [c, s, 0.0, 0.0, 0.0, x * s - y * c] for c, s in np.c_[np.cos(angles), np.sin(angles)]
        ]
    low, high = 0.0, 10.0
    while high - low > 1e-4:
        mu = 0.5 * (low + high)
        cone = np.zeros((4, 4 * 65))
        for i in range(4):
            cone[i, 65 * i : 65 * i + 65] = [-mu, *np.ones(64)]
        found = linprog(np.zeros(4 * 65), cone, np.zeros(4), np.array(columns).T, w, method="highs")
        low, high = (low, mu) if found.status == 0 else (mu, high)
    return high


@pytest.mark.parametrize(
    ("edges", "worst"), [(4, 0.707), (6, 0.866), (8, 0.924), (12, 0.966), (16, 0.981)]
)
def test_a_points_pyramid_loses_what_it_says(edges: int, worst: float) -> None:
    contact = PointContact(friction=0.8, edges=edges).contact
    angles = np.linspace(0.0, 2.0 * np.pi, 3601)
    radii = []
    for angle in angles:
        w = np.array([0.8 * np.cos(angle), 0.8 * np.sin(angle), 1.0, 0.0, 0.0, 0.0])
        radii.append(1.0 / used(contact, w, 0.8))
    assert max(radii) == pytest.approx(1.0)  # a vertex lies on the cone, and none beyond it
    assert min(radii) == pytest.approx(worst, abs=6e-4)
    assert radii[0] == pytest.approx(1.0)  # the first along x


def test_use_is_zero_for_pure_squeeze_one_at_the_edge_and_none_without_contact() -> None:
    for grasp in (SurfaceContact(friction=0.4), PointContact(friction=0.4)):
        contact = grasp.contact
        assert used(contact, [0, 0, 7.0, 0, 0, 0], 0.4) == 0.0
        assert used(contact, [0, 0, 0.0, 0, 0, 0], 0.4) == np.inf
        assert used(contact, [0, 0, -1.0, 0, 0, 0], 0.4) == np.inf
        assert friction_for(contact, [0, 0, -1.0, 0, 0, 0]) > 0.4
        for w in np.random.default_rng(0).normal(size=(50, 6)) * [0.2, 0.2, 0, 0.01, 0.01, 0.01]:
            w[2] = 1.0
            u = used(contact, w, 0.4)
            assert used(contact, 5.0 * w, 0.4) == pytest.approx(u)
            edge = w / max(u, 1e-9)
            edge[2] = 1.0
            assert used(contact, edge, 0.4) == pytest.approx(1.0)
            # What counts on less friction uses more of it.
            assert used(contact, w, 0.3) > u


def test_the_contact_frame_is_where_the_grasp_says() -> None:
    grasp = SurfaceContact(position=(0.1, 0, 0), normal=(0, 2, 0), along=(0, 0.5, 1))
    X: pin.SE3 = grasp.contact.placement
    assert np.allclose(X.rotation.T @ X.rotation, np.eye(3))
    assert np.allclose(X.rotation[:, 2], [0, 1, 0])
    assert np.allclose(X.rotation[:, 0], [0, 0, 1])
    assert np.allclose(X.translation, [0.1, 0, 0])
    assert len(grasp.passive_joints(np.eye(3))) == 0
    assert len(PointContact().passive_joints(np.eye(3))) == 3


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"friction": 0.0}, "friction"),
        ({"friction": -0.5}, "friction"),
        ({"normal": (0, 0, 0)}, "normal"),
        ({"normal": (0, 0, 1), "along": (0, 0, 2)}, "along: goes along the normal"),
        ({"half_lengths": (0.0, 0.03)}, "half_lengths"),
    ],
)
def test_contacts_that_cannot_be_are_refused(settings: dict[str, object], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        SurfaceContact(**settings)


def pad_of(grasp: SurfaceContact) -> Contact:
    contact = grasp.contact
    assert isinstance(contact, Pad)
    return replace(contact)
