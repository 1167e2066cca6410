"""The command line. Heavy imports wait until a command needs them, so that --help is quick."""

from __future__ import annotations

import json
from collections.abc import Callable
from functools import wraps
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
FOLDER = click.Path(exists=True, file_okay=False, path_type=Path)
SOLVER = click.option("--solver", help="QP solver, instead of the scenario's.")
JSON = click.option("--json", "as_json", is_flag=True, help="Print JSON for machines.")


def catalogued(command: Callable[..., None]) -> Callable[..., None]:
    """Options that name plug-ins of the user's own; the command gets the catalogue with them."""

    @click.option(
        "--plugins",
        "plugin_folders",
        multiple=True,
        type=FOLDER,
        help="Folder with plug-ins of your own in subfolders tasks, limits, controllers ...; "
        "may be given more than once.",
    )
    @click.option(
        "--tasks",
        "task_folders",
        multiple=True,
        type=FOLDER,
        help="Folder with task files of your own; may be given more than once.",
    )
    @wraps(command)
    def with_catalog(
        *, plugin_folders: tuple[Path, ...], task_folders: tuple[Path, ...], **options: Any
    ) -> None:
        from coopqp.scenario.catalog import Catalog

        command(catalog=Catalog(task_folders, plugin_folders), **options)

    return with_catalog


@main.command()
@SCENARIO
@click.option("--out", type=click.Path(path_type=Path), help="Folder for the report and the data.")
@click.option("--controllers", default="", help="Comma-separated, instead of the scenario's.")
@SOLVER
@catalogued
@JSON
def compare(
    scenario: str,
    out: Path | None,
    controllers: str,
    solver: str | None,
    catalog: Any,
    as_json: bool,
) -> None:
    """Run a scenario under several controllers and report what each of them did.

    SCENARIO is a YAML file or the name of a shipped scenario (coopqp list scenarios).
    """
    loaded = _load(scenario, catalog, solver)
    names = [name.strip() for name in controllers.split(",") if name.strip()]
    _show(loaded, names or list(loaded.controllers), out, as_json=as_json)


@main.command()
@SCENARIO
@click.option("--controller", required=True, help="Which one.")
@click.option("--out", type=click.Path(path_type=Path), help="Folder for the report and the data.")
@SOLVER
@catalogued
@JSON
def run(
    scenario: str,
    controller: str,
    out: Path | None,
    solver: str | None,
    catalog: Any,
    as_json: bool,
) -> None:
    """Run one controller on a scenario."""
    _show(_load(scenario, catalog, solver), [controller], out, as_json=as_json)


@main.command()
@SCENARIO
@click.option("--actuated", help="Scheme to ask about: joints, or q1,q2,... by order.")
@click.option("--phase", help="Which phase of the scenario; the first if omitted.")
@click.option("--html", "page", type=click.Path(path_type=Path), help="Write a page to this file.")
@catalogued
@JSON
def mobility(
    scenario: str,
    actuated: str | None,
    phase: str | None,
    page: Path | None,
    catalog: Any,
    as_json: bool,
) -> None:
    """Tell what a scenario's grasp allows, before anything moves."""
    from coopqp.report import files, strict_json
    from coopqp.report import mobility as report
    from coopqp.report.terminal import console

    asked = [name.strip() for name in actuated.split(",")] if actuated is not None else None
    study = report.study(_load(scenario, catalog, None), asked, phase=phase)
    if page:
        files.write_one(page, report.page(study))
    if as_json:
        click.echo(strict_json.text(report.as_json(study)))
        return
    for table in report.tables(study):
        console().print(table)
    console().print(study.mobility.verdict(), markup=False, highlight=False)
    if page:
        click.echo(f"wrote {page}")


@main.command()
@click.argument("trace", type=click.Path(path_type=Path))
@click.option("--tick", type=int, help="Explain one tick, not the run.")
@click.option("--controller", help="Whose; the first QP controller of the trace if omitted.")
@click.option(
    "--save",
    type=click.Path(path_type=Path),
    help="Keep a tick in this file; if --tick is omitted, the "
    "first that gave something up, else the last.",
)
@catalogued
@JSON
def explain(
    trace: Path,
    tick: int | None,
    controller: str | None,
    save: Path | None,
    catalog: Any,
    as_json: bool,
) -> None:
    """Say why a run did not reach its goal, and what would do.

    TRACE is a trace.csv, or its folder, written by 'coopqp compare --out'.
    """
    from coopqp.report import explained, files
    from coopqp.report.terminal import progress_bars
    from coopqp.study.explanation import explain_run
    from coopqp.study.recorded_tick import recorded_tick
    from coopqp.study.trace_file import controllers_of, recording_from_trace

    path, scenario = _recorded(trace, catalog)
    known = controllers_of(path)
    if tick is not None or save:
        record = recorded_tick(path, scenario, controller, tick)
        click.echo(explained.tick_text(record, as_json=as_json))
        if save:
            files.write_one(save, record.text())
            click.echo(f"wrote {save}", err=as_json)  # what machines read is JSON alone
        return
    own = scenario.controllers
    solving = [name for name in known if name in own and own[name].uses_solver]
    recording = recording_from_trace(path, scenario, controller or (solving or known)[0])
    with progress_bars(["explaining"], 1) as progress:
        report = (lambda share: progress("explaining", share)) if progress else lambda share: None
        found = explain_run(scenario, recording, report)
    click.echo(explained.run_text(found, path.parent.resolve().name, as_json=as_json))


@main.command()
@click.argument("trace", type=click.Path(path_type=Path))
@click.option("--controller", help="Whose; the first with measured joints if omitted.")
@click.option("--encoders", is_flag=True, help="Look for offsets of the encoders as well.")
@catalogued
@JSON
def calibrate(
    trace: Path, controller: str | None, encoders: bool, catalog: Any, as_json: bool
) -> None:
    """Find from a run where the object really is in the hands; print lines for the scenario.

    TRACE is a trace.csv with measured joints, or its folder, written by 'coopqp compare --out'.
    """
    from coopqp.report import calibration as report
    from coopqp.report import strict_json
    from coopqp.report.terminal import console
    from coopqp.study.calibration import calibrate as find
    from coopqp.study.recorded_run import measured_run

    path, scenario = _recorded(trace, catalog)
    name, q = measured_run(path, scenario, controller)
    held = scenario.held_by(name)
    found = find(held.chain, q, encoders=encoders)
    if as_json:
        click.echo(strict_json.text(report.as_json(found)))
        return
    console().print(report.table(found))
    for sentence in report.sentences(found, encoders=encoders):
        click.echo(sentence)
    click.echo(f"\n{report.yaml_text(found, held)}", nl=False)


@main.command()
@click.argument("file", type=click.Path(path_type=Path))
@click.option("--solver", multiple=True, help="Which; may be given more than once. All if omitted.")
@catalogued
@JSON
def replay(file: Path, solver: tuple[str, ...], catalog: Any, as_json: bool) -> None:
    """Solve a tick saved by 'coopqp explain --save' again, with any solver."""
    from coopqp.report.terminal import console
    from coopqp.scenario.loader import solver_by_name, solver_names
    from coopqp.study.replay import replay as solve_again
    from coopqp.study.tick_record import TickRecord

    record = TickRecord.read(file)
    answers = {
        name: solve_again(record, solver_by_name(name, catalog))
        for name in solver or solver_names(catalog)
    }
    from coopqp.report import strict_json, table

    if as_json:
        click.echo(strict_json.text({name: a.as_json() for name, a in answers.items()}))
        return
    console().print(table.replay(record, answers))


@main.command()
@click.option("--rollouts", type=click.IntRange(1), default=1000, help="How many.")
@click.option("--seed", type=click.IntRange(0), default=0, help="Of the first; others count up.")
@click.option("--jobs", type=click.IntRange(0), default=0, help="Processes; all cores if 0.")
@click.option("--solver", default="daqp", help="QP solver; daqp if omitted.")
@click.option("--plant", default="kinematic", help="With masses: each with and without errors.")
@JSON
def stress(rollouts: int, seed: int, jobs: int, solver: str, plant: str, as_json: bool) -> None:
    """Run random rollouts of the QP law; exit code 1 if one breaks a promise."""
    from dataclasses import asdict

    from coopqp.report import strict_json
    from coopqp.report.terminal import console, progress_bars
    from coopqp.scenario.catalog import Catalog
    from coopqp.scenario.loader import plant_by_name, solver_by_name
    from coopqp.study import stress as trial

    catalog = Catalog()
    asked = solver_by_name(solver, catalog), plant_by_name(plant, catalog)
    with progress_bars(["rollouts"], rollouts) as progress:
        report = (lambda done: progress("rollouts", done)) if progress else None
        done = trial.stress(rollouts, *asked, seed=seed, jobs=jobs, progress=report)
    lines, broken = trial.summarize(done), [r for r in done if r.broken]
    if as_json:
        data = {"lines": [asdict(x) for x in lines], "broken": [asdict(r) for r in broken]}
        click.echo(strict_json.text(data))
    else:
        from coopqp.report import table

        console().print(table.stress(lines, plant))
        for r in broken[:20]:
            click.echo(f"seed {r.seed}: {'; '.join(r.broken)}", err=True)
    if broken:
        click.get_current_context().exit(1)


@main.command()
@click.option("--goals", type=click.IntRange(1), default=200, help="How many on each robot.")
@click.option("--seed", type=click.IntRange(0), default=0, help="Of the first; others count up.")
@click.option("--jobs", type=click.IntRange(0), default=0, help="Processes; all cores if 0.")
@JSON
def statistics(goals: int, seed: int, jobs: int, as_json: bool) -> None:
    """Count how often each law reaches random goals inside all limits."""
    from dataclasses import asdict

    from coopqp.report import strict_json
    from coopqp.report.terminal import console, progress_bars
    from coopqp.study import statistics as study

    with progress_bars(["goals"], goals * len(study.arenas())) as progress:
        report = (lambda done: progress("goals", done)) if progress else None
        done = study.statistics(goals, seed=seed, jobs=jobs, progress=report)
    lines = study.summarize(done)
    if as_json:
        data = {"lines": [asdict(x) for x in lines], "goals": [asdict(g) for g in done]}
        click.echo(strict_json.text(data))
        return
    for table in study.tables(lines):
        console().print(table, "")


@main.command(name="solve-start")
@SCENARIO
@click.option("--seed", type=click.IntRange(0), help="Of the tries, instead of the scenario's.")
@catalogued
@JSON
def solve_start(scenario: str, seed: int | None, catalog: Any, as_json: bool) -> None:
    """Find joint values, inside the limits, with which every arm reaches its grasp.

    The scenario gives object.pose and every grasp's object_in_hand; its own start does not count.
    """
    from coopqp.report import strict_json
    from coopqp.report.terminal import progress_bars
    from coopqp.scenario.loader import load_and_solve
    from coopqp.scenario.start_solver import yaml_text

    with progress_bars(["solving"], 1) as progress:
        report = (lambda done, total: progress("solving", done / total)) if progress else None
        found = load_and_solve(scenario, catalog, seed=seed, progress=report)
    if as_json:
        asked = ("start", "margin", "tries", "found")
        click.echo(strict_json.text({key: getattr(found, key) for key in asked}))
        return
    click.echo(yaml_text(found), nl=False)


@main.command()
@click.argument("scenarios", nargs=-1, required=True)
@catalogued
def validate(scenarios: tuple[str, ...], catalog: Any) -> None:
    """Check scenario files; every fault is listed with its line."""
    from coopqp.errors import Fault, ScenarioError

    faults: list[Fault] = []
    for name in scenarios:
        try:
            _note(_load(name, catalog, None), [])
        except ScenarioError as error:
            faults.extend(error.faults)
        else:
            click.echo(f"{name}: ok")
    if faults:
        raise ScenarioError(faults)


@main.command(name="list")
@click.argument("kind", required=False, type=click.Choice(COLLECTIONS))
@catalogued
@JSON
def list_(kind: str | None, catalog: Any, as_json: bool) -> None:
    """List what scenarios can name, with a line of help each."""
    from coopqp.report import names
    from coopqp.report.terminal import console

    rows = {k: names.help_lines(k, catalog) for k in ([kind] if kind else COLLECTIONS)}
    if as_json:
        click.echo(json.dumps(rows, indent=2))
        return
    console().print(names.table(rows))


@main.command()
@catalogued
def schema(catalog: Any) -> None:
    """Print the JSON Schema of scenario files, for editors."""
    from coopqp.scenario.form import file_model

    click.echo(json.dumps(file_model(catalog).model_json_schema(), indent=2))


def _load(name: str, catalog: Any, solver: str | None) -> Any:
    from coopqp.scenario.loader import load, with_solver

    loaded = load(name, catalog)
    for line in loaded.robot_model.warnings:
        click.echo(f"warning: {line}", err=True)
    return with_solver(loaded, solver) if solver else loaded


def _recorded(trace: Path, catalog: Any) -> tuple[Path, Any]:
    """A written trace, from its own or its folder's path, and the scenario beside it."""
    from coopqp.study.trace_file import controllers_of

    path = trace / "trace.csv" if trace.is_dir() else trace
    controllers_of(path)  # a trace that is missing is said before its scenario is
    return path, _load(str(path.parent / "scenario.yaml"), catalog, None)


def _note(scenario: Any, controllers: list[str]) -> None:
    """Say which parts of a scenario have no effect on which of these controllers."""
    from coopqp.controller_run import controller_of
    from coopqp.scenario.notes import notes

    chosen = controllers or list(scenario.controllers)
    for line in notes(scenario, {name: controller_of(scenario, name) for name in chosen}):
        click.echo(f"note: {line}", err=True)


def _show(scenario: Any, controllers: list[str], out: Path | None, *, as_json: bool) -> None:
    """Run, print the table or JSON, and write the report."""
    from coopqp.comparison import compare as run_all
    from coopqp.report import files, table
    from coopqp.report.terminal import console, progress_bars

    _note(scenario, controllers)
    if out:
        files.check_folder(out)
    with progress_bars(controllers, scenario.ticks) as progress:
        comparison = run_all(scenario, controllers=controllers, progress=progress)
    written = files.write(comparison, out) if out else []
    if as_json:
        click.echo(files.metrics_json(comparison), nl=False)
        return
    console().print(table.summary(comparison))
    for path in written:
        click.echo(f"wrote {path}")
