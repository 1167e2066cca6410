"""Uses coopqp as it is installed: ``python tests/release/use.py``, with the Python that has it.

It asks for what a checkout has, and must have been installed: the compiled kernel, all that is
shipped, the types. The study is run where the extra ``studies`` is installed.
"""

from __future__ import annotations

import importlib.metadata
import importlib.util
import platform
import subprocess
import sys
import sysconfig
import tempfile
import time
from pathlib import Path

import coopqp
from coopqp.kernel import native

ROOT = Path(__file__).resolve().parents[2]
PACKAGE = Path(coopqp.__file__).parent
COMMAND = Path(sysconfig.get_path("scripts"), "coopqp")
#: What users copy and type, and types, which no import would miss.
SHIPPED = ("tasks/*.py", "scenarios/*.yaml", "studies/*.yaml", "coopqp/py.typed", "coopqp/*.pyi")
SHARE = "1/64"  # of a shipped study: two variants


def main() -> None:
    """Ask for all of it; the first thing that is missing ends this."""
    assert ROOT not in PACKAGE.parents, f"{PACKAGE} is the checkout, not what is installed"
    assert coopqp.__version__ == importlib.metadata.version("coopqp")
    there = [path for pattern in SHIPPED for path in ROOT.glob(pattern)]
    missing = [path for path in there if not installed(path).exists()]
    assert there, f"{ROOT} is no checkout"
    assert not missing, f"not installed: {missing}"
    compiled = sorted(path.name.split(".")[0] for path in PACKAGE.glob("kernel/_*.so"))
    avx2 = platform.machine().lower() in ("x86_64", "amd64")
    assert compiled == ["_avx2", "_baseline"][not avx2 :], f"variants of the kernel: {compiled}"
    assert native.module(), "the kernel is not what its sources say"
    trace = coopqp.run(coopqp.load("point_on_plane"), controller="qp")
    assert trace.engine == "kernel", trace.engine
    print(f"coopqp {coopqp.__version__}: {len(there)} files, {native.module().__name__}")
    with tempfile.TemporaryDirectory() as folder:
        used(Path(folder))


def installed(path: Path) -> Path:
    """Where a file of the checkout is installed."""
    inside = path.relative_to(ROOT)
    return PACKAGE.parent / inside if inside.parts[0] == "coopqp" else PACKAGE / inside


def used(folder: Path) -> None:
    """Type what the first page of the docs says."""
    typed(folder, "--version")
    typed(folder, "list")
    typed(folder, "validate", "point_on_point", "reach_of_nao")
    typed(folder, "compare", "point_on_point", "--out", "out")
    assert (folder / "out" / "report.html").stat().st_size > 100_000
    if importlib.util.find_spec("pyarrow"):
        typed(folder, "sweep", "reach_of_nao", "--out", "study", "--shard", SHARE)


def typed(folder: Path, *words: str) -> None:
    """Run a command of coopqp, far from its sources."""
    begin = time.perf_counter()
    done = subprocess.run(
        [str(COMMAND), *words], cwd=folder, capture_output=True, text=True, check=False
    )
    seconds = time.perf_counter() - begin
    assert done.returncode == 0, f"{' '.join(words)}\n{done.stdout}{done.stderr}"
    print(f"{seconds:6.1f} s  coopqp {' '.join(words)}")


if __name__ == "__main__":
    sys.exit(main())
