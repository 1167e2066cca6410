"""The same velocities as another checkout: ``python -m tests.qp_law.same_as /path/to/checkout``.

Every scenario with a QP that the other checkout ships runs as it is, with its first task made hard,
and scaled, by the plain law and by the kernel, in this checkout and in the other one, each in a
process of its own. Compared are the ticks up to the first that is not OPTIMAL in either. Exit code
1 where velocities differ by more than 1e-9 rad/s, or where this checkout is OPTIMAL for fewer
ticks. ``--error-damping 0`` leaves out the damping for errors, by which laws may differ on purpose.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import click
import numpy as np

SAME = 1e-9  # [rad/s, m/s]
HERE = Path(__file__).parents[2]


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.qp_law.same_as", description=__doc__)
    parser.add_argument("other", type=Path, help="a checkout with its kernel compiled")
    parser.add_argument("--ticks", type=int, default=100_000, help="of each run at most")
    parser.add_argument("--error-damping", type=float, help="of both laws; default: each its own")
    asked = parser.parse_args()
    more = [] if asked.error_damping is None else [str(asked.error_damping)]
    other = asked.other.resolve()
    with tempfile.TemporaryDirectory() as folder:
        outs = [Path(folder) / f"{name}.npz" for name in ("here", "other")]
        for tree, out in zip((HERE, other), outs, strict=True):
            _run(tree, [str(out), str(other / "scenarios"), str(asked.ticks), *more])
        here, there = (dict(np.load(out)) for out in outs)
    return _tell(here, there)


def _run(tree: Path, arguments: list[str]) -> None:
    script = Path(__file__).with_name("velocities.py")
    environment = {**os.environ, "PYTHONPATH": str(tree)}
    command = [sys.executable, str(script), *arguments]
    subprocess.run(command, cwd=Path(arguments[0]).parent, env=environment, check=True)


def _tell(here: Mapping[str, Any], other: Mapping[str, Any]) -> int:
    """One line for each run that differs, and the counts."""
    runs = sorted({key.rpartition("|")[0] for key in (*here, *other)})
    ticks, worst, wrong = 0, 0.0, 0
    for run in runs:
        if f"{run}|raised" in here or f"{run}|raised" in other:
            a, b = (str(found.get(f"{run}|raised", "runs")) for found in (here, other))
            wrong += a != b
            click.echo(f"{run}: {a} here, {b} there")
            continue
        (v, n), (was, before) = (_optimal(found, run) for found in (here, other))
        compared = min(n, before)
        off = float(np.abs(v[:compared] - was[:compared]).max(initial=0.0))
        ticks, worst = ticks + compared, max(worst, off)
        if off > SAME or n != before:
            wrong += off > SAME or n < before
            click.echo(f"{run}: {off:.1e} rad/s; OPTIMAL for {n} ticks, {before} there")
    click.echo(f"{len(runs)} runs, {ticks} ticks: at most {worst:.1e} rad/s; {wrong} runs differ")
    return 1 if wrong else 0


def _optimal(found: Mapping[str, Any], run: str) -> tuple[Any, int]:
    """The velocities of a run, and how many ticks from the first are OPTIMAL."""
    optimal = found[f"{run}|optimal"]
    return found[f"{run}|v"], len(optimal) if optimal.all() else int(np.argmin(optimal))


if __name__ == "__main__":
    sys.exit(main())
