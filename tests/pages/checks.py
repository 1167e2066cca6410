"""What must be so of a block of code, whether it is run or not."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from collections.abc import Iterable, Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

import click
from scenario_files import HAS_ROBOTS

from coopqp import Catalog, cli, load
from coopqp.ros.bridge import RosSettings
from coopqp.scenario.form import check, chosen, file_model
from coopqp.scenario.yaml import parsed
from coopqp.study.sweep.reader import read_study

from .blocks import MARKS, MARKS_OF_TEXT, ROOT, Block, commands

CATALOG = Catalog(plugin_folders=(ROOT / "examples" / "plugins",))
#: Keys that a part of a scenario needs beside it to be one.
REST = {"robot": "nao_t14", "tasks": [{"point_on_point": {"goal": [0.15, 0.0, 0.06]}}]}
#: Robots that are read from files, which pages do not have.
FROM_FILES = ("urdf", "mjcf")
EXTRA = re.compile(r"(?:coopqp|\.)\[([\w,]+)\]")


def check_block(block: Block) -> None:
    """See whether a block is what its language and its marks say.

    Raises:
        AssertionError: it is not.
        Exception: what reading it raises.
    """
    known = MARKS_OF_TEXT if block.language == "text" else MARKS
    assert set(block.marks) <= set(known), f"{block.place}: unknown mark in {block.marks}"
    assert all(block.marks.values()), f"{block.place}: a mark says nothing"
    kind = LANGUAGES.get(block.language)
    assert kind, f"{block.place}: '{block.language}' is none of {', '.join(LANGUAGES)}"
    kind(block)


def _python(block: Block) -> None:
    for code in (block.marks.get("run first", ""), block.code):
        compile(code, block.place, "exec")


def _text(block: Block) -> None:
    told = (line.split() for line in block.code.splitlines())
    bad = [words for words in told if words[:1] == ["coopqp"]]
    assert not bad, f"{block.place}: commands belong into a block of sh"
    for words in commands(block.marks.get("printed by", "")):
        check_command(words, block.place)


def _json(block: Block) -> None:
    json.loads(block.code)


def _toml(block: Block) -> None:
    if sys.version_info >= (3, 11):
        import tomllib

        tomllib.loads(block.code)


def _yaml(block: Block) -> None:
    """A study, parameters of ROS, a scenario or a part of one."""
    file = parsed(Path.cwd() / "studies" / "page.yaml", block.code)
    if "vary" in file.data:
        path = Path.cwd() / f"{block.place.replace('/', '_')}.yaml"
        path.write_text(block.code.replace("../scenarios", "scenarios"), encoding="utf-8")
        read_study(path, CATALOG)
    elif "coopqp" in file.data:
        _parameters(file.data["coopqp"]["ros__parameters"])
    elif {"robot", "start", "tasks", "duration"} <= set(file.data):
        path = Path.cwd() / "page.yaml"
        path.write_text(block.code, encoding="utf-8")
        load(path, CATALOG)
    else:
        _part(file, block)


def _part(file: Any, block: Block) -> None:
    """What stands in a scenario, or in one of its tasks."""
    data = file.data
    if not set(data) <= set(file_model(CATALOG).model_fields):
        data = {"tasks": [{"point_on_point": data}]}
    rest = {} if "phases" in data else {**REST, "duration": 1.0}
    read: Any = check(file.changed({**rest, "robot": REST["robot"], **data}), CATALOG)
    name, robot = chosen(read.robot)
    from_package = name in ("example_robot", "several")
    if "robot" in data and name not in FROM_FILES and (HAS_ROBOTS or not from_package):
        assert robot.build().arms, block.place


def _parameters(given: Mapping[str, Any]) -> None:
    known = {field.name for field in fields(RosSettings)}
    settings = RosSettings(**{key: value for key, value in given.items() if key in known})
    assert set(given) - known <= set(settings.controllers)


def _shell(block: Block) -> None:
    subprocess.run(["bash", "-n", "-c", block.code], check=True)
    for words in commands(block.code):
        check_command(words, block.place)


def check_command(words: list[str], place: str) -> None:
    """See whether a command exists, and takes these words.

    Args:
        words: of the command.
        place: where it stands.
    """
    name, *rest = words
    program = name.removeprefix(".venv/bin/")
    if program == "coopqp":
        _coopqp([word for word in rest if word != "--debug"], place)
    elif program == "make":
        targets = re.findall(r"^([\w-]+):", (ROOT / "Makefile").read_text("utf-8"), re.MULTILINE)
        assert set(_plain(rest)) <= set(targets), f"{place}: make has no {rest}"
    elif program == "pip":
        extras = (ROOT / "pyproject.toml").read_text("utf-8").split("optional-dependencies]")[1]
        for extra in re.split(",", ",".join(EXTRA.findall(" ".join(rest)))):
            assert not extra or f"\n{extra} = [" in extras, f"{place}: no extra {extra}"
    elif program in ("python", "pytest", "sh"):
        _file(rest, place)


def _plain(words: Iterable[str]) -> list[str]:
    return [word for word in words if "=" not in word and not word.startswith("-")]


def _file(words: list[str], place: str) -> None:
    """What Python, pytest or a shell are to run lies in the repository."""
    if words[:1] == ["-m"]:
        path = words[1].replace(".", "/")
        found = any((ROOT / f"{path}{end}").exists() for end in (".py", "/__main__.py"))
        assert found or words[1] in ("venv", "pip", "http"), f"{place}: no module {words[1]}"
    elif words and not words[0].startswith("-"):
        assert (ROOT / words[0]).exists(), f"{place}: no file {words[0]}"


def _coopqp(words: list[str], place: str) -> None:
    """The command line takes these words; files that another command writes need not be there."""
    words = [word for word in words if not re.fullmatch(r"\[.*|.*\]", word)]
    if not words or words[0].startswith(("-", "...")):
        return
    assert words[0] in cli.main.commands, f"{place}: coopqp has no command '{words[0]}'"
    if len(words) == 1:
        return
    try:
        cli.main.commands[words[0]].make_context(words[0], words[1:])
    except click.UsageError as error:
        if not (isinstance(error, click.BadParameter) and "does not exist" in str(error)):
            raise AssertionError(f"{place}: {error.format_message()}") from None


LANGUAGES = {
    "python": _python, "yaml": _yaml, "sh": _shell, "text": _text, "json": _json, "toml": _toml,
}  # fmt: skip
