"""Run a scenario's controllers side by side, measure them and judge them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from coopqp.assessment import assess
from coopqp.assessment.verdict import verdict
from coopqp.base.errors import CoopqpError, InvalidValueError, UnknownNameError
from coopqp.execution.controller_run import Progress, run
from coopqp.metric import measured
from coopqp.scenario.notes import of_faults
from coopqp.scenario.scenario import Scenario, needs_scenario
from coopqp.trace import Trace


@dataclass(frozen=True)
class Comparison:
    """The outcome of one scenario under several controllers."""

    scenario: Scenario  #: As run.
    traces: Mapping[str, Trace]  #: By controller.
    metrics: Mapping[str, Mapping[str, Any]]  #: By controller, then by metric.
    verdicts: Mapping[str, str]  #: One sentence each, by controller.
    refused: Mapping[str, str] = field(default_factory=dict)  #: By controller: why not run.
    faults: Sequence[str] = ()  #: Errors of metrics, one sentence each.
    notes: Sequence[str] = ()  #: What limits do not bound of the robot, and its faults.

    def __str__(self) -> str:
        left_out = {name: f"left out: {why}" for name, why in self.refused.items()}
        lines = {**self.verdicts, **left_out}
        return "\n".join(f"{name}: {words}" for name, words in lines.items())

    def as_json(self) -> dict[str, Any]:
        """The content of ``metrics.json``."""
        return {
            "scenario": self.scenario.name,
            "kappa": self.scenario.drift_gain,
            "dt": self.scenario.dt,
            "controllers": {name: dict(values) for name, values in self.metrics.items()},
            **({"refused": dict(self.refused)} if self.refused else {}),
            **({"notes": list(self.notes)} if self.notes else {}),
        }


def compare(
    scenario: Scenario, *, controllers: Sequence[str] = (), progress: Progress | None = None
) -> Comparison:
    """Run several controllers on one scenario.

    Args:
        scenario: from :func:`coopqp.load`.
        controllers: their names; the scenario's own when omitted.
        progress: called every few ticks.

    A controller that cannot be used for the scenario is left out, and the comparison says so.

    Raises:
        CoopqpError: none of them can be run: as :func:`run`.
    """
    needs_scenario(scenario)
    names = list(controllers) or list(scenario.controllers)
    if not names:
        raise InvalidValueError("controllers: none given, and the scenario has none")
    traces: dict[str, Trace] = {}
    refused: dict[str, CoopqpError] = {}
    for name in names:
        try:
            traces[name] = run(scenario, controller=name, progress=progress)
        except CoopqpError as error:
            if isinstance(error, UnknownNameError) and error.kind == "controller":
                raise
            refused[name] = error
    if len(refused) == 1 and not traces:
        raise next(iter(refused.values()))
    if not traces:
        raise CoopqpError("\n".join(dict.fromkeys(map(str, refused.values()))))
    why = {name: str(error) for name, error in refused.items()}
    return replace(summarize(scenario, traces), refused=why)


def summarize(scenario: Scenario, traces: Mapping[str, Trace]) -> Comparison:
    """Metrics and verdicts of traces; a metric that raises is None."""
    entries = scenario.catalog.entries("metrics")
    plugins = {name: entry.cls() for name, entry in entries.items()}
    results = {name: measured(plugins, trace) for name, trace in traces.items()}
    metrics = {name: values for name, (values, _) in results.items()}
    chain, limits = scenario.chain, scenario.limits
    unseen = [line for limit in limits for line in limit.unseen(chain)]
    verdicts = {
        name: verdict(assess(trace), metrics[name], unseen) for name, trace in traces.items()
    }
    return Comparison(
        scenario,
        traces,
        metrics,
        verdicts,
        faults=tuple(dict.fromkeys(fault for _, faults in results.values() for fault in faults)),
        notes=(*(line for k in limits for line in k.notes(chain)), *of_faults(scenario)),
    )
