"""The command that runs a scenario as a node of ROS 2."""

from __future__ import annotations

from typing import Any

import click

from coopqp.cli.options import SCENARIO, catalogued, read_scenario


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
