"""Transmission of internal wrenches: commanded by motors, borne by the structure, or released.

Wrenches of the hands against each other through the object have 6 (N - 1) dimensions. At rest
motor rows read tau = J_c' lambda, and passive ones 0 = J_cp' lambda, so the dimensions are

    not transmitted    rank J_cp             a hinge yields to it
    commanded          rank J_c - rank J_cp  motors generate it
    structure          6 (N - 1) - rank J_c  in the left null space: the links bear it

The same ranks of one arm's Jacobian J_i, six dimensions, hold for that arm against a fixed object,
and of J_j - J_i for a pair of hands. Torques count as forces at LENGTH.
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from coopqp.base.spec import Array
from coopqp.closed_loop.grasp_matrix import COMPONENTS, grasp_matrix, section
from coopqp.closed_loop.hands import hands
from coopqp.closed_loop.screw import LENGTH, MOTION_TOLERANCE, Screw, rank_of, scaled, screw_of
from coopqp.model.closed_chain import ClosedChain

COMMANDED, STRUCTURE, LET_GO, MIXED = "commanded", "structure", "not transmitted", "not alone"
#: These of components of a section wrench, in the order of the report.
FATES = {
    COMMANDED: "the motors command",
    MIXED: "only together with others they command",
    STRUCTURE: "the structure bears, unseen by any motor,",
    LET_GO: "a passive joint does not transmit",
}


@dataclass(frozen=True)
class Counts:
    """Dimensions of a space of wrenches."""

    commanded: int  # commanded, structure, let_go: see the module
    structure: int
    let_go: int
    weakest: float  # smallest singular value that is not zero [m or rad for a unit of joint motion]

    @property
    def summary(self) -> str:
        """Such as "4 commanded, 0 borne by the structure, 2 not transmitted"."""
        return (
            f"{self.commanded} commanded, {self.structure} borne by the structure, "
            f"{self.let_go} not transmitted"
        )


@dataclass(frozen=True)
class ArmTransmission:
    """One arm's wrenches on a fixed object, and those its links bear without motors, as screws."""

    arm: str
    counts: Counts
    borne: tuple[Screw, ...]


@dataclass(frozen=True)
class PairTransmission:
    """Wrenches of two hands against each other."""

    arms: tuple[str, str]
    counts: Counts
    # of the section wrench, each with the others zero: "commanded", "structure", "not transmitted",
    # or "not alone" where a component comes with others only
    components: dict[str, str]


@dataclass(frozen=True)
class Transmission:
    """The 6 (N - 1) internal wrenches: all, of each arm alone, and of each pair."""

    dimensions: int
    all: Counts
    arms: tuple[ArmTransmission, ...]
    pairs: tuple[PairTransmission, ...]


def transmission(chain: ClosedChain, q: Array) -> Transmission:
    """Classify the wrenches between the hands at q, shape (n,), with the loops closed."""
    J, passive = chain.object_jacobians(q)[: chain.holding], chain.passive
    X_WO = chain.object_pose(q)
    origin = X_WO.translation
    names = [arm.name for arm in chain.arms[: chain.holding]]
    J_c = scaled((J[1:] - J[0]).reshape(-1, chain.n))
    arms = []
    for name, J_i in zip(names, J, strict=True):
        _, values, Vt = np.linalg.svd(scaled(J_i).T)
        borne = scaled(Vt[int(np.sum(values > MOTION_TOLERANCE)) :].T)
        # A force along a line is dual to a turn about it: (m; f) is a twist about the same axis.
        turned = (np.concatenate([column[3:], column[:3]]) for column in borne.T)
        screws = tuple(screw_of(twist, origin) for twist in turned)
        arms.append(ArmTransmission(name, counts(scaled(J_i), passive), screws))
    touched = [origin + X_WO.rotation @ hand.X_OC.translation for hand in hands(chain)]
    pairs = []
    for i, j in itertools.combinations(range(len(names)), 2):
        rows = scaled(J[j] - J[i])
        cut = section(touched[i], touched[j])
        # A unit of each component at the middle, as a wrench of hand i at the object's origin.
        units = grasp_matrix([cut.middle], origin) @ np.kron(np.eye(2), cut.axes.T)
        components = _components(rows, scaled(units, 1.0 / LENGTH), passive)
        pairs.append(PairTransmission((names[i], names[j]), counts(rows, passive), components))
    return Transmission(len(J_c), counts(J_c, passive), tuple(arms), tuple(pairs))


def counts(rows: Array, passive: NDArray[np.int_] | Sequence[int]) -> Counts:
    """The three ranks for a Jacobian, shape (r, n), with rotations scaled to lengths."""
    values = np.linalg.svd(rows, compute_uv=False) if rows.size else np.zeros(0)
    moving = values[values > MOTION_TOLERANCE]
    let_go = rank_of(rows[:, list(passive)])
    weakest = float(moving.min(initial=np.inf))
    return Counts(len(moving) - let_go, len(rows) - len(moving), let_go, weakest)


def _components(rows: Array, units: Array, passive: NDArray[np.int_]) -> dict[str, str]:
    found = {}
    for name, unit in zip(COMPONENTS, units.T, strict=True):
        torque = rows.T @ (unit / np.linalg.norm(unit))
        if np.linalg.norm(torque) < MOTION_TOLERANCE:
            found[name] = STRUCTURE
        elif np.linalg.norm(torque[passive]) < MOTION_TOLERANCE:
            found[name] = COMMANDED
        else:
            found[name] = MIXED if rank_of(rows[:, passive]) < len(rows) else LET_GO
    return found
