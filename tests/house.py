"""The size of the house, and whether it is as CONTRIBUTING.md says: ``python -m tests.house``."""

from __future__ import annotations

import ast
import re
import statistics
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import grimp

ROOT = Path(__file__).resolve().parents[1]

#: What is written one file a name: such files may be short, and have one importer.
COLLECTIONS = ("robots", "grasps", "signals", "tasks", "limits", "solvers", "controllers")
COLLECTIONS += ("plants", "metrics")

#: What one must read to understand and change one tick, in reading order.
CORE = (
    "coopqp/model/*.py",
    "coopqp/task.py",
    "coopqp/program.py",
    "coopqp/limit.py",
    "coopqp/solver.py",
    "coopqp/controller.py",
    "coopqp/qp_law/*.py",
    "tasks/_line_or_plane.py",
    "tasks/point_on_plane.py",
    "coopqp/limits/joint_position.py",
    "coopqp/solvers/daqp.py",
)

#: What the figures may be at most.
GOALS = {"lines of Python": 51_806, "modules at the root": 12, "rooms": 36, "layers": 14}
GOALS |= {"lines of the readable core": 7_000}


@cache
def modules() -> dict[str, Path]:
    """Every module of coopqp and its file; tasks are a link to a folder at the top."""
    found = {}
    for top in ("coopqp", "tasks"):
        for path in sorted((ROOT / top).rglob("*.py")):
            parts = path.relative_to(ROOT).with_suffix("").parts
            if (ROOT / Path(*parts[:2])).is_symlink():
                continue
            parts = ("coopqp", *parts) if top == "tasks" else parts
            found[".".join(part for part in parts if part != "__init__")] = path
    return found


def rooms() -> list[str]:
    """All packages, as paths from coopqp: ``report/figures``."""
    packages = [m for m, path in modules().items() if path.name == "__init__.py" and "." in m]
    return sorted(name.removeprefix("coopqp.").replace(".", "/") for name in packages)


def root_modules() -> list[str]:
    """The modules that lie in no room."""
    flat = [m for m, path in modules().items() if path.parent == ROOT / "coopqp" and "." in m]
    return sorted(name.removeprefix("coopqp.") for name in flat if name.count(".") == 1)


def layers() -> list[set[str]]:
    """Those of the import contract, from the top."""
    text = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    (block,) = re.findall(r"^layers = \[\n(.*?)^\]", text, re.M | re.S)
    return [set(re.split(r" [|:] ", layer)) for layer in re.findall(r'^  "(.+?)"', block, re.M)]


def described() -> list[set[str]]:
    """The layers as CONTRIBUTING's table has them, from the top."""
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    table = text[text.index("| layer |") :]
    rows = table[: table.index("\n\n")].splitlines()[2:]
    return [set(re.findall(r"`(\w+)/?`", row.split("|")[1])) for row in rows]


def private_imports() -> list[str]:
    """Imports of a ``_module`` from outside its own room."""
    graph = grimp.build_graph("coopqp", cache_dir=None)
    return [
        f"{importer} imports {module}"
        for module in sorted(graph.modules)
        if module.rsplit(".", 1)[-1].startswith("_")
        for importer in sorted(graph.find_modules_that_directly_import(module))
        if importer.rpartition(".")[0] != module.rpartition(".")[0]
    ]


def figures() -> Iterator[tuple[str, str]]:
    """What is counted, and how much of it there is."""
    lines = {name: len(path.read_text().splitlines()) for name, path in modules().items()}
    yield "lines of Python", f"{sum(lines.values())}"
    yield "files", f"{len(lines)}"
    yield "modules at the root", f"{len(root_modules())}"
    yield "rooms", f"{len(rooms())}"
    yield "layers", f"{len(layers())}"
    core = {path for pattern in CORE for path in ROOT.glob(pattern)}
    yield "lines of the readable core", f"{sum(len(p.read_text().splitlines()) for p in core)}"
    graph = grimp.build_graph("coopqp", cache_dir=None)
    helpers = [
        name
        for name, path in modules().items()
        if path.name != "__init__.py" and name.split(".")[1] not in COLLECTIONS
    ]
    yield "helpers under 60 lines", f"{sum(lines[name] < 60 for name in helpers)}"
    once = [n for n in helpers if len(graph.find_modules_that_directly_import(n)) == 1]
    yield "helpers with one importer", f"{len(once)}"
    arrows = {
        (a.split(".")[1], b.split(".")[1])
        for a in graph.modules
        for b in graph.find_modules_directly_imported_by(a)
        if "." in a and "." in b and a.split(".")[1] != b.split(".")[1]
    }
    yield "arrows between rooms", f"{len(arrows)}"
    lengths = sorted(_function_lengths())
    p90 = lengths[int(0.9 * len(lengths))]
    yield "lines of a function, median and p90", f"{statistics.median(lengths):g} and {p90}"


def _function_lengths() -> Iterator[int]:
    """Lines of every function's body, without its docstring."""
    for path in modules().values():
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.FunctionDef):
                body = node.body[1:] if ast.get_docstring(node) else node.body
                yield body[-1].end_lineno - body[0].lineno + 1 if body else 0


def main() -> int:
    """Print the figures; 1 if one is above its goal."""
    over = 0
    for name, value in figures():
        goal = GOALS.get(name)
        over += goal is not None and int(value) > goal
        print(f"{name:36} {value:>8}" + (f"   (at most {goal})" if goal else ""))  # noqa: T201
    return int(over > 0)


if __name__ == "__main__":
    sys.exit(main())
