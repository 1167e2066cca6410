"""The command line; heavy imports wait until a command needs them, so that --help is quick."""

from __future__ import annotations

import click

from coopqp import __version__
from coopqp.cli import scenarios, studies
from coopqp.cli.ending import Group


@click.group(cls=Group, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(__version__, prog_name="coopqp")
@click.option("--debug", is_flag=True, help="Show the traceback of what is a fault of coopqp.")
def main(debug: bool) -> None:
    """Compare QP control of arms that hold one object with the pseudoinverse laws.

    Begin with: coopqp compare point_on_point --out out/point_on_point
    """


for module in (scenarios, studies):
    for command in vars(module).values():
        if isinstance(command, click.Command):
            main.add_command(command)
