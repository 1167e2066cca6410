"""Who says what of a run; all of them have to say the same of it."""

from __future__ import annotations

import re
from collections.abc import Iterator

from random_goals.trial import _judge
from stress.draw import DAQP, LAW, draw
from stress.trial import one_rollout

from coopqp.assessment import Assessment, assess
from coopqp.assessment.assessment import FORCES
from coopqp.assessment.thresholds import matters
from coopqp.assessment.verdict import MAX_NAMES, verdict
from coopqp.controller import ControlProblem
from coopqp.execution.comparison import summarize
from coopqp.execution.rollout import rollout
from coopqp.metrics.reached import Reached
from coopqp.plant import Disturbance
from coopqp.plants import Kinematic
from coopqp.report.cells import cells
from coopqp.scenario.scenario import Scenario
from coopqp.study.explanation import explain_run
from coopqp.study.sweep.sweep import row_of
from coopqp.trace import Trace
from coopqp.viewer.picture import drawn
from coopqp.viewer.simulated_controller import SimulatedController

ARRIVES = re.compile(r"(?i)\breaches the goal|yields .* as .* specifies")
BREAKS = re.compile(r"\b(drives|goes|brings|exceeds|needs|lets the loop open|loses the object)\b")
#: Kinds of explanations that geometry has no part in.
WITHOUT_LIMITS = ("lost", "input", "failed")
#: Metrics that verdict and table read, where there is no scenario to measure all of them for.
NO_METRICS = {"loop_offset": {"position": 0.0, "orientation": 0.0}, "relaxed_ticks": {}}


def disagreements(
    scenario: Scenario, trace: Trace, *, explained: bool = True, drawn_too: bool = False
) -> Iterator[str]:
    """What readers say of a run that its assessment does not.

    Args:
        scenario: that was run.
        trace: of the run.
        explained: whether the explanation is asked, which may run it again.
        drawn_too: whether the viewer plays it, which only agrees on traces as they were run.
    """
    name, found = trace.controller, assess(trace)
    comparison = summarize(scenario, {name: trace})
    metrics, said = comparison.metrics[name], comparison.verdicts[name]
    told = {
        "metrics": (metrics["reached"], found.reached),
        "loop_error_max": (tuple(metrics["loop_error_max"].values()), found.loop),
        "input_ticks": ((metrics["input_ticks"] or {}).get("stale", 0), found.inputs.stale),
        "held": ((metrics["held"] or {}).get("held", found.held), found.held),
        **_verdict(said, found),
        **_cells(cells(trace, metrics), found),
        **_row(trace, found),
        **_judged(scenario.problem(), trace, found),
    }
    if explained:
        told |= _explained(scenario, trace, found)
    if drawn_too:
        told |= _drawn(scenario, found)
    for who, (says, is_so) in told.items():
        if says != is_so:
            yield f"{scenario.name}, {name}: {who} says {says}, it is {is_so}: {said}"


def _verdict(said: str, found: Assessment) -> dict[str, tuple[object, object]]:
    whole = bool(ARRIVES.search(said)) and not BREAKS.search(said)
    opens = found.held is not False and not found.loop_closed
    kept = not (found.joints or found.limits or found.ended)
    return {
        "verdict, goal": (bool(ARRIVES.search(said)), found.reached),
        "verdict, limits": ("keeps every" in said, kept),
        "verdict, speed": (bool(re.search("needs .* speed", said)), bool(found.speeds)),
        "verdict, loop": ("lets the loop open" in said, opens),
        "verdict, hold": ("oses the object at" in said, found.lost_tick is not None),
        "verdict, whole": (whole, found.succeeds),
    }


def _cells(row: dict[str, object], found: Assessment) -> dict[str, tuple[object, object]]:
    def bad(key: str) -> bool:
        return bool(row[key].bad)  # type: ignore[attr-defined]

    return {
        "cell, reached": (bad("reached"), not found.reached),
        "cell, task_error": (bad("task_error"), bool(found.missed)),
        "cell, limit": (
            bad("limit"),
            any(violation.farther for violation in (*found.joints, *found.limits)),
        ),
        "cell, speed": (bad("speed"), bool(found.speeds)),
        "cell, loop": (bad("loop"), found.held is not False and not found.loop_closed),
        "cell, motors": (bad("motors"), bool(found.saturated)),
    }


def _row(trace: Trace, found: Assessment) -> dict[str, tuple[object, object]]:
    """What a study writes down."""
    row = row_of(trace, {"reached": Reached()})
    return {
        "study, success": (row["success"], found.succeeds),
        "study, reached": (row["reached"], found.reached),
        "study, broken": (row["broken"], ", ".join(found.broken)),
    }


def _judged(
    problem: ControlProblem, trace: Trace, found: Assessment
) -> dict[str, tuple[object, object]]:
    if len(trace.tasks) != sum(len(task.parts(problem.chain)) for task in problem.tasks):
        return {}  # phases and forces, which no random goal has
    judged = _judge(trace.controller, trace, problem)
    return {
        "random goals, reached": (judged.reached, found.reached),
        "random goals, inside": (judged.inside, not (found.joints or found.speeds)),
        "random goals, loop": (judged.loop, found.loop_closed),
    }


def _explained(
    scenario: Scenario, trace: Trace, found: Assessment
) -> dict[str, tuple[object, object]]:
    answer = explain_run(scenario, trace)
    there = answer.kind in ("reached", "broken", "open") and "no goal" not in answer.sentence
    k = found.tasks.index(found.missed[0]) if found.missed else None
    at = found.at_limits(k) if k is not None and answer.kind not in WITHOUT_LIMITS else ()
    return {
        "explain, limits": (all(name in answer.sentence for name in at[:MAX_NAMES]), True),
        "explain, succeeds": (answer.kind == "reached", found.succeeds),
        "explain, words": ("every goal is reached" in answer.sentence, found.succeeds),
        "explain, reached": (there, found.reached),
    }


def _drawn(scenario: Scenario, found: Assessment) -> dict[str, tuple[object, object]]:
    """The page at the end of the same run."""
    lane = SimulatedController(scenario, found.trace.controller, {})
    for _ in range(found.trace.ticks + 1):
        lane.tick()
    seen, last = drawn(lane, ()), found.trace.ticks
    places = [
        task
        for task, k in zip(found.tasks, found.trace.last_instants, strict=True)
        if k == last and task.unit not in FORCES
    ]
    arrives = all(task.reached for task in places) and found.inputs.followed
    # As the verdict, the page says nothing of limits once the plant broke down.
    out = [o for o in found.joints if matters(o.at_end, o.row.unit) and not found.ended]
    return {
        "viewer, reached": (seen.reached, arrives),
        "viewer, limits": ("past its limit" in seen.broken, bool(out)),
    }


def of_stress(seed: int) -> Iterator[str]:
    """The same of one random rollout, which has no scenario.

    Args:
        seed: of the draw.
    """
    stressed = one_rollout(seed)
    problem = draw(seed, DAQP).problem
    law = LAW.unprepared(problem)
    plant = Kinematic().build(problem, 0, Disturbance())
    trace = rollout(law, plant, stressed.ticks, controller="qp", solver=None, timed=False)
    found = assess(trace)
    metrics = {**NO_METRICS, "reached": found.reached}
    told = {
        **_verdict(verdict(found, metrics), found),
        **_judged(problem, trace, found),
        "stress, loop": (stressed.loop_position, found.loop[0]),
    }
    if stressed.outcome == "reached":
        told["stress, reached"] = (True, found.reached)
    elif not found.joints and stressed.outcome != "recovering":  # who is outside may be there
        told["stress, missed"] = (False, found.reached)
    for who, (says, is_so) in told.items():
        if says != is_so and not (who == "stress, loop" and abs(says - is_so) < 1e-9):
            yield f"seed {seed}: {who} says {says}, it is {is_so}"
