"""Commands on recorded runs, and on many runs."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import click

from coopqp.cli.options import JSON, WRITTEN, catalogued, engined, read_tick, read_trace, say
from coopqp.errors import CoopqpError
from coopqp.reading import absolute

FORMATS = ("mcap", "rosbag2", "parquet")


@click.command()
@click.argument("trace", type=click.Path(path_type=Path))
@click.option("--tick", type=int, help="Explain one tick, not the run.")
@click.option("--controller", help="Whose; the first QP controller of the trace if omitted.")
@click.option(
    "--save",
    type=WRITTEN,
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

    TRACE is a trace.csv, or its folder, written by 'coopqp compare --out', or what 'coopqp export'
    made of it.
    """
    from coopqp.report import explained, files
    from coopqp.report.terminal import progress_bars
    from coopqp.study.explanation import explain_run
    from coopqp.study.trace_file import recording_from_trace

    if tick is not None or save:
        record = read_tick(trace, catalog, controller, tick)
        click.echo(explained.tick_text(record, as_json=as_json))
        if save:
            files.write_one(save, record.text())
            say(f"wrote {save}", aside=as_json)  # what machines read is JSON alone
        return
    run, scenario = read_trace(trace, catalog)
    known, own = run.controllers, scenario.controllers
    solving = [name for name in known if name in own and own[name].uses_solver]
    recording = recording_from_trace(run, scenario, controller or (solving or known)[0])
    with progress_bars(["explaining"], 1) as progress:
        report = (lambda share: progress("explaining", share)) if progress else lambda share: None
        found = explain_run(scenario, recording, report)
    click.echo(explained.run_text(found, absolute(run.path.parent).name, as_json=as_json))


@click.command()
@click.argument("run", type=click.Path(path_type=Path))
@click.option("--to", required=True, type=click.Choice(FORMATS), help="Format.")
@click.option("--controller", help="Whose; all of them, a file each, if omitted.")
@click.option("--out", type=WRITTEN, help="File; CONTROLLER.FORMAT beside RUN if omitted.")
@catalogued
def export(run: Path, to: str, controller: str | None, out: Path | None, catalog: Any) -> None:
    """Write a recorded run for Foxglove, ROS 2, PlotJuggler or pandas.

    RUN is a trace.csv, or its folder, written by 'coopqp compare --out', or what a live loop
    recorded; explain and replay work on the files as on RUN.
    """
    from coopqp.errors import CoopqpError
    from coopqp.recordings.known import EXPORTS
    from coopqp.recordings.known import export as write
    from coopqp.study.trace_file import check_trace

    kept, scenario = read_trace(run, catalog)
    names = [controller] if controller else kept.controllers
    for name in names:
        check_trace(kept, scenario, name)
    if out and len(names) > 1:
        listed = ", ".join(names)
        raise CoopqpError(
            f"--out is one file, but '{kept.path}' has {listed}; add --controller NAME"
        )
    suffix = {known.name: known.suffix for known in EXPORTS}[to]
    for name in names:
        if not out and Path(name).name != name:
            raise CoopqpError(f"'{name}' is no file's name; give --controller and --out")
        file = out or kept.path.parent / f"{name}{suffix}"
        write(kept, scenario, to, name, file)
        say(f"wrote {file}", aside=False)


@click.command()
@click.argument("trace", type=click.Path(path_type=Path))
@click.option("--controller", help="Whose; the first with measured joints if omitted.")
@click.option("--encoders", is_flag=True, help="Look for offsets of the encoders as well.")
@catalogued
@JSON
def calibrate(
    trace: Path, controller: str | None, encoders: bool, catalog: Any, as_json: bool
) -> None:
    """Find from a run where the object really is in the hands; print lines for the scenario.

    TRACE is a run with measured joints, as for 'coopqp explain'.
    """
    from coopqp.report import calibration as report
    from coopqp.report import strict_json
    from coopqp.report.terminal import console
    from coopqp.study.calibration import calibrate as find
    from coopqp.study.trace_file import measured_run

    run, scenario = read_trace(trace, catalog)
    name, q = measured_run(run, scenario, controller)
    held = scenario.held_by(name)
    found = find(held.chain, q, encoders=encoders)
    if as_json:
        click.echo(strict_json.text(report.as_json(found)))
        return
    console().print(report.table(found))
    for sentence in report.sentences(found, encoders=encoders):
        click.echo(sentence)
    click.echo(f"\n{report.yaml_text(found, held)}", nl=False)


@click.command()
@click.argument("file", type=click.Path(path_type=Path))
@click.option("--tick", type=int, help="Which tick of a run; as 'explain --save' if omitted.")
@click.option("--controller", help="Whose tick of a run; the first QP controller's if omitted.")
@click.option("--solver", multiple=True, help="Which; may be given more than once. All if omitted.")
@catalogued
@JSON
def replay(
    file: Path,
    tick: int | None,
    controller: str | None,
    solver: tuple[str, ...],
    catalog: Any,
    as_json: bool,
) -> None:
    """Solve a tick again, with any solver.

    FILE is a tick saved by 'coopqp explain --save', or a recorded run as for 'coopqp explain'.
    """
    from coopqp.recordings.known import is_run
    from coopqp.report.terminal import console
    from coopqp.scenario.loader import solver_by_name, solver_names
    from coopqp.study.replay import replay as solve_again
    from coopqp.study.tick_record import TickRecord

    recorded = is_run(file)
    record = read_tick(file, catalog, controller, tick) if recorded else TickRecord.read(file)
    answers = {
        name: solve_again(record, solver_by_name(name, catalog))
        for name in solver or solver_names(catalog)
    }
    from coopqp.report import strict_json, table

    if as_json:
        click.echo(strict_json.text({name: a.as_json() for name, a in answers.items()}))
        return
    console().print(table.replay(record, answers))


@click.command()
@click.option("--rollouts", type=click.IntRange(1), default=1000, help="How many.")
@click.option("--seed", type=click.IntRange(0), default=0, help="Of the first; others count up.")
@click.option("--solver", default="daqp", help="QP solver; daqp if omitted.")
@click.option("--plant", default="kinematic", help="With masses: each with and without errors.")
@click.option("--contacts", is_flag=True, help="Hands that press, torque_qp on rigid bodies.")
@engined
@JSON
def stress(
    rollouts: int,
    seed: int,
    solver: str,
    plant: str,
    contacts: bool,
    engine: Any,
    as_json: bool,
) -> None:
    """Run random rollouts of the QP law; exit code 1 if one breaks a promise."""
    from dataclasses import asdict

    from coopqp.errors import InvalidValueError
    from coopqp.report import strict_json
    from coopqp.report.terminal import console, progress_bars
    from coopqp.scenario.catalog import Catalog
    from coopqp.scenario.loader import plant_by_name, solver_by_name
    from coopqp.study import stress as trial

    catalog = Catalog()
    if contacts and plant not in ("kinematic", "rigid_body"):
        raise InvalidValueError(
            f"--contacts: found --plant {plant}, needs rigid_body; omit --plant"
        )
    asked = solver_by_name(solver, catalog), plant_by_name(plant, catalog)
    done: Any
    lines: Any
    with progress_bars(["rollouts"], rollouts) as progress:
        report = (lambda done: progress("rollouts", done)) if progress else None
        where: Any = {"seed": seed, "engine": engine, "progress": report}
        if contacts:
            done = trial.stress_contacts(rollouts, asked[0], **where)
        else:
            done = trial.stress(rollouts, *asked, **where)
    lines = trial.summarize_contacts(done) if contacts else trial.summarize(done)
    broken = [r for r in done if r.broken]
    if as_json:
        data = {"lines": [asdict(x) for x in lines], "broken": [asdict(r) for r in broken]}
        click.echo(strict_json.text(data))
    else:
        from coopqp.report import table

        console().print(table.contacts(lines) if contacts else table.stress(lines, plant))
        for r in broken[:20]:
            click.echo(f"seed {r.seed}: {'; '.join(r.broken)}", err=True)
    if broken:
        click.get_current_context().exit(1)


@click.command()
@click.option("--goals", type=click.IntRange(1), default=200, help="How many on each robot.")
@click.option("--seed", type=click.IntRange(0), default=0, help="Of the first; others count up.")
@click.option("--out", type=WRITTEN, help="File that keeps each goal; goes on from what it has.")
@engined
@JSON
def statistics(goals: int, seed: int, out: Path | None, engine: Any, as_json: bool) -> None:
    """Count how often each law reaches random goals inside all limits."""
    from dataclasses import asdict

    from coopqp.report import strict_json
    from coopqp.report.terminal import console, progress_bars
    from coopqp.study import statistics as study

    bars = progress_bars(["goals"], goals * len(study.arenas()))
    with _kept_goals(out) as (known, keep), bars as progress:
        report = (lambda done: progress("goals", done)) if progress else None
        where: Any = {"seed": seed, "engine": engine, "progress": report}
        done = study.statistics(goals, **where, known=known, keep=keep)
    lines = study.summarize(done)
    if as_json:
        data = {"lines": [asdict(x) for x in lines], "goals": [asdict(g) for g in done]}
        click.echo(strict_json.text(data))
        return
    for table in study.tables(lines):
        console().print(table, "")


@contextmanager
def _kept_goals(path: Path | None) -> Iterator[tuple[list[Any], Callable[[Any], None] | None]]:
    """Goals that a file has, and who writes others to it as they are done."""
    from dataclasses import asdict

    from coopqp import __version__
    from coopqp.study.statistics import kept
    from coopqp.study.sweep.journal import Journal, head_of, records

    if path is None:
        yield [], None
        return
    head = {"statistics": __version__}
    before = head_of(path) if path.exists() else None
    if before is not None and before.get("statistics") != __version__:
        words = "has no goals of this version of coopqp; give another --out"
        raise CoopqpError(f"'{path}' {words}")
    with Journal.opened(path, head) as journal:
        known = [kept(found["goal"]) for _, found in records(path) if found]
        yield known, lambda goal: journal.append([(None, {"goal": asdict(goal)})])
