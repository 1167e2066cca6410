"""Commands that go on until somebody ends them."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import click

from coopqp.cli.options import (
    SCENARIO,
    SOLVER,
    WRITTEN,
    catalogued,
    print_notes,
    read_scenario,
    say,
)


class _Speed(click.FloatRange):
    """A share of real time; NaN is in no range."""

    def convert(self, value: Any, param: Any, ctx: Any) -> Any:
        found = super().convert(value, param, ctx)
        if math.isnan(found):
            self.fail(f"{value} is not in the range {self._describe_range()}.", param, ctx)
        return found


@click.command()
@SCENARIO
@click.option(
    "--controller", "controllers", multiple=True,
    help="Which; may be given more than once. All of the scenario's if omitted.",
)  # fmt: skip
@click.option("--port", type=int, default=8080, help="Of the page; any that is free if 0.")
@click.option("--host", default="127.0.0.1", help="Address to listen on; this machine's alone.")
@click.option("--speed", type=_Speed(0.05, 4.0), default=1.0, help="Times real time, at first.")
@click.option(
    "--record", type=WRITTEN,
    help="Folder for a recording, which coopqp compare replays; written at the end too.",
)  # fmt: skip
@SOLVER
@catalogued
def play(
    scenario: str,
    controllers: tuple[str, ...],
    port: int,
    host: str,
    speed: float,
    record: Path | None,
    solver: str | None,
    catalog: Any,
) -> None:
    """Play a scenario on a page in the browser, where its goals can be dragged.

    SCENARIO is a YAML file or the name of a shipped scenario (coopqp list scenarios).
    """
    from coopqp.base.errors import CoopqpError
    from coopqp.viewer import play as viewer
    from coopqp.viewer.recording import check_folder

    viewer.check_viewer()
    viewer.check_address(host, port)
    if record:
        check_folder(record)
    loaded = read_scenario(scenario, catalog, solver)
    print_notes(loaded, controllers, steered=True)
    from coopqp.viewer.player import Player

    player = Player(loaded, controllers, record)
    player.speed = speed
    for name, why in player.refused.items():
        say(f"warning: {name} is left out: {why}")
    for fault in player.faults:
        say(f"warning: {fault}")
    try:
        viewer.play(player, host, port, lambda page: click.echo(f"{page}  (Ctrl-C ends it)"))
    except CoopqpError:
        player.save()  # what was played is not lost for the page
        raise
    except KeyboardInterrupt:
        words = f"ended after {player.lanes[0].t:.2f} s"
        if record:
            player.save()
            words += f"; {player.note}"
        click.echo(words)
