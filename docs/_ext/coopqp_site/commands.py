"""The page of the command line, from the commands themselves."""

from __future__ import annotations

import inspect

import click

from coopqp import cli
from coopqp_site.writing import table


def page() -> str:
    """Every command with its arguments and options."""
    top = click.Context(cli.main, info_name="coopqp")
    text = f"# Command line\n\n{_help(cli.main)}\n\n{_options(cli.main, top)}"
    for name, command in sorted(cli.main.commands.items()):
        if command.hidden:
            continue
        inside = click.Context(command, info_name=name, parent=top)
        usage = " ".join([inside.command_path, *command.collect_usage_pieces(inside)])
        text += f"\n## {name}\n\n```text\n{usage}\n```\n\n{_help(command)}\n\n"
        text += _options(command, inside)
    return text


def _help(command: click.Command) -> str:
    return inspect.cleandoc(command.help or "").replace("\b", "")


def _options(command: click.Command, context: click.Context) -> str:
    records = (option.get_help_record(context) for option in command.get_params(context))
    rows = ((f"`{record[0]}`", record[1]) for record in records if record)
    return table(("option", "meaning"), rows)
