"""The compiled core without Python: faults put into its ticks, and garbage."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest

CORE = Path(__file__).with_name("core.cpp")
COMPILER = shutil.which("c++") or shutil.which("g++") or shutil.which("clang++")


@pytest.mark.skipif(COMPILER is None, reason="needs a C++ compiler")
def test_the_check_catches_every_fault(tmp_path: Path) -> None:
    """Wrong rows, directions, multipliers, stale factors, forgotten limits, on random robots."""
    assert COMPILER
    program, flags = tmp_path / "core", ["-std=c++17", "-O0", "-ffp-contract=off", "-Wno-psabi"]
    subprocess.run([COMPILER, *flags, "-DCOOPQP_FAULTS", str(CORE), "-o", str(program)], check=True)
    # In the last two a limit that pulled passed once, where it may only push.
    for first, count in (("0", "200"), ("8783", "1"), ("11818", "1")):
        asked = [str(program), first, count]
        done = subprocess.run(asked, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stdout + done.stderr
        assert " 0 missed" in done.stdout
