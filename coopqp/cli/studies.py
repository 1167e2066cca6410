"""Commands on recorded runs, and on studies of many runs."""

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Any

import click

from coopqp.base.errors import CoopqpError, InvalidValueError
from coopqp.base.reading import absolute
from coopqp.cli import options
from coopqp.cli.options import print_json, read_scenario, read_trace, say, say_wrote, show

FORMATS = ("mcap", "rosbag2", "parquet", "lerobot")


@click.command(name="time")
@click.argument("path", type=click.Path(exists=True, path_type=Path))
@click.option("--scenario", help="Whose robot and limits count; that of a recorded run if omitted.")
@click.option("--out", type=options.WRITTEN, help="Folder for the timed path.")
@click.option("--controller", help="Of a recorded run; the first if omitted.")
@click.option("--torque", type=float, default=1.0, help="Share of each motor that is planned with.")
@click.option(
    "--wrench", type=(float, float), metavar="N NM", help="Largest internal force, torque."
)
@click.option("--safety", type=float, default=1.5, help="By which friction is divided.")
@click.option(
    "--speed", type=(float, float), default=(0.0, 0.0), metavar="FROM TO",
    help="Of the joints at the beginning and the end [rad/s].",
)  # fmt: skip
@click.option("--rise", type=float, default=0.0, help="Time in which accelerations change [s].")
@click.option("--points", type=int, default=200, help="Intervals of the grid.")
@options.catalogued
@options.JSON
def time_(
    path: Path, scenario: str | None, out: Path | None, catalog: Any, *, as_json: bool, **how: Any
) -> None:
    """Find the fastest motion along a path that speeds, accelerations and torques allow.

    PATH is a recorded run, a CSV file with a column for each joint, or with the object's x, y, z,
    qx, qy, qz and qw, or the folder of one.
    """
    from coopqp.planning.closed_path import table_of
    from coopqp.planning.time_along import time_phases, would_do
    from coopqp.report import files
    from coopqp.report.planning import TIMED, check_written, limits_table, phase_titles, write_timed

    if scenario is None and (table := table_of(path)):
        scenario = _scenario_for(table)
    loaded = read_scenario(scenario, catalog) if scenario else read_trace(path, catalog)[1]
    check_written(out, loaded, TIMED)
    with files.checked_folder(out), _named(path):
        parts = time_phases(path, loaded, **how)
        tried = [would_do(part) for part in parts]
        written = write_timed(parts, tried, loaded, out) if out else ()
    keys = ("duration", "hold", "exceeded", "shares", "notes")
    data = [
        {key: getattr(part, key) for key in keys} | {"would_do": more}
        for part, more in zip(parts, tried, strict=True)
    ]
    if as_json:
        print_json(data[0] if len(data) == 1 else data)
    else:
        for title, part, more in zip(phase_titles(parts, loaded), parts, tried, strict=True):
            first = f"{title}:" if len(parts) > 1 else ""
            for line in filter(None, [first, *part.sentences, part.coarse(loaded.dt)]):
                say(line, aside=False)
            show(limits_table(part, more))
    say_wrote(*written, aside=as_json)
    if out and not any(file.suffix == ".yaml" for file in written):
        words = f"{loaded.name} does not begin where the path does, and at rest"
        say(f"no scenario that follows it is written, since {words}", aside=as_json)


@contextmanager
def _named(path: Path) -> Iterator[None]:
    """Say which file an error of its path is in."""
    try:
        yield
    except InvalidValueError as error:
        if not str(error).startswith("path: "):
            raise
        raise InvalidValueError(f"{path}: {str(error)[6:]}") from None


def _scenario_for(table: Path) -> str:
    """The scenario that stands beside a table of joints, as 'coopqp plan' writes it."""
    found = sorted(table.parent.glob("*.yaml"))
    if len(found) != 1:
        words = "says where joints are, not whose; add --scenario, such as what was planned for"
        raise CoopqpError(f"'{table}' {words}")
    return str(found[0])


@click.command()
@click.argument("trace", type=click.Path(path_type=Path))
@click.option("--tick", type=int, help="Explain one tick, not the run.")
@click.option(
    "--controller", help="Whose; the first that falls short if omitted, QP controllers first."
)
@click.option(
    "--save",
    type=options.WRITTEN,
    help="Keep a tick in this file; if --tick is omitted, the "
    "first that gave something up, else the last.",
)
@options.catalogued
@options.JSON
def explain(
    trace: Path, tick: int | None, controller: str | None, save: Path | None, catalog: Any,
    as_json: bool,
) -> None:  # fmt: skip
    """Say why a run did not reach its goal, and what would do.

    TRACE is a trace.csv, or its folder, written by 'coopqp compare --out', or what 'coopqp export'
    made of it.
    """
    from coopqp.planning import way_round
    from coopqp.report import files, table
    from coopqp.study import explanation, trace_file

    if tick is not None or save:
        record = options.read_tick(trace, catalog, controller, tick)
        click.echo(table.tick_text(record, as_json=as_json))
        if save:
            files.write_one(save, record.text())
            say_wrote(save, aside=as_json)
        return
    run, scenario = read_trace(trace, catalog)
    if controller:
        recorded = trace_file.trace_from_file(run, scenario, controller)
    else:
        recorded = trace_file.worth_explaining(run, scenario)
    with options.bar("explaining") as report:
        explained = explanation.explain_run(scenario, recorded, report)
        beside = run.path.with_name("scenario.yaml")  # recordings of other formats hold theirs
        explained = way_round(scenario, explained, str(beside) if beside.exists() else "SCENARIO")
    click.echo(table.run_text(explained, absolute(run.path.parent).name, as_json=as_json))


@click.command()
@click.argument("run", type=click.Path(path_type=Path))
@click.option("--to", required=True, type=click.Choice(FORMATS), help="Format.")
@click.option("--controller", help="Whose; all of them, a file each, if omitted.")
@click.option("--out", type=options.WRITTEN, help="File; CONTROLLER.FORMAT beside RUN if omitted.")
@options.catalogued
def export(run: Path, to: str, controller: str | None, out: Path | None, catalog: Any) -> None:
    """Write a recorded run for Foxglove, ROS 2, PlotJuggler, pandas or LeRobot.

    RUN is a trace.csv, or its folder, written by 'coopqp compare --out', or what a live loop
    recorded; explain and replay work on the files as on RUN.
    """
    from coopqp.recordings import export as write
    from coopqp.study.trace_file import check_trace

    kept, scenario = read_trace(run, catalog)
    names = [controller] if controller else kept.controllers
    for name in names:
        check_trace(kept, scenario, name)
    if out and len(names) > 1:
        words = f"'{kept.path}' has {', '.join(names)}; add --controller NAME"
        raise CoopqpError(f"--out is one file, but {words}")
    for name in names:
        if not out and Path(name).name != name:
            raise CoopqpError(f"'{name}' is no file's name; give --controller and --out")
        file = out or kept.path.parent / f"{name}.{to}"
        write(kept, scenario, to, name, file)
        say_wrote(file)


@click.command()
@click.argument("trace", type=click.Path(path_type=Path))
@click.option("--controller", help="Whose; the first with measured joints if omitted.")
@click.option("--encoders", is_flag=True, help="Look for offsets of the encoders as well.")
@options.catalogued
@options.JSON
def calibrate(
    trace: Path, controller: str | None, encoders: bool, catalog: Any, as_json: bool
) -> None:
    """Find from a run where the object really is in the hands; print lines for the scenario.

    TRACE is a run with measured joints, as for 'coopqp explain'.
    """
    from coopqp.report import calibration as report
    from coopqp.study.calibration import calibrate as find
    from coopqp.study.trace_file import measured_run

    run, scenario = read_trace(trace, catalog)
    name, q = measured_run(run, scenario, controller)
    held = scenario.held_by(name)
    result = find(held.chain, q, encoders=encoders)
    if as_json:
        print_json(report.as_json(result))
        return
    show(report.table(result))
    for sentence in report.sentences(result, encoders=encoders):
        click.echo(sentence)
    click.echo(f"\n{report.yaml_text(result, held)}", nl=False)


@click.command()
@click.argument("file", type=click.Path(path_type=Path))
@click.option("--tick", type=int, help="Which tick of a run; as 'explain --save' if omitted.")
@click.option("--controller", help="Whose tick of a run; the first QP controller's if omitted.")
@click.option("--solver", multiple=True, help="Which; may be given more than once. All if omitted.")
@options.catalogued
@options.JSON
def replay(
    file: Path, tick: int | None, controller: str | None, solver: tuple[str, ...], catalog: Any,
    as_json: bool,
) -> None:  # fmt: skip
    """Solve a tick again, with any solver.

    FILE is a tick saved by 'coopqp explain --save', or a recorded run as for 'coopqp explain'.
    """
    from coopqp.recordings import is_run
    from coopqp.report import table
    from coopqp.scenario.loader import solver_by_name, solver_names
    from coopqp.study import tick_record

    read = tick_record.TickRecord.read
    record = options.read_tick(file, catalog, controller, tick) if is_run(file) else read(file)
    answers = {
        name: tick_record.replay(record, solver_by_name(name, catalog))
        for name in solver or solver_names(catalog)
    }
    if as_json:
        print_json({name: answer.as_json() for name, answer in answers.items()})
    else:
        show(table.replay(record, answers))


def _moved(name: str, what: str, module: str) -> click.Command:
    """A removed command that says what has replaced it."""

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


@click.command()
@click.argument("what", type=click.Path(path_type=Path), metavar="STUDY | FOLDER")
@click.option("--out", type=options.WRITTEN, help="Folder for journal, results and page.")
@options.engined
@click.option("--watch", is_flag=True, help="Draw the page anew while it runs.")
@click.option("--table", is_flag=True, help="Print what there is by now; with a folder.")
@click.option("--show", type=int, metavar="ROW", help="Compare on one row; with a folder.")
@options.catalogued
@options.JSON
def sweep(
    what: Path, out: Path | None, engine: Any, watch: bool, table: bool, show: int | None,
    catalog: Any, as_json: bool,
) -> None:  # fmt: skip
    """Run a scenario in many variants, and go on where it was when it is called again.

    STUDY is a YAML file or the name of a shipped study (coopqp list studies).
    With the FOLDER of a study: print its table, draw its page, or run one of its rows again.
    """
    if out is None and (what.is_dir() or table or show is not None):
        if table and show is not None:
            raise click.UsageError("--table and --show are two questions; ask one at a time")
        if engine.scheduler or not engine.share.whole:
            raise click.UsageError("--shard and --scheduler need a study file and --out FOLDER")
        _look(what, catalog, watch=watch, show=show, as_json=as_json)
        return
    if out is None:
        raise click.UsageError("needs --out FOLDER for the results of a study file")
    if table or show is not None:
        raise click.UsageError(f"--table and --show need the folder alone: coopqp sweep {out} ...")
    _run(what, out, engine, catalog, watch=watch, as_json=as_json)


def _run(what: Path, out: Path, engine: Any, catalog: Any, *, watch: bool, as_json: bool) -> None:
    from coopqp.report.sweep.table import shown
    from coopqp.study import sweep as study_of

    with options.printed_aside(as_json):
        study = study_of.read_study(what, catalog)
    for note in study.notes:
        say(f"note: {note}")
    page = _LivePage(out, study) if watch else None
    with options.printed_aside(as_json), shown(study) as show_progress:

        def progress(state: Any) -> None:
            show_progress(state)
            if page:
                page.update()

        done = study_of.sweep(study, out, engine=engine, progress=progress)
    if done.damaged:
        say(f"warning: {_records(done.damaged)} damaged; what stood there has been done again")
    _print(study, out, as_json=as_json)


def _look(folder: Path, catalog: Any, *, watch: bool, show: int | None, as_json: bool) -> None:
    """Print, draw or rerun from a folder, also while another command runs the study."""
    from coopqp.study.sweep import kept_study, results

    study = kept_study(folder, catalog)
    if show is not None:
        _show(study, folder, show)
        return
    results.needs_arrow()
    index = results.compact(study, folder)
    if index.damaged:
        say(f"warning: {_records(index.damaged)} damaged; what stands there does not count")
    while watch and index.done < study.points.count:
        _print(study, folder, as_json=as_json)
        time.sleep(_LivePage.EVERY)
        index = results.compact(study, folder)
    _print(study, folder, as_json=as_json)


def _records(count: int) -> str:
    return "a record of the journal is" if count == 1 else f"{count:,} records of the journal are"


def _print(study: Any, folder: Path, *, as_json: bool) -> None:
    from coopqp.report.sweep import table
    from coopqp.report.sweep.page import write
    from coopqp.study.sweep.results import Columns
    from coopqp.study.sweep.summary import summarize

    columns = Columns.of(folder)
    summary = summarize(columns, exact=study.exact)
    if as_json:
        print_json({"study": study.name, **asdict(summary)})
    else:
        show(table.table(study.name, summary))
        if compared := table.paired(summary):
            show("", compared)
        for sentence in table.sentences(summary):
            say(sentence, aside=False)
        if summary.rows < study.rows:
            say(f"{summary.rows:,} of {study.rows:,} rows are there yet", aside=False)
    page = write(study, columns, summary, folder)
    say_wrote(columns.path, page, aside=as_json)


def _show(study: Any, folder: Path, row: int) -> None:
    from coopqp.cli.scenarios import compare_on
    from coopqp.report.files import write_one
    from coopqp.report.sweep.page import ROWS
    from coopqp.study.sweep import scenario_of_row
    from coopqp.study.sweep.sweep import check_plugins

    for odd in check_plugins(folder, study):
        say(f"warning: {odd}")
    text, controller = scenario_of_row(study, row)
    path = folder / ROWS / f"{row}.yaml"
    write_one(path, text)
    say_wrote(path)
    loaded = read_scenario(str(path), study.catalog)
    compare_on(loaded, [controller], folder / ROWS / str(row), as_json=False)


class _LivePage:
    """A study's page that is drawn anew now and then, and never costs much of the time."""

    EVERY = 10.0  # s at least
    SHARE = 0.1  # of the time at most

    def __init__(self, folder: Path, study: Any) -> None:
        self._folder, self._study = absolute(folder), study
        self._next = time.monotonic() + self.EVERY

    def update(self) -> None:
        from coopqp.report.sweep.page import write
        from coopqp.study.sweep.results import Columns, compact
        from coopqp.study.sweep.summary import summarize

        begun = time.monotonic()
        if begun < self._next:
            return
        compact(self._study, self._folder)
        columns = Columns.of(self._folder)
        summary = summarize(columns, exact=self._study.exact)
        write(self._study, columns, summary, self._folder)
        took = time.monotonic() - begun
        self._next = time.monotonic() + max(self.EVERY, took / self.SHARE)
