"""Compiles the kernel while coopqp is installed; without a compiler, pure Python is installed.

The environment may say more: COOPQP_KERNEL=0 leaves the kernel out, COOPQP_KERNEL=1 makes it an
error when it cannot be built, CXX names the compiler, CXXFLAGS adds to its flags.
"""

from __future__ import annotations

import os
import platform
import runpy
import shlex
import shutil
import subprocess
import sys
import sysconfig
import tempfile
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

HERE = Path(__file__).parent
KERNEL = Path("coopqp", "kernel")
#: Contraction is off, so that every variant rounds alike and gives the same bits.
FLAGS = [
    "-std=c++17", "-O3", "-fPIC", "-fvisibility=hidden", "-DNDEBUG",
    "-ffp-contract=off", "-fno-math-errno", "-fno-trapping-math",
]  # fmt: skip
#: From 3.12 on what one Python compiles serves all later ones, but for those without the GIL.
STABLE = sys.version_info >= (3, 12) and not sysconfig.get_config_var("Py_GIL_DISABLED")
if STABLE:
    FLAGS.append("-DPy_LIMITED_API=0x030C0000")
WARNINGS = ["-Wall", "-Wextra", "-Werror", "-Wno-psabi"]
#: Chosen at import, coopqp.kernel.native.
VARIANTS = {"_baseline": []}
if platform.machine().lower() in ("x86_64", "amd64"):
    VARIANTS["_avx2"] = ["-march=x86-64-v3"]


class KernelHook(BuildHookInterface):
    """Adds the compiled module, in one variant a kind of processor."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Compile into the source tree for editable installs, into the wheel otherwise."""
        wanted = os.environ.get("COOPQP_KERNEL", "")
        if self.target_name != "wheel" or wanted == "0":
            return
        into = HERE / KERNEL if version == "editable" else Path(tempfile.mkdtemp())
        try:
            built = compiled(into)
        except (OSError, RuntimeError, ImportError) as error:
            if wanted == "1":
                raise
            self.app.display_warning(f"coopqp is installed without its kernel: {error}")
            return
        build_data["pure_python"] = False
        tag = self.build_config.builder.get_best_matching_tag()
        build_data["tag"] = f"cp312-abi3-{tag.rpartition('-')[2]}" if STABLE else tag
        if version != "editable":
            for path in built:
                build_data["force_include"][str(path)] = str(KERNEL / path.name)


def compiled(into: Path) -> list[Path]:
    """The extension modules, compiled and linked.

    Raises:
        RuntimeError: no compiler, or it fails.
    """
    import nanobind

    compiler = _compiler()
    of_nanobind = Path(nanobind.include_dir()).parent
    include = [
        f"-I{sysconfig.get_path('include')}", f"-I{nanobind.include_dir()}",
        f"-I{of_nanobind / 'ext' / 'robin_map' / 'include'}",
    ]  # fmt: skip
    more = shlex.split(os.environ.get("CXXFLAGS", ""))
    suffix = ".abi3.so" if STABLE else sysconfig.get_config_var("EXT_SUFFIX")
    sources = runpy.run_path(str(HERE / KERNEL / "native.py"))["digest"]()
    built = []
    with tempfile.TemporaryDirectory() as folder:
        library = Path(folder, "nanobind.o")
        _run([*compiler, *FLAGS, "-fno-strict-aliasing", "-DNB_COMPACT_ASSERTIONS", *include, "-c",
              str(of_nanobind / "src" / "nb_combined.cpp"), "-o", str(library)])  # fmt: skip
        for name, flags in VARIANTS.items():
            part, module = Path(folder, f"{name}.o"), into / f"{name}{suffix}"
            named = f"-DKERNEL_MODULE={name}", f'-DKERNEL_SOURCES="{sources}"'
            _run([*compiler, *FLAGS, *WARNINGS, *flags, *named, *include, *more,
                  "-c", str(HERE / KERNEL / "binding.cpp"), "-o", str(part)])  # fmt: skip
            fresh = Path(folder, module.name)
            _run([*compiler, *_link_flags(), str(part), str(library), "-o", str(fresh)])
            os.replace(shutil.copy(fresh, f"{module}.new"), module)  # one in use stays whole
            built.append(module)
    return built


def _compiler() -> list[str]:
    named = os.environ.get("CXX", "")
    if named:
        return shlex.split(named)
    for name in ("c++", "g++", "clang++"):
        if found := shutil.which(name):
            return [found]
    raise RuntimeError("no C++ compiler was found (c++, g++, clang++, or CXX)")


def _link_flags() -> list[str]:
    if sys.platform == "darwin":
        return ["-bundle", "-undefined", "dynamic_lookup"]
    return ["-shared", "-s"]


def _run(command: list[str]) -> None:
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        lines = (done.stderr or done.stdout).strip().splitlines()
        said = next((line for line in lines if "error" in line), *lines[-1:])
        raise RuntimeError(f"{command[0]} failed: {said}")
