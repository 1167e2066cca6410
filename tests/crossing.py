"""Goals that go slowly across the border of reach, and how continuous a law's command is there.

A point of the object follows a circle of which one half is unreachable. The law drives; where its
command changes most from one tick to the next, the segment between the two states (q, v, t and
memory) is halved towards the half with the larger change. A continuous command changes less and
less; what is left of a change is a jump. Near the border a command may be steep, as damping begins
there from next to nothing: that of scaled tasks is 1e-6, and more by 150 times what a share lacked
a tick ago, so that v may change by 1e8 rad/s for a unit of it. 52 halvings, after which q and t are
equal but for last digits, tell such a slope from a jump.

Later levels of a hierarchy jump on their own, whatever the mode of the first task, where a limit
ceases to depend on the rows decided before. So the motion is looked at of the task alone, and
beside others what the task itself sees of it, J v, which later levels keep.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import scipy.linalg
from stress import goals
from walks import vector

from coopqp.base.spec import Array
from coopqp.controller import ControlProblem, Law
from coopqp.controllers import QPController
from coopqp.limits import JointPosition, JointVelocity
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.profile import Profile
from coopqp.model.state import State
from coopqp.signals import Circle
from coopqp.solver import Status, written
from coopqp.solvers import Daqp
from coopqp.task import TaskStack
from coopqp.tasks import JointCentering, Orientation, PointOnPoint

DT = 0.01  # [s]
RADIUS, PERIOD, ROUNDS = 0.02, 4.0, 1.5  # of the circle [m, s], and how often it is gone round
APPROACH = 4.0  # time in which a run comes to the border [s]
OUT = 2.0  # farther than any arm reaches, a share of its reach
LOOKED_AT, HALVINGS = 20, 52  # steps in which v changes most
#: Of a change that may be left where the command is continuous [rad/s, m/s].
LEFT = 1e-4

Mode = Literal["soft", "hard", "scaled"]


@dataclass(frozen=True)
class Left:
    """What is left of a change after all halvings.

    Attributes:
        size: of it [rad/s, m/s].
        said: what the commands on both sides say.
        sides: the two states, packed.
        step: the change of the state from one tick to the next, packed.
    """

    size: float
    said: tuple[str, str]
    sides: tuple[Array, Array]
    step: Array


@dataclass(frozen=True)
class Jump:
    """How far a command is from continuous along a motion.

    Attributes:
        step: largest change of v from one tick to the next [rad/s, m/s].
        left: what is left of any change of v after all halvings [rad/s, m/s].
        seen: what the first task sees of a change, J v, after all halvings [m/s].
        tick: where that is.
        said: what the commands on both sides of it say.
        relaxed: share of the ticks that say that tasks are not met in full.
        crossings: how often the command changes between such ticks and optimal ones.
        jumps: all changes of v of which more than LEFT is left.
    """

    step: float
    left: float
    seen: float
    tick: int
    said: tuple[str, str]
    relaxed: float
    crossings: int
    jumps: tuple[Left, ...]


def problem(
    chain: ClosedChain,
    mode: Mode,
    seed: int = 0,
    *,
    alone: bool = False,
    signs: tuple[int, int] = (1, 1),
) -> ControlProblem:
    """A point goes round a circle about the border of reach, from the side that is in reach.

    Args:
        chain: at a pose inside its limits.
        mode: of that task; a soft one comes before the other task, as a hard one does.
        seed: of the directions.
        alone: without another task.
        signs: of the two directions.
    """
    drawn = directions(chain, np.random.default_rng(seed))
    out, across = (sign * way for sign, way in zip(signs, drawn, strict=True))
    border = _at_the_end(chain, chain.start_position + OUT * chain.reach * out)
    begin = border.start_position - RADIUS * out
    near = _at_the_end(border, begin)
    round_ = Circle(
        center=vector(border.start_position),
        radius=RADIUS,
        normal=vector(np.cross(out, across)),
        begin=vector(-out),
        period=PERIOD,
    )
    firm = PointOnPoint(name="firm", goal=round_, mode=mode, gain=5.0, profile=Profile(kind="step"))
    made = _problem(near, firm)
    return replace(made, tasks=(firm,), secondary=()) if alone else made


def directions(chain: ClosedChain, rng: np.random.Generator) -> tuple[Array, Array]:
    """Two directions at right angles in which the object can move at the start, if it can."""
    state = State(chain)
    ways = state.J_task[:3] @ scipy.linalg.null_space(state.J_loop, rcond=1e-8)
    U, values, _ = np.linalg.svd(ways)
    free = U[:, : int((values > 1e-3).sum())]
    out = free @ rng.normal(size=free.shape[1])
    out /= np.linalg.norm(out)
    rest = free if free.shape[1] > 1 else np.eye(3)
    across = rest @ rng.normal(size=rest.shape[1])
    across -= (across @ out) * out
    return out, across / np.linalg.norm(across)


def _problem(chain: ClosedChain, firm: PointOnPoint) -> ControlProblem:
    roll, pitch, yaw = goals.random_aim(
        np.random.default_rng(0), chain.object_pose(chain.q_start)
    ).rpy
    turned = Orientation(
        name="turned", rpy=(roll + 0.2, pitch - 0.1, yaw + 0.2), priority=1,
        gain=5.0, profile=Profile(kind="step"),
    )  # fmt: skip
    return ControlProblem(
        chain=chain,
        tasks=(firm, turned),
        secondary=(JointCentering(gain=0.5),),
        limits=(JointPosition(), JointVelocity()),
        dt=DT,
        solver=Daqp(),
    )


def _at_the_end(chain: ClosedChain, goal: Array) -> ClosedChain:
    """The chain at the place as near to a goal as the QP with soft tasks comes."""
    reach = PointOnPoint(
        name="reach", goal=vector(goal), gain=5.0, profile=Profile(duration=0.5 * APPROACH)
    )
    law = QPController().build(_problem(chain, reach))
    made = law.run(law.start(), round(APPROACH / DT))
    return chain.moved(made.q[-1])


def jump(law: Law) -> Jump:
    """The largest jump of a law's command as it drives the circle."""
    state, ticks = law.start(), round(ROUNDS * PERIOD / law.problem.dt)
    states, commands, relaxed = [], [], []
    for _ in range(ticks):
        states.append(_packed(state))
        command = law.step(state)
        commands.append(command.v.copy())
        relaxed.append(command.status is not Status.OPTIMAL)
    changes = np.abs(np.diff(commands, axis=0)).max(axis=1)
    crossed = np.flatnonzero(np.diff(np.array(relaxed, int)))
    asked = Asked(law)
    found = {
        k: (asked.left(states[k], states[k + 1]), asked.left(states[k], states[k + 1], seen=True))
        for k in {*np.argsort(changes)[-LOOKED_AT:].tolist(), *crossed.tolist()}
    }
    worst = max(found, key=lambda k: found[k][0].size)
    return Jump(
        step=float(changes.max()),
        left=found[worst][0].size,
        seen=max(seen.size for _, seen in found.values()),
        tick=worst,
        said=found[worst][0].said,
        relaxed=float(np.mean(relaxed)),
        crossings=len(crossed),
        jumps=tuple(found[k][0] for k in sorted(found) if found[k][0].size > LEFT),
    )


class Asked:
    """The commands of a law at any states."""

    def __init__(self, law: Law) -> None:
        self._law, self._state = law, law.start()
        self._firm = TaskStack(law.problem.tasks[:1], self._state)

    def left(self, a: Array, b: Array, *, seen: bool = False) -> Left:
        """Halve the segment between two states towards the larger change.

        Args:
            a: a state, packed.
            b: another.
            seen: whether it is the change of what the first task sees, instead of all of v.
        """
        step, at_a, at_b = b - a, self.at(a, seen=seen), self.at(b, seen=seen)
        for _ in range(HALVINGS):
            middle = 0.5 * (a + b)
            at_middle = self.at(middle, seen=seen)
            if np.abs(at_middle - at_a).max() > np.abs(at_b - at_middle).max():
                b, at_b = middle, at_middle
            else:
                a, at_a = middle, at_middle
        said = self._said(a), self._said(b)
        return Left(float(np.abs(at_b - at_a).max()), said, (a, b), step)

    def _said(self, packed: Array) -> str:
        self.at(packed)
        return written(self._law.command.causes)

    def state(self, packed: Array) -> State:
        """It, as it is before a tick."""
        state, n = self._state, len(self._state.q)
        state.t, state.corrected = float(packed[0]), float(packed[1])
        state.q[:], state.v[:] = packed[2 : 2 + n], packed[2 + n : 2 + 2 * n]
        state.memory.numbers[:] = packed[2 + 2 * n :]
        state.update()
        return state

    def at(self, packed: Array, *, seen: bool = False) -> Array:
        """The command at a state, or what the first task sees of it."""
        state = self.state(packed)
        v = self._law.tick(state).v.copy()
        if not seen:
            return v
        self._firm.update(state)
        return np.asarray(self._firm.J @ v)


def _packed(state: State) -> Array:
    """All that a tick depends on."""
    return np.concatenate([[state.t, state.corrected], state.q, state.v, state.memory.numbers])
