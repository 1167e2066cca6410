"""Run many cases in a process of their own: ``python -m tests.fuzz --cases 20000 --seed 0``.

A case that takes longer than ten seconds, or for which the process needs more than 1 GiB beyond
what it has with everything imported, counts as wrong. Exit code 1 if any is.
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter

import click

from .workers import Worker


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz", description=__doc__)
    parser.add_argument("--cases", type=int, default=20_000)
    parser.add_argument("--seed", type=int, default=0, help="of the first; others count up")
    parser.add_argument("--show", type=int, default=20, help="how many wrong ones to show whole")
    asked = parser.parse_args()
    worker, ended, wrong = Worker(), Counter[str](), 0
    for k in range(asked.cases):
        outcome = worker.run(asked.seed + k)
        ended[f"{outcome.kind} {outcome.ended}"] += 1
        if outcome.wrong:
            wrong += 1
            if wrong <= asked.show:
                click.echo(f"seed {outcome.seed}: {outcome.kind} {outcome.ended}")
                click.echo(outcome.words)
        if k % 500 == 499:
            click.echo(f"{k + 1} cases: {dict(sorted(ended.items()))}")
    worker.end()
    counts = dict(sorted(ended.items()))
    click.echo(f"{asked.cases} cases from seed {asked.seed}: {wrong} wrong; {counts}")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
