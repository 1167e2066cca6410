"""Every law on one random goal after the other, wherever the engine does them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from coopqp.assessment import assess
from coopqp.assessment.limits import beyond
from coopqp.base.errors import CoopqpError
from coopqp.controller import Controller, ControlProblem
from coopqp.controllers import (
    DampedPseudoinverse,
    Pseudoinverse,
    PseudoinverseNullSpace,
    QPController,
    SaturationNullSpace,
    TwoStep,
    WeightedLeastNorm,
)
from coopqp.execution.rollout import rollout
from coopqp.plant import Disturbance
from coopqp.plants import Kinematic
from coopqp.study.engine import Engine, Lost
from coopqp.task import Task
from coopqp.tasks import JointLimitBarrier
from coopqp.trace import Trace
from random_goals.draw import arenas, draw
from random_goals.reach import holds_inside

AFTER = 2.5  # time after the references have arrived [s]
HERE = Engine()
#: Gain of the barrier [1/s]: the best of 0.05 to 0.5 on other goals than seeds below 10,000 draw.
BARRIER = JointLimitBarrier(gain=0.5)
#: What is compared, each as its file has it, without settings, and what some have instead of the
#: scenario's secondary objectives.
LAWS: dict[str, tuple[Controller, tuple[Task, ...]]] = {
    "qp": (QPController(), ()),
    "saturation_null_space": (SaturationNullSpace(), ()),
    "weighted_least_norm": (WeightedLeastNorm(), ()),
    "null_space with barrier": (PseudoinverseNullSpace(), (BARRIER,)),
    "pseudoinverse_null_space": (PseudoinverseNullSpace(), ()),
    "pseudoinverse": (Pseudoinverse(), ()),
    "damped_pseudoinverse": (DampedPseudoinverse(), ()),
    "two_step": (TwoStep(), ()),
}
OTHERS = 6  # configurations from which inverse kinematics begins, beside the start


@dataclass(frozen=True)
class LawRun:
    """One law on one goal.

    Attributes:
        reached: every task's error ended within its tolerance.
        inside: no joint ever beyond a limit of its position or its speed.
        loop: the loops were closed all the time.
        error: at the end, sqrt(sum_i w_i |e_i|^2), what the tasks' weights make of it.
        violation: of a position limit, the worst [rad or m].
        speed: the largest, as a share of the joint's limit.
        loop_error: the widest [m].
    """

    law: str
    reached: bool
    inside: bool
    loop: bool
    error: float
    violation: float
    speed: float
    loop_error: float

    @property
    def safe(self) -> bool:
        """Inside the limits with the loops closed."""
        return self.inside and self.loop


@dataclass(frozen=True)
class GoalRun:
    """All laws on one goal.

    Attributes:
        start: "near" a joint limit or "away" from all.
        goal: "inside" if it can be held inside the limits, else "beyond".
        witness: whether that was shown by a law that ended there alone, and missed by the inverse
            kinematics.
        tolerance: what counts as the same error, the tasks' tolerances weighted alike.
    """

    robot: str
    seed: int
    start: str
    goal: str
    witness: bool
    tolerance: float
    runs: tuple[LawRun, ...]


def statistics(
    goals: int,
    *,
    seed: int = 0,
    engine: Engine = HERE,
    progress: Callable[[int], None] | None = None,
    known: Sequence[GoalRun] = (),
    keep: Callable[[GoalRun], None] | None = None,
) -> list[GoalRun]:
    """Run every law on many goals of every arena.

    Args:
        goals: how many on each robot.
        seed: of the first; the others count up.
        engine: where; on all cores when omitted.
        progress: called with the number of goals done.
        known: goals that have been run before; those of other seeds do not count.
        keep: called with each other goal when it is done.

    Raises:
        CoopqpError: a goal ends the process that runs it.
    """
    asked = [(robot, s) for robot in arenas() for s in range(seed, seed + goals)]
    before = {(goal.robot, goal.seed): goal for goal in known}
    mine = engine.share.taken(asked)
    done = [before[one] for one in mine if one in before]
    for (robot, own), goal in engine.results(_goal, [x for x in mine if x not in before]):
        if isinstance(goal, Lost):
            raise CoopqpError(f"{robot}, seed {own}: {goal.reason}")
        done.append(goal)
        if keep:
            keep(goal)
        if progress:
            progress(len(done))
    return sorted(done, key=lambda goal: asked.index((goal.robot, goal.seed)))


def kept(line: Mapping[str, Any]) -> GoalRun:
    """A goal from what :func:`dataclasses.asdict` made of it."""
    return GoalRun(**{**line, "runs": tuple(LawRun(**run) for run in line["runs"])})


def _goal(asked: tuple[str, int]) -> GoalRun:
    """What the engine has a worker do."""
    return one_goal(*asked)


def one_goal(robot: str, seed: int) -> GoalRun:
    """Draw a start and a goal on the robot of an arena, and run every law there."""
    drawn = draw(robot, seed, OTHERS)
    problem = drawn.problem
    with np.errstate(all="ignore"):  # laws that run away leave the range of numbers
        runs = tuple(_run(name, problem) for name in LAWS)
    found = holds_inside(problem, (problem.chain.q_start, *drawn.elsewhere))
    witness = any(run.reached and run.safe for run in runs)
    return GoalRun(
        robot=robot,
        seed=seed,
        start=drawn.start,
        goal="inside" if found or witness else "beyond",
        witness=witness and not found,
        tolerance=_norm(
            problem, [p.tolerance for t in problem.tasks for p in t.parts(problem.chain)]
        ),
        runs=runs,
    )


def _run(name: str, problem: ControlProblem) -> LawRun:
    controller, secondary = LAWS[name]
    given = replace(problem, secondary=secondary or problem.secondary)
    law = controller.unprepared(given)
    plant = Kinematic().build(given, 0, Disturbance())
    ticks = round((max(task.end for task in given.tasks) + AFTER) / given.dt)
    trace = rollout(law, plant, ticks, controller=name, solver=None, timed=False)
    return _judge(name, trace, given)


def _judge(name: str, trace: Trace, problem: ControlProblem) -> LawRun:
    """What counts of a run."""
    found = assess(trace)
    return LawRun(
        law=name,
        reached=found.reached,
        inside=not (found.joints or found.speeds),
        loop=found.loop_closed,
        error=_norm(problem, [task.error for task in found.tasks]),
        violation=float(beyond(trace).max()),
        speed=float((np.abs(trace.v) / trace.velocity).max()),
        loop_error=found.loop[0],
    )


def _norm(problem: ControlProblem, errors: list[float]) -> float:
    """Errors of all parts of all tasks as one number."""
    weights = [task.weight for task in problem.tasks for _ in task.parts(problem.chain)]
    return float(np.sqrt(np.sum(np.array(weights) * np.array(errors) ** 2)))
