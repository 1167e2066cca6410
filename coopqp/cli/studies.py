"""Commands on recorded runs, and on many runs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from coopqp.base.errors import CoopqpError
from coopqp.base.reading import absolute
from coopqp.cli.options import JSON, WRITTEN, catalogued, read_tick, read_trace, say

FORMATS = ("mcap", "rosbag2", "parquet")


@click.command()
@click.argument("trace", type=click.Path(path_type=Path))
@click.option("--tick", type=int, help="Explain one tick, not the run.")
@click.option(
    "--controller", help="Whose; the first that falls short if omitted, QP controllers first."
)
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
    from coopqp.report import files, table
    from coopqp.report.terminal import progress_bars
    from coopqp.study.explanation import explain_run
    from coopqp.study.trace_file import trace_from_file, worth_explaining

    if tick is not None or save:
        record = read_tick(trace, catalog, controller, tick)
        click.echo(table.tick_text(record, as_json=as_json))
        if save:
            files.write_one(save, record.text())
            say(f"wrote {save}", aside=as_json)  # what machines read is JSON alone
        return
    run, scenario = read_trace(trace, catalog)
    if controller:
        recorded = trace_from_file(run, scenario, controller)
    else:
        recorded = worth_explaining(run, scenario)
    with progress_bars(["explaining"], 1) as progress:
        report = (lambda share: progress("explaining", share)) if progress else lambda share: None
        found = explain_run(scenario, recorded, report)
    click.echo(table.run_text(found, absolute(run.path.parent).name, as_json=as_json))


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
    from coopqp.base.errors import CoopqpError
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
    from coopqp.study.tick_record import TickRecord
    from coopqp.study.tick_record import replay as solve_again

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


def _moved(name: str, what: str, module: str) -> click.Command:
    """A command that is none any more says where it has gone."""

    @click.command(
        name, hidden=True, add_help_option=False, context_settings={"ignore_unknown_options": True}
    )
    @click.argument("words", nargs=-1, type=click.UNPROCESSED)
    def command(words: tuple[str, ...]) -> None:
        raise CoopqpError(
            f"the random {what} are a test now: python -m tests.{module}, with the same options, "
            f"in a checkout of coopqp (docs/{name}.md)"
        )

    return command


stress = _moved("stress", "rollouts", "stress")
statistics = _moved("statistics", "goals", "random_goals")
