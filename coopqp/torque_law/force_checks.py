"""Checks of wanted forces at the start and at rest, by linear programs."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from coopqp.base.errors import GraspError, InvalidValueError
from coopqp.closed_loop.holding import Bound, StaticHold, cannot_carry
from coopqp.closed_loop.wrench_stack import WrenchStack
from coopqp.controller import ControlProblem
from coopqp.model.state import State

#: Wanted forces may be unreachable by rounding [N, N m].
ROUNDING = 1e-6


def require_forces(problem: ControlProblem, safety: float, name: str) -> None:
    """Refuse grasps that do not hold with friction over ``safety``, and unreachable wrenches.

    Raises:
        GraspError: hands that press cannot carry the object, or hard tasks ask for wrenches that
            the grasp cannot transmit together; says which.
        InvalidValueError: a wrench beyond what motors and friction give; says how much they do.
    """
    pressing = any(grasp.contact for grasp in problem.chain.grasps.values())
    if problem.chain.holding < 2 or not (pressing or problem.wrenches):
        return
    start = State(problem.chain)
    hold, asked = StaticHold(problem.chain, safety=safety), WrenchStack(problem.wrenches, start)
    if pressing and (load := hold.load()).value < 1.0:
        raise GraspError(
            f"{name}: cannot hold the object at rest with safety {safety:g}: "
            f"{cannot_carry(problem.chain, hold, load)}"
        )
    asked.update(start)
    for fault in unreachable_wrenches(hold, asked):
        raise InvalidValueError(f"{name}: {fault}")
    _require_together(hold, asked, name)


def unreachable_wrenches(hold: StaticHold, asked: WrenchStack) -> Iterator[str]:
    """Wanted wrenches beyond what motors and friction give at rest, a sentence each.

    ``asked`` must be up to date at the pose of ``hold``.
    """
    for row, C, wanted in zip(asked.rows, asked.C, asked.wanted, strict=True):
        least, most = (hold.extreme(C, sign) for sign in (-1.0, 1.0))
        if least is None or most is None:
            return  # the object cannot be carried; reported elsewhere where hands press
        if least.value - ROUNDING <= wanted <= most.value + ROUNDING:
            continue
        near: Bound = least if wanted < least.value else most
        yield (
            f"{row.name} wants {wanted:.3g} {row.unit}, but at rest at the start the hands "
            f"can do {least.value:.3g} to {most.value:.3g} {row.unit}; {near.holds} back"
        )


def _require_together(hold: StaticHold, asked: WrenchStack, name: str) -> None:
    hard = np.flatnonzero(asked.hard)
    if not len(hard) or _can(hold, asked, hard):
        return
    culprits = [asked.rows[i].name for i in hard if _can(hold, asked, hard[hard != i])]
    which = ", ".join(culprits) or "several of them"
    raise GraspError(
        f"{name}: the grasp cannot bear all hard wrenches together; without one of {which} it "
        "could. Leave that component free, or make it soft"
    )


def _can(hold: StaticHold, asked: WrenchStack, rows: NDArray[np.intp]) -> bool:
    """Whether these rows can have their values at once."""
    nothing = np.zeros(asked.C.shape[1])
    return hold.extreme(nothing, 1.0, (asked.C[rows], asked.wanted[rows])) is not None
