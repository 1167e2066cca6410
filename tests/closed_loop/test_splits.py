"""Splits of the hands' wrenches against closed forms, and the section wrench against power."""

from __future__ import annotations

import numpy as np
import pytest

from coopqp.base.errors import GraspError
from coopqp.base.spec import Array
from coopqp.closed_loop.grasp_matrix import (
    COMPONENTS,
    Split,
    across,
    grasp_matrix,
    moved,
    section,
    squeeze_rows,
    virtual_inertia,
    virtual_linkage,
    walker,
)

GRASPS = 500
A = 0.15  # half the distance between two hands [m]
J = 0.01  # [kg m2]
TWO = np.array([[-A, 0.0, 0.0], [A, 0.0, 0.0]])
HALVES, MIDDLE = (0.5, 0.5), np.zeros(3)


def random_grasp(rng: np.random.Generator, hands: int) -> tuple[Array, Array, Array]:
    """Points, an origin and shares."""
    shares = rng.uniform(0.1, 1.0, hands)
    return rng.normal(0.0, 0.3, (hands, 3)), rng.normal(0.0, 0.1, 3), shares / shares.sum()


def splits(points: Array, origin: Array, shares: Array) -> tuple[Split, Split]:
    inertia = virtual_inertia(points, origin, shares, J * np.ones(len(points)))
    return walker(points, origin, shares), inertia


def internal_part(split: Split, h: Array) -> Array:
    """Of wrenches of the hands what cancels, shape (N, 6)."""
    return np.asarray((split.projector @ h.ravel()).reshape(h.shape), float)


@pytest.mark.parametrize("hands", [2, 3, 4, 5])
def test_the_moving_part_is_all_of_the_wrench_and_the_rest_cancels(hands: int) -> None:
    rng = np.random.default_rng(hands)
    for _ in range(GRASPS):
        points, origin, shares = random_grasp(rng, hands)
        h = rng.normal(0.0, 10.0, (hands, 6))
        for split in splits(points, origin, shares):
            w = split.G @ h.ravel()
            size = np.abs(split.X).max() * np.abs(h).max()
            assert np.abs(split.G @ split.X @ w - w).max() < 1e-12 * size
            assert np.abs(split.G @ internal_part(split, h).ravel()).max() < 1e-12 * size
            assert np.allclose(h.ravel() - split.X @ w, internal_part(split, h).ravel())


def test_walkers_hands_do_their_share_of_force_and_of_torque() -> None:
    """f_i = a_i F, m_i = a_i (M - r_i x F), written out hand by hand."""
    rng = np.random.default_rng(0)
    for _ in range(GRASPS):
        points, origin, shares = random_grasp(rng, 3)
        w = rng.normal(0.0, 10.0, 6)
        did = (walker(points, origin, shares).X @ w).reshape(3, 6)
        for place, share, h in zip(points, shares, did, strict=True):
            torque = share * (w[3:] - np.cross(place - origin, w[:3]))
            assert np.allclose(h, [*(share * w[:3]), *torque], rtol=0.0, atol=1e-12)


def test_walkers_split_knows_no_origin_point_or_unit() -> None:
    rng = np.random.default_rng(1)
    points, origin, shares = random_grasp(rng, 3)
    h = rng.normal(0.0, 10.0, (3, 6))
    here = internal_part(walker(points, origin, shares), h)
    assert np.allclose(internal_part(walker(points, origin + 0.3, shares), h), here)
    elsewhere = points + rng.normal(0.0, 0.05, points.shape)
    told = [moved(w, p, to) for w, p, to in zip(h, points, elsewhere, strict=True)]
    there = internal_part(walker(elsewhere, origin, shares), np.array(told))
    back = [moved(w, p, to) for w, p, to in zip(there, elsewhere, points, strict=True)]
    assert np.allclose(back, here)
    millimetres = np.tile([1.0, 1.0, 1.0, 1e3, 1e3, 1e3], 3).reshape(3, 6)
    in_mm = internal_part(walker(1e3 * points, 1e3 * origin, shares), h * millimetres)
    assert np.allclose(in_mm / millimetres, here)


def test_virtual_bodies_have_no_internal_wrench_where_they_would_move_freely() -> None:
    """Newton and Euler: hands of these masses, moved with the object, do m a and j alpha."""
    rng = np.random.default_rng(2)
    for _ in range(GRASPS):
        points, origin, masses = random_grasp(rng, 3)
        inertias = rng.uniform(0.01, 0.1, 3)
        a, alpha = rng.normal(size=3), rng.normal(size=3)
        h = np.array(
            [
                [*(m * (a + np.cross(alpha, p - origin))), *(j * alpha)]
                for p, m, j in zip(points, masses, inertias, strict=True)
            ]
        )
        split = virtual_inertia(points, origin, masses, inertias)
        assert np.abs(internal_part(split, h)).max() < 1e-12 * np.abs(h).max() / inertias.min()


@pytest.mark.parametrize(("inertia", "shear"), [(J, 1.765), (1e-9, 3.333), (0.5, 0.0733)])
def test_a_moment_across_two_hands_becomes_shear_by_virtual_inertia_alone(
    inertia: float, shear: float
) -> None:
    """M a / (2 (2 j + a^2)), and M / L for j to 0; the last is the pseudoinverse. Walker: none."""
    w = np.array([0.0, 0.0, 0.0, 0.0, 1.0, 0.0])
    by_inertia = virtual_inertia(TWO, MIDDLE, HALVES, (inertia, inertia)).X @ w
    closed = A / (2.0 * (2.0 * inertia + A**2))
    assert abs(by_inertia[2]) == pytest.approx(closed)
    assert closed == pytest.approx(shear, rel=1e-3)
    assert np.allclose(walker(TWO, MIDDLE, HALVES).X @ w, [0, 0, 0, 0, 0.5, 0] * 2)


def test_a_force_across_two_hands_asks_walkers_hands_for_moments() -> None:
    """A force F asks a F / 2 each, opposite, which a pad has to bear; virtual bodies bear none."""
    w = np.array([0.0, 0.0, 10.0, 0.0, 0.0, 0.0])
    moments = (walker(TWO, MIDDLE, HALVES).X @ w).reshape(2, 6)[:, 4]
    assert np.allclose(moments, [-0.75, 0.75])
    by_inertia = (virtual_inertia(TWO, MIDDLE, HALVES, (J, J)).X @ w).reshape(2, 6)
    assert np.allclose(by_inertia[:, 3:], 0.0)
    # Seen from Walker's, that is a bend of F L / 4.
    of_pads = section(*TWO).of(internal_part(walker(TWO, MIDDLE, HALVES), by_inertia))
    assert np.abs(of_pads[4:]).max() == pytest.approx(10.0 * 2 * A / 4)


def test_about_the_line_through_both_hands_each_bears_half() -> None:
    twist = np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0])
    by_inertia = virtual_inertia(TWO, MIDDLE, HALVES, (1e-9, 1e-9)).X @ twist
    assert np.allclose(by_inertia, [0, 0, 0, 0.5, 0, 0] * 2)


def test_the_section_wrench_does_the_work_of_the_relative_twist() -> None:
    rng = np.random.default_rng(3)
    for _ in range(GRASPS):
        p = rng.normal(0.0, 0.3, (2, 3))
        h, V = rng.normal(0.0, 10.0, (2, 6)), rng.normal(size=(2, 6))
        cut = section(p[0], p[1])
        # Twists of bodies fixed to each hand, of their points at the middle.
        at_middle = [
            np.concatenate([v[:3] + np.cross(v[3:], cut.middle - place), v[3:]])
            for v, place in zip(V, p, strict=True)
        ]
        total = grasp_matrix(p, cut.middle) @ h.ravel()
        s = cut.of(h)
        relative = at_middle[0] - at_middle[1]
        turned = np.concatenate([cut.axes @ relative[:3], cut.axes @ relative[3:]])
        mean = 0.5 * (at_middle[0] + at_middle[1])
        assert total @ mean + s @ turned == pytest.approx(np.sum(h * V), abs=1e-10)


def test_with_equal_shares_the_section_wrench_is_walkers_internal_one() -> None:
    rng = np.random.default_rng(4)
    for _ in range(GRASPS):
        points, origin, _ = random_grasp(rng, 2)
        h = rng.normal(0.0, 10.0, (2, 6))
        cut = section(*points)
        internal = internal_part(walker(points, origin, HALVES), h)
        assert np.allclose(cut.of(internal), cut.of(h), atol=1e-9)
        # Beam identities.
        s_f, s_m = cut.axes.T @ cut.of(h)[:3], cut.axes.T @ cut.of(h)[3:]
        assert np.allclose(internal[:, 3:].sum(axis=0), np.cross(points[1] - points[0], s_f))
        assert np.allclose(0.5 * (internal[0, 3:] - internal[1, 3:]), s_m)


def test_pressing_hands_squeeze_and_both_splits_agree_on_that_and_on_twist() -> None:
    press = np.array([[1.0, 0, 0, 0.3, 0, 0], [-1.0, 0, 0, -0.3, 0, 0]])
    assert np.allclose(section(*TWO).of(press), [1.0, 0, 0, 0.3, 0, 0])
    rng = np.random.default_rng(5)
    for _ in range(GRASPS):
        points, origin, _ = random_grasp(rng, 2)
        h = rng.normal(0.0, 10.0, (2, 6))
        one, other = (
            section(*points).of(internal_part(split, h))
            for split in splits(points, origin, np.array(HALVES))
        )
        assert np.allclose(one[[0, 3]], other[[0, 3]], atol=1e-10)


def test_up_is_up_and_something_stands_for_it_on_a_vertical_line() -> None:
    assert np.allclose(across(np.array([0.0, 1.0, 0.0])), [[0, 1, 0], [0, 0, 1], [1, 0, 0]])
    for e in ([0.0, 0.0, 1.0], [0.0, 0.05, -1.0], [0.6, 0.0, 0.8]):
        axes = across(np.array(e) / np.linalg.norm(e))
        assert np.allclose(axes @ axes.T, np.eye(3))
        assert np.linalg.det(axes) == pytest.approx(1.0)
    assert len(COMPONENTS) == 6


def test_the_virtual_linkage_takes_what_the_least_squares_of_forces_leaves() -> None:
    rng = np.random.default_rng(6)
    for _ in range(GRASPS):
        p, f = rng.normal(0.0, 0.3, (3, 3)), rng.normal(0.0, 10.0, 9)
        W = grasp_matrix(p, np.zeros(3)).reshape(6, 3, 6)[:, :, :3].reshape(6, 9)
        rows = virtual_linkage(p)
        E = np.linalg.pinv(rows)
        assert np.allclose(W @ E, 0.0, atol=1e-12)
        pushes = rows @ f
        assert np.allclose(E @ pushes, f - np.linalg.pinv(W) @ W @ f, atol=1e-9)
    # A push along one edge alone is told as that.
    assert np.allclose(rows @ E[:, 1], [0.0, 1.0, 0.0])


def test_what_cannot_be_split_is_refused() -> None:
    line = np.array([[0.0, 0, 0], [0.1, 0, 0], [0.3, 0, 0]])
    assert not squeeze_rows(line)
    with pytest.raises(GraspError, match="no direction between them"):
        section(MIDDLE, MIDDLE)
