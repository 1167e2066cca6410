"""The torque QP's program with round cones in place of linear ones, by a conic solver (Clarabel).

python benchmarks/cones.py             # 500 ticks of press_and_lift, with pads and a fingertip

Pads bear a force at each corner that is counted on, |f_t| <= m f_z, and fingertips one force with
the same cone. All else is the first level's program as the law filled it; nothing is foreseen of
the tick, and what tilts pads keeps its rows. A round cone with cos(pi / edges) of the friction lies
inside the linear one, and that inside the round one with all of it; so the cost lies between the
costs of these two. A pad's square has four edges. Of the yaw that corners in round cones bear,
m f_z sqrt(X^2 + Y^2), a soft pad bears the share ``torsion``.
"""

from __future__ import annotations

import copy
import itertools
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import clarabel
import numpy as np
from scipy import sparse
from scipy.linalg import null_space

import coopqp
from coopqp.base.spec import Array
from coopqp.closed_loop.hands import into_contacts
from coopqp.controllers import TorqueQp
from coopqp.controllers.torque_qp import TorqueQpLaw
from coopqp.execution.rollout import drive
from coopqp.grasp import Contact
from coopqp.grasps import PointContact
from coopqp.model.state import State
from coopqp.plant import Disturbance, PlantModel
from coopqp.plants import RigidBody
from coopqp.solver import Status

TICKS, EVERY = 500, 8  # every eighth of 4 s: lifted, tilted, carried
ROUNDING = 1e-4  # of a cost, as solvers tell it
ACCURACY = 1e-9
RANK = 1e-9  # of equalities


def cost(qp: Any, x: Array) -> float:
    """What a program minimises, less its constant."""
    return float(0.5 * x @ qp.P @ x + qp.q @ x)


def round_cost(law: TorqueQpLaw, state: State, *, narrow: bool = False) -> float:
    """Least cost of the law's last program with round cones; inf where there is no answer.

    Args:
        law: after a tick.
        state: of that tick.
        narrow: whether with as much less friction as the linear cones lose at worst.
    """
    qp, layout, safety = law.qp, law.layout, law.settings.safety
    pads = [hand.contact and hand.contact.counted_on for hand in law.hands.hands]
    corners = [_corners(pad) for pad in pads if pad]
    n, extra = len(qp.q), 3 * sum(len(places) for places in corners)
    A, b, cones = _linear(law, n + extra)
    turned, at = into_contacts(law.hands.hands, state.R_WO), n
    places = iter(corners)
    for i, pad in enumerate(pads):
        if not pad:
            continue
        share = (worst_share(pad) if narrow else 1.0) / safety
        at, sums, rounds, kinds = _one(pad, next(places), share, at, n + extra)
        yaw = _yaw(pad, share, sums)
        start = layout.h.start + 6 * i
        sums[:3, start : start + 3] = -turned[i]
        if len(sums) > 3:
            sums[3:, start + 3 : start + 6] = -turned[i]
        A += [sums, yaw, *rounds.reshape(len(kinds), 3, -1)]
        b += [np.zeros(len(sums)), np.zeros(len(yaw)), *np.zeros((len(kinds), 3))]
        cones += [clarabel.ZeroConeT(len(sums)), clarabel.NonnegativeConeT(len(yaw)), *kinds]
    return _solved(law, A, b, cones)


def _solved(law: TorqueQpLaw, A: list[Array], b: list[Array], cones: list[Any]) -> float:
    """Least cost, about the law's own answer and along what the equalities leave free."""
    qp, n, size = law.qp, len(law.qp.q), A[0].shape[1]
    same = [isinstance(kind, clarabel.ZeroConeT) for kind in cones]
    E, e = _stacked(A, same), _stacked(b, same)
    G, g = _stacked(A, [not x for x in same]), _stacked(b, [not x for x in same])
    x = np.concatenate([law.solution.v, np.zeros(size - n)])
    x += np.linalg.lstsq(E, e - E @ x, rcond=RANK)[0]
    N = null_space(E, rcond=RANK)
    P = N[:n].T @ qp.P @ N[:n]
    q = N[:n].T @ (qp.P @ x[:n] + qp.q)
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.tol_gap_rel = settings.tol_gap_abs = settings.tol_feas = ACCURACY
    solver = clarabel.DefaultSolver(
        sparse.csc_matrix(np.triu(P)), q, sparse.csc_matrix(G @ N), g - G @ x,
        [kind for kind in cones if not isinstance(kind, clarabel.ZeroConeT)], settings,
    )  # fmt: skip
    answer = solver.solve()
    if answer.status not in (clarabel.SolverStatus.Solved, clarabel.SolverStatus.AlmostSolved):
        return float("inf")
    return cost(qp, x[:n] + N[:n] @ np.array(answer.x))


def _stacked(parts: list[Array], which: list[bool]) -> Array:
    return np.concatenate([part for part, own in zip(parts, which, strict=True) if own])


def _corners(contact: Contact) -> list[tuple[float, float]]:
    X, Y = contact.half_lengths
    return [(a * X, b * Y) for a, b in itertools.product((1.0, -1.0), repeat=2)] if X else [(0, 0)]


def _linear(law: TorqueQpLaw, size: int) -> tuple[list[Array], list[Array], list[Any]]:
    """All rows but those of friction: equalities, then inequalities and bounds, as A x + s = b."""
    qp, n = law.qp, len(law.qp.q)
    friction = [".friction[" in row.name for row in law.layout.inequalities]
    G, h = qp.G[~np.array(friction)], qp.h[~np.array(friction)]
    eye, fixed = np.eye(n), qp.lb == qp.ub  # sigma: a cone without an inside is no cone
    up, low = np.isfinite(qp.ub) & ~fixed, np.isfinite(qp.lb) & ~fixed
    same, exact = np.vstack([qp.A, eye[fixed]]), np.concatenate([qp.b, qp.lb[fixed]])
    rows, right = np.vstack([G, eye[up], -eye[low]]), [h, qp.ub[up], -qp.lb[low]]
    A = [np.zeros((len(same), size)), np.zeros((len(rows), size))]
    A[0][:, :n], A[1][:, :n] = same, rows
    bounded = np.concatenate(right)
    kinds = [clarabel.ZeroConeT(len(exact)), clarabel.NonnegativeConeT(len(bounded))]
    return A, [exact, bounded], kinds


def _one(
    contact: Contact, places: list[tuple[float, float]], share: float, at: int, size: int
) -> tuple[int, Array, Array, list[Any]]:
    """Sums of forces at corners, less the hand's wrench, and one cone for each corner."""
    m = contact.friction * share
    sums, rounds = np.zeros((6, size)), np.zeros((3 * len(places), size))
    for j, (x, y) in enumerate(places):
        part = slice(at, at + 3)
        sums[:3, part] = np.eye(3)
        sums[3:, part] = [[0.0, 0.0, y], [0.0, 0.0, -x], [-y, x, 0.0]]
        rounds[3 * j : 3 * j + 3, part] = [[0.0, 0.0, -m], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]
        at += 3
    # Behind a fingertip there are hinges, which say of themselves that it bears no torque.
    sums = sums if any(contact.half_lengths) else sums[:3]
    return at, sums, rounds, [clarabel.SecondOrderConeT(3) for _ in places]


def _yaw(contact: Contact, share: float, sums: Array) -> Array:
    """Rows <= 0 on the yaw of a pad that bears less of it than its corners would."""
    torsion = getattr(contact, "torsion", 1.0)
    if torsion == 1.0:
        return np.zeros((0, sums.shape[1]))
    most = torsion * share * contact.friction * float(np.hypot(*contact.half_lengths))
    return np.vstack([sums[5] - most * sums[2], -sums[5] - most * sums[2]])


def worst_share(contact: Contact) -> float:
    """Share of the friction whose round cone lies inside the linear one: of a pad's square 71 %."""
    return float(np.cos(np.pi / getattr(contact, "edges", 4)))


@dataclass(frozen=True)
class Costs:
    """Least costs of one tick.

    Attributes:
        linear: of the law's program.
        round: with round cones.
        narrow: with round cones inside the linear ones.
        free: with as much friction as anyone wants.
    """

    linear: float
    round: float
    narrow: float
    free: float

    @property
    def between(self) -> bool:
        """Whether the law's cost is between those of round cones, as far as solvers tell."""
        rounding = ROUNDING * max(self.narrow - self.free, ROUNDING * abs(self.free))
        return self.round - rounding <= self.linear <= self.narrow + rounding

    @property
    def loss(self) -> float:
        """How much more linear cones cost, over what round ones cost."""
        return (self.linear - self.round) / (self.round - self.free)

    @property
    def most(self) -> float:
        """How much more they may cost."""
        return (self.narrow - self.round) / (self.round - self.free)


def costs(law: TorqueQpLaw, state: State) -> Costs:
    """Of the law's last program, of a tick without another before it."""
    A, b, cones = _linear(law, len(law.qp.q))
    return Costs(
        cost(law.qp, law.solution.v), round_cost(law, state),
        round_cost(law, state, narrow=True), _solved(law, A, b, cones),
    )  # fmt: skip


def drawn(law: TorqueQpLaw, plant: PlantModel, every: int, count: int) -> Iterator[Costs]:
    """Costs of every so many ticks of a run, of those that gave nothing up.

    A second law decides them anew, as if nothing had been before.
    """
    anew, state = law.settings.build(law.problem), law.start()
    assert isinstance(anew, TorqueQpLaw)
    for i, _ in enumerate(drive(law, plant, state, every * count)):
        if i % every == 0:
            alone = copy.copy(state)
            alone.memory = copy.copy(state.memory)
            alone.memory["answer"][:] = 0.0
            if anew.tick(alone).causes == (Status.OPTIMAL,):
                yield costs(anew, alone)


def main() -> None:
    scenario = coopqp.load("press_and_lift")
    assert isinstance(scenario.grasps, Mapping)
    pose = scenario.grasps["left/arm"].object_in_hand
    tip = {**scenario.grasps, "left/arm": PointContact(object_in_hand=pose)}
    soft = {arm: replace(grasp, torsion=0.5) for arm, grasp in scenario.grasps.items()}
    aside = replace(scenario.held, com=(0.0, 0.03, 0.0))
    kinds = {
        "two pads": scenario,
        "two soft pads, 3 cm from the mass": replace(scenario, grasps=soft, held=aside),
        "a fingertip and a pad": replace(scenario, grasps=tip),
    }
    print("| held by | ticks | between | loss mean [%] | worst [%] | allowed mean [%] |")
    print("|---|---|---|---|---|---|")
    for kind, held in kinds.items():
        problem = held.problem()
        law = TorqueQp().build(problem)
        assert isinstance(law, TorqueQpLaw)
        plant = RigidBody().build(problem, 0, Disturbance())
        found = list(drawn(law, plant, EVERY, TICKS))
        loss = 100.0 * np.array([x.loss for x in found])
        most = 100.0 * np.mean([x.most for x in found])
        print(
            f"| {kind} | {len(found)} | {sum(x.between for x in found)} | {loss.mean():.1f} "
            f"| {loss.max():.1f} | {most:.1f} |"
        )


if __name__ == "__main__":
    main()
