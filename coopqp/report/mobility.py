"""The mobility report of a scenario: as a table, as JSON and as a page."""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from itertools import islice
from string import Template
from typing import Any

import numpy as np
from plotly.offline import get_plotlyjs
from rich.table import Table
from rich.text import Text

from coopqp import __version__
from coopqp.base.errors import CoopqpError, InvalidValueError, UnknownNameError
from coopqp.base.spec import Array
from coopqp.base.wording import counted
from coopqp.closed_loop.forces import Bound, Forces, forces
from coopqp.closed_loop.mobility import WEAK, Mobility, manipulability, mobility
from coopqp.execution.controller_run import run
from coopqp.model.state import State
from coopqp.report.page import asset, html_table, script_json, text
from coopqp.report.strict_json import finite
from coopqp.scenario.scenario import Scenario
from coopqp.task import TaskStack

SHOWN = 8  # schemes in the tables
POSES = ("generic poses", "at the start")
MAX_POINTS = 400  # of the manipulability curve


@dataclass(frozen=True)
class Study:
    """Mobility of a scenario's grasp, and manipulability of its tasks on the way."""

    scenario: Scenario
    phase: str
    mobility: Mobility  # at generic poses and at the start
    # between the hands at the start; None for a single arm, or hands in one place
    forces: Forces | None
    t: Array  # shape (K,) [s]
    # of the tasks along the run of the scenario's first controller, shape (K,); at the start alone
    # where that controller is refused
    manipulability: Array
    refused: CoopqpError | None = None  # why it is

    @property
    def name(self) -> str:
        """Of the scenario, and of the phase if it has phases."""
        return f"{self.scenario.name}, phase {self.phase}" if self.phase else self.scenario.name

    def verdict(self) -> str:
        of_forces = self.forces.sentences() if self.forces else ()
        return " ".join([self.mobility.verdict(), *of_forces])


def study(
    scenario: Scenario, scheme: Sequence[str] | None = None, *, phase: str | None = None
) -> Study:
    """Analyse a phase, the first if none is named, and a scheme: joints by name, or q1, q2 ...

    CoopqpError: none such, or the first controller is refused before the phase.
    """
    if phase is not None and not scenario.phases:
        raise InvalidValueError("phase: this scenario has no phases; leave it out")
    phases = [p.name for p in scenario.phases] or [""]
    if phase is not None and phase not in phases:
        raise UnknownNameError("phase", phase, phases)
    number = phases.index(phase) if phase else 0
    times, path, refused = _run(scenario)
    if refused and number:
        raise refused
    # Where its first controller is when the phase begins.
    problem = list(islice(scenario.problems(lambda first: path[first]), number + 1))[-1]
    chain = problem.chain
    state = State(chain)
    tasks = TaskStack([task for task in problem.tasks if not task.joint_space], state)
    tasks.update(state)
    slices = zip(tasks.tasks, tasks.slices, strict=True)
    rows = [(task.name, tasks.J[part].copy()) for task, part in slices]
    joints = {f"q{i}": name for i, name in enumerate(chain.joint_names, start=1)}
    names = None if scheme is None else [joints.get(name, name) for name in scheme]
    analysis = mobility(chain, task_rows=rows, requested=names, seed=scenario.seed)
    first = scenario.first_ticks[number]
    last = first + scenario.schedule[number].ticks(scenario.dt)
    kept = slice(first, last + 1, max(1, (last - first) // MAX_POINTS))
    measure = []
    for t, q in zip(times[kept] - times[first], path[kept], strict=True):
        state.t, state.q[:] = float(t), q
        state.update()
        tasks.update(state)
        measure.append(manipulability(chain, q, tasks.J))
    between = None
    with suppress(CoopqpError):  # hands in one place have no direction between them
        between = forces(chain) if chain.holding > 1 else None
    on_the_way = times[kept], np.array(measure)
    return Study(scenario, phases[number], analysis, between, *on_the_way, refused)


def _run(scenario: Scenario) -> tuple[Array, Array, CoopqpError | None]:
    """Times and joints of the first controller's run; of the start where that is refused."""
    try:
        trace = run(scenario, controller=next(iter(scenario.controllers)))
    except CoopqpError as error:
        return np.zeros(1), scenario.chain.q_start[None], error
    return trace.t, trace.q, None


def as_json(result: Study) -> dict[str, Any]:
    """Everything, with infinities as null."""
    m = result.mobility
    data = {"asked" if key == "requested" else key: value for key, value in asdict(m).items()}
    for key in ("impossible", "uncontrolled"):
        data[key] = [asdict(s) | {"words": s.describe()} for s in getattr(m, key)]
    data |= {
        "scenario": result.scenario.name,
        "phase": result.phase,
        "verdict": result.verdict(),
        "forces": _forces_json(result.forces),
        "inadmissible": m.inadmissible,
        "inadmissible_start": m.inadmissible_start,
        "lost_at_start": [s.joints for s in m.lost_at_start],
        "manipulability": {"t": result.t, "value": result.manipulability},
    }
    return dict(finite(data))


def _forces_json(internal: Forces | None) -> dict[str, Any] | None:
    if internal is None:
        return None
    ranks = internal.transmission
    borne = {arm.arm: [screw.describe_force() for screw in arm.borne] for arm in ranks.arms}
    return {
        "dimensions": ranks.dimensions,
        "all": ranks.all,
        "arms": {arm.arm: asdict(arm.counts) | {"borne": borne[arm.arm]} for arm in ranks.arms},
        "pairs": [
            {"arms": pair.arms, **asdict(pair.counts), "components": pair.components}
            for pair in ranks.pairs
        ],
        "squeeze": [
            {"arms": s.arms, "least": _bound_json(s.lower), "most": _bound_json(s.upper)}
            for s in internal.squeezes
        ],
        "load": _bound_json(internal.load),
        "safety": internal.safety,
    }


def _bound_json(bound: Bound | None) -> dict[str, Any] | None:
    return {"value": bound.value, "by": bound.by} if bound else None


def rows(result: Study) -> list[tuple[str, str, str]]:
    """Name of a quantity, its value at generic poses, at the start."""
    m = result.mobility
    tried = f"of {m.schemes_total}" if m.schemes_complete else f"of {len(m.schemes)} tried"
    lines = [
        ("joints (passive)", f"{len(m.joints)} ({len(m.passive)})", ""),
        ("rank of J_c", ", ".join(map(str, m.ranks)), str(m.rank_start)),
        ("degrees of freedom, l - rank", str(m.freedom), str(m.freedom_start)),
        ("object motions (largest task)", str(m.object_freedom), str(m.object_freedom_start)),
        ("object motions the motors decide", str(m.motor_freedom), str(m.motor_freedom_start)),
        ("inadmissible schemes", f"{m.inadmissible} {tried}", f"{m.inadmissible_start} {tried}"),
    ]
    lines += [("redundant loop row", name, "") for name in m.dropped]
    lines += [
        (f"task '{task.name}', {counted(task.rows, 'row')}", "", _free(task.rank, task.weakest))
        for task in m.tasks
    ]
    if len(m.tasks) > 1:
        lines.append((f"all tasks, {m.tasks_rows} rows", "", _free(m.tasks_rank, m.tasks_weakest)))
    lines += [("impossible motion", "", screw.describe()) for screw in m.impossible]
    lines += [("motion no motor decides", "", screw.describe()) for screw in m.uncontrolled]
    lines += _force_rows(result.forces) if result.forces else []
    low, high = result.manipulability.min(), result.manipulability.max()
    return [*lines, ("manipulability on the way", "", f"{low:.3g} to {high:.3g}")]


def _force_rows(internal: Forces) -> list[tuple[str, str, str]]:
    ranks = internal.transmission
    lines = [(f"internal wrenches, {ranks.dimensions}", "", ranks.all.summary)]
    for arm in ranks.arms:
        borne = "".join(f"; borne: {screw.describe_force()}" for screw in arm.borne)
        lines.append((f"wrenches of {arm.arm} alone, 6", "", f"{arm.counts.summary}{borne}"))
    if len(ranks.pairs) > 1:
        lines += [(f"between {' and '.join(p.arms)}, 6", "", p.counts.summary) for p in ranks.pairs]
    ends = ((s.arms, s.summary.partition(" (")[0]) for s in internal.squeezes)  # motors: verdict
    lines += [(f"squeeze of {' and '.join(arms)}", "", words) for arms, words in ends]
    return lines


def _free(rank: int, weakest: float) -> str:
    return f"{rank} free" + (f", one weakly ({weakest:.2g})" if weakest < WEAK else "")


def schemes(result: Study) -> list[tuple[str, str, str]]:
    """The named and the best schemes with their condition at generic poses and at the start."""
    m = result.mobility
    shown = ([m.requested] if m.requested else []) + list(m.schemes[:SHOWN])
    joints = (", ".join(s.joints) for s in shown)
    generic = (f"{s.condition:.3g}" if s.admissible else "inadmissible" for s in shown)
    start = (f"{s.condition_start:.3g}" if s.admissible_start else "singular" for s in shown)
    return list(zip(joints, generic, start, strict=True))


def tables(result: Study) -> list[Table]:
    """For the terminal."""
    shown = "asked for, then best" if result.mobility.requested else "best"
    titles = f"mobility of {result.name}", "actuation schemes: condition number"
    headings = ("", *POSES), (shown, "generic", "start")
    every = []
    for title, heads, lines in zip(titles, headings, (rows(result), schemes(result)), strict=True):
        table = Table(*heads, title=Text(title), title_justify="left")
        for row in lines:
            table.add_row(*map(Text, row))
        every.append(table)
    return every


def page(result: Study) -> str:
    """One HTML page that works offline."""
    values, look = finite(result.manipulability.tolist()), {"color": "#0072B2", "width": 2.5}
    line = {"x": result.t.tolist(), "y": values, "mode": "lines", "line": look}
    layout = {
        "height": 300,
        "margin": {"l": 70, "r": 20, "t": 10, "b": 45},
        "xaxis": {"title": {"text": "time [s]"}},
        "yaxis": {"title": {"text": "manipulability"}, "rangemode": "tozero"},
    }
    return Template(asset("mobility.html")).substitute(
        css=asset("page.css"),
        title=text(result.name),
        version=__version__,
        description=text(result.scenario.description),
        verdict=text(result.verdict()),
        rows=html_table(("", *POSES), [[*map(text, row)] for row in rows(result)]),
        schemes=html_table(("joints", *POSES), [[*map(text, row)] for row in schemes(result)]),
        figure=script_json({"data": [line], "layout": layout}),
        plotly=get_plotlyjs(),
    )
