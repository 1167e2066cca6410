"""Ask all readers of many runs: ``python -m tests.assessment --seeds 500``.

All shipped scenarios under every controller that can run them, and random rollouts of the stress.
Exit code 1 if any disagree.
"""

from __future__ import annotations

import argparse
import sys

import click

import coopqp
from coopqp.base.errors import CoopqpError
from coopqp.execution.controller_run import run

sys.path.insert(0, "tests")

from scenario_files import LOADABLE

from .contract import disagreements, of_stress


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.assessment", description=__doc__)
    parser.add_argument("--seeds", type=int, default=500)
    parser.add_argument("--scenarios", nargs="*", default=list(LOADABLE))
    asked, count, wrong = parser.parse_args(), 0, list[str]()
    for name in asked.scenarios:
        scenario = coopqp.load(name)
        for controller in dict.fromkeys((*scenario.controllers, *_all(scenario))):
            try:
                trace = run(scenario, controller=controller)
            except CoopqpError:  # it cannot run this scenario
                continue
            count += 1
            wrong += disagreements(scenario, trace, drawn_too=True)
        click.echo(f"{name}: {len(wrong)} so far")
    for seed in range(asked.seeds):
        count += 1
        wrong += of_stress(seed)
    click.echo("\n".join(wrong))
    click.echo(f"{count} runs, {len(wrong)} disagreements")
    return 1 if wrong else 0


def _all(scenario: coopqp.Scenario) -> list[str]:
    return list(scenario.catalog.entries("controllers"))


if __name__ == "__main__":
    sys.exit(main())
