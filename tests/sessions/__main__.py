"""The command; docs/faults.md says what is drawn and what came of it."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import click
import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))  # what tests share, for workers as well

from rich.table import Table
from stress.trial import stress, tried

from coopqp.cli import Command
from coopqp.cli.options import engined
from coopqp.report.table import console, progress_bars
from sessions.session import EFFECT, KINDS, OPENED, Session, run

HEADS = (
    "fault", "sessions", "with effect", "named", "soon", "right place", "latest [s]",
    "force after over when named", "named without effect",
)  # fmt: skip
#: When a fault with an effect must be named after it [s]: nine in ten, and all.
SOON, LATEST = 0.3, 0.8


@click.command(cls=Command, context_settings={"help_option_names": ["-h", "--help"]})
@click.option("--sessions", type=click.IntRange(0), default=1000, help="With one fault each.")
@click.option("--sound", type=click.IntRange(0), default=1000, help="Without a fault.")
@click.option("--seed", type=click.IntRange(0), default=0, help="Of the first; others count up.")
@engined
def main(sessions: int, sound: int, seed: int, engine: Any) -> None:
    """Run random sessions of the loop for robots; exit code 1 if one breaks a promise."""
    done: list[list[Session]] = []
    for count, is_sound in ((sessions, False), (sound, True)):
        name = "sound" if is_sound else "with a fault"
        with progress_bars([name], max(count, 1)) as progress:
            told = partial(progress, name) if progress else None
            one = partial(_one, sound=is_sound)
            where: Any = {"seed": seed, "engine": engine, "progress": told}
            done.append(stress(count, one, kind=Session, **where))
    faulty, fine = done
    console().print(_table(faulty))
    broken = [*_broken(faulty), *_broken_sound(fine)]
    able = [s for s in fine if not s.overloaded]
    named = sum(s.named == s.named for s in able)
    click.echo(f"{named} false alarms in {len(able)} sound sessions")
    doubts = sum(s.doubted and s.named != s.named for s in able)
    click.echo(f"{doubts} of these braked for a sample or more, as a joint was doubted")
    weak = [s for s in fine if s.overloaded]
    told = sum(s.named == s.named for s in weak)
    click.echo(f"{told} of {len(weak)} in which a motor was at its limit are named")
    for words in broken[:40]:
        click.echo(words, err=True)
    if broken:
        click.get_current_context().exit(1)


def _one(seed: int, *, sound: bool) -> Session:
    return tried(partial(run, sound=sound), Session, seed)


def _table(sessions: Sequence[Session]) -> Table:
    table = Table(*HEADS)
    for kind in (*KINDS, "all"):
        own = [s for s in sessions if kind in (s.fault, "all")]
        harmful = [s for s in own if s.effect == s.effect]
        late = [s.named - s.effect for s in harmful if s.named == s.named]
        table.add_row(
            kind, str(len(own)), str(len(harmful)), str(len(late)),
            str(sum(x <= SOON for x in late)), str(sum(s.right for s in harmful)),
            f"{max(late, default=np.nan):.2f}",
            f"{max((s.most / max(s.force_named, EFFECT) for s in harmful), default=np.nan):.2f}",
            str(sum(s.named == s.named and s.effect != s.effect for s in own)),
        )  # fmt: skip
    return table


def _broken(sessions: Sequence[Session]) -> Iterator[str]:
    for s in sessions:
        who = f"seed {s.seed}: {s.robot}, {s.plant}, {s.fault} of {' and '.join(s.where) or '-'}"
        for words in s.broken:
            yield f"{who}: {words}"
        if s.effect == s.effect and not s.named - s.effect <= LATEST:
            when = "never" if s.named != s.named else f"{s.named - s.effect:.2f} s late"
            yield f"{who}: named {when}; {s.most:.0f} N"
        if s.effect == s.effect and s.most > 2.0 * max(s.force_named, EFFECT):
            yield f"{who}: {s.most:.0f} N after {s.force_named:.0f} N when named {s.kind}"
        if s.opened > OPENED:
            yield f"{who}: the loop told the hands to part by {1e3 * s.opened:.1f} mm"


def _broken_sound(sessions: Sequence[Session]) -> Iterator[str]:
    for s in sessions:
        who = f"sound seed {s.seed}: {s.robot}, {s.plant}"
        for words in s.broken:
            yield f"{who}: {words}"
        if s.named == s.named and not s.overloaded:
            yield f"{who}: named {s.kind} of {' and '.join(s.found)} at {s.named:.2f} s"


if __name__ == "__main__":
    main(prog_name="python -m tests.sessions")
