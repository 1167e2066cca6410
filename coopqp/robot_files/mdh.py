"""Modified Denavit-Hartenberg tables after Khalil and Kleinfinger (1986).

The transform from the antecedent frame a(j) to frame j is (paper eq. (2))

    T = rot_z(gamma) trans_z(b) rot_x(alpha) trans_x(d) rot_z(theta) trans_z(r)

with gamma = b = 0 when x_a(j) is perpendicular to z_j. Lengths in metres, angles in radians.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Literal

import numpy as np
import pinocchio as pin
from pydantic import BeforeValidator

from coopqp.base.errors import InvalidValueError, UnknownNameError
from coopqp.base.spec import (
    FARTHEST,
    Array,
    NonNegative,
    Positive,
    Vector3,
    Vector6,
    one_angle,
    spec,
)
from coopqp.model.grasp_configuration import check_inertia, inertia_matrix

PARALLEL_AXES = 1e-8  # sin(alpha) below which two axes count as parallel


@dataclass(frozen=True, kw_only=True)
class MdhParameters:
    """The six parameters of one transform, eq. (2)."""

    gamma: float = 0.0
    b: float = 0.0
    alpha: float = 0.0
    d: float = 0.0
    theta: float = 0.0
    r: float = 0.0


def name_of(value: Any) -> Any:
    """A row's name, or its number j as one."""
    return str(value) if type(value) is int else value


SIGMA: tuple[str, ...] = ("revolute", "prismatic", "fixed")


#: What rows may say instead of a name and a word.
Antecedent = BeforeValidator(lambda x: None if type(x) is int and x == 0 else name_of(x))
Word = BeforeValidator(lambda x: SIGMA[x] if type(x) is int and 0 <= x <= 2 else x)


@spec
class MdhRow:
    """Row j of the table: a joint, its antecedent, its transform and its limits."""

    name: Annotated[str, BeforeValidator(name_of)]
    """Of the joint, or its number j."""
    antecedent: Annotated[str | None, Antecedent] = None
    """a(j): name of the row before it; the base when omitted or 0."""
    sigma: Annotated[Literal["revolute", "prismatic", "fixed"], Word] = "revolute"
    """Revolute (0), prismatic (1) or fixed (2)."""
    gamma: float | None = None
    """[rad]"""
    gamma_deg: float | None = None
    """[degrees]"""
    b: float = 0.0
    """[m]"""
    alpha: float | None = None
    """[rad]"""
    alpha_deg: float | None = None
    """[degrees]"""
    d: float = 0.0
    """[m]"""
    theta: float | None = None
    """[rad]; of a revolute joint the value that is added to the joint's."""
    theta_deg: float | None = None
    """[degrees]"""
    r: float = 0.0
    """[m]; of a prismatic joint the value that is added to the joint's."""
    lower: float | None = None
    """Position limit [rad or m]; none when omitted."""
    lower_deg: float | None = None
    """[degrees]"""
    upper: float | None = None
    """Position limit [rad or m]; none when omitted."""
    upper_deg: float | None = None
    """[degrees]"""
    velocity: Positive | None = None
    """Limit [rad/s or m/s]; none when omitted."""
    velocity_deg: Positive | None = None
    """[degrees/s]"""
    effort: Positive | None = None
    """Limit [N m or N]; none when omitted."""
    mass: NonNegative | None = None
    """Of the link that the joint moves [kg]; massless when omitted."""
    com: Vector3 = (0.0, 0.0, 0.0)
    """Its centre of mass, from the row's origin [m]."""
    inertia: Vector6 = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    """ixx ixy ixz iyy iyz izz about the centre of mass [kg m2]."""
    axes: Literal["joint", "base"] = "joint"
    """Of com and inertia: the row's own, or the base's at the zero pose."""

    def __post_init__(self) -> None:
        for key in ("gamma", "alpha", "theta", "lower", "upper", "velocity"):
            degrees = getattr(self, f"{key}_deg")
            one_angle(key, getattr(self, key), degrees)
            if key in ("lower", "upper", "velocity") and degrees and self.sigma == "prismatic":
                raise ValueError(f"{key}_deg: a prismatic joint has no degrees; give {key} in m")
        for key in ("b", "d", "r"):
            if abs(getattr(self, key)) > FARTHEST:
                words = f"found {getattr(self, key):g} m, needs at most {FARTHEST:g} m"
                raise ValueError(f"{key}: {words}")
        if self.mass is None and any((*self.com, *self.inertia)):
            raise ValueError("com and inertia need a mass")
        check_inertia(inertia_matrix(self.inertia), "link inertia")
        if self.sigma != "fixed" and not self.limit("lower") < self.limit("upper"):
            low, high = self.limit("lower"), self.limit("upper")
            words = f"lower limit {low} is not below upper {high}"
            raise ValueError(f"joint {self.name}: {words}")

    @property
    def parameters(self) -> MdhParameters:
        """Its transform at joint value 0."""
        gamma, alpha, theta = (self._radians(key) or 0.0 for key in ("gamma", "alpha", "theta"))
        return MdhParameters(gamma=gamma, b=self.b, alpha=alpha, d=self.d, theta=theta, r=self.r)

    def limit(self, key: Literal["lower", "upper", "velocity", "effort"]) -> float:
        """One of its limits, infinite where there is none [rad, rad/s, N m; m, m/s, N]."""
        value = self.effort if key == "effort" else self._radians(key)
        return (-math.inf if key == "lower" else math.inf) if value is None else value

    def _radians(self, key: str) -> float | None:
        value, degrees = getattr(self, key), getattr(self, f"{key}_deg")
        return value if degrees is None else math.radians(degrees)


@spec
class Tip:
    """A hand: a frame fixed to a row, with the base's axes at the zero pose."""

    parent: Annotated[str, BeforeValidator(name_of)]
    """Name of the row."""
    offset: Vector3 = (0.0, 0.0, 0.0)
    """From the row's origin, along the base's axes at the zero pose [m]."""


def transform(p: MdhParameters) -> pin.SE3:
    """The pose of frame j in frame a(j), eq. (2)."""
    first = pin.SE3(_rot_z(p.gamma), np.array([0.0, 0.0, p.b]))
    c, s = math.cos(p.alpha), math.sin(p.alpha)
    rot_x = np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])
    fixed = first * pin.SE3(rot_x, rot_x @ np.array([p.d, 0.0, 0.0]))
    return fixed * pin.SE3(_rot_z(p.theta), np.array([0.0, 0.0, p.r]))


def grasp_parameters(X: pin.SE3) -> MdhParameters:
    """The parameters whose transform is X, the inverse of eq. (2); with r = 0 for parallel axes."""
    R, p = X.rotation, X.translation
    sin_alpha = math.hypot(R[0, 2], R[1, 2])
    alpha = math.atan2(sin_alpha, R[2, 2])
    if sin_alpha > PARALLEL_AXES:
        gamma = math.atan2(R[0, 2], -R[1, 2])
        theta = math.atan2(R[2, 0], R[2, 1])
        d, minus_r_sin, b_plus_r_cos = _rot_z(-gamma) @ p
        r = -minus_r_sin / sin_alpha
        b = b_plus_r_cos - r * R[2, 2]
        return MdhParameters(gamma=gamma, b=b, alpha=alpha, d=d, theta=theta, r=r)
    # Parallel axes: alpha is 0 or pi and only gamma +- theta matters; x is along the offset.
    alpha = 0.0 if R[2, 2] > 0.0 else math.pi
    gamma = math.atan2(p[1], p[0])
    about_z = math.atan2(R[1, 0], R[0, 0])
    theta = about_z - gamma if alpha == 0.0 else gamma - about_z
    d = math.hypot(p[0], p[1])
    return MdhParameters(gamma=gamma, b=p[2], alpha=alpha, d=d, theta=theta, r=0.0)


_Placed = dict[str | None, tuple[int, pin.SE3]]
"""Joint that moves each row's frame, and the frame in it; the base is None."""


def build_model(name: str, rows: Sequence[MdhRow], tips: Mapping[str, Tip]) -> pin.Model:
    """A pinocchio model whose joint frames are the table's frames.

    The joint variable is the encoder angle (or stroke): frame j of the table at joint value q is
    ``transform`` with theta + q (or r + q). Rows are listed arm by arm (depth first); tips are
    frames to add at the end of a row, such as a hand, by name.

    UnknownNameError: an antecedent or tip parent is not in the table above it. InvalidValueError:
    two rows share a name, or rows are not depth first.
    """
    model = pin.Model()
    model.name = name
    placed: _Placed = {None: (0, pin.SE3.Identity())}
    for i, row in enumerate(rows):
        if row.name in placed:
            words = f"MDH table {name}: two rows are called '{row.name}'"
            raise InvalidValueError(words).at("rows", i)
        if row.antecedent not in placed:
            where = f"row {row.name}: "
            raise _unknown("antecedent", str(row.antecedent), placed, where).at("rows", i)
        parent, X = placed[row.antecedent]
        placement = X * transform(row.parameters)
        if row.sigma == "fixed":
            placed[row.name] = parent, placement
            model.addFrame(pin.Frame(row.name, parent, placement, pin.FrameType.OP_FRAME))
        else:
            placed[row.name] = _add_joint(model, parent, placement, row), pin.SE3.Identity()
    if not model.check(model.createData()):
        words = f"MDH table {name}: list the rows arm by arm (depth first)"
        raise InvalidValueError(words).at("rows")
    data = model.createData()
    pin.forwardKinematics(model, data, pin.neutral(model))
    for row in rows:
        if row.mass is not None:
            joint, X = placed[row.name]
            R = (data.oMi[joint] * X).rotation.T if row.axes == "base" else np.eye(3)
            about = R @ inertia_matrix(row.inertia) @ R.T
            model.appendBodyToJoint(joint, pin.Inertia(row.mass, R @ np.asarray(row.com), about), X)
    _add_tips(model, data, tips, placed)
    return model


def _unknown(kind: str, name: str, placed: _Placed, where: str) -> UnknownNameError:
    return UnknownNameError(kind, name, [str(n) for n in placed if n is not None], where)


def _add_joint(model: pin.Model, parent: int, placement: pin.SE3, row: MdhRow) -> int:
    joint = pin.JointModelRZ() if row.sigma == "revolute" else pin.JointModelPZ()
    limits = (np.full(1, row.limit(key)) for key in ("effort", "velocity", "lower", "upper"))
    index = model.addJoint(parent, joint, placement, row.name, *limits)
    model.addJointFrame(index)
    return int(index)


def _add_tips(model: pin.Model, data: pin.Data, tips: Mapping[str, Tip], placed: _Placed) -> None:
    for name, tip in tips.items():
        if name in placed:
            raise InvalidValueError(f"tip {name}: a row has this name already").at("tips", name)
        if tip.parent not in placed:
            raise _unknown("row", tip.parent, placed, f"tip {name}: ").at("tips", name)
        joint, X = placed[tip.parent]
        X_WJ = data.oMi[joint]
        X_WT = pin.SE3(np.eye(3), (X_WJ * X).translation + np.asarray(tip.offset))
        model.addFrame(pin.Frame(name, joint, X_WJ.inverse() * X_WT, pin.FrameType.OP_FRAME))


def _rot_z(angle: float) -> Array:
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
