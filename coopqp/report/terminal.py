"""What the commands print to: a console, and progress bars where somebody looks."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn


def console() -> Console:
    """A rich console; without a terminal it keeps a width that tables fit in."""
    found = Console()
    return found if found.is_terminal else Console(width=120)


@contextmanager
def progress_bars(names: list[str], ticks: int) -> Iterator[Callable[[str, float], None] | None]:
    """A progress bar per controller on a terminal, nothing elsewhere."""
    errors = Console(stderr=True)
    if not errors.is_terminal:
        yield None
        return
    columns = (TextColumn("{task.description}"), BarColumn(), TimeRemainingColumn())
    with Progress(*columns, console=errors, transient=True) as progress:
        bars = {name: progress.add_task(name, total=ticks) for name in names}
        yield lambda name, done: progress.update(bars[name], completed=done)
