"""Run a scenario's controllers side by side, measure them and judge them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from coopqp.controller_run import Progress, run
from coopqp.errors import InvalidValueError
from coopqp.scenario.scenario import Scenario
from coopqp.trace import Trace
from coopqp.verdict import verdict


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

    def __str__(self) -> str:
        return "\n".join(f"{name}: {said}" for name, said in self.verdicts.items())

    def as_json(self) -> dict[str, Any]:
        """What ``metrics.json`` holds."""
        return {
            "scenario": self.scenario.name,
            "kappa": self.scenario.drift_gain,
            "dt": self.scenario.dt,
            "controllers": {name: dict(values) for name, values in self.metrics.items()},
        }


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
    if not names:
        raise InvalidValueError("controllers: none given, and the scenario has none")
    traces = {name: run(scenario, controller=name, progress=progress) for name in names}
    return summarize(scenario, traces)


def summarize(scenario: Scenario, traces: Mapping[str, Trace]) -> Comparison:
    """Metrics and verdicts of traces."""
    entries = scenario.catalog.entries("metrics")
    metrics = {
        name: {key: entry.cls().measure(trace) for key, entry in entries.items()}
        for name, trace in traces.items()
    }
    verdicts = {name: verdict(trace, metrics[name]) for name, trace in traces.items()}
    return Comparison(scenario, traces, metrics, verdicts)
