"""What the installation needs before anything is installed."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import coopqp

NATIVE = Path(coopqp.__file__).parent / "kernel" / "native.py"


def test_the_digest_of_the_kernel_needs_nothing_but_python() -> None:
    """Where the installation cannot compute it, coopqp is installed without its kernel."""
    subprocess.run([sys.executable, "-I", "-S", str(NATIVE)], check=True)
