"""The command; docs/stress.md has what is drawn and promised, and what came of it."""

from __future__ import annotations

import sys
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

import click

sys.path.insert(0, str(Path(__file__).parents[1]))  # what tests share, for workers as well

from coopqp.base.errors import InvalidValueError, UnknownNameError
from coopqp.cli import Command
from coopqp.cli.options import JSON, engined
from coopqp.report import strict_json
from coopqp.report.table import console, progress_bars
from coopqp.scenario.catalog import Catalog
from coopqp.scenario.loader import solver_by_name
from stress.contacts import ContactRollout, contact_rollout
from stress.faults import faulty_rollout
from stress.summary import contact_table, fault_table, summarize, table
from stress.trial import one_rollout, stress


@click.command(cls=Command, context_settings={"help_option_names": ["-h", "--help"]})
@click.option("--rollouts", type=click.IntRange(1), default=1000, help="How many.")
@click.option("--seed", type=click.IntRange(0), default=0, help="Of the first; others count up.")
@click.option("--solver", default="daqp", help="QP solver; daqp if omitted.")
@click.option("--plant", default="kinematic", help="With masses: each with and without errors.")
@click.option("--contacts", is_flag=True, help="Hands that press, torque_qp on rigid bodies.")
@click.option("--faults", is_flag=True, help="Sensors and motors that fail.")
@engined
@JSON
def main(
    rollouts: int,
    seed: int,
    solver: str,
    plant: str,
    contacts: bool,
    faults: bool,
    engine: Any,
    as_json: bool,
) -> None:
    """Run random rollouts of the QP law; exit code 1 if one breaks a promise."""
    catalog = Catalog()
    if contacts and plant not in ("kinematic", "rigid_body"):
        raise InvalidValueError(
            f"--contacts: found --plant {plant}, needs rigid_body; omit --plant"
        )
    if contacts and faults:
        raise InvalidValueError("--contacts: found --faults as well; omit one of them")
    plants = catalog.entries("plants")
    if plant not in plants:
        raise UnknownNameError("plant", plant, plants)
    asked = solver_by_name(solver, catalog), plants[plant].cls()
    with progress_bars(["rollouts"], rollouts) as progress:
        where: Any = {"seed": seed, "engine": engine}
        where["progress"] = partial(progress, "rollouts") if progress else None
        done: Any
        if contacts:
            one = partial(contact_rollout, solver=asked[0])
            done = stress(rollouts, one, kind=ContactRollout, **where)
        else:
            one = partial(
                faulty_rollout if faults else one_rollout, solver=asked[0], plant=asked[1]
            )
            done = stress(rollouts, one, **where)
    lines, broken = summarize(done), [r for r in done if r.broken]
    if as_json:
        data = {"lines": lines, "broken": [asdict(r) for r in broken]}
        click.echo(strict_json.text(data))
    else:
        shown = contact_table(lines) if contacts else None
        shown = fault_table(lines, plant) if faults else shown
        console().print(shown or table(lines, plant))
        for r in broken[:20]:
            click.echo(f"seed {r.seed}: {'; '.join(r.broken)}", err=True)
    if broken:
        click.get_current_context().exit(1)


if __name__ == "__main__":
    main(prog_name="python -m tests.stress")
