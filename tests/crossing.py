"""Goals that go slowly across the border of reach, and how continuous a law's command is there.

A point of the object follows a circle of which one half is out of reach. The law drives; where its
command changes most from one tick to the next, the segment between the two states (q, v, t and
memory) is halved towards the half with the larger change. A continuous command changes less and
less; what is left of a change is a jump.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from coopqp.checked import Array
from coopqp.closed_chain import ClosedChain
from coopqp.controller import ControlProblem, Law
from coopqp.controllers import QPController
from coopqp.limits import JointPosition, JointVelocity
from coopqp.profile import Profile
from coopqp.rank import null_space
from coopqp.signals import Circle
from coopqp.solver import Status, written
from coopqp.solvers import Daqp
from coopqp.state import State
from coopqp.study.stress import goals
from coopqp.tasks import JointCentering, Orientation, PointOnPoint

DT = 0.01  # [s]
RADIUS, PERIOD, ROUNDS = 0.02, 4.0, 1.5  # of the circle [m, s], and how often it is gone round
APPROACH = 4.0  # time in which a run comes to the border [s]
OUT = 2.0  # farther than any arm reaches, a share of its reach
LOOKED_AT, HALVINGS = 20, 24  # steps in which v changes most
#: Of a change that may be left where the command is continuous; soft tasks leave 3e-6 [rad/s, m/s].
LEFT = 1e-4

Mode = Literal["soft", "hard", "scaled"]


@dataclass(frozen=True)
class Jump:
    """How far a command is from continuous along a motion.

    Attributes:
        step: largest change of v from one tick to the next [rad/s, m/s].
        left: what is left of any change after all halvings [rad/s, m/s].
        tick: where that is.
        said: what the commands on both sides of it say.
        relaxed: share of the ticks that say that tasks are not met in full.
        crossings: how often the command changes between such ticks and optimal ones.
    """

    step: float
    left: float
    tick: int
    said: tuple[str, str]
    relaxed: float
    crossings: int


def problem(chain: ClosedChain, mode: Mode, seed: int = 0) -> ControlProblem:
    """A point goes round a circle about the border of reach, from the side that is in reach.

    Args:
        chain: at a pose inside its limits.
        mode: of that task; a soft one comes before the other task, as a hard one does.
        seed: of the directions.
    """
    out, across = directions(chain, np.random.default_rng(seed))
    border = _at_the_end(chain, chain.start_position + OUT * chain.reach * out)
    begin = border.start_position - RADIUS * out
    near = _at_the_end(border, begin)
    round_ = Circle(
        center=goals.vector(border.start_position),
        radius=RADIUS,
        normal=goals.vector(np.cross(out, across)),
        begin=goals.vector(-out),
        period=PERIOD,
    )
    firm = PointOnPoint(name="firm", goal=round_, mode=mode, gain=5.0, profile=Profile(kind="step"))
    return _problem(near, firm)


def directions(chain: ClosedChain, rng: np.random.Generator) -> tuple[Array, Array]:
    """Two directions at right angles in which the object can move at the start, if it can."""
    state = State(chain)
    ways = state.J_task[:3] @ null_space(state.J_loop)
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
        name="reach", goal=goals.vector(goal), gain=5.0, profile=Profile(duration=0.5 * APPROACH)
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
    scratch = law.start()
    found = {
        int(k): _left(law, scratch, states[k], states[k + 1])
        for k in np.argsort(changes)[-LOOKED_AT:]
    }
    worst = max(found, key=lambda k: found[k][0])
    left, said = found[worst]
    return Jump(
        float(changes.max()),
        left,
        worst,
        said,
        float(np.mean(relaxed)),
        int(np.abs(np.diff(np.array(relaxed, int))).sum()),
    )


def _left(law: Law, scratch: State, a: Array, b: Array) -> tuple[float, tuple[str, str]]:
    """What is left of the change of v between two states after all halvings; what they say."""
    at_a, at_b = _asked(law, scratch, a), _asked(law, scratch, b)
    for _ in range(HALVINGS):
        middle = 0.5 * (a + b)
        at_middle = _asked(law, scratch, middle)
        if np.abs(at_middle - at_a).max() > np.abs(at_b - at_middle).max():
            b, at_b = middle, at_middle
        else:
            a, at_a = middle, at_middle
    said = []
    for side in (a, b):
        _asked(law, scratch, side)
        said.append(written(law.command.causes))
    return float(np.abs(at_b - at_a).max()), (said[0], said[1])


def _packed(state: State) -> Array:
    """All that a tick depends on."""
    return np.concatenate([[state.t, state.corrected], state.q, state.v, state.memory.numbers])


def _asked(law: Law, state: State, packed: Array) -> Array:
    """The command at a state."""
    n = len(state.q)
    state.t, state.corrected = float(packed[0]), float(packed[1])
    state.q[:], state.v[:] = packed[2 : 2 + n], packed[2 + n : 2 + 2 * n]
    state.memory.numbers[:] = packed[2 + 2 * n :]
    return law.tick(state).v.copy()
