"""Adversarial chunks through the filter: ``python -m tests.adapters --chunks 10000``."""

from __future__ import annotations

import sys
from collections import defaultdict
from pathlib import Path

import click
import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))  # what tests share

from adapters.adversarial import Judged, Trial

COUNTED = "changed", "unnamed", "still", "frozen"


@click.command()
@click.option("--chunks", type=click.IntRange(1), default=1000, help="How many.")
@click.option("--seed", type=click.IntRange(0), default=0, help="Of the first; others count up.")
def main(chunks: int, seed: int) -> None:
    """Filter chunks of 100 frames for two SO-101; exit code 1 if one breaks a limit."""
    trial, by_kind = Trial(), defaultdict[tuple[str, bool], list[Judged]](list)
    bad = 0
    for k in range(seed, seed + chunks):
        judged = trial.one(k)
        by_kind[judged.kind, judged.held].append(judged)
        if judged.broken or judged.unnamed or judged.frozen:
            bad += 1
            click.echo(f"{k}: {judged}")
    click.echo("kind, held | chunks | broken | frames changed | unnamed | still | frozen | CPU ms")
    for (kind, held), found in sorted(by_kind.items()):
        cpu = np.percentile([one.cpu for one in found], [50, 95])
        sums = [sum(getattr(one, name) for one in found) for name in COUNTED]
        numbers = [len(found), sum(bool(one.broken) for one in found), *sums]
        cells = [f"{kind}{', held' if held else ''}", *map(str, numbers)]
        click.echo(" | ".join([*cells, f"{cpu[0]:.1f}, 95 %: {cpu[1]:.1f}"]))
    half, most = np.percentile([one.cpu for found in by_kind.values() for one in found], [50, 95])
    click.echo(f"all: {half:.1f} ms, 95 %: {most:.1f}")
    click.echo(f"{bad} of {chunks} chunks break something, have a change without a name, or stand")
    click.echo("still where they could move")
    raise SystemExit(bad > 0)


if __name__ == "__main__":
    main()
