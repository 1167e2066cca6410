"""How far a study is: a bar on a terminal, a line now and then elsewhere, as in a job's log."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import click
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn

from coopqp.study.sweep.study import Study
from coopqp.study.sweep.sweep import Progress as State

EVERY = 30.0  # s between two lines


@contextmanager
def shown(study: Study) -> Iterator[Callable[[State], None]]:
    """A function that is told of each batch."""
    errors = Console(stderr=True)
    if not errors.is_terminal:
        yield _Lines(study).tell
        return
    columns = (TextColumn("{task.description}"), BarColumn(), TextColumn("{task.fields[said]}"))
    with Progress(*columns, console=errors, transient=True) as bars:
        bar = bars.add_task(study.name, total=None, said="begins")

        def tell(state: State) -> None:
            bars.update(bar, total=state.total, completed=state.done, said=words(state))

        yield tell


class _Lines:
    """A line now and then."""

    def __init__(self, study: Study) -> None:
        self._name, self._next = study.name, time.monotonic() + EVERY

    def tell(self, state: State) -> None:
        """Say how far it is if it is time."""
        if time.monotonic() >= self._next:
            self._next = time.monotonic() + EVERY
            click.echo(f"{self._name}: {words(state)}", err=True)


def words(state: State) -> str:
    """Such as "120/2,048 variants, 35.2 a second, 1 min left, 3 rows invalid, 0 failed"."""
    left = f"{span(state.left)} left" if math.isfinite(state.left) else "time left unknown"
    return (
        f"{state.done:,}/{state.total:,} variants, {state.rate:.3g} a second, {left}, "
        f"{state.states['invalid']:,} rows invalid, {state.states['failed']:,} failed"
    )


def span(seconds: float) -> str:
    """A time for people."""
    if seconds < 100.0:
        return f"{seconds:.0f} s"
    return f"{seconds / 60.0:.0f} min" if seconds < 6000.0 else f"{seconds / 3600.0:.1f} h"
