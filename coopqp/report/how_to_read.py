"""What the page says to readers who know neither the paper, nor QPs, nor forces between hands."""

from __future__ import annotations

from collections.abc import Iterator

from coopqp.assessment.ends import FORCES
from coopqp.comparison import Comparison
from coopqp.report.cells import plugin_name


def how_to_read(comparison: Comparison) -> Iterator[str]:
    """Paragraphs: the closed loop, what forces are in the run, and what the laws do."""
    yield (
        "All arms hold one object, so the joints are not free: whatever they do, every hand has "
        "to stay where it holds the object. This condition is the closed loop. The loop error is "
        "what steps of finite length still let open; the drift correction κ pulls it back."
    )
    of_forces = list(_forces(comparison))
    yield from of_forces
    laws = [plugin_name(law) for law in comparison.scenario.controllers.values()]
    if not of_forces or any("pseudoinverse" in law for law in laws):
        yield from _laws(comparison)


def _forces(comparison: Comparison) -> Iterator[str]:
    """What the hands do to each other; nothing where the scenario asks for none of it."""
    scenario, traces = comparison.scenario, comparison.traces.values()
    if any("normal_force" in trace.signals for trace in traces):
        yield (
            "Nothing fastens the object to hands that press. They hold it between them, and "
            "friction bears what goes along their faces: at most the coefficient of friction times "
            "the normal force, so that more is borne the harder they press. Beyond that the object "
            "slips. A pad also bears torques, by pressing more on one side than on the other; with "
            "all of the pressure on an edge it tips."
        )
    if any(task.unit in FORCES for trace in traces for task in trace.tasks):
        yield (
            "The squeeze is the force with which two hands press on each other through the object. "
            "It moves nothing, so that it has to be asked for, and measured, as a force."
        )
    if getattr(scenario.plant, "spring_hands", None):
        yield (
            "Between each arm and the object there is a spring, such as a rubber pad. Hands that "
            "approach each other by a millimetre squeeze by a millimetre times the stiffness of "
            "all that yields."
        )
    tasks = [task for phase in scenario.schedule for task in phase.tasks]
    if any(plugin_name(task) == "impedance" for task in tasks):
        yield (
            "An impedance lets the object give way like a mass on springs: a push F moves it by "
            "F / K, with the stiffness K as stated. While it is pushed its error is how far it has "
            "given way, as it was asked to."
        )


def _laws(comparison: Comparison) -> Iterator[str]:
    """Pseudoinverses and QPs."""
    bounded = (
        "and no joint goes beyond its limits"
        if comparison.scenario.limits
        else "and joints keep the limits that the scenario lists (this one lists none)"
    )
    yield (
        "The pseudoinverse laws compute joint speeds that move the object and keep the loop "
        "closed, but they do not know the joint limits; the null-space variant leans away from "
        "limits and cannot stop there. The QP solves a small optimisation problem in every "
        f"control period, with two hard conditions: the loop stays closed, {bounded}. "
        "It follows the task as well as these allow."
    )
    yield (
        "So the curves are much alike while no limit is in the way. Where one is, the QP stops at "
        "it and goes on with the other joints, or keeps a task error. A pseudoinverse law goes "
        "on into the hatched region: a motion that only looks good, because the real robot "
        "cannot make it."
    )
