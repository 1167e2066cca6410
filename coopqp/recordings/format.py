"""What a format of recorded runs is, and what it is given to write."""

from __future__ import annotations

import os
import secrets
import shutil
from abc import ABC, abstractmethod
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import ClassVar

from coopqp.base.errors import CoopqpError, MissingDependencyError
from coopqp.recordings.run import Run
from coopqp.scenario.catalog import Catalog
from coopqp.scenario.scenario import Scenario

#: What ``pip install 'coopqp[...]'`` brings the packages.
EXTRA = "recordings"


class Format(ABC):
    """A format that can be read."""

    @abstractmethod
    def holds(self, path: Path) -> bool:
        """Whether a path is of this format, by its name."""

    @abstractmethod
    def read(self, path: Path) -> Run:
        """All rows of a file.

        Raises:
            CoopqpError: no such file, or a damaged one.
            MissingDependencyError: the package that reads it is not installed.
        """

    @abstractmethod
    def scenario(self, path: Path, catalog: Catalog) -> Scenario:
        """The scenario that was run.

        Raises:
            CoopqpError: as :meth:`read`; the scenario cannot be loaded.
        """

    def cut_short(self, path: Path) -> bool:
        """Whether its writer was killed, so that the end is missing."""
        return False


class ExportFormat(Format):
    """A format that can be written too."""

    name: ClassVar[str]
    """As ``--to`` has it."""

    suffix: ClassVar[str]
    """Of its files' names."""

    def holds(self, path: Path) -> bool:
        return path.suffix == self.suffix

    @abstractmethod
    def write(self, run: Run, scenario: Scenario, path: Path) -> None:
        """Write a new file.

        Args:
            run: of one controller.
            scenario: as the controller holds it, :meth:`Scenario.held_by`.
            path: of the file.

        Raises:
            CoopqpError: a row is damaged.
            MissingDependencyError: the package that writes it is not installed.
            OSError: the file cannot be written.
        """

    def replace(self, run: Run, scenario: Scenario, path: Path) -> None:
        """Write a file, as :meth:`write`; one that is there stays until the new one is whole.

        Raises:
            CoopqpError: it cannot be written, with the reason.
        """
        if path.is_dir() and not self.holds(path):
            raise CoopqpError(f"'{path}' is a folder, and none of this format; choose another name")
        aside = path.with_name(f".{path.name}-{secrets.token_hex(8)}")
        try:
            aside.mkdir(parents=True)
            self.write(run, scenario, aside / path.name)  # files in it are named after it
            if path.is_dir():
                shutil.rmtree(path)
            os.replace(aside / path.name, path)
        except OSError as error:
            raise CoopqpError(f"cannot write '{path}': {error.strerror or error}") from error
        finally:
            shutil.rmtree(aside, ignore_errors=True)


@contextmanager
def needs(what: str) -> Iterator[None]:
    """Name the extra where a package is missing."""
    try:
        yield
    except ImportError:
        raise MissingDependencyError(what, EXTRA) from None


@contextmanager
def readable(path: Path) -> Iterator[None]:
    """One line for whatever a library raises over a file that is damaged."""
    try:
        yield
    except CoopqpError:
        raise
    except Exception as error:  # noqa: BLE001 - each library has its own, and names them anew
        words = " ".join(str(error).split()) or type(error).__name__
        raise CoopqpError(f"{path}: cannot be read: {words[:200]}; the file is damaged") from None
