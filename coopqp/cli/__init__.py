"""The command line, and how a command ends: its exit code, and one line for all that goes wrong.

Heavy imports wait until a command needs them, so that --help is quick.
"""

import errno
import os
import signal
import sys
import threading
import traceback
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, NoReturn

import click

from coopqp import __version__
from coopqp.base.errors import CoopqpError, InternalError, one_line
from coopqp.cli import scenarios, studies

# Exit codes; docs/files.md has the list.
BAD_INPUT = 2  # the same that click uses for wrong options
OUR_FAULT = 70  # EX_SOFTWARE of sysexits.h
INTERRUPTED, TERMINATED = 130, 143  # 128 and the signal's number, as shells have it
#: Errors of a full output stream; those of files have a name.
FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO)
REPORT = (
    "this is a fault of coopqp, please report it with the command and its files; "
    "'coopqp --debug COMMAND ...' shows where it happened"
)


class _Terminated(KeyboardInterrupt):
    """SIGTERM; like Ctrl-C it is not caught as an error of users' code."""


class Command(click.Command):
    """A command whose errors end in one line each: bad input with exit code 2, our faults 70."""

    def invoke(self, ctx: click.Context) -> Any:
        debug = ctx.params.get("debug", False)
        try:
            with warnings.catch_warnings(), _terminable():
                if not debug:  # of numpy on overflows; results are checked
                    warnings.simplefilter("ignore", RuntimeWarning)
                result = super().invoke(ctx)
                sys.stdout.flush()  # what cannot be written is known now, and not when Python ends
                return result
        except (click.ClickException, click.exceptions.Exit, BrokenPipeError):
            raise
        except SystemExit as error:
            if isinstance(error.__context__, BrokenPipeError):  # rich makes this of it
                raise error.__context__ from None
            code, message = _ending(error)
        except BaseException as error:  # noqa: BLE001 - the last resort; code of users may exit
            code, message = _ending(error)
            if debug and code == OUR_FAULT:
                traceback.print_exception(error.__cause__ or error)
        for line in message.splitlines():
            click.echo(one_line(line), err=True)
        return ctx.exit(code)


class Group(Command, click.Group):
    """Several of them."""


def _ending(error: BaseException) -> tuple[int, str]:
    """The exit code, and what is printed."""
    if isinstance(error, _Terminated):
        return TERMINATED, "terminated"
    if isinstance(error, click.Abort) or _interrupted(error):
        return INTERRUPTED, "interrupted"
    if isinstance(error, CoopqpError) and not isinstance(error, InternalError):
        return BAD_INPUT, "\n".join(f"error: {line}" for line in str(error).splitlines())
    if isinstance(error, OSError) and error.errno in FULL and error.filename is None:
        _drop_output()
        return BAD_INPUT, f"error: cannot write what the command prints: {error.strerror}"
    from coopqp.base.wording import by_user, raised  # brings in numpy, which --help does not need

    if isinstance(error, InternalError):
        words = str(error)
    else:
        words = "out of memory" if isinstance(error, MemoryError) else raised(error)
    line = f"error: {' '.join(words.split())}"
    return (BAD_INPUT, line) if by_user(error) else (OUR_FAULT, f"{line}; {REPORT}")


def _interrupted(error: BaseException | None) -> bool:
    """Whether Ctrl-C began it: a library that is interrupted while it is imported raises others."""
    while error and not isinstance(error, KeyboardInterrupt):
        error = error.__cause__ or error.__context__
    return error is not None


def _drop_output() -> None:
    """Discard what is still in the buffer, or Python reports it at its end."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, sys.stdout.fileno())
    os.close(nowhere)


@contextmanager
def _terminable() -> Iterator[None]:
    """Let SIGTERM end a command as Ctrl-C does, so that its resources are closed."""

    def end(*_: object) -> NoReturn:
        raise _Terminated

    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGTERM, end)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


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
