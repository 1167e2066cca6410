"""Run one controller through all phases of a scenario."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from coopqp.checked import Array
from coopqp.controller import Controller
from coopqp.errors import CoopqpError, InternalError, InvalidValueError, UnknownNameError
from coopqp.plant import PlantModel
from coopqp.rollout import rollout
from coopqp.scenario.scenario import Scenario
from coopqp.solver import Status
from coopqp.state import State
from coopqp.trace import PhaseInfo, Trace, join
from coopqp.wording import by_user, raised

Progress = Callable[[str, int], None]
"""Called now and then with the controller's name and the number of ticks it has done."""


def run(scenario: Scenario, *, controller: str, progress: Progress | None = None) -> Trace:
    """Run one controller of a scenario.

    Args:
        scenario: from :func:`coopqp.load`.
        controller: its name in the scenario, or any controller's type name.
        progress: called every few ticks.

    Raises:
        UnknownNameError: no such controller.
        CoopqpError: the controller or the plant cannot be built for this scenario.
    """
    chosen = controller_of(scenario, controller)
    if chosen.commands_torques and not scenario.plant.takes_torques:
        raise InvalidValueError(
            f"controller '{controller}' commands torques, which this plant does not take; use "
            "plant: rigid_body or plant: mujoco"
        )
    scenario.check_size()
    solver = scenario.solver_name if chosen.uses_solver else None
    with _own_words(controller):
        legs = list(_legs(scenario.held_by(controller), chosen, controller, solver, progress))
        return join(legs) if scenario.phases else legs[0][1]


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


def _legs(
    scenario: Scenario,
    chosen: Controller,
    name: str,
    solver: str | None,
    progress: Progress | None,
) -> Iterator[tuple[PhaseInfo, Trace]]:
    """Run the phases one after the other, each from where the one before has ended."""
    ended: tuple[PlantModel, State] | None = None

    def where(_: int) -> Array:
        assert ended
        before, state = ended
        return state.q if before.measured is None else before.measured

    problems = scenario.problems(where)
    for phase, first in zip(scenario.schedule, scenario.first_ticks, strict=True):
        problem = next(problems)
        law = chosen.build(problem)
        plant = scenario.plant.build(problem, scenario.seed, scenario.disturbance)
        if ended:
            plant.resume(ended[0])
        state = law.start(q_measured=plant.measured)
        if ended:
            state.v[:] = ended[1].v
        leg = rollout(
            law,
            plant,
            phase.ticks(scenario.dt),
            controller=name,
            solver=solver,
            heeds=chosen.heeds,
            progress=_shifted(progress, name, first),
            state=state,
        )
        yield PhaseInfo(phase.name, first, phase.released), leg
        last = first == scenario.first_ticks[-1]
        if not last and leg.failures and leg.failures[-1].cause == Status.PLANT_FAILED.value:
            words = f"phase '{phase.name}' does not end: {leg.failures[-1].note}"
            raise InvalidValueError(f"{name}: {words}")
        ended = plant, state


def _shifted(progress: Progress | None, name: str, first: int) -> Callable[[int], None] | None:
    """Progress of a phase as progress of the whole run."""
    return (lambda k: progress(name, first + k)) if progress else None
