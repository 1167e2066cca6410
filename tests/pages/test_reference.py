"""The site's reference: whatever can be named is in it, with all its keys; its links hold."""

from __future__ import annotations

import dataclasses
import re

import click
import pytest
from coopqp_site import outside
from coopqp_site.api import HOMES
from coopqp_site.pages import written
from coopqp_site.writing import ROOT

from coopqp import Catalog, Status, cli
from coopqp.scenario.catalog import COLLECTIONS
from coopqp.scenario.form import file_model
from coopqp.scenario.loader import shipped


def section(page: str, title: str) -> str:
    """What stands below a heading."""
    found = re.search(rf"^## {title}$(.*?)(?=^## |\Z)", written()[page], re.MULTILINE | re.DOTALL)
    assert found, f"{page} has nothing on {title}"
    return found[1]


@pytest.mark.parametrize("kind", COLLECTIONS)
def test_every_file_of_a_collection_is_told_of_with_every_key(kind: str) -> None:
    folder = ROOT / ("tasks" if kind == "tasks" else f"coopqp/{kind}")
    files = {path.stem for path in folder.glob("[!_]*.py")}
    entries = Catalog().entries(kind)
    assert files == set(entries)
    head = written()[f"{kind}.md"].split("\n## ")[0]
    for name in files:
        told = section(f"{kind}.md", name)
        assert entries[name].help in told
        keys = {field.name for field in dataclasses.fields(entries[name].cls)}
        missing = {key for key in keys if f"`{key}`" not in told + head}
        assert not missing, f"{name}: {missing}"


def test_the_meaning_of_every_key_is_told() -> None:
    pages = [f"{kind}.md" for kind in COLLECTIONS] + ["scenario_keys.md", "values.md"]
    for page in pages:
        rows = re.findall(r"^\| \**`(\w+)`\** \|.*\| (.*) \|$", written()[page], re.MULTILINE)
        assert not [key for key, meaning in rows if not meaning.strip()], page


def test_all_else_that_can_be_named_is_there() -> None:
    assert all(
        f"`{status.name}` | {status.value} |" in written()["statuses.md"] for status in Status
    )
    for key in file_model(Catalog()).model_fields:
        assert f"`{key}`" in written()["scenario_keys.md"]
    for name in shipped():
        assert f"[{name}]" in written()["scenarios.md"]
    for name, command in cli.main.commands.items():
        if command.hidden:
            continue
        told = section("command_line.md", name)
        options = (option for option in command.params if isinstance(option, click.Option))
        assert all(option.opts[0] in told for option in options)
    for name in HOMES:
        assert f"[`{name}`](python/" in written()["python.md"]


def test_every_link_between_pages_of_the_reference_leads_to_a_heading() -> None:
    for name, text in written().items():
        for target, anchor in re.findall(r"\]\((\w[\w/]*\.md)#(\w+)\)", text):
            headings = re.findall(r"^#+ (.*)$", written()[target], re.MULTILINE)
            assert anchor in {heading.lower() for heading in headings}, (name, target, anchor)


def test_links_out_of_docs_go_to_pages_that_show_the_file() -> None:
    text = "[a](../scenarios/yeo_4_5.yaml) [b](signals.md#inputs) [c](../README.md) ![d](play.png)"
    moved = outside.relinked(text, "docs/x.md", "x")
    assert "[a](source/scenarios/yeo_4_5.yaml.md)" in moved
    assert "[b](signals.md#inputs) [c](source/README.md) ![d](play.png)" in moved
    kept = "```yaml\n[a](../scenarios/yeo_4_5.yaml)\n```\n[no](../scenarios/none.yaml)"
    assert outside.relinked(kept, "docs/x.md", "x") == kept
