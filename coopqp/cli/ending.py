"""How a command ends: its exit code, and one line for everything that goes wrong."""

from __future__ import annotations

import traceback
import warnings
from typing import Any

import click

from coopqp.errors import CoopqpError, InternalError

BAD_INPUT = 2  # exit code, the same that click uses for wrong options
OUR_FAULT = 70  # exit code, EX_SOFTWARE of sysexits.h
REPORT = (
    "this is a fault of coopqp, please report it with the command and its files; "
    "'coopqp --debug COMMAND ...' shows where it happened"
)


class Group(click.Group):
    """Commands whose bad input ends in one clear message per fault, and exit code 2.

    What nobody foresaw ends in one line too, with how to report it, and exit code 70.
    """

    def invoke(self, ctx: click.Context) -> Any:
        debug = ctx.params["debug"]
        try:
            with warnings.catch_warnings():
                if not debug:  # numpy's on what overflows; what comes of it is checked and said
                    warnings.simplefilter("ignore", RuntimeWarning)
                return super().invoke(ctx)
        except (click.ClickException, click.exceptions.Exit, click.Abort, BrokenPipeError):
            raise
        except InternalError as error:
            fault, told = error.__cause__ or error, str(error)
        except CoopqpError as error:
            for line in str(error).splitlines():
                click.echo(f"error: {line}", err=True)
            ctx.exit(BAD_INPUT)
        except Exception as error:  # noqa: BLE001 - the last resort
            fault, told = error, _said(error)
        if debug:
            traceback.print_exception(fault)
        click.echo(f"error: {' '.join(told.split())}; {REPORT}", err=True)
        return ctx.exit(OUR_FAULT)


def _said(error: Exception) -> str:
    """``FILE:LINE: raises ZeroDivisionError: division by zero``."""
    if isinstance(error, MemoryError):
        return "out of memory"
    from coopqp.wording import raised  # brings in numpy, for which --help does not wait

    return raised(error)
