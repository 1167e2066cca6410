"""Run a scenario's controllers side by side and say in words what each of them did."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from coopqp.checked import Array
from coopqp.closed_chain import CLOSED_ORIENTATION, CLOSED_POSITION
from coopqp.controller import Controller
from coopqp.errors import InvalidValueError, UnknownNameError
from coopqp.plant import PlantModel
from coopqp.rollout import rollout
from coopqp.scenario.catalog import Catalog
from coopqp.scenario.scenario import Scenario
from coopqp.state import State
from coopqp.trace import PhaseInfo, Trace, join

Progress = Callable[[str, int], None]
"""Called now and then with the controller's name and the number of ticks it has done."""

#: A limit overrun below this is rounding [rad, rad/s].
ROUNDING = 1e-9


@dataclass(frozen=True)
class Comparison:
    """The outcome of one scenario under several controllers.

    Attributes:
        scenario: what was run.
        traces: by controller.
        metrics: by controller, then by metric.
        verdicts: one sentence each, by controller.
    """

    scenario: Scenario
    traces: Mapping[str, Trace]
    metrics: Mapping[str, Mapping[str, Any]]
    verdicts: Mapping[str, str]

    def as_json(self) -> dict[str, Any]:
        """What ``metrics.json`` holds."""
        return {
            "scenario": self.scenario.name,
            "kappa": self.scenario.kappa,
            "dt": self.scenario.dt,
            "controllers": {name: dict(values) for name, values in self.metrics.items()},
        }


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
    chosen = scenario.controllers.get(controller)
    if chosen is None:
        known = Catalog().entries("controllers")
        if controller not in known:
            raise UnknownNameError("controller", controller, {*known, *scenario.controllers})
        chosen = known[controller].cls()
        assert isinstance(chosen, Controller)  # what the catalogue holds there
    if chosen.commands_torques and not scenario.plant.takes_torques:
        raise InvalidValueError(
            f"controller '{controller}' commands torques, which this plant does not take; use "
            "plant: rigid_body or plant: mujoco"
        )
    solver = scenario.solver_name if chosen.uses_solver else None
    legs = list(_legs(scenario.held_by(controller), chosen, controller, solver, progress))
    return join(legs) if scenario.phases else legs[0][1]


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
        return ended[0].configuration(ended[1])

    problems = scenario.problems(where)
    for phase, first in zip(scenario.schedule, scenario.first_ticks, strict=True):
        problem = next(problems)
        law = chosen.build(problem)
        plant = scenario.plant.build(problem, scenario.seed, scenario.disturbance)
        state = law.start()
        if ended:
            plant.resume(ended[0])
            state.v[:] = ended[1].v
        leg = rollout(
            law,
            plant,
            phase.ticks(scenario.dt),
            controller=name,
            solver=solver,
            progress=_shifted(progress, name, first),
            state=state,
        )
        yield PhaseInfo(phase.name, first, phase.released), leg
        ended = plant, state


def _shifted(progress: Progress | None, name: str, first: int) -> Callable[[int], None] | None:
    """Progress of a phase as progress of the whole run."""
    return (lambda k: progress(name, first + k)) if progress else None


def compare(
    scenario: Scenario,
    *,
    controllers: Sequence[str] = (),
    progress: Progress | None = None,
) -> Comparison:
    """Run several controllers on one scenario.

    Args:
        scenario: from :func:`coopqp.load`.
        controllers: their names; the scenario's own when omitted.
        progress: called every few ticks.

    Raises:
        CoopqpError: as :func:`run`.
    """
    names = list(controllers) or list(scenario.controllers)
    traces = {name: run(scenario, controller=name, progress=progress) for name in names}
    return summarize(scenario, traces)


def summarize(scenario: Scenario, traces: Mapping[str, Trace]) -> Comparison:
    """Metrics and verdicts of traces."""
    entries = Catalog().entries("metrics")
    metrics = {
        name: {key: entry.cls().measure(trace) for key, entry in entries.items()}
        for name, trace in traces.items()
    }
    verdicts = {name: verdict(trace, metrics[name]) for name, trace in traces.items()}
    return Comparison(scenario, traces, metrics, verdicts)


def verdict(trace: Trace, metrics: Mapping[str, Any]) -> str:
    """Say in one sentence whether it gets there, keeps the limits and the loop closed."""
    parts = [_arrival(trace), _limits(trace), _speed(trace), _loop(metrics), _ticks(metrics)]
    text = "; ".join(part for part in parts if part)
    return text[0].upper() + text[1:] + "."


def _arrival(trace: Trace) -> str:
    missed = [
        (task, error)
        for task, error in zip(trace.tasks, trace.final_error, strict=True)
        if error > task.tolerance
    ]
    if not missed:
        return "reaches the goal"
    task, error = max(missed, key=lambda pair: pair[1] / pair[0].tolerance)
    far = f"{1e3 * error:.1f} mm" if task.unit == "m" else f"{error:.3g} {task.unit}"
    at_limit = _joints_at_limit(trace)
    why = f", held back by {at_limit}" if at_limit else ""
    return f"ends {far} off the goal of '{task.name}'{why}"


def _joints_at_limit(trace: Trace) -> str:
    """Joints that end at a limit they never left."""
    end, beyond = trace.q[-1], np.maximum(trace.lower - trace.q, trace.q - trace.upper)
    near = np.minimum(np.abs(end - trace.lower), np.abs(trace.upper - end)) < 1e-6
    kept = beyond.max(axis=0) <= ROUNDING
    return " and ".join(np.array(trace.joints)[near & kept][:3])


def _limits(trace: Trace) -> str:
    beyond = np.maximum(trace.lower - trace.q, trace.q - trace.upper).max(axis=0)
    worst = int(beyond.argmax())
    if beyond[worst] <= ROUNDING:
        return "keeps every joint inside its limits"
    far = f"{_round(beyond[worst])} {trace.units[worst]}"
    return f"drives {trace.joints[worst]} {far} beyond its limit"


def _speed(trace: Trace) -> str:
    share = np.abs(trace.v).max(axis=0, initial=0.0) / trace.velocity
    worst = int(share.argmax())
    if share[worst] <= 1.0 + ROUNDING:
        return ""
    return f"asks {_round(share[worst])} times the speed {trace.joints[worst]} has"


def _loop(metrics: Mapping[str, Any]) -> str:
    error = metrics["loop_error_max"]
    if error["position"] <= CLOSED_POSITION and error["orientation"] <= CLOSED_ORIENTATION:
        return ""
    return (
        f"lets the loop open by {_round(1e3 * error['position'])} mm and "
        f"{_round(np.degrees(error['orientation']))} degrees"
    )


def _round(value: float) -> str:
    """Two digits, and never an exponent for large numbers."""
    return f"{value:.2g}" if value < 100.0 else f"{value:,.0f}"


def _ticks(metrics: Mapping[str, Any]) -> str:
    failed = metrics["failed_ticks"]
    return f"holds still in {failed} of {metrics['ticks']} ticks" if failed else ""
