"""The command on studies: run one, go on with it, look at what there is."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import click

from coopqp.base.reading import absolute
from coopqp.cli.options import (
    JSON,
    WRITTEN,
    catalogued,
    engined,
    printed_aside,
    read_scenario,
    say,
)


@click.command()
@click.argument("what", type=click.Path(path_type=Path), metavar="STUDY | FOLDER")
@click.option("--out", type=WRITTEN, help="Folder for journal, results and page.")
@engined
@click.option("--watch", is_flag=True, help="Draw the page anew while it runs.")
@click.option("--table", is_flag=True, help="Print what there is by now; with a folder.")
@click.option("--show", type=int, metavar="ROW", help="Compare on one row; with a folder.")
@catalogued
@JSON
def sweep(
    what: Path,
    out: Path | None,
    engine: Any,
    watch: bool,
    table: bool,
    show: int | None,
    catalog: Any,
    as_json: bool,
) -> None:
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

    with printed_aside(as_json):
        study = study_of.read_study(what, catalog)
    for note in study.notes:
        say(f"note: {note}")
    drawn = _Drawn(out, study) if watch else None
    with printed_aside(as_json), shown(study) as show_progress:

        def progress(state: Any) -> None:
            show_progress(state)
            if drawn:
                drawn.perhaps()

        done = study_of.sweep(study, out, engine=engine, folders=catalog.folders, progress=progress)
    if done.damaged:
        say(f"warning: {_records(done.damaged)} damaged; what stood there has been done again")
    _print(study, out, as_json=as_json)


def _look(folder: Path, catalog: Any, *, watch: bool, show: int | None, as_json: bool) -> None:
    """What can be done with a folder, also while another command runs the study."""
    from coopqp.study.sweep import kept_study
    from coopqp.study.sweep.results import compact, needs_arrow

    study = kept_study(folder, catalog)
    if show is not None:
        _show(study, folder, show)
        return
    needs_arrow()
    index = compact(study, folder)
    if index.damaged:
        say(f"warning: {_records(index.damaged)} damaged; what stands there does not count")
    while watch and index.done < study.points.count:
        _print(study, folder, as_json=as_json)
        time.sleep(_Drawn.EVERY)
        index = compact(study, folder)
    _print(study, folder, as_json=as_json)


def _records(count: int) -> str:
    return "a record of the journal is" if count == 1 else f"{count:,} records of the journal are"


def _print(study: Any, folder: Path, *, as_json: bool) -> None:
    """Write the page and print the table."""
    from coopqp.report import strict_json
    from coopqp.report.sweep import table
    from coopqp.report.sweep.page import write
    from coopqp.report.terminal import console
    from coopqp.study.sweep.results import Columns
    from coopqp.study.sweep.summary import summarize

    columns = Columns.of(folder)
    summary = summarize(columns, exact=study.exact)
    if as_json:
        click.echo(strict_json.text(table.as_json(study.name, summary)))
    else:
        console().print(table.table(study.name, summary))
        if compared := table.paired(summary):
            console().print("", compared)
        for sentence in table.sentences(summary):
            say(sentence, aside=False)
        if summary.rows < study.rows:
            say(f"{summary.rows:,} of {study.rows:,} rows are there yet", aside=False)
    page = write(study, columns, summary, folder)
    for path in (columns.path, page):
        say(f"wrote {path}", aside=as_json)


def _show(study: Any, folder: Path, row: int) -> None:
    """Write a row's scenario and compare on it."""
    from coopqp.cli.scenarios import compare_on
    from coopqp.report.files import write_one
    from coopqp.report.sweep.page import ROWS
    from coopqp.study.sweep import scenario_of_row
    from coopqp.study.sweep.folder import check_plugins

    for odd in check_plugins(folder, study):
        say(f"warning: {odd}")
    text, controller = scenario_of_row(study, row)
    path = folder / ROWS / f"{row}.yaml"
    write_one(path, text)
    say(f"wrote {path}", aside=False)
    loaded = read_scenario(str(path), study.catalog)
    compare_on(loaded, [controller], folder / ROWS / str(row), as_json=False)


class _Drawn:
    """A page that is drawn anew now and then, and never costs much of the time.

    Args:
        folder: of the study.
        study: whose page it is.
    """

    EVERY = 10.0  # s at least
    SHARE = 0.1  # of the time at most

    def __init__(self, folder: Path, study: Any) -> None:
        self._folder, self._study = absolute(folder), study
        self._next = time.monotonic() + self.EVERY

    def perhaps(self) -> None:
        """Draw it if it is time."""
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
