"""The command line. Heavy imports wait until a command needs them, so that --help is quick."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import click

from coopqp import __version__
from coopqp.errors import CoopqpError

COLLECTIONS = (
    "robots", "grasps", "tasks", "limits", "controllers", "solvers", "plants", "metrics",
    "scenarios",
)  # fmt: skip

BAD_INPUT = 2  # exit code, the same that click uses for wrong options


class _Group(click.Group):
    """Commands whose bad input ends in one clear message per fault, and exit code 2."""

    def invoke(self, ctx: click.Context) -> Any:
        try:
            return super().invoke(ctx)
        except CoopqpError as error:
            for line in str(error).splitlines():
                click.echo(f"error: {line}", err=True)
            ctx.exit(BAD_INPUT)


@click.group(cls=_Group, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(__version__, prog_name="coopqp")
def main() -> None:
    """Compare QP control of arms that hold one object with the pseudoinverse laws.

    Begin with: coopqp compare point_on_point --out out/point_on_point
    """


SCENARIO = click.argument("scenario")
TASKS = click.option(
    "--tasks",
    "task_folders",
    multiple=True,
    type=click.Path(exists=True, file_okay=False, path_type=Path),
    help="Folder with task files of your own; may be given more than once.",
)
SOLVER = click.option("--solver", help="QP solver, instead of the scenario's.")
JSON = click.option("--json", "as_json", is_flag=True, help="Print JSON for machines.")


@main.command()
@SCENARIO
@click.option("--out", type=click.Path(path_type=Path), help="Folder for the report and the data.")
@click.option("--controllers", default="", help="Comma-separated, instead of the scenario's.")
@SOLVER
@TASKS
@JSON
def compare(
    scenario: str,
    out: Path | None,
    controllers: str,
    solver: str | None,
    task_folders: tuple[Path, ...],
    as_json: bool,
) -> None:
    """Run a scenario under several controllers and report what each of them did.

    SCENARIO is a YAML file or the name of a shipped scenario (coopqp list scenarios).
    """
    loaded = _load(scenario, task_folders, solver)
    names = [name.strip() for name in controllers.split(",") if name.strip()]
    _show(loaded, names or list(loaded.controllers), out, as_json=as_json)


@main.command()
@SCENARIO
@click.option("--controller", required=True, help="Which one.")
@click.option("--out", type=click.Path(path_type=Path), help="Folder for the report and the data.")
@SOLVER
@TASKS
@JSON
def run(
    scenario: str,
    controller: str,
    out: Path | None,
    solver: str | None,
    task_folders: tuple[Path, ...],
    as_json: bool,
) -> None:
    """Run one controller on a scenario."""
    _show(_load(scenario, task_folders, solver), [controller], out, as_json=as_json)


@main.command()
@SCENARIO
@click.option("--actuated", help="Scheme to ask about: joints, or q1,q2,... by order.")
@click.option("--phase", help="Which phase of the scenario; the first if omitted.")
@click.option("--html", "page", type=click.Path(path_type=Path), help="Write a page to this file.")
@TASKS
@JSON
def mobility(
    scenario: str,
    actuated: str | None,
    phase: str | None,
    page: Path | None,
    task_folders: tuple[Path, ...],
    as_json: bool,
) -> None:
    """Tell what a scenario's grasp allows, before anything moves."""
    from coopqp.report import files, strict_json
    from coopqp.report import mobility as report

    asked = [name.strip() for name in actuated.split(",")] if actuated is not None else None
    study = report.study(_load(scenario, task_folders, None), asked, phase=phase)
    if page:
        files.write_one(page, report.page(study))
    if as_json:
        click.echo(strict_json.text(report.as_json(study)))
        return
    for table in report.tables(study):
        _console().print(table)
    _console().print(study.mobility.verdict(), markup=False, highlight=False)
    if page:
        click.echo(f"wrote {page}")


@main.command()
@click.argument("trace", type=click.Path(path_type=Path))
@click.option("--tick", type=int, help="Which; the first that gave something up, else the last.")
@click.option("--controller", help="Whose; the first QP controller of the trace if omitted.")
@click.option("--save", type=click.Path(path_type=Path), help="Keep the whole tick in this file.")
@TASKS
@JSON
def explain(
    trace: Path,
    tick: int | None,
    controller: str | None,
    save: Path | None,
    task_folders: tuple[Path, ...],
    as_json: bool,
) -> None:
    """Say why a tick could not do what its tasks asked.

    TRACE is a trace.csv, or its folder, written by 'coopqp compare --out'.
    """
    from dataclasses import asdict

    from coopqp.report import files, strict_json
    from coopqp.study import explanation

    record = _tick(trace, tick, controller, task_folders)
    found = explanation.explain(record)
    if save:
        files.write_one(save, record.text())
    if as_json:
        data = {"tick": record.tick, "status": record.status, **asdict(found)}
        click.echo(strict_json.text(data))
        return
    click.echo(f"{record.scenario}, {record.controller}, tick {record.tick} ({record.status}):")
    click.echo(f"{found.sentence[0].upper()}{found.sentence[1:]}.")
    if save:
        click.echo(f"wrote {save}")


@main.command()
@click.argument("file", type=click.Path(path_type=Path))
@click.option("--solver", multiple=True, help="Which; may be given more than once. All if omitted.")
@JSON
def replay(file: Path, solver: tuple[str, ...], as_json: bool) -> None:
    """Solve a tick saved by 'coopqp explain --save' again, with any solver."""
    from coopqp.report import strict_json
    from coopqp.scenario.catalog import Catalog
    from coopqp.scenario.loader import solver_by_name, solver_names
    from coopqp.study import explanation

    catalog, record = Catalog(), explanation.TickRecord.read(file)
    rows = {}
    for name in solver or solver_names(catalog):
        answer = explanation.replay(record, solver_by_name(name, catalog))
        rows[name] = {
            "status": answer.status.value,
            "primal_residual": answer.primal_residual,
            "dual_residual": answer.dual_residual,
            "difference": answer.difference,
            "v": answer.v.tolist(),
        }
    if as_json:
        click.echo(strict_json.text(rows))
        return
    from rich.table import Table

    table = Table(title=f"{record.scenario}, {record.controller}, tick {record.tick}")
    for heading in ("solver", "status", "primal residual", "dual residual", "off the saved answer"):
        table.add_column(heading)
    for name, row in rows.items():
        numbers = (row["primal_residual"], row["dual_residual"], row["difference"])
        table.add_row(name, str(row["status"]), *(f"{number:.2g}" for number in numbers))
    _console().print(table)


@main.command()
@click.option("--rollouts", type=click.IntRange(1), default=1000, help="How many.")
@click.option("--seed", type=click.IntRange(0), default=0, help="Of the first; others count up.")
@click.option("--jobs", type=click.IntRange(0), default=0, help="Processes; all cores if 0.")
@JSON
def stress(rollouts: int, seed: int, jobs: int, as_json: bool) -> None:
    """Run random rollouts of the QP law; exit code 1 if one breaks a promise."""
    from dataclasses import asdict

    from coopqp.report import strict_json
    from coopqp.study import stress as trial

    with _progress(["rollouts"], rollouts) as progress:
        report = (lambda done: progress("rollouts", done)) if progress else None
        done = trial.stress(rollouts, seed=seed, jobs=jobs, progress=report)
    lines, broken = trial.summarize(done), [r for r in done if r.broken]
    if as_json:
        data = {"lines": [asdict(x) for x in lines], "broken": [asdict(r) for r in broken]}
        click.echo(strict_json.text(data))
    else:
        _console().print(_stress_table(lines))
        for r in broken[:20]:
            click.echo(f"seed {r.seed}: {'; '.join(r.broken)}", err=True)
    if broken:
        click.get_current_context().exit(1)


@main.command(name="solve-start")
@SCENARIO
@click.option("--seed", type=click.IntRange(0), help="Of the tries, instead of the scenario's.")
@TASKS
@JSON
def solve_start(
    scenario: str, seed: int | None, task_folders: tuple[Path, ...], as_json: bool
) -> None:
    """Find joint values, inside the limits, with which every arm reaches its grasp.

    The scenario gives object.pose and every grasp's object_in_hand; its own start does not count.
    """
    from coopqp.report import strict_json
    from coopqp.scenario.catalog import Catalog
    from coopqp.scenario.loader import load_and_solve
    from coopqp.scenario.start_solver import yaml_text

    with _progress(["solving"], 1) as progress:
        report = (lambda done, total: progress("solving", done / total)) if progress else None
        found = load_and_solve(scenario, Catalog(task_folders), seed=seed, progress=report)
    if as_json:
        asked = ("start", "margin", "tries", "found")
        click.echo(strict_json.text({key: getattr(found, key) for key in asked}))
        return
    click.echo(yaml_text(found), nl=False)


@main.command()
@click.argument("scenarios", nargs=-1, required=True)
@TASKS
def validate(scenarios: tuple[str, ...], task_folders: tuple[Path, ...]) -> None:
    """Check scenario files; every fault is listed with its line."""
    from coopqp.errors import Fault, ScenarioError

    faults: list[Fault] = []
    for name in scenarios:
        try:
            _load(name, task_folders, None)
        except ScenarioError as error:
            faults.extend(error.faults)
        else:
            click.echo(f"{name}: ok")
    if faults:
        raise ScenarioError(faults)


@main.command(name="list")
@click.argument("kind", required=False, type=click.Choice(COLLECTIONS))
@TASKS
@JSON
def list_(kind: str | None, task_folders: tuple[Path, ...], as_json: bool) -> None:
    """List what scenarios can name, with a line of help each."""
    rows = {k: _help_lines(k, task_folders) for k in ([kind] if kind else COLLECTIONS)}
    if as_json:
        click.echo(json.dumps(rows, indent=2))
        return
    from rich.markup import escape
    from rich.table import Table

    table = Table(box=None, show_header=False, pad_edge=False)
    table.add_column(style="bold", no_wrap=True)
    table.add_column()
    for k, lines in rows.items():
        table.add_row(f"{k}:", "")
        for name, text in lines.items():
            table.add_row(f"  {name}", escape(text))
    _console().print(table)


@main.command()
@TASKS
def schema(task_folders: tuple[Path, ...]) -> None:
    """Print the JSON Schema of scenario files, for editors."""
    from coopqp.scenario.catalog import Catalog
    from coopqp.scenario.form import file_model

    click.echo(json.dumps(file_model(Catalog(task_folders)).model_json_schema(), indent=2))


def _load(name: str, task_folders: tuple[Path, ...], solver: str | None) -> Any:
    from coopqp.scenario.catalog import Catalog
    from coopqp.scenario.loader import load, with_solver

    catalog = Catalog(task_folders)
    loaded = load(name, catalog)
    for line in loaded.robot_model.warnings:
        click.echo(f"warning: {line}", err=True)
    return with_solver(loaded, solver, catalog) if solver else loaded


def _tick(
    trace: Path, tick: int | None, controller: str | None, task_folders: tuple[Path, ...]
) -> Any:
    """A tick of a written trace, whole."""
    from bisect import bisect_right
    from itertools import islice

    from coopqp.controllers.qp import QPLaw
    from coopqp.errors import InvalidValueError, UnknownNameError
    from coopqp.study.explanation import record_tick
    from coopqp.study.trace_file import blocked_tick, controllers_of, state_from_trace

    path = trace / "trace.csv" if trace.is_dir() else trace
    names = controllers_of(path)
    scenario = _load(str(path.parent / "scenario.yaml"), task_folders, None)
    laws = {}
    for name in names:
        plugin = scenario.controllers.get(name)
        if plugin is not None and not plugin.commands_torques:
            law = plugin.build(scenario.held_by(name).problem())
            if isinstance(law, QPLaw):
                laws[name] = law
    if not laws:
        raise InvalidValueError(f"{path}: no controller here solves a QP in velocities")
    chosen = controller or next(iter(laws))
    if chosen not in laws:
        raise UnknownNameError("QP controller", chosen, laws, f"{path}: ")
    k = blocked_tick(path, chosen) if tick is None else tick
    held, law = scenario.held_by(chosen), laws[chosen]
    phase = max(0, bisect_right(held.first_ticks, k) - 1)
    if phase:
        # The arms that hold from here on took hold where the trace says that they were.
        problems = held.problems(lambda first: state_from_trace(path, chosen, first, law).q)
        law = scenario.controllers[chosen].build(list(islice(problems, phase + 1))[-1])
    state = state_from_trace(path, chosen, k, law, held.first_ticks[phase] * held.dt)
    name = path.parent.resolve().name
    return record_tick(law, state, scenario=name, controller=chosen, tick=k)


def _stress_table(lines: Any) -> Any:
    from rich.table import Table

    table = Table(title="random rollouts of the QP law")
    for heading in (
        "rollouts", "number", "ended as", "position excess [rad]", "speed excess [rad/s]",
        "loop [mm]", "loop [mrad]", "fallback ticks", "broken",
    ):  # fmt: skip
        table.add_column(heading)
    for x in lines:
        ended = ", ".join(f"{count} {name}" for name, count in x.outcomes.items())
        table.add_row(
            x.kind, str(x.count), ended, f"{x.position_excess:.1e}", f"{x.velocity_excess:.1e}",
            f"{1e3 * x.loop_position:.3f}", f"{1e3 * x.loop_orientation:.2f}",
            str(x.fallbacks), str(x.broken),
        )  # fmt: skip
    return table


def _show(scenario: Any, controllers: list[str], out: Path | None, *, as_json: bool) -> None:
    """Run, print the table or JSON, and write the report."""
    from coopqp.comparison import compare as run_all
    from coopqp.report import files, table

    if out:
        files.check_folder(out)
    with _progress(controllers, scenario.ticks) as progress:
        comparison = run_all(scenario, controllers=controllers, progress=progress)
    written = files.write(comparison, out) if out else []
    if as_json:
        click.echo(files.metrics_json(comparison), nl=False)
        return
    _console().print(table.summary(comparison))
    for path in written:
        click.echo(f"wrote {path}")


def _help_lines(kind: str, task_folders: tuple[Path, ...]) -> dict[str, str]:
    """A line of help for each name of a collection."""
    if kind == "scenarios":
        from coopqp.scenario.loader import shipped
        from coopqp.scenario.yaml import read_yaml

        return {
            name: read_yaml(path).data.get("description", "") for name, path in shipped().items()
        }
    from coopqp.scenario.catalog import Catalog

    lines = {name: e.help for name, e in Catalog(task_folders).entries(kind).items()}
    if kind == "solvers":
        from coopqp.solvers.qpsolvers import installed

        others = (name for name in installed() if name not in lines)
        lines.update(dict.fromkeys(others, "Backend of qpsolvers, one cold call a tick."))
    return lines


def _console() -> Any:
    """A rich console; without a terminal it keeps a width that tables fit in."""
    from rich.console import Console

    console = Console()
    return console if console.is_terminal else Console(width=120)


@contextmanager
def _progress(names: list[str], ticks: int) -> Iterator[Callable[[str, float], None] | None]:
    """A progress bar per controller on a terminal, nothing elsewhere."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    console = Console(stderr=True)
    if not console.is_terminal:
        yield None
        return
    columns = (TextColumn("{task.description}"), BarColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console, transient=True) as progress:
        bars = {name: progress.add_task(name, total=ticks) for name in names}
        yield lambda name, done: progress.update(bars[name], completed=done)
