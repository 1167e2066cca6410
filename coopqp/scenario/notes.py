"""What of a scenario has no effect on some of its controllers, in words."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from coopqp.controller import Controller
from coopqp.limits import JointPosition, JointVelocity
from coopqp.scenario.scenario import Scenario
from coopqp.scenario.unit_hints import far_goals

#: The limits of every scenario that names none; that baselines ignore them is their point.
USUAL_LIMITS = (JointPosition(), JointVelocity())


def notes(scenario: Scenario, controllers: Mapping[str, Controller] | None = None) -> list[str]:
    """One sentence for each part of the scenario that not every controller reads.

    What limits cannot bound comes after it, and goals that nothing can reach.

    Args:
        scenario: what is to be run.
        controllers: that are to run, which say what they heed; the scenario's own when omitted.
    """
    chosen = scenario.controllers if controllers is None else controllers
    deaf_to = [
        f"{what} no effect on {' and '.join(deaf)}"
        for part, what in _stated(scenario)
        if (deaf := [name for name, c in chosen.items() if part not in c.heeds])
    ]
    of_limits = (line for k in scenario.limits for line in k.notes(scenario.chain))
    return [*deaf_to, *of_limits, *far_goals(scenario)]


def _stated(scenario: Scenario) -> Iterator[tuple[str, str]]:
    """The parts that this scenario has beyond what every scenario has."""
    tasks = [task for phase in scenario.schedule for task in phase.tasks]
    if scenario.limits != USUAL_LIMITS:
        yield "limits", "the limits have"
    if any(task.mode != "soft" for task in tasks):
        yield "modes", "that tasks are hard or scaled has"
    if any(task.priority for task in tasks):
        yield "priorities", "the priorities of tasks have"
    if scenario.secondary:
        yield "secondary", "the secondary objectives have"
    if scenario.on_infeasible != "scale":
        yield "on_infeasible", "on_infeasible has"
