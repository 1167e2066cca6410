"""The pages of the Python API: every public name, by the module that it lives in."""

from __future__ import annotations

import ast
import importlib
import inspect
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import coopqp
from coopqp_site.signatures import signature
from coopqp_site.writing import plain

OVERVIEW = """# Python API

All that `import coopqp` gives, with its types, for type checkers too (`py.typed`). The classes of
tasks, limits and their like are in `coopqp.tasks`, `coopqp.limits` and so on, with the fields of
their pages here. What is not on this page may change in any version.
"""

STUB = ast.parse(Path(coopqp.__file__).with_suffix(".pyi").read_text(encoding="utf-8"))
#: Module of each public name, as the stub imports it.
HOMES = {
    alias.name: f"coopqp.{node.module}"
    for node in STUB.body
    if isinstance(node, ast.ImportFrom)
    for alias in node.names
}


def pages() -> Iterator[tuple[str, str]]:
    """Name and text of each page: an overview, and one for each module with public names."""
    homes: dict[str, list[str]] = {}
    for name, home in HOMES.items():
        homes.setdefault(home, []).append(name)
    yield "python.md", _overview(homes)
    for home, names in homes.items():
        yield f"python/{_page(home)}", _module(home, names)


def _page(home: str) -> str:
    return home.removeprefix("coopqp.").replace(".", "_") + ".md"


def _overview(homes: dict[str, list[str]]) -> str:
    rows = sorted((name, home) for home, names in homes.items() for name in names)
    told = (
        f"[`{name}`](python/{_page(home)}#{name.lower()}): {_first(name, home)}\n\n"
        f"```python\n{_typed(name, home)}\n```\n"
        for name, home in rows
    )
    toc = "```{toctree}\n:hidden:\n:glob:\n\npython/*\n```\n"
    return "\n".join([OVERVIEW, *told, toc])


def _first(name: str, home: str) -> str:
    """First line of what a name is."""
    value = getattr(coopqp, name)
    if _written_here(value):
        return plain(inspect.getdoc(value)).split("\n", 1)[0]
    return _definition(name, importlib.import_module(home))[1].split("\n", 1)[0] or "Type."


def _typed(name: str, home: str) -> str:
    """How it is called, or which type it is."""
    value = getattr(coopqp, name)
    if _written_here(value):
        return signature(name, value)
    return _definition(name, importlib.import_module(home))[0]


def _written_here(value: object) -> bool:
    """Whether it is a class or function of coopqp's own, not another name for a type."""
    kind = inspect.isclass(value) or inspect.isfunction(value)
    return kind and str(value.__module__).startswith("coopqp")


def _module(home: str, names: list[str]) -> str:
    module = importlib.import_module(home)
    text = f"# {home.removeprefix('coopqp.')}\n\n{plain(module.__doc__)}\n"
    for name in names:
        text += f"\n## {name}\n\n{_told(name, module)}\n"
    return text


def _told(name: str, module: ModuleType) -> str:
    value = getattr(coopqp, name)
    if not _written_here(value):
        return "```python\n{}\n```\n\n{}".format(*_definition(name, module))
    kind = "autoclass" if inspect.isclass(value) else "autofunction"
    members = "\n   :members:" if inspect.isclass(value) else ""
    return f"```{{eval-rst}}\n.. {kind}:: coopqp.{name}{members}\n```"


def _definition(name: str, module: ModuleType) -> tuple[str, str]:
    """Another name for a type, as its module writes it, and what is said of it there."""
    body = ast.parse(inspect.getsource(module)).body
    for node, after in zip(body, [*body[1:], None], strict=True):
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == name:
            words = ""
            if isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant):
                words = inspect.cleandoc(str(after.value.value))
            return ast.unparse(node), plain(words)
    raise LookupError(f"{module.__name__} has no definition of {name}")
