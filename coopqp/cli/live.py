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
        speed = super().convert(value, param, ctx)
        if math.isnan(speed):
            self.fail(f"{value} is not in the range {self._describe_range()}.", param, ctx)
        return speed


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
    from coopqp.viewer.player import Player
    from coopqp.viewer.recording import check_folder

    viewer.check_viewer()
    viewer.check_address(host, port)
    if record:
        check_folder(record)
    loaded = read_scenario(scenario, catalog, solver)
    print_notes(loaded, controllers, steered=True)

    player = Player(loaded, controllers, record)
    player.speed = speed
    left_out = (f"{name} is left out: {why}" for name, why in player.refused.items())
    for line in (*left_out, *player.faults):
        say(f"warning: {line}")
    try:
        viewer.play(player, host, port, lambda page: click.echo(f"{page}  (Ctrl-C ends it)"))
    except CoopqpError:
        player.save()  # the recording survives the page
        raise
    except KeyboardInterrupt:
        words = f"ended after {player.controllers[0].t:.2f} s"
        if record:
            player.save()
            words += f"; {player.note}"
        click.echo(words)


@click.command(context_settings={"ignore_unknown_options": True})
@SCENARIO
@click.argument("ros_args", nargs=-1, type=click.UNPROCESSED, metavar="[--ros-args ...]")
@catalogued
def ros(scenario: str, ros_args: tuple[str, ...], catalog: Any) -> None:
    """Run a scenario on a robot as a node of ROS 2 (docs/ros.md).

    Its parameters and topics are ROS's own, after --ros-args.
    """
    from coopqp.ros.node import run_node

    if ros_args and ros_args[0] != "--ros-args":
        raise click.UsageError(f"found {ros_args[0]}; what is for ROS comes after --ros-args")
    click.echo(str(run_node(read_scenario(scenario, catalog), ros_args)))
