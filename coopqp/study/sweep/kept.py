"""A study from its folder alone, without its files."""

from __future__ import annotations

import io
from pathlib import Path
from shlex import quote
from typing import Any

from ruamel.yaml import YAML

from coopqp.errors import CoopqpError, ScenarioError
from coopqp.scenario.catalog import Catalog
from coopqp.scenario.loader import has_files
from coopqp.scenario.yaml import parsed
from coopqp.study.sweep.identity import plugins_hash
from coopqp.study.sweep.journal import head_of, journals
from coopqp.study.sweep.reader import study_text
from coopqp.study.sweep.study import CONTROLLERS, Study


def kept_study(folder: Path, catalog: Catalog | None = None) -> Study:
    """The study whose results a folder holds.

    No plug-ins are looked for where it was run: who opens a folder runs none of its code.

    Args:
        folder: of the study.
        catalog: what its scenario can name, for who runs it; shipped and installed plug-ins when
            omitted.

    Raises:
        CoopqpError: it holds none; its points cannot be drawn again.
    """
    head = _head(folder)
    path, text = head["scenario"]
    own, words = head["study"]
    study = study_text(Path(own), words, (Path(path), text), catalog or Catalog())
    if head["identity"]["points"] != study.points.digest:
        words = "other points are drawn here than where it was run, by another scipy or numpy"
        raise CoopqpError(f"'{folder}': {words}; use that one's")
    return study


def check_plugins(folder: Path, study: Study) -> list[str]:
    """Refuse to run a row without the plug-ins that the study was run with.

    Args:
        folder: of the study.
        study: as it was opened, with its catalogue.

    Returns:
        What is odd.

    Raises:
        CoopqpError: it was run with plug-ins of the user's own, and none are given.
    """
    head = _head(folder)
    named = [
        f"{option} {quote(path)}"
        for option, paths in zip(("--tasks", "--plugins"), head["folders"], strict=True)
        for path in paths
    ]
    if named and not any(study.catalog.folders):
        words = "was run with plug-ins, and opening a folder never runs code by itself"
        raise CoopqpError(f"'{folder}' {words}; if you trust them, add {' '.join(named)}")
    if head["identity"]["plugins"] != plugins_hash(study):
        return ["the plug-ins are not those that the study was run with"]
    return []


def _head(folder: Path) -> dict[str, Any]:
    if folder.is_file():
        raise CoopqpError(f"'{folder}' is a file; --table and --show need the folder of a study")
    if not folder.is_dir():
        raise CoopqpError(f"'{folder}' is neither a study file nor the folder of a study")
    found = journals(folder)
    if not found:
        raise CoopqpError(
            f"'{folder}' holds no study: needs a journal, as 'coopqp sweep' writes it"
        )
    return head_of(found[0]) or {}


def scenario_of_row(study: Study, row: int) -> tuple[str, str]:
    """A scenario file for one row, and the name of its controller.

    Args:
        study: of the row.
        row: its number, as in the results.

    Raises:
        CoopqpError: there is no such row.
    """
    if not 0 <= row < study.rows:
        raise CoopqpError(f"--show: found {row}; the study has rows 0 to {study.rows - 1}")
    number, k = divmod(row, len(study.controllers))
    variant = study.variant(number)
    data: dict[str, Any] = study.changed(variant)
    controllers = data.get(CONTROLLERS)
    if controllers:
        data = {**data, CONTROLLERS: [controllers[k]]}
    if has_files(data):
        own = data.get("folder")
        base = study.scenario_text[0].parent
        data = {**data, "folder": str(base / own if isinstance(own, str) else base)}
    columns = zip(study.columns, study.parts(variant), strict=True)
    values = ", ".join(f"{name} {value}" for name, value in columns)
    head = f"# Row {row} of the study {study.name}, variant {number}: {values}\n"
    return head + _yaml(study, data), study.controllers[k]


def _yaml(study: Study, data: dict[str, Any]) -> str:
    """As YAML for people; as JSON where that would not be read back as it was."""
    stream = io.StringIO()
    writer = YAML(typ="safe", pure=True)
    writer.default_flow_style, writer.sort_base_mapping_type_on_output = None, False  # type: ignore[assignment]
    writer.dump(data, stream)
    text = stream.getvalue()
    try:
        if parsed(study.scenario.path, text).data == data:
            return text
    except ScenarioError:
        pass
    return study.scenario.changed(data).text
