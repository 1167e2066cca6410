"""Modified Denavit-Hartenberg tables after Khalil and Kleinfinger (1986).

The transform from the antecedent frame a(j) to frame j is (paper eq. (2))

    T = rot_z(gamma) trans_z(b) rot_x(alpha) trans_x(d) rot_z(theta) trans_z(r)

with gamma = b = 0 when x_a(j) is perpendicular to z_j. Lengths in metres, angles in radians.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Annotated, Any, Literal, get_args

import numpy as np
import pinocchio as pin
from pydantic import BeforeValidator

from coopqp.base.errors import InvalidValueError, UnknownNameError
from coopqp.base.spec import Array, Vector3, spec
from coopqp.model.held_object import check_inertia, inertia_matrix

#: sin(alpha) below which two axes count as parallel.
PARALLEL_AXES = 1e-8

JointKind = Literal["revolute", "prismatic", "fixed"]


@dataclass(frozen=True, kw_only=True)
class MdhParameters:
    """The six parameters of one transform, eq. (2)."""

    gamma: float = 0.0
    b: float = 0.0
    alpha: float = 0.0
    d: float = 0.0
    theta: float = 0.0
    r: float = 0.0


@dataclass(frozen=True, kw_only=True)
class Link:
    """Mass properties of the link moved by a joint.

    Attributes:
        mass: [kg].
        com: centre of mass from the origin of frame j, shape (3,) [m].
        inertia: ixx ixy ixz iyy iyz izz about the centre of mass [kg m2].
        axes: of com and inertia: "joint", those of MDH frame j; "base", those of the base at the
            zero pose, as in data of robot makers.
    """

    mass: float
    com: tuple[float, float, float] = (0.0, 0.0, 0.0)
    inertia: tuple[float, float, float, float, float, float] = (0.0,) * 6
    axes: Literal["joint", "base"] = "joint"

    def __post_init__(self) -> None:
        if not 0.0 <= self.mass < math.inf:
            raise InvalidValueError(f"link mass: found {self.mass} kg, needs 0 or more")
        if not np.isfinite([*self.com, *self.inertia]).all():
            raise InvalidValueError("link com and inertia: need finite numbers")
        check_inertia(self.matrix, "link inertia")

    @property
    def matrix(self) -> Array:
        """Inertia about the centre of mass, shape (3, 3) [kg m2]."""
        return inertia_matrix(self.inertia)


@dataclass(frozen=True, kw_only=True)
class MdhRow:
    """One row of the table: joint j, its antecedent, its transform and its limits.

    Attributes:
        name: of the joint (or of the frame, for a fixed row).
        antecedent: name of the antecedent joint; None for the base.
        kind: sigma of the table: revolute (0), prismatic (1), fixed (2).
        parameters: the transform at joint value 0; theta of a revolute joint, r of a prismatic one
            is the offset between the encoder's zero and the table's.
        lower, upper, velocity, effort: limits [rad or m], [rad/s or m/s], [N m or N].
        link: None if massless.
    """

    name: str
    antecedent: str | None
    kind: JointKind = "revolute"
    parameters: MdhParameters = field(default_factory=MdhParameters)
    lower: float = -math.inf
    upper: float = math.inf
    velocity: float = math.inf
    effort: float = math.inf
    link: Link | None = None

    def __post_init__(self) -> None:
        if self.kind not in get_args(JointKind):
            known = get_args(JointKind)
            raise UnknownNameError("kind", str(self.kind), known, f"joint {self.name}: ")
        if not (self.velocity > 0.0 and self.effort >= 0.0):
            raise InvalidValueError(
                f"joint {self.name}: velocity {self.velocity} and effort {self.effort} "
                "must be positive"
            )
        if self.kind != "fixed" and not self.lower < self.upper:
            raise InvalidValueError(
                f"joint {self.name}: lower limit {self.lower} is not below upper {self.upper}"
            )


def name_of(value: Any) -> Any:
    """A row's name, or its number j as one."""
    return str(value) if type(value) is int else value


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
        return MdhParameters(
            gamma=gamma, b=b_plus_r_cos - r * R[2, 2], alpha=alpha, d=d, theta=theta, r=r
        )
    # Parallel axes: alpha is 0 or pi and only gamma +- theta matters; x is along the offset.
    alpha = 0.0 if R[2, 2] > 0.0 else math.pi
    gamma = math.atan2(p[1], p[0])
    about_z = math.atan2(R[1, 0], R[0, 0])
    theta = about_z - gamma if alpha == 0.0 else gamma - about_z
    return MdhParameters(
        gamma=gamma, b=p[2], alpha=alpha, d=math.hypot(p[0], p[1]), theta=theta, r=0.0
    )


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
        if row.kind == "fixed":
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
        if row.link is not None:
            joint, X = placed[row.name]
            R = (data.oMi[joint] * X).rotation.T if row.link.axes == "base" else np.eye(3)
            com = R @ np.asarray(row.link.com)
            body = pin.Inertia(row.link.mass, com, R @ row.link.matrix @ R.T)
            model.appendBodyToJoint(joint, body, X)
    _add_tips(model, data, tips, placed)
    return model


def _unknown(kind: str, name: str, placed: _Placed, where: str) -> UnknownNameError:
    return UnknownNameError(kind, name, [str(n) for n in placed if n is not None], where)


def _add_joint(model: pin.Model, parent: int, placement: pin.SE3, row: MdhRow) -> int:
    joint = pin.JointModelRZ() if row.kind == "revolute" else pin.JointModelPZ()
    one = np.ones(1)
    index = model.addJoint(
        parent, joint, placement, row.name,
        row.effort * one, row.velocity * one, row.lower * one, row.upper * one,
    )  # fmt: skip
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
