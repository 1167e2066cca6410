"""Run one controller through all phases of a scenario."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from coopqp.base.errors import CoopqpError, InternalError, InvalidValueError, UnknownNameError
from coopqp.base.wording import by_user, raised
from coopqp.controller import Controller
from coopqp.execution.phase_run import PhaseRun, begin_phase
from coopqp.execution.rollout import rollout
from coopqp.scenario.scenario import Scenario, needs_scenario
from coopqp.solver import Status
from coopqp.trace import PhaseInfo, Trace, join

#: After these there is no next phase.
ENDED = (Status.PLANT_FAILED.value, Status.OBJECT_LOST.value)

Progress = Callable[[str, int], None]
"""Called now and then with the controller's name and the number of ticks it has done."""


def run(
    scenario: Scenario, *, controller: str, progress: Progress | None = None, timed: bool = True
) -> Trace:
    """Run one controller of a scenario.

    Args:
        scenario: from :func:`coopqp.load`.
        controller: its name in the scenario, or any controller's type name.
        progress: called every few ticks.
        timed: whether ticks are timed; if not, many are computed at once on plants without errors,
            which is faster, and :attr:`Trace.tick_us` is NaN.

    Raises:
        UnknownNameError: no such controller.
        CoopqpError: the controller or the plant cannot be built for this scenario.
    """
    needs_scenario(scenario)
    chosen = controller_of(scenario, controller)
    check_plant(scenario, chosen, controller)
    scenario.check_size()
    solver = scenario.solver_name if chosen.uses_solver else None
    with _one_line_errors(controller):
        held = scenario.held_by(controller)
        phases = list(_run_phases(held, chosen, controller, solver, progress, timed=timed))
        return join(phases) if scenario.phases else phases[0][1]


def built(scenario: Scenario, controller: str) -> PhaseRun:
    """The first phase of a run, built and not run; arguments and errors as for :func:`run`."""
    chosen = controller_of(scenario, controller)
    check_plant(scenario, chosen, controller)
    with _one_line_errors(controller):
        return begin_phase(scenario.held_by(controller), chosen)


def check_plant(scenario: Scenario, chosen: Controller, name: str) -> None:
    """Raise InvalidValueError for a torque controller where the plant takes no torques."""
    if chosen.commands_torques and not scenario.plant.takes_torques:
        raise InvalidValueError(
            f"controller '{name}' commands torques, which this plant does not take; use "
            "plant: rigid_body or plant: mujoco"
        )


@contextmanager
def _one_line_errors(controller: str) -> Iterator[None]:
    """Turn unexpected errors into one line, so that other controllers can be run all the same."""
    try:
        yield
    except (CoopqpError, KeyboardInterrupt):
        raise
    except BaseException as error:
        kind = InvalidValueError if by_user(error) else InternalError
        raise kind(f"{controller}: {raised(error)}") from error


def controller_of(scenario: Scenario, name: str) -> Controller:
    """A controller of a scenario, or of its catalogue by type name; or UnknownNameError."""
    if name in scenario.controllers:
        return scenario.controllers[name]
    known = scenario.catalog.entries("controllers")
    if name not in known:
        raise UnknownNameError("controller", str(name), {*known, *scenario.controllers})
    chosen = known[name].cls()
    assert isinstance(chosen, Controller)  # what the catalogue holds there
    return chosen


def _run_phases(
    scenario: Scenario,
    chosen: Controller,
    name: str,
    solver: str | None,
    progress: Progress | None,
    *,
    timed: bool,
) -> Iterator[tuple[PhaseInfo, Trace]]:
    """Run the phases one after the other, each from where the one before has ended."""
    begun: PhaseRun | None = None
    for phase in scenario.schedule:
        begun = begin_phase(scenario, chosen, begun, timed=timed)
        assert begun.plant is not None  # no robot takes its place
        begun.ticks = phase.ticks(scenario.dt)
        trace = rollout(
            begun.law,
            begun.plant,
            begun.ticks,
            controller=name,
            solver=solver,
            supports=chosen.supports,
            progress=_shifted(progress, name, begun.first),
            state=begun.state,
            feed=begun.feed(),
            timed=timed,
        )
        yield PhaseInfo(phase.name, begun.first, phase.released), trace
        if not begun.is_last and trace.failures and trace.failures[-1].cause in ENDED:
            words = f"phase '{phase.name}' does not end: {trace.failures[-1].note}"
            raise InvalidValueError(f"{name}: {words}")


def _shifted(progress: Progress | None, name: str, first: int) -> Callable[[int], None] | None:
    """Progress of a phase as progress of the whole run."""
    return (lambda k: progress(name, first + k)) if progress else None
