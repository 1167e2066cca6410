"""A robot from the user's own table of modified Denavit-Hartenberg parameters.

Columns after Khalil and Kleinfinger (1986), the paper's eq. (2): see :mod:`coopqp.robot_files.mdh`.
"""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field

from coopqp.base.errors import under
from coopqp.base.spec import FARTHEST, NonNegative, Positive, Vector3, Vector6, one_angle, spec
from coopqp.robot import Robot, RobotModel
from coopqp.robot_files import mdh
from coopqp.robot_files.selection import Arms, Description, Locked, robot_model

SIGMA: tuple[mdh.JointKind, ...] = ("revolute", "prismatic", "fixed")


def _word(value: Any) -> Any:
    return SIGMA[value] if type(value) is int and 0 <= value <= 2 else value


def _antecedent(value: Any) -> Any:
    return None if type(value) is int and value == 0 else mdh.name_of(value)


@spec
class TableRow:
    """Row j of the table."""

    name: Annotated[str, BeforeValidator(mdh.name_of)]
    """Of the joint, or its number j."""
    antecedent: Annotated[str | None, BeforeValidator(_antecedent)] = None
    """a(j): name of the row before it; the base when omitted or 0."""
    sigma: Annotated[Literal["revolute", "prismatic", "fixed"], BeforeValidator(_word)] = "revolute"
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

    def read(self) -> mdh.MdhRow:
        parameters = mdh.MdhParameters(
            gamma=self._radians("gamma", 0.0), b=self.b, alpha=self._radians("alpha", 0.0),
            d=self.d, theta=self._radians("theta", 0.0), r=self.r,
        )  # fmt: skip
        link = None
        if self.mass is not None:
            link = mdh.Link(mass=self.mass, com=self.com, inertia=self.inertia, axes=self.axes)
        return mdh.MdhRow(
            name=self.name,
            antecedent=self.antecedent,
            kind=self.sigma,
            parameters=parameters,
            lower=self._radians("lower", -math.inf),
            upper=self._radians("upper", math.inf),
            velocity=self._radians("velocity", math.inf),
            effort=math.inf if self.effort is None else self.effort,
            link=link,
        )

    def _radians(self, key: str, otherwise: float) -> float:
        value, degrees = getattr(self, key), getattr(self, f"{key}_deg")
        if degrees is not None:
            return math.radians(degrees)
        return otherwise if value is None else float(value)


@spec
class MdhTable(Robot):
    """A robot from its table after Khalil and Kleinfinger (modified Denavit-Hartenberg)."""

    rows: Annotated[tuple[TableRow, ...], Field(min_length=1)]
    """The table, arm by arm, each row after its antecedent."""
    arms: Arms
    """Arms by name, each its tip (a row or one of tips) or {tip: frame, joints: [...]}."""
    tips: dict[str, mdh.Tip] = Field(default_factory=dict)
    """Frames of the hands, by name: {parent: row, offset: [m]}."""
    free: tuple[str, ...] = ()
    """Joints that join in besides those of the arms."""
    locked: Locked = Field(default_factory=dict)
    """Joints kept still: names, or names with values [rad or m]; others that move no tip too."""

    def build(self) -> RobotModel:
        rows = []
        for i, row in enumerate(self.rows):
            with under("rows", i):
                rows.append(row.read())
        model = mdh.build_model("mdh_table", rows, self.tips)
        return robot_model(
            Description(name=model.name, model=model),
            arms=self.arms,
            free=self.free,
            locked=self.locked,
        )
