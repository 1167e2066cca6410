"""Run one controller through all phases of a scenario."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from coopqp.checked import Array
from coopqp.controller import Controller, ControlProblem, Law
from coopqp.errors import CoopqpError, InternalError, InvalidValueError, UnknownNameError
from coopqp.plant import PlantModel
from coopqp.rollout import rollout
from coopqp.scenario.scenario import Scenario
from coopqp.solver import Status
from coopqp.state import State
from coopqp.trace import PhaseInfo, Trace, join
from coopqp.wording import by_user, raised

#: After these there is no next phase.
ENDED = (Status.PLANT_FAILED.value, Status.OBJECT_LOST.value)

Progress = Callable[[str, int], None]
"""Called now and then with the controller's name and the number of ticks it has done."""


def run(
    scenario: Scenario,
    *,
    controller: str,
    progress: Progress | None = None,
    timed: bool = True,
) -> Trace:
    """Run one controller of a scenario.

    Args:
        scenario: from :func:`coopqp.load`.
        controller: its name in the scenario, or any controller's type name.
        progress: called every few ticks.
        timed: whether it is asked how long each tick takes; if not, many are done at once where
            joints do exactly as told, which is faster, and :attr:`Trace.tick_us` is NaN.

    Raises:
        UnknownNameError: no such controller.
        CoopqpError: the controller or the plant cannot be built for this scenario.
    """
    chosen = controller_of(scenario, controller)
    check_plant(scenario, chosen, controller)
    scenario.check_size()
    solver = scenario.solver_name if chosen.uses_solver else None
    with _own_words(controller):
        held = scenario.held_by(controller)
        legs = list(_legs(held, chosen, controller, solver, progress, timed=timed))
        return join(legs) if scenario.phases else legs[0][1]


def built(scenario: Scenario, controller: str) -> BegunPhase:
    """What a run builds for its first phase, without running it.

    Args:
        scenario: from :func:`coopqp.load`.
        controller: its name in the scenario, or any controller's type name.

    Raises:
        CoopqpError: as :func:`run`.
    """
    chosen = controller_of(scenario, controller)
    check_plant(scenario, chosen, controller)
    with _own_words(controller):
        return begin_phase(scenario.held_by(controller), chosen, 0, None)


def check_plant(scenario: Scenario, chosen: Controller, name: str) -> None:
    """Refuse a controller by torques where the plant takes none.

    Raises:
        InvalidValueError: that is so.
    """
    if chosen.commands_torques and not scenario.plant.takes_torques:
        raise InvalidValueError(
            f"controller '{name}' commands torques, which this plant does not take; use "
            "plant: rigid_body or plant: mujoco"
        )


@contextmanager
def _own_words(controller: str) -> Iterator[None]:
    """One line for what nobody foresaw, so that other controllers can be run all the same.

    Raises:
        InvalidValueError: a user's code has raised something.
        InternalError: ours has.
    """
    try:
        yield
    except (CoopqpError, KeyboardInterrupt):
        raise
    except BaseException as error:
        kind = InvalidValueError if by_user(error) else InternalError
        raise kind(f"{controller}: {raised(error)}") from error


def controller_of(scenario: Scenario, name: str) -> Controller:
    """A controller of a scenario, or of its catalogue.

    Args:
        scenario: from :func:`coopqp.load`.
        name: in the scenario, or any controller's type name.

    Raises:
        UnknownNameError: no such controller.
    """
    if name in scenario.controllers:
        return scenario.controllers[name]
    known = scenario.catalog.entries("controllers")
    if name not in known:
        raise UnknownNameError("controller", name, {*known, *scenario.controllers})
    chosen = known[name].cls()
    assert isinstance(chosen, Controller)  # what the catalogue holds there
    return chosen


@dataclass(frozen=True)
class BegunPhase:
    """A phase that is about to be run.

    Attributes:
        problem: what the law was built for.
        law, plant: built.
        state: in which it begins; whoever runs the phase leaves it where that ends.
    """

    problem: ControlProblem
    law: Law
    plant: PlantModel
    state: State

    @property
    def q(self) -> Array:
        """Where the joints are, by the sensors where there are any, shape (n,) [rad, m]."""
        return self.state.q if self.plant.measured is None else self.plant.measured


def begin_phase(
    scenario: Scenario,
    chosen: Controller,
    phase: int,
    before: BegunPhase | None,
    *,
    timed: bool = True,
) -> BegunPhase:
    """Build what a phase needs.

    Args:
        scenario: as the controller holds it, :meth:`Scenario.held_by`.
        chosen: the controller.
        phase: index into the schedule.
        before: the phase before, which has been run; None for the first.
        timed: whether its ticks are, so that none may wait for what is built late.

    Raises:
        CoopqpError: the controller or the plant cannot be built.
    """
    asked = scenario.schedule[phase]
    chain = before.problem.chain.handed_over(before.q, asked.released) if before else None
    problem = scenario.problem(asked, chain)
    law = chosen.build(problem) if timed else chosen.unprepared(problem)
    plant = scenario.plant.build(problem, scenario.seed, scenario.disturbance)
    if law.squeezer and plant.hand_wrench is None:
        raise InvalidValueError(
            f"controller '{chosen.name}' squeezes by measured forces, and this plant tells none "
            "(signal hand_wrench); use plant: mujoco or plant: rigid_body"
        )
    if before:
        plant.resume(before.plant)
    state = law.start(q_measured=plant.measured, hand_wrench=plant.hand_wrench)
    if before:
        state.v[:] = before.state.v
    return BegunPhase(problem, law, plant, state)


def _legs(
    scenario: Scenario,
    chosen: Controller,
    name: str,
    solver: str | None,
    progress: Progress | None,
    *,
    timed: bool,
) -> Iterator[tuple[PhaseInfo, Trace]]:
    """Run the phases one after the other, each from where the one before has ended."""
    begun: BegunPhase | None = None
    spans = zip(scenario.schedule, scenario.first_ticks, strict=True)
    for i, (phase, first) in enumerate(spans):
        begun = begin_phase(scenario, chosen, i, begun, timed=timed)
        leg = rollout(
            begun.law,
            begun.plant,
            phase.ticks(scenario.dt),
            controller=name,
            solver=solver,
            heeds=chosen.heeds,
            progress=_shifted(progress, name, first),
            state=begun.state,
            feed=scenario.feed(begun.problem, begun.state, first),
            timed=timed,
        )
        yield PhaseInfo(phase.name, first, phase.released), leg
        last = first == scenario.first_ticks[-1]
        if not last and leg.failures and leg.failures[-1].cause in ENDED:
            words = f"phase '{phase.name}' does not end: {leg.failures[-1].note}"
            raise InvalidValueError(f"{name}: {words}")


def _shifted(progress: Progress | None, name: str, first: int) -> Callable[[int], None] | None:
    """Progress of a phase as progress of the whole run."""
    return (lambda k: progress(name, first + k)) if progress else None
