"""Work for an engine's workers, which import no more for it than this."""

from __future__ import annotations

import os
import signal
from pathlib import Path

from coopqp.base.errors import MissingDependencyError


def square(item: int) -> int:
    """A number of -1 ends the process; other negative ones do the first time."""
    if item == -1 or (isinstance(item, int) and item < 0 and _first(item)):
        os.kill(os.getpid(), signal.SIGKILL)
    return item * item


def _first(item: int) -> bool:
    """Whether no process has had this item before."""
    try:
        Path(os.environ["COOPQP_TEST_MARKS"], str(item)).touch(exist_ok=False)
    except FileExistsError:
        return False
    return True


def refuses(item: int) -> int:
    raise MissingDependencyError("solver 'x'", "extra")
