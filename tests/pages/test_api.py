"""All public names are on one page of the site, with a line of what they are and their types."""

from __future__ import annotations

import ast
import inspect
import re

import pytest
from coopqp_site.pages import written
from coopqp_site.writing import ROOT

import coopqp

STUB = ast.parse((ROOT / "coopqp" / "__init__.pyi").read_text(encoding="utf-8"))
IMPORTS = [node for node in STUB.body if isinstance(node, ast.ImportFrom)]
NAMES = [alias.name for node in IMPORTS for alias in node.names]


def test_names_of_the_stub_are_those_of_the_package_and_of_the_page() -> None:
    assert sorted([*NAMES, "__version__"]) == sorted(coopqp.__all__)
    assert re.findall(r"^\[`(\w+)`\]", written()["python.md"], re.MULTILINE) == sorted(NAMES)


@pytest.mark.parametrize("name", NAMES)
def test_a_name_has_a_line_and_its_types(name: str) -> None:
    entry = rf"^\[`{name}`\]\(python/\w+\.md#\w+\): ([^\n]+)\n\n```python\n(.*?)\n```$"
    found = re.search(entry, written()["python.md"], re.MULTILINE | re.DOTALL)
    assert found, f"{name} has no line, or no signature"
    value = getattr(coopqp, name)
    if inspect.isfunction(value):
        asked = inspect.signature(value)
        assert found[2].startswith(f"def {name}(")
        assert all(f"{key}: " in found[2] for key in asked.parameters)
        assert asked.return_annotation is not inspect.Signature.empty
    assert "_empty" not in found[2], "an argument without a type"


def test_the_front_page_has_a_link_to_it() -> None:
    front = (ROOT / "docs" / "index.md").read_text(encoding="utf-8")
    assert "reference/python" in front.splitlines()
    assert "](reference/python.md)" in front
