"""The command; docs/statistics.md has what is drawn and counted, and what came of it."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Any

import click

sys.path.insert(0, str(Path(__file__).parents[1]))  # what tests share, for workers as well

from coopqp import __version__
from coopqp.base.errors import CoopqpError
from coopqp.cli import Command
from coopqp.cli.options import JSON, WRITTEN, engined
from coopqp.report import strict_json
from coopqp.report.table import console, progress_bars
from coopqp.study.sweep.results import Journal, head_of, records
from random_goals import trial
from random_goals.draw import arenas
from random_goals.summary import summarize
from random_goals.table import tables
from random_goals.trial import GoalRun, kept


@click.command(cls=Command, context_settings={"help_option_names": ["-h", "--help"]})
@click.option("--goals", type=click.IntRange(1), default=200, help="How many on each robot.")
@click.option("--seed", type=click.IntRange(0), default=0, help="Of the first; others count up.")
@click.option("--out", type=WRITTEN, help="File that keeps each goal; goes on from what it has.")
@engined
@JSON
def main(goals: int, seed: int, out: Path | None, engine: Any, as_json: bool) -> None:
    """Count how often each law reaches random goals inside all limits."""
    bars = progress_bars(["goals"], goals * len(arenas()))
    with _kept_goals(out) as (known, keep), bars as progress:
        report = (lambda done: progress("goals", done)) if progress else None
        where: Any = {"seed": seed, "engine": engine, "progress": report}
        done = trial.statistics(goals, **where, known=known, keep=keep)
    lines = summarize(done)
    if as_json:
        data = {"lines": [asdict(x) for x in lines], "goals": [asdict(g) for g in done]}
        click.echo(strict_json.text(data))
        return
    for table in tables(lines):
        console().print(table, "")


@contextmanager
def _kept_goals(
    path: Path | None,
) -> Iterator[tuple[list[GoalRun], Callable[[GoalRun], None] | None]]:
    """Goals that a file has, and who writes others to it as they are done."""
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


if __name__ == "__main__":
    main(prog_name="python -m tests.random_goals")
