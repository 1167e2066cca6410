"""How a command ends: its exit code, and one line for everything that goes wrong."""

from __future__ import annotations

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

from coopqp.base.errors import CoopqpError, InternalError, one_line

# Exit codes; docs/files.md has the list.
BAD_INPUT = 2  # the same that click uses for wrong options
OUR_FAULT = 70  # EX_SOFTWARE of sysexits.h
INTERRUPTED, TERMINATED = 130, 143  # 128 and the signal's number, as shells have it
#: What a stream says that takes no more; files of ours are said by name.
FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO)
REPORT = (
    "this is a fault of coopqp, please report it with the command and its files; "
    "'coopqp --debug COMMAND ...' shows where it happened"
)


class _Terminated(KeyboardInterrupt):
    """SIGTERM; it goes the way of Ctrl-C, past all that catches what users' code raises."""


class Command(click.Command):
    """A command whose bad input ends in one clear message per fault, and exit code 2.

    What nobody foresaw ends in one line too, with how to report it, and exit code 70.
    """

    def invoke(self, ctx: click.Context) -> Any:
        debug = ctx.params.get("debug", False)
        try:
            with warnings.catch_warnings(), _terminable():
                if not debug:  # numpy's on what overflows; what comes of it is checked and said
                    warnings.simplefilter("ignore", RuntimeWarning)
                found = super().invoke(ctx)
                sys.stdout.flush()  # what cannot be written is known now, and not when Python ends
                return found
        except (click.ClickException, click.exceptions.Exit, BrokenPipeError):
            raise
        except BaseException as error:  # noqa: BLE001 - the last resort; code of users may exit
            code, told = _ending(error)
            if debug and code == OUR_FAULT:
                traceback.print_exception(error.__cause__ or error)
        for line in told.splitlines():
            click.echo(one_line(line), err=True)
        return ctx.exit(code)


class Group(Command, click.Group):
    """Several of them."""


def _ending(error: BaseException) -> tuple[int, str]:
    """The exit code, and what is said."""
    if isinstance(error, _Terminated):
        return TERMINATED, "terminated"
    if isinstance(error, KeyboardInterrupt | click.Abort):
        return INTERRUPTED, "interrupted"
    if isinstance(error, CoopqpError) and not isinstance(error, InternalError):
        return BAD_INPUT, "\n".join(f"error: {line}" for line in str(error).splitlines())
    if isinstance(error, OSError) and error.errno in FULL and error.filename is None:
        _drop_output()
        return BAD_INPUT, f"error: cannot write what the command prints: {error.strerror}"
    told = str(error) if isinstance(error, InternalError) else _said(error)
    line = f"error: {' '.join(told.split())}"
    return (BAD_INPUT, line) if _by_user(error) else (OUR_FAULT, f"{line}; {REPORT}")


def _drop_output() -> None:
    """Send what is still in the buffer nowhere, or Python says so in its own words at its end."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, sys.stdout.fileno())
    os.close(nowhere)


@contextmanager
def _terminable() -> Iterator[None]:
    """Let SIGTERM end a command as Ctrl-C does, with what it holds open put away."""

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


def _by_user(error: BaseException) -> bool:
    from coopqp.base.wording import by_user  # brings in numpy, for which --help does not wait

    return by_user(error)


def _said(error: BaseException) -> str:
    """``FILE:LINE: raises ZeroDivisionError: division by zero``."""
    if isinstance(error, MemoryError):
        return "out of memory"
    from coopqp.base.wording import raised

    return raised(error)
