"""Modified Denavit-Hartenberg transforms, their inverse, and the models built from tables."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any, Literal

import numpy as np
import pinocchio as pin
import pytest

from coopqp.base.errors import InvalidValueError, UnknownNameError
from coopqp.base.spec import Array
from coopqp.robot_files import mdh


def rot_x(angle: float) -> Array:
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[1, 0, 0, 0], [0, c, -s, 0], [0, s, c, 0], [0, 0, 0, 1]])


def rot_z(angle: float) -> Array:
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, -s, 0, 0], [s, c, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])


def trans(x: float, y: float, z: float) -> Array:
    T = np.eye(4)
    T[:3, 3] = x, y, z
    return T


def product(p: mdh.MdhParameters, turn: float = 0.0, stroke: float = 0.0) -> Array:
    """Eq. (2) as printed, with a joint that turns by turn and slides by stroke."""
    before = rot_z(p.gamma) @ trans(0, 0, p.b) @ rot_x(p.alpha) @ trans(p.d, 0, 0)
    return before @ rot_z(p.theta + turn) @ trans(0, 0, p.r + stroke)


def random_parameters(rng: np.random.Generator) -> mdh.MdhParameters:
    gamma, alpha, theta = rng.uniform(-math.pi, math.pi, 3)
    b, d, r = rng.uniform(-1, 1, 3)
    return mdh.MdhParameters(gamma=gamma, b=b, alpha=alpha, d=d, theta=theta, r=r)


def random_pose(rng: np.random.Generator) -> pin.SE3:
    turn = pin.Quaternion(rng.normal(size=4)).normalized().matrix()
    return pin.SE3(turn, rng.uniform(-1, 1, 3))


def assert_same_pose(found: pin.SE3, wanted: Array, within: float = 1e-13) -> None:
    np.testing.assert_allclose(found.homogeneous, wanted, rtol=0, atol=within)


def test_transform_is_the_product_of_six_elementary_motions(rng: np.random.Generator) -> None:
    for _ in range(200):
        p = random_parameters(rng)
        assert_same_pose(mdh.transform(p), product(p))


def test_six_parameters_give_any_grasp_back(rng: np.random.Generator) -> None:
    for _ in range(1000):
        X = random_pose(rng)
        assert_same_pose(X, product(mdh.grasp_parameters(X)))


@pytest.mark.parametrize("alpha", [0.0, math.pi])
@pytest.mark.parametrize("offset", [(0.0, 0.0, 0.0), (0.0, 0.0, 0.3), (0.1, -0.2, 0.3)])
def test_grasp_with_parallel_axes_comes_back_without_r(
    alpha: float, offset: tuple[float, float, float], rng: np.random.Generator
) -> None:
    for about_z in [0.0, math.pi, -math.pi / 2, *rng.uniform(-math.pi, math.pi, 50)]:
        wanted = trans(*offset) @ rot_x(alpha) @ rot_z(about_z)
        p = mdh.grasp_parameters(pin.SE3(wanted))
        assert (p.alpha, p.r) == (alpha, 0.0)
        np.testing.assert_allclose(product(p), wanted, rtol=0, atol=1e-13)


@pytest.mark.parametrize("exponent", range(-15, 0))
def test_grasp_with_nearly_parallel_axes_comes_back_to_a_micrometre(
    exponent: int, rng: np.random.Generator
) -> None:
    for base in (0.0, math.pi):
        for _ in range(50):
            turn, back = rng.uniform(-3, 3, 2)
            tilt = base + 10.0**exponent
            wanted = trans(*rng.uniform(-1, 1, 3)) @ rot_z(turn) @ rot_x(tilt) @ rot_z(back)
            found = product(mdh.grasp_parameters(pin.SE3(wanted)))
            np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-6)


def tree(rng: np.random.Generator) -> list[mdh.MdhRow]:
    """A revolute trunk that carries a bracket with a slide, and a second, revolute branch."""
    p = [random_parameters(rng) for _ in range(5)]
    return [
        mdh.MdhRow(name="trunk", **vars(p[0])),
        mdh.MdhRow(name="bracket", antecedent="trunk", sigma="fixed", **vars(p[1])),
        mdh.MdhRow(name="slide", antecedent="bracket", sigma="prismatic", **vars(p[2])),
        mdh.MdhRow(name="finger", antecedent="slide", **vars(p[3])),
        mdh.MdhRow(name="branch", antecedent="trunk", **vars(p[4])),
    ]


def test_every_frame_of_a_tree_is_where_the_table_says(rng: np.random.Generator) -> None:
    rows = tree(rng)
    p = {row.name: row.parameters for row in rows}
    model = mdh.build_model("tree", rows, {})
    data = model.createData()
    assert list(model.names) == ["universe", "trunk", "slide", "finger", "branch"]
    for q in rng.uniform(-2, 2, (20, 4)):
        trunk = product(p["trunk"], turn=q[0])
        bracket = trunk @ product(p["bracket"])
        slide = bracket @ product(p["slide"], stroke=q[1])
        wanted = {
            "trunk": trunk,
            "bracket": bracket,
            "slide": slide,
            "finger": slide @ product(p["finger"], turn=q[2]),
            "branch": trunk @ product(p["branch"], turn=q[3]),
        }
        pin.framesForwardKinematics(model, data, q)
        for name, pose in wanted.items():
            assert_same_pose(data.oMf[model.getFrameId(name)], pose)


def test_model_carries_the_limits_of_the_table() -> None:
    rows = [
        mdh.MdhRow(name="a", lower=-1, upper=2, velocity=3, effort=4),
        mdh.MdhRow(name="b", antecedent="a", sigma="prismatic", lower=-0.1, upper=0.2),
    ]
    model = mdh.build_model("two", rows, {})
    np.testing.assert_array_equal(model.lowerPositionLimit, [-1, -0.1])
    np.testing.assert_array_equal(model.upperPositionLimit, [2, 0.2])
    np.testing.assert_array_equal(model.velocityLimit, [3, np.inf])
    np.testing.assert_array_equal(model.effortLimit, [4, np.inf])


def test_tip_lies_along_the_base_axes_at_the_zero_pose(rng: np.random.Generator) -> None:
    rows, offset = tree(rng), (0.1, -0.2, 0.3)
    tips = {
        "on_joint": mdh.Tip(parent="finger", offset=offset),
        "on_fixed": mdh.Tip(parent="bracket"),
    }
    model = mdh.build_model("tree", rows, tips)
    data = model.createData()
    pin.framesForwardKinematics(model, data, np.zeros(4))
    finger, bracket = (data.oMf[model.getFrameId(n)] for n in ("finger", "bracket"))
    assert_same_pose(data.oMf[model.getFrameId("on_joint")], trans(*(finger.translation + offset)))
    assert_same_pose(data.oMf[model.getFrameId("on_fixed")], trans(*bracket.translation))


INERTIA = (2e-3, 1e-4, -2e-4, 3e-3, 3e-4, 4e-3)
MATRIX = np.array([[2e-3, 1e-4, -2e-4], [1e-4, 3e-3, 3e-4], [-2e-4, 3e-4, 4e-3]])


@pytest.mark.parametrize("loaded", ["finger", "bracket"])
@pytest.mark.parametrize("axes", ["base", "joint"])
def test_link_has_its_mass_where_the_maker_put_it(
    axes: str, loaded: str, rng: np.random.Generator
) -> None:
    """Also for a fixed row, whose mass moves with the joint before it."""
    com = (0.01, 0.02, -0.03)
    link: dict[str, Any] = {"mass": 0.7, "com": com, "inertia": INERTIA, "axes": axes}
    rows = [replace(row, **link) if row.name == loaded else row for row in tree(rng)]
    model = mdh.build_model("tree", rows, {})
    data = model.createData()
    pin.framesForwardKinematics(model, data, np.zeros(4))
    frame = data.oMf[model.getFrameId(loaded)]
    R = frame.rotation if axes == "joint" else np.eye(3)
    joint = model.frames[model.getFrameId(loaded)].parentJoint
    body = data.oMi[joint].act(model.inertias[joint])
    assert body.mass == pytest.approx(0.7)
    np.testing.assert_allclose(body.lever, frame.translation + R @ com, atol=1e-13)
    np.testing.assert_allclose(body.inertia, R @ MATRIX @ R.T, atol=1e-13)
    assert sum(i.mass for i in model.inertias) == pytest.approx(0.7)


def test_unknown_antecedent_is_named_with_the_nearest_one() -> None:
    rows = [
        mdh.MdhRow(name="elbow"),
        mdh.MdhRow(name="wrist", antecedent="elbwo"),
    ]
    with pytest.raises(UnknownNameError, match=r"row wrist: .*'elbwo'.*'elbow'"):
        mdh.build_model("arm", rows, {})


def test_antecedent_further_down_the_table_is_refused() -> None:
    rows = [
        mdh.MdhRow(name="wrist", antecedent="elbow"),
        mdh.MdhRow(name="elbow"),
    ]
    with pytest.raises(UnknownNameError, match="'elbow'"):
        mdh.build_model("arm", rows, {})


def test_tip_on_an_unknown_row_is_refused() -> None:
    rows = [mdh.MdhRow(name="elbow")]
    with pytest.raises(UnknownNameError, match=r"tip hand: .*'wrist'"):
        mdh.build_model("arm", rows, {"hand": mdh.Tip(parent="wrist")})


def test_two_rows_with_one_name_are_refused() -> None:
    rows = [mdh.MdhRow(name="elbow"), mdh.MdhRow(name="elbow", antecedent="elbow")]
    with pytest.raises(InvalidValueError, match="two rows are called 'elbow'"):
        mdh.build_model("arm", rows, {})


@pytest.mark.parametrize("kind", ["revolute", "fixed"])
def test_tip_with_the_name_of_a_row_is_refused(kind: Literal["revolute", "fixed"]) -> None:
    """Else getFrameId finds the row's frame, and the tip's offset is silently lost."""
    rows = [
        mdh.MdhRow(name="elbow"),
        mdh.MdhRow(name="hand", antecedent="elbow", sigma=kind),
    ]
    with pytest.raises(InvalidValueError, match="hand"):
        mdh.build_model("arm", rows, {"hand": mdh.Tip(parent="elbow", offset=(0.1, 0, 0))})


def test_rows_that_jump_between_arms_are_refused() -> None:
    rows = [
        mdh.MdhRow(name="r1"),
        mdh.MdhRow(name="l1"),
        mdh.MdhRow(name="r2", antecedent="r1"),
    ]
    with pytest.raises(InvalidValueError, match="depth first"):
        mdh.build_model("arms", rows, {})


@pytest.mark.parametrize(("lower", "upper"), [(1.0, 1.0), (2.0, 1.0)])
def test_empty_joint_range_is_refused(lower: float, upper: float) -> None:
    with pytest.raises(InvalidValueError, match="elbow"):
        mdh.MdhRow(name="elbow", lower=lower, upper=upper)


IMPOSSIBLE: dict[str, dict[str, Any]] = {
    "limit not a number": {"lower": math.nan, "upper": 1.0},
    "negative mass": {"mass": -0.1},
    "mass not a number": {"mass": math.nan},
    "infinite mass": {"mass": math.inf},
    "negative moment": {"mass": 1, "inertia": (-1e-3, 0, 0, 1e-3, 0, 1e-3)},
    "moments no body has": {"mass": 1, "inertia": (1e-3, 0, 0, 1e-3, 0, 3e-3)},
    "products too large": {"mass": 1, "inertia": (1e-3, 2e-3, 0, 1e-3, 0, 1e-3)},
    "inertia not a number": {"mass": 1, "inertia": (math.nan, 0, 0, 1, 0, 1)},
    "infinite moment": {"mass": 1, "inertia": (math.inf, 0, 0, 1, 0, 1)},
    "centre of mass nowhere": {"mass": 1, "com": (math.nan, 0, 0)},
    "negative speed limit": {"velocity": -1},
    "unknown kind of joint": {"sigma": "ball"},
}


@pytest.mark.parametrize("keys", IMPOSSIBLE.values(), ids=IMPOSSIBLE.keys())
def test_row_without_meaning_is_refused(keys: dict[str, Any]) -> None:
    with pytest.raises(InvalidValueError):
        mdh.MdhRow(name="elbow", **keys)


def test_massless_link_is_allowed() -> None:
    model = mdh.build_model("arm", [mdh.MdhRow(name="elbow", mass=0.0)], {})
    assert model.inertias[1].mass == 0.0
