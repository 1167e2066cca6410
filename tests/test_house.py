"""The rooms, the root and the layers are those of CONTRIBUTING.md: a new one is a decision."""

from __future__ import annotations

import ast
import importlib
from importlib.util import find_spec

import house


def test_root_and_layers_are_those_of_the_table() -> None:
    assert house.layers() == house.described()


def test_every_room_is_in_the_table() -> None:
    text = (house.ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    assert [room for room in house.rooms() if f"`{room}/`" not in text] == []


def test_root_has_nothing_beside_the_layers() -> None:
    top = {room for room in house.rooms() if "/" not in room}
    assert set().union(*house.layers()) == top | set(house.root_modules())


def test_helpers_of_a_collection_are_its_own() -> None:
    assert house.private_imports() == []


def test_house_is_no_larger_than_it_may_be() -> None:
    figures = dict(house.figures())
    over = {name: figures[name] for name, goal in house.GOALS.items() if int(figures[name]) > goal}
    assert over == {}


def test_benchmarks_and_examples_import_what_is_there() -> None:
    """Types are checked in the package and its tests alone."""
    for top in ("benchmarks", "examples"):
        for path in sorted((house.ROOT / top).rglob("*.py")):
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
                if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("coopqp"):
                    module = importlib.import_module(str(node.module))
                    for name in (alias.name for alias in node.names):
                        there = hasattr(module, name) or find_spec(f"{node.module}.{name}")
                        assert there, f"{path.name} imports {name} from {node.module}"
