"""Adversarial chunks through the filter: ``python -m tests.adapters --chunks 10000``."""

from __future__ import annotations

import sys
from collections import defaultdict
from pathlib import Path

import click
import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))  # what tests share

from adapters.adversarial import Judged, Trial


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
        if judged.broken or judged.unnamed:
            bad += 1
            click.echo(f"{k} {judged.kind} {judged.held} {judged.broken[:3]} {judged.unnamed}")
    click.echo(
        "kind, held | chunks | broken | changed frames | unnamed | still | CPU ms median, 95 %"
    )
    for (kind, held), found in sorted(by_kind.items()):
        cpu = np.percentile([one.cpu for one in found], [50, 95])
        bad_ones = sum(bool(one.broken) for one in found)
        click.echo(
            f"{kind}{', held' if held else ''} | {len(found)} | {bad_ones}"
            f" | {sum(j.changed for j in found)} | {sum(j.unnamed for j in found)}"
            f" | {sum(j.still for j in found)} | {cpu[0]:.1f}, {cpu[1]:.1f}"
        )
    click.echo(f"{bad} of {chunks} chunks break something or have a change without a name")
    raise SystemExit(bad > 0)


if __name__ == "__main__":
    main()
