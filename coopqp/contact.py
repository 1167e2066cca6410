"""What a hand can do that holds by pressing: the cone of wrenches that friction allows.

A contact frame has its z axis into the object. w = (f; t) is what the hand does to the object, in
that frame and at its origin. A cone is rows with ``rows @ w <= 0``, so that it is closed under
scaling: what counts is the ratio to the normal force f_z, which pushes and never pulls.

Two linear cones stand for the round one of Coulomb, |f_t| <= mu f_z. The inner one lies inside it,
so that what it allows friction bears; the outer one around it, so that what it forbids slips.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from coopqp.checked import Array

#: Friction is counted on over this where nothing else is said.
SAFETY = 1.5
#: Share of a pad's half-lengths that is counted on where nothing else is said: beyond its edge no
#: friction holds, and torques are held for a tick in which the arms move on.
REACH = 0.95
#: A hand that presses with less does not hold anything, whatever the ratio says [N].
NO_CONTACT = 1e-6
#: A pad tips over its edge where the normal force is beyond it by more than this share.
BEYOND = 1e-5


@dataclass(frozen=True)
class ForceRows:
    """What a wrench in the contact frame has to keep, rows @ w <= most.

    Attributes:
        rows: shape (r, 6).
        most: shape (r,) [N].
        labels: such as "friction[3]", "edge[2]", "least" and "most".
    """

    rows: Array
    most: Array
    labels: tuple[str, ...]


@dataclass(frozen=True, kw_only=True)
class Contact(ABC):
    """A hand's contact with the object.

    Attributes:
        placement: pose of the contact frame in the hand's tip frame, a pinocchio SE3.
        friction: coefficient mu.
        half_lengths: of the pad along the frame's x and y [m]; zero for a point.
        reach: share of the half-lengths that is counted on; what holds is the whole pad.
        least: normal force with which a hand is to press at least [N].
        most: normal force that hand and object stand [N].
    """

    placement: Any
    friction: float
    half_lengths: tuple[float, float] = (0.0, 0.0)
    reach: float = 1.0
    least: float = 0.0
    most: float = np.inf

    @abstractmethod
    def rows(self, friction: float) -> Array:
        """A cone inside Coulomb's, rows @ w <= 0, shape (r, 6).

        Args:
            friction: coefficient that is counted on: mu over a safety factor.
        """

    @abstractmethod
    def friction_needed(self, wrench: ArrayLike) -> float:
        """The coefficient of true friction that a wrench needs, whether or not it tips the hand.

        Args:
            wrench: of the hand on the object, contact frame, shape (6,) [N, N m].

        Returns:
            inf where the hand does not press.
        """

    @abstractmethod
    def edge_use(self, wrench: ArrayLike) -> float:
        """How far out the normal force is, over the half-lengths: 0 in the middle, 1 at an edge.

        Args:
            wrench: of the hand on the object, contact frame, shape (6,) [N, N m].

        Returns:
            NaN for a contact without an edge, and where the hand does not press.
        """

    def needed(self, wrench: ArrayLike) -> float:
        """The coefficient of true friction that a wrench needs; inf where none bears it.

        Args:
            wrench: of the hand on the object, contact frame, shape (6,) [N, N m].
        """
        tips = self.edge_use(wrench) > 1.0 + BEYOND
        return math.inf if tips else self.friction_needed(wrench)

    def holds(self, wrench: ArrayLike, friction: float) -> bool:
        """Whether true friction bears a wrench.

        Args:
            wrench: contact frame, shape (6,) [N, N m].
            friction: coefficient that there is.
        """
        return self.needed(wrench) <= friction

    def force_rows(self, safety: float) -> ForceRows:
        """All that a wrench of the hand has to keep: the inner cone, and the normal force.

        Args:
            safety: friction is counted on over this.
        """
        cone = self.counted_on.rows(self.friction / safety)
        # Rows without friction say where the normal force is: beyond the edge nothing helps.
        tilts = ~cone[:, [0, 1, 5]].any(axis=1)
        kinds = np.where(tilts, "edge", "friction")
        normal = np.zeros((2, 6))
        normal[:, 2] = -1.0, 1.0
        bounds, labels = [-self.least, self.most], ["least", "most"]
        ends = 1 if np.isinf(self.most) else 2
        return ForceRows(
            np.vstack([cone, normal[:ends]]),
            np.concatenate([self.least * cone[:, 2] * tilts, bounds[:ends]]),
            tuple([f"{kind}[{i}]" for i, kind in enumerate(kinds)] + labels[:ends]),
        )

    @property
    def counted_on(self) -> Contact:
        """The contact with the pad that is counted on, about the same middle."""
        X, Y = self.half_lengths
        return replace(self, half_lengths=(self.reach * X, self.reach * Y), reach=1.0)

    def use(self, wrench: ArrayLike, friction: float) -> float:
        """How much of the inner cone a wrench uses: 0 pure squeeze, 1 its edge; inf without one.

        Args:
            wrench: contact frame, shape (6,) [N, N m].
            friction: coefficient that is counted on.
        """
        w = np.asarray(wrench, float)
        if not w[2] > NO_CONTACT:
            return np.inf
        rows = self.rows(friction)
        return used(rows, w)

    def margin(self, wrench: ArrayLike, friction: float) -> float:
        """Share of the inner cone that is left, 1 - use; negative beyond it."""
        return 1.0 - self.use(wrench, friction)


def used(rows: Array, w: Array) -> float:
    """The largest share of a row's normal part that the rest of the wrench takes.

    Args:
        rows: of a cone, shape (r, 6).
        w: wrench with a normal force that presses, shape (6,).
    """
    normal = -rows[:, 2] * w[2]
    bound = normal > 0.0
    return float(np.max((rows[bound] @ w + normal[bound]) / normal[bound], initial=0.0))
