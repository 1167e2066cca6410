"""The law against an independent cascade: ``python -m tests.qp_law.cascade --ticks 2000``.

Random ticks with hard, scaled and soft tasks that often cannot all hold: random robots and poses,
reachable and unreachable goals, tight limits, joints near their limits. What the law commands is
compared with the lexicographic optimum (tests/lexicographic.py). Where they differ by more than
1e-7 rad/s the optimum is asked again with all Jacobians, and joints, moved by their last digits;
where that moves it as far it is not determined. Exit code 1 where a command is off.
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import click
import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))  # what tests share

from laws import WIDE
from lexicographic import Cascade, Optimum
from oracle import UndeterminedError
from stress import arrangements, goals
from stress.goals import pick
from unreachable_goals import OTHERS, chain_of, robots
from walks import walk

from coopqp.controller import Command, ControlProblem, Law
from coopqp.controllers import QPController
from coopqp.limits import JointAcceleration, JointPosition, JointVelocity, ObjectSpeed
from coopqp.model.profile import Profile
from coopqp.model.state import State
from coopqp.qp_law.equations import Damping
from coopqp.solver import Status, written
from coopqp.solvers import Daqp
from coopqp.study.engine import Engine, Lost
from coopqp.tasks import JointCentering

SAME = 1e-7  # [rad/s, m/s]
SAMPLES, FACTOR = 3, 10.0  # of moved numbers, and by which such moves may have been lucky ones
DAMPING, ERROR_DAMPING = 1e-6, 0.5
MODES = (("hard",), ("scaled",), ("hard", "scaled"), ("hard", "hard"), ("scaled", "scaled"))
RELAXED = Status.TASKS_RELAXED
COMPARED = ((Status.OPTIMAL,), (RELAXED,))
KINDS = tuple(kind for kind in goals.BUILDERS if kind != "relative_motion")


@dataclass(frozen=True)
class Tick:
    """What a tick has come to.

    Attributes:
        seed: of the draw.
        kind: modes of its tasks, and which of them cannot hold.
        outcome: "within", "not determined", "off", or why it was not compared.
        off: difference from the optimum [rad/s, m/s]. moved: of the optimum by last digits.
        said: what the command says. compiled: whether the kernel decided it.
    """

    seed: int
    kind: str
    outcome: str
    off: float = 0.0
    moved: float = 0.0
    said: str = ""
    compiled: bool = False


def draw(seed: int) -> tuple[ControlProblem, State]:
    """A random problem and a state of it."""
    rng = np.random.default_rng(seed)
    robot = pick(rng, robots())
    grasp = "its own" if robot in OTHERS else pick(rng, arrangements.grasps_of(robot))
    first = chain_of(robot, grasp)
    chain = first.moved(walk(rng, first))
    X = chain.object_pose(walk(rng, chain))
    modes = [*pick(rng, MODES), *["soft"] * int(rng.integers(1, 4))]
    tasks = []
    for i, mode in enumerate(modes):
        there = X if rng.random() < 0.4 else goals.anywhere(rng, X, chain.reach)
        common = {
            "name": f"t{i}", "mode": mode, "priority": int(rng.integers(0, 3)),
            "weight": float(10.0 ** rng.uniform(-1.0, 1.0)), "gain": float(rng.uniform(2.0, 20.0)),
            "profile": Profile(kind="step"),
        }  # fmt: skip
        tasks.append(goals.BUILDERS[pick(rng, KINDS)](goals.random_aim(rng, there), common))
    limits = [JointPosition(), JointVelocity(scale=float(rng.uniform(0.05, 1.0)))]
    if rng.random() < 0.3:
        limits.append(ObjectSpeed(linear=float(rng.uniform(0.02, 0.3)), angular=0.5))
    if rng.random() < 0.2:
        limits.append(JointAcceleration(max=float(10.0 ** rng.uniform(1.0, 2.5))))
    problem = ControlProblem(
        chain=chain,
        tasks=tuple(tasks),
        secondary=(JointCentering(gain=0.5),) if rng.random() < 0.5 else (),
        limits=tuple(limits),
        dt=pick(rng, (0.005, 0.01, 0.02)),
        solver=Daqp(),
        budget=WIDE,
    )
    return problem, _later(problem, int(rng.integers(0, 150)))


def _later(problem: ControlProblem, ticks: int) -> State:
    """The state after so many ticks with all tasks soft, which brings joints to their limits."""
    soft = tuple(replace(task, mode="soft") for task in problem.tasks)
    law = QPController().unprepared(replace(problem, tasks=soft))
    state = law.start()
    law.run(state, ticks)
    found = State(problem.chain, state.q.copy(), state.t)
    found.v[:] = state.v
    return found


def compare(seed: int, engine: str) -> Tick:
    """One tick."""
    problem, at = draw(seed)
    law: Law = QPController(engine=engine).unprepared(problem)  # type: ignore[arg-type]
    state = law.start(at.q)
    state.t, state.v[:] = at.t, at.v
    _remember(state, np.random.default_rng(seed))
    at.memory = law.start().memory
    at.memory.numbers[:] = state.memory.numbers  # as it is before the tick
    at.update()
    command = law.tick(state)
    return replace(_judged(seed, problem, at, command), compiled=law.compiled)


def _judged(seed: int, problem: ControlProblem, at: State, command: Command) -> Tick:
    """What a command has come to, at a state as it was before the tick."""
    kind, said = "+".join(sorted({task.mode for task in problem.tasks})), written(command.causes)
    if command.causes not in COMPARED:
        return Tick(seed, kind, f"not compared: {said}")
    try:
        best = _optimum(problem, at)
        names = {"hard": best.hard, "scaled": best.scaled}
        lacking = [mode for mode, relaxed in names.items() if relaxed]
        kind += f", {' and '.join(lacking) or 'none'} relaxed"
        off = float(np.abs(command.v - best.v).max())
        if off <= SAME:
            agrees = (command.causes == (RELAXED,)) == bool(lacking)
            return Tick(seed, kind, "within" if agrees else f"within, but says {said}")
        moved = max(_moved(problem, at, best, k) for k in range(SAMPLES))
    except UndeterminedError:
        return Tick(seed, kind, "not determined")
    outcome = "not determined" if off <= FACTOR * moved else "off"
    return Tick(seed, kind, outcome, off, moved, said)


def _remember(state: State, rng: np.random.Generator) -> None:
    """Let half of the states remember that tasks were missed and that levels pulled."""
    if rng.random() < 0.5:
        return
    sizes = {"missed": 0.1, "missing": 1.0, "later pulls": 10.0, "chatter": 2.5}
    for name, size in sizes.items():
        state.memory[name][:] = size * rng.random(len(state.memory[name]))
    state.memory["chatter"][1:] = 0.0


def _optimum(problem: ControlProblem, state: State, jitter: float = 0.0, seed: int = 0) -> Optimum:
    damping = Damping(DAMPING, ERROR_DAMPING, problem.dt)
    return Cascade(problem, state, damping, jitter, seed).optimum()


def _moved(problem: ControlProblem, state: State, best: Optimum, seed: int) -> float:
    """How far the optimum moves where all Jacobians, or all joints, move by their last digit."""
    digits = np.finfo(float).eps * np.random.default_rng(seed).choice((-1.0, 1.0), len(state.q))
    beside = State(problem.chain, state.q * (1.0 + digits), state.t)
    beside.v[:], beside.memory = state.v, state.memory
    beside.update()
    found = _optimum(problem, state, 1.0, seed), _optimum(problem, beside)
    return max(float(np.abs(one.v - best.v).max()) for one in found)


def compared(one: tuple[int, str]) -> Tick:
    """What the engine has a worker do."""
    return compare(*one)


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.qp_law.cascade", description=__doc__)
    parser.add_argument("--ticks", type=int, default=2000)
    parser.add_argument("--seed", type=int, default=0, help="of the first; others count up")
    parser.add_argument("--jobs", type=int, default=2, help="processes")
    parser.add_argument("--engine", default="python", choices=["auto", "python", "kernel"])
    parser.add_argument("--show", type=int, default=20, help="how many that are off to name")
    asked, ticks = parser.parse_args(), list[Tick]()
    items = [(seed, asked.engine) for seed in range(asked.seed, asked.seed + asked.ticks)]
    found = Engine(asked.jobs).results(compared, items)
    with click.progressbar(found, length=asked.ticks, label="ticks", file=sys.stderr) as bar:
        for (seed, _), one in bar:
            ticks.append(Tick(seed, "lost", one.reason) if isinstance(one, Lost) else one)
    tell(ticks, asked.show)
    return 1 if any(tick.outcome in ("off", "lost") for tick in ticks) else 0


def tell(ticks: Sequence[Tick], shown: int) -> None:
    """Counts by kinds of levels, and the ticks that are off."""
    for kind in sorted({tick.kind for tick in ticks}):
        counts = Counter(tick.outcome for tick in ticks if tick.kind == kind)
        words = ", ".join(f"{count} {outcome}" for outcome, count in counts.most_common())
        click.echo(f"{kind}: {words}")
    every = Counter(tick.outcome for tick in ticks)
    compiled = sum(tick.compiled for tick in ticks)
    click.echo(f"all {len(ticks)}: {dict(every.most_common())}; {compiled} by the kernel")
    off = sorted((tick for tick in ticks if tick.outcome == "off"), key=lambda tick: tick.seed)
    for tick in off[:shown]:
        click.echo(
            f"--seed {tick.seed} --ticks 1: {tick.off:.1e} rad/s off, last digits move it by "
            f"{tick.moved:.1e}; {tick.kind}; says {tick.said}"
        )


if __name__ == "__main__":
    sys.exit(main())
