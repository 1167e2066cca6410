"""Options that several commands have, and how they read what these name."""

import contextlib
import os
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import wraps
from pathlib import Path
from typing import Any

import click

from coopqp.base.errors import CoopqpError, one_line

SCENARIO = click.argument("scenario")


class _Written(click.Path):
    """A path that is written to; an empty one would be the current folder."""

    def convert(self, value: Any, param: Any, ctx: Any) -> Any:
        if value == "":
            self.fail("is empty; needs a name", param, ctx)
        return super().convert(value, param, ctx)


def _filled(_: Any, __: Any, value: str | None) -> str | None:
    """Refuse an empty text, as of a shell variable that is not set."""
    if value == "":
        raise click.BadParameter("is empty; leave the option out, or fill it in")
    return value


WRITTEN = _Written(path_type=Path)
FOLDER = click.Path(exists=True, file_okay=False, path_type=Path)
SOLVER = click.option("--solver", help="QP solver, instead of the scenario's.")
MAX_PER_CORE = 4  # processes
SAME = 1e-6  # velocities of a tick that is computed again [rad/s, m/s]
JSON = click.option("--json", "as_json", is_flag=True, help="Print JSON for machines.")


def catalogued(command: Callable[..., None]) -> Callable[..., None]:
    """Options that name plug-ins of the user's own; the command gets the catalogue with them."""

    @click.option(
        "--plugins", "plugin_folders", multiple=True, type=FOLDER,
        help="Folder with plug-ins of your own in subfolders tasks, limits, controllers ...; "
        "may be given more than once.",
    )  # fmt: skip
    @click.option(
        "--tasks", "task_folders", multiple=True, type=FOLDER,
        help="Folder with task files of your own; may be given more than once.",
    )  # fmt: skip
    @wraps(command)
    def with_catalog(
        *, plugin_folders: tuple[Path, ...], task_folders: tuple[Path, ...], **options: Any
    ) -> None:
        from coopqp.scenario.catalog import Catalog

        if options.get("out"):
            _refuse_inside(plugin_folders, options["out"])
        with printed_aside(options.get("as_json", False)):
            catalog = Catalog(task_folders, plugin_folders)
        command(catalog=catalog, **options)

    return with_catalog


def _refuse_inside(folders: Sequence[Path], out: Path) -> None:
    """Results in a folder of plug-ins would be taken for a collection from then on."""
    for folder in folders:
        within = os.path.relpath(out, folder).split(os.sep)
        if within[0] != ".." and not any(name.startswith("_") for name in within):
            raise click.BadParameter(
                f"{out} lies in the folder of plug-ins {folder}, where it would be taken for a "
                "collection; write elsewhere, or under a name that begins with _",
                param_hint="--out",
            )


def engined(command: Callable[..., None]) -> Callable[..., None]:
    """Options that say where many runs are done; the command gets the engine."""

    @click.option("--jobs", type=click.IntRange(0), default=0, help="Processes; all cores if 0.")
    @click.option("--scheduler", callback=_filled, metavar="ADDRESS", help="Of a Dask cluster.")
    @click.option(
        "--shard", default="1/1", metavar="I/N", help="Do this share of N, as job I does."
    )
    @wraps(command)
    def with_engine(*, jobs: int, scheduler: str | None, shard: str, **options: Any) -> None:
        from coopqp.base.errors import InvalidValueError
        from coopqp.study.engine import Engine, Share, cores

        if jobs > MAX_PER_CORE and jobs > (limit := MAX_PER_CORE * cores()):
            words = f"--jobs: found {jobs}; needs at most {limit}, {MAX_PER_CORE} for each core"
            raise InvalidValueError(f"{words}, because each process takes 0.2 GB")
        command(engine=Engine(jobs, scheduler or "", Share.read(shard)), **options)

    return with_engine


@contextlib.contextmanager
def printed_aside(aside: bool) -> Iterator[None]:
    """Send what plug-ins print, here and in workers, to the error stream, if aside."""
    if not aside:
        yield
        return
    sys.stdout.flush()
    kept = os.dup(1)
    os.dup2(2, 1)
    try:
        with contextlib.redirect_stdout(sys.stderr):
            yield
    finally:
        os.dup2(kept, 1)
        os.close(kept)


def read_scenario(name: str, catalog: Any, solver: str | None = None) -> Any:
    """A scenario, with another solver if one is named; prints what its robot leaves out."""
    from coopqp.scenario.loader import load, with_solver

    loaded = load(name, catalog)
    _warn(loaded)
    return with_solver(loaded, solver) if solver else loaded


def read_trace(trace: Path, catalog: Any) -> tuple[Any, Any]:
    """A recorded run, from its own or its folder's path, and its scenario."""
    from coopqp.recordings import format_of, read, trace_in

    _refuse_other(trace)
    path = trace_in(trace)
    run = read(path)  # before the scenario, so that a missing trace is named first
    if format_of(path).cut_short(path):
        words = "was cut short, as by a kill; what follows is of what had been written"
        say(f"warning: {path}: {words}")
    loaded = format_of(path).scenario(path, catalog)
    _warn(loaded)
    return run, loaded


def _refuse_other(path: Path) -> None:
    """Refuse what runs come from, a scenario or a study, with what is to be given instead."""
    from coopqp.scenario.loader import shipped
    from coopqp.study.sweep.results import PATTERN

    if path.is_dir() and any(path.glob(PATTERN)):
        words = f"holds a study; 'coopqp sweep {path} --show ROW' runs one of its rows"
        raise CoopqpError(f"'{path}' {words}, in {path / 'rows' / 'ROW'}")
    if path.suffix in (".yaml", ".yml") or (str(path) in shipped() and not path.exists()):
        words = f"is not a recorded run; 'coopqp compare {path} --out DIR' writes one, in DIR"
        raise CoopqpError(f"'{path}' {words}")


def read_tick(trace: Path, catalog: Any, controller: str | None, tick: int | None) -> Any:
    """A tick of a recorded run, computed again; warns where it differs from the record."""
    from coopqp.study.trace_file import off_the_record, recorded_tick

    run, scenario = read_trace(trace, catalog)
    record = recorded_tick(run, scenario, controller, tick)
    off = off_the_record(run, record)
    if off > SAME:
        words = "done again it commands another velocity than recorded, by up to"
        why = "its scenario or the code is another than when it was run"
        say(f"warning: tick {record.tick}: {words} {off:.2g}; {why}")
    return record


def _warn(scenario: Any) -> None:
    for line in scenario.robot_model.warnings:
        say(f"warning: {line}")


def say(line: str, *, aside: bool = True) -> None:
    """Print one line, whatever the names in it hold, to the error stream if aside."""
    click.echo(one_line(line), err=aside)


def say_wrote(*paths: Path, aside: bool = False) -> None:
    """Name the files that a command has written; what machines read is JSON alone."""
    for path in paths:
        say(f"wrote {path}", aside=aside)


def say_left_out(refused: Mapping[str, object], place: str = "") -> None:
    """Name the controllers that cannot be used, and why."""
    for name, why in refused.items():
        say(f"warning: {place}{name} is left out: {why}")


def show(*parts: Any) -> None:
    """Print tables, and sentences as they are."""
    from coopqp.report.table import console

    for part in parts:
        styled = not isinstance(part, str)
        console().print(part, markup=styled, highlight=styled)


def print_json(data: Any) -> None:
    """Print data for machines."""
    from coopqp.report import strict_json

    click.echo(strict_json.text(data))


def print_notes(scenario: Any, controllers: Sequence[str] = (), *, steered: bool = False) -> None:
    """Print which parts of a scenario have no effect on which of the controllers."""
    from coopqp.execution.controller_run import controller_of
    from coopqp.scenario.notes import notes

    names = controllers or list(scenario.controllers)
    chosen = {name: controller_of(scenario, name) for name in names}
    for line in notes(scenario, chosen, steered=steered):
        say(f"note: {line}")


@contextlib.contextmanager
def bar(name: str) -> Iterator[Callable[[float], None]]:
    """A progress bar of one search, on a terminal."""
    from coopqp.report.table import progress_bars

    with progress_bars([name], 1) as progress:
        yield (lambda share: progress(name, share)) if progress else (lambda share: None)
