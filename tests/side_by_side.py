"""The plain law drives; the kernel is asked at the same states."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

import numpy as np
import pytest

from coopqp.base.spec import Array
from coopqp.controller import ControlProblem
from coopqp.kernel import native
from coopqp.kernel.compiled import Outcome
from coopqp.kernel.free_space import FreeSpace, Told
from coopqp.kernel.law import KernelLaw
from coopqp.limit import LimitRows, Tighten
from coopqp.limits import _keep_apart
from coopqp.limits._bodies import Distances
from coopqp.limits._keep_apart import KeepApart
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.state import Memory, State
from coopqp.qp_law.law import QPLaw
from coopqp.solver import Status, written

DAMPING, ERROR_DAMPING = 1e-6, 0.5
#: How many were skipped stands at the end of a run: conftest.
needs_kernel = pytest.mark.skipif(native.module() is None, reason=native.MISSING)


@dataclass
class Agreement:
    """What became of the ticks of one motion.

    Attributes:
        ticks: how many.
        decided: by the kernel.
        left: what the kernel and the plain law said in ticks that were left to the plain law.
        otherwise: ticks of which the kernel and the plain law say something else.
        v: largest difference of velocities where the plain law is accurate too [rad/s].
        memory: largest difference of what is remembered.
    """

    ticks: int = 0
    decided: int = 0
    left: Counter[str] = field(default_factory=Counter)
    otherwise: Counter[str] = field(default_factory=Counter)
    v: float = 0.0
    memory: float = 0.0


def laws(problem: ControlProblem) -> tuple[QPLaw, KernelLaw]:
    """The plain law, and the kernel with a plain law of its own; both measure bodies alike."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(KeepApart, "bind", bind_to_the_kernels_distances)
        plain = QPLaw(problem, DAMPING, ERROR_DAMPING)
        return plain, KernelLaw(problem, DAMPING, ERROR_DAMPING).prepare()


BIND = KeepApart.bind


def bind_to_the_kernels_distances(self: KeepApart, chain: ClosedChain, dt: float) -> Tighten:
    """A limit's rows in Python, from the kernel's distances instead of coal's.

    coal iterates to a micrometre, and of parallel faces both may take other points for the nearest.
    The distances themselves are held against coal's by tests.kernel.distances.
    """
    space, now = FreeSpace(chain, [self.program(chain, dt)]), list[State]()

    class Measured(Distances):
        def update(self, within: float | Array) -> None:
            super().update(within)
            found = space.measure(now[-1].q)
            known = self.near[found[self.near, 0] == Told.MEASURED]
            self.d[known] = found[known, 1]
            self.p[known], self.n[known] = found[known, 3:6], found[known, 6:9]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(_keep_apart, "Distances", Measured)
        tighten = BIND(self, chain, dt)

    def measured(state: State, rows: LimitRows) -> None:
        now[:] = [state]
        tighten(state, rows)

    return measured


def why(law: KernelLaw) -> str:
    """What the kernel said last of a tick that it left to the plain law."""
    return Outcome(law.whole.outcome).name


def ask_alike(other: State, state: State) -> None:
    """Let a state be as another one."""
    other.q[:], other.v[:], other.t = state.q, state.v, state.t
    other.loop_offset[:], other.corrected = state.loop_offset, state.corrected
    other.memory.numbers[:] = state.memory.numbers


def drive(problem: ControlProblem, ticks: int) -> Agreement:
    """Compare along a motion."""
    plain, kernel = laws(problem)
    state, seen = plain.start(), Agreement(ticks)
    other = State(problem.chain, memory=Memory(plain.memory_sizes))
    for _ in range(ticks):
        ask_alike(other, state)
        found, wanted = kernel.tick(other), plain.tick(state)
        if not kernel.compiled:
            seen.left[f"{why(kernel)}, {written(wanted.causes)}"] += 1
        elif found.causes != wanted.causes and wanted.causes[0] is not Status.INACCURATE:
            seen.otherwise[f"{written(found.causes)} for {written(wanted.causes)}"] += 1
        else:
            seen.decided += 1
            if Status.INACCURATE not in wanted.causes:
                seen.v = max(seen.v, float(np.abs(found.v - wanted.v).max()))
                off = np.abs(other.memory.numbers - state.memory.numbers)
                seen.memory = max(seen.memory, float(off.max(initial=0.0)))
        state.advance(wanted.v, problem.dt)
    return seen
