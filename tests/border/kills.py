"""Kill writers of a report at random moments: ``python -m tests.border.kills --kills 200``.

A writer replaces a report without end, each version with another number in all of its files. After
every kill all files must be there and have one number, that of a version written to the end.
"""

from __future__ import annotations

import argparse
import os
import shutil
import signal
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from random import Random

import click

from coopqp.report.files import publish

NAMES = ("report.html", "metrics.json", "trace.csv", "scenario.yaml")
LONGEST = 0.3  # until a kill [s]
SIZE = 30_000  # characters of a file
#: What Python tells of before it asks the file system for it.
STEPS = ("open", "os.rename", "os.symlink", "os.mkdir", "os.remove", "os.rmdir", "os.chmod")


def contents(version: int) -> dict[str, str]:
    """A report all of whose files have the number of its version at both ends."""
    return dict.fromkeys(NAMES, f"{version}\n{'x' * SIZE}\n{version}")


def version_of(folder: Path) -> int:
    """The number that all files have.

    Raises:
        AssertionError: a file is missing, is not whole or has another number than the others.
    """
    found = set()
    for name in NAMES:
        first, body, last = (folder / name).read_text(encoding="utf-8").split("\n")
        assert len(body) == SIZE, f"{name} is not whole"
        found |= {first, last}
    assert len(found) == 1, f"a mixed report: versions {sorted(found)}"
    return int(found.pop())


def kill_one(folder: Path, after: float) -> int:
    """Begin a writer, kill it and return the version that is there."""
    before = version_of(folder)
    pid = os.fork()
    if not pid:
        version = before
        while True:
            version += 1
            publish(contents(version), folder)
    time.sleep(after)
    os.kill(pid, signal.SIGKILL)
    os.waitpid(pid, 0)
    return version_of(folder)


def kill_at(folder: Path, step: int) -> bool:
    """Write a report and be killed before a step on the file system; whether it came to that."""
    before = version_of(folder)
    pid = os.fork()
    if not pid:
        counted = 0

        def count(event: str, _: object) -> None:
            nonlocal counted
            if event in STEPS:
                if counted == step:
                    os.kill(os.getpid(), signal.SIGKILL)
                counted += 1

        sys.addaudithook(count)
        publish(contents(before + 1), folder)
        os._exit(0)
    killed = os.waitpid(pid, 0)[1] != 0
    assert version_of(folder) in (before, before + 1)
    return killed


def old_report(folder: Path) -> None:
    """A report of plain files, as earlier versions of coopqp wrote it."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    for name, content in contents(0).items():
        (folder / name).write_text(content, encoding="utf-8")


def main(words: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.border.kills", description=__doc__)
    parser.add_argument("--kills", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    asked = parser.parse_args(words)
    rng, versions, steps = Random(asked.seed), 0, 0
    with tempfile.TemporaryDirectory() as outer:
        folder = Path(outer) / "report"
        for k in range(asked.kills):
            if k % 2 == 0:
                old_report(folder)
            versions += kill_one(folder, rng.uniform(0.0, LONGEST)) > 0
        for plain in (True, False):
            step = -1
            old_report(folder)
            while step < 0 or kill_at(folder, step):
                step, steps = step + 1, steps + 1
                if plain:
                    old_report(folder)
        publish(contents(1), folder)
        left = [path.name for path in folder.iterdir() if path.name.startswith(".report-")]
        assert len(left) == 1, f"left behind: {left}"
    told = f"{asked.kills} kills, {versions} with a new report; {steps} at each step"
    click.echo(f"{told}: none broken")
    return 0


if __name__ == "__main__":
    sys.exit(main())
