"""Plug-ins of the user's own: examples and pages, packages, and one clear line for each mistake."""

from __future__ import annotations

import json
import multiprocessing
import re
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from command_line import typed

from coopqp import Catalog, CoopqpError, cli, compare, load
from coopqp.scenario.catalog import COLLECTIONS, Entry
from coopqp.scenario.loader import with_solver

ROOT = Path(__file__).parents[2]
EXAMPLES = ROOT / "examples" / "plugins"
FILES = sorted(EXAMPLES.glob("*/[!_]*.py"))
EXAMPLE = {file.parent.name: file for file in FILES}


def write(folder: Path, name: str, text: str) -> Path:
    """A file in a folder that is made if needed."""
    path = folder / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")
    return path


def refused(*words: str | Path) -> list[str]:
    """The lines with which a command refuses."""
    result = typed(*words)
    assert result.exit_code == 2
    assert "Traceback" not in result.output
    return result.stderr.splitlines()


def short(folder: Path) -> Path:
    """The scenario of the examples, a tenth of a second long."""
    text = (EXAMPLES / "own.yaml").read_text(encoding="utf-8")
    text = re.sub(r"duration: (3.0|1.5)", "duration: 0.1", text)
    return write(folder, "own.yaml", text)


# What comes with coopqp.


def test_there_is_an_example_and_a_page_for_every_collection() -> None:
    assert {file.parent.name for file in FILES} == set(COLLECTIONS)
    pages = {page.stem + "s" for page in (ROOT / "docs" / "plugins").glob("*.md")}
    assert pages == set(COLLECTIONS)
    assert (*COLLECTIONS, "scenarios", "studies") == cli.scenarios.COLLECTIONS


@pytest.mark.parametrize("kind", COLLECTIONS)
def test_the_code_on_a_page_is_the_example(kind: str) -> None:
    page = ROOT / "docs" / "plugins" / f"{kind.removesuffix('s')}.md"
    blocks = re.findall(r"^```python\n(.*?)^```", page.read_text(encoding="utf-8"), re.M | re.S)
    assert blocks[0] == EXAMPLE[kind].read_text(encoding="utf-8")


def test_a_scenario_of_plug_ins_alone_runs_and_its_metric_is_measured(tmp_path: Path) -> None:
    out = tmp_path / "out"
    scenario = EXAMPLES / "own.yaml"
    result = typed("compare", scenario, "--plugins", EXAMPLES, "--out", out)
    assert result.exit_code == 0
    measured = json.loads((out / "metrics.json").read_text(encoding="utf-8"))["controllers"]
    assert set(measured) == {"qp", "jacobian_transpose"}
    for metrics in measured.values():
        assert metrics["reached"]
        assert metrics["failed_ticks"] == 0
        # The box has to rise by 5 cm and to go 4 cm aside and 5 cm to the left.
        assert 0.08 < metrics["path_length"] < 0.2


def test_a_written_run_is_explained_and_replayed_with_the_same_plug_ins(tmp_path: Path) -> None:
    out, saved, own = tmp_path / "out", tmp_path / "tick.json", ("--plugins", EXAMPLES)
    assert typed("compare", short(tmp_path), *own, "--out", out).exit_code == 0
    explained = typed("explain", out, *own, "--tick", "0", "--save", saved)
    assert explained.exit_code == 0
    assert "slow start of " in explained.output
    answers = json.loads(typed("replay", saved, *own, "--json").stdout)
    assert answers["active_set"]["difference"] < 1e-9
    assert answers["daqp"]["difference"] < 1e-6


def test_explaining_without_the_plug_ins_says_which_name_is_unknown_and_what_to_give(
    tmp_path: Path,
) -> None:
    out = tmp_path / "out"
    assert typed("compare", short(tmp_path), "--plugins", EXAMPLES, "--out", out).exit_code == 0
    lines = refused("explain", out)
    assert len(lines) == 9 - 1  # a metric is not named in a scenario
    assert any("unknown task 'hold_height'" in line for line in lines)
    assert all("--plugins FOLDER" in line for line in lines)


def test_the_active_set_of_the_examples_agrees_with_daqp() -> None:
    scenario = load("point_on_point", Catalog(plugin_folders=(EXAMPLES,)))
    runs = [with_solver(scenario, name) for name in ("daqp", "active_set")]
    exact, other = (compare(run, controllers=["qp"]).traces["qp"] for run in runs)
    assert np.abs(exact.q - other.q).max() < 1e-5


@pytest.mark.parametrize(
    "words",
    [
        ("run", "SHORT", "--controller", "jacobian_transpose"),
        ("mobility", "SHORT"),
        ("validate", "SHORT"),
        ("list", "tasks"),
        ("schema",),
    ],
)
def test_every_command_that_reads_scenarios_takes_plug_ins(
    tmp_path: Path, words: tuple[str, ...]
) -> None:
    file = short(tmp_path)
    command = [file if word == "SHORT" else word for word in words]
    result = typed(*command, "--plugins", EXAMPLES)
    assert result.exit_code == 0
    if len(words) == 1 or words[0] == "list":
        assert "hold_height" in result.output


def test_a_folder_of_tasks_alone_is_read_by_the_same_means(tmp_path: Path) -> None:
    text = EXAMPLE["tasks"].read_text(encoding="utf-8")
    write(tmp_path, "keep_up.py", "from ._help import *\n" + text.split("annotations\n")[1])
    write(tmp_path, "_help.py", "GRAVITY = 9.81\n")
    tasks = Catalog((tmp_path,)).entries("tasks")
    assert tasks["keep_up"].cls.__name__ == "HoldHeight"
    assert set(tasks) - set(Catalog().entries("tasks")) == {"keep_up"}


# Helpers, packages and other processes.

HELPED = """
from coopqp import Metric, spec
from ._words import WORDS

@spec
class Says(Metric):
    '''Says something.'''

    def measure(self, trace):
        return WORDS
"""


def test_files_of_a_subfolder_share_helpers_and_two_folders_do_not_mix(tmp_path: Path) -> None:
    for name in ("one", "two"):
        write(tmp_path / name, "metrics/_words.py", f"WORDS = 'from {name}'\n")
        write(tmp_path / name, f"metrics/says_{name}.py", HELPED)
    metrics = Catalog((), (tmp_path / "one", tmp_path / "two")).entries("metrics")
    said = [metrics[f"says_{name}"].cls().measure(None) for name in ("one", "two")]
    assert said == ["from one", "from two"]


def type_name(plugin: object) -> str:
    return type(plugin).__name__


def test_a_plug_in_travels_to_a_process_that_has_never_heard_of_its_folder() -> None:
    tasks = Catalog(plugin_folders=(EXAMPLES,)).entries("tasks")
    task = tasks["hold_height"].cls(height=0.1)
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        assert pool.map(type_name, [task]) == ["HoldHeight"]


def package(folder: Path, plugin: str, value: str = "my_lab.own") -> None:
    """An installed package with a metric, as pip would leave it."""
    write(folder, "my_lab/own/metrics/says.py", plugin)
    write(folder, "my_lab/own/metrics/_words.py", "WORDS = 'from a package'\n")
    write(folder, "my_lab-1.0.dist-info/METADATA", "Metadata-Version: 2.1\nName: my-lab\n")
    points = f"[coopqp.plugins]\nmy_lab = {value}\n"
    write(folder, "my_lab-1.0.dist-info/entry_points.txt", points)


@pytest.fixture
def site(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A folder from which Python imports."""
    monkeypatch.syspath_prepend(tmp_path)
    yield tmp_path
    for name in [name for name in sys.modules if name.split(".")[0] == "my_lab"]:
        del sys.modules[name]


def test_an_installed_package_needs_no_flag(site: Path) -> None:
    package(site, HELPED)
    entry = Catalog().entries("metrics")["says"]
    assert (entry.name, entry.help) == ("says", "Says something.")
    assert entry.cls().measure(None) == "from a package"
    assert "says" in typed("list", "metrics").output


@pytest.mark.parametrize(
    ("plugin", "value", "message"),
    [
        (HELPED, "my_lab.nothing", "my_lab = my_lab.nothing of coopqp.plugins: cannot be imported"),
        (HELPED, "my_lab.own.metrics.says", "needs a package with the collections' names"),
        ("x = 1", "my_lab.own", "needs exactly one Metric class, found 0"),
    ],
)
def test_a_broken_package_is_named(site: Path, plugin: str, value: str, message: str) -> None:
    package(site, plugin, value)
    (line,) = refused("list", "metrics")
    assert message in line


# Mistakes, one clear line each.


def line_of(kind: str, name: str, text: str, folder: Path) -> str:
    """What is said of a file in a folder of plug-ins, without the folder."""
    write(folder, f"{kind}/{name}.py", text)
    (line,) = refused("list", "--plugins", folder)
    return line.removeprefix("error: ").replace(f"{folder}/", "")


HALF_WRITTEN = {
    "robots": ("Robot", "'build'"),
    "grasps": ("Grasp", "'passive_joints'"),
    "tasks": ("Task", "'rows'"),
    "signals": ("Signal", "'bind'"),
    "limits": ("Limit", "'bind'"),
    "controllers": ("Controller", "'build'"),
    "solvers": ("Solver", "'open'"),
    "plants": ("Plant", "'build'"),
    "metrics": ("Metric", "'measure'"),
}


@pytest.mark.parametrize("kind", COLLECTIONS)
def test_a_half_written_plug_in_says_what_it_needs(kind: str, tmp_path: Path) -> None:
    idea, missing = HALF_WRITTEN[kind]
    text = f"from coopqp import {idea}, spec\n\n@spec\nclass Mine({idea}):\n    '''Mine.'''\n"
    said = line_of(kind, "mine", text, tmp_path)
    assert said == f"{kind}/mine.py:3: Mine is half-written; it needs {missing}"


def test_a_task_with_rows_alone_says_what_it_needs(tmp_path: Path) -> None:
    text = "from coopqp import Task, spec\n\n@spec\nclass Mine(Task):\n    '''Mine.'''\n"
    text += "\n    def rows(self, chain):\n        return ('x',)\n"
    write(tmp_path, "tasks/mine.py", text)
    shipped = (ROOT / "scenarios" / "point_on_plane.yaml").read_text(encoding="utf-8")
    tasks = re.sub(r"(?ms)^tasks:.*?^(?=\w)", "tasks: [mine]\n", shipped)
    file = write(tmp_path, "own.yaml", tasks)
    (said,) = refused("validate", "--plugins", tmp_path, file)
    assert said.endswith("tasks[0]: mine: needs a method bind, geometry or program")


@pytest.mark.parametrize(
    ("kind", "part"), [("controllers", "JacobianTransposeLaw"), ("plants", "LaggingModel")]
)
def test_a_half_written_law_or_model_says_what_it_needs(
    kind: str, part: str, tmp_path: Path
) -> None:
    text = EXAMPLE[kind].read_text(encoding="utf-8")
    text = re.sub(r"def (decide|step)\b", r"def _\1", text)
    said = line_of(kind, "mine", text, tmp_path)
    assert re.match(rf"{kind}/mine.py:\d+: {part} is half-written; it needs '", said)


TASK = """from coopqp import Task, spec
from coopqp.tasks import PointOnPoint

@spec
class Mine(Task):
    '''Mine.'''

    def rows(self, chain):
        return ("z",)

    def bind(self, start):
        return lambda state, rows: None
"""


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("mine", "x = 1", "tasks/mine.py: needs exactly one Task class, found 0; write"),
        ("mine", TASK + TASK.replace("Mine", "Other"), "tasks/mine.py:16: needs exactly one Task"),
        (
            "mine",
            "from coopqp import Limit, spec\n@spec\nclass Mine(Limit):\n    '''Mine.'''\n",
            "tasks/mine.py:2: needs exactly one Task class, found 0; Mine is a Limit; move the "
            "file into limits",
        ),
        ("point_on_point", TASK, "tasks/point_on_point.py: a task 'point_on_point' exists already"),
        ("mine", TASK.replace("@spec", ""), "tasks/mine.py:5: Mine needs '@spec' above it"),
        (
            "mine",
            "from dataclasses import dataclass\n"
            + TASK.replace("@spec", "@dataclass(frozen=True, kw_only=True)"),
            "tasks/mine.py:5: Mine needs '@spec' above it",
        ),
        (
            "mine",
            TASK.replace("Mine(Task)", "Mine(PointOnPoint)"),
            "tasks/mine.py:4: Mine inherits from PointOnPoint; a plug-in inherits from Task and "
            "from nothing else",
        ),
        ("hold-height", TASK, "tasks/hold-height.py: 'hold-height' is not a name in Python"),
        ("class", TASK, "tasks/class.py: 'class' is not a name in Python"),
        ("json", TASK, "tasks/json.py: 'json' is a name that pydantic"),
        ("mine", "x = 1\nimport nothing", "tasks/mine.py:2: cannot be imported: ModuleNotFound"),
        ("mine", "x = 1\n\nx = = 2\n", "tasks/mine.py:3: cannot be imported: SyntaxError: inval"),
        ("mine", "x = 1\nx / 0", "tasks/mine.py:2: cannot be imported: ZeroDivisionError: div"),
        ("mine", "exit('no\\nway')", "tasks/mine.py:1: cannot be imported: SystemExit: no way"),
        (
            "mine",
            TASK.replace("'''Mine.'''", "goal: memoryview\n"),
            "tasks/mine.py:4: cannot be imported: PydanticSchemaGenerationError: Unable to",
        ),
        (
            "mine",
            "from __future__ import annotations\n" + TASK.replace("'''Mine.'''", "goal: flot\n"),
            "tasks/mine.py:5: Mine has a field whose type is not known: name 'flot' is not defined",
        ),
    ],
)
def test_a_file_that_is_no_plug_in_is_answered_in_one_line(
    name: str, text: str, said: str, tmp_path: Path
) -> None:
    assert line_of("tasks", name, text, tmp_path).startswith(said)


def test_a_metric_that_would_need_keys_is_refused(tmp_path: Path) -> None:
    text = EXAMPLE["metrics"].read_text(encoding="utf-8")
    text = text.replace('= "m"', '= "m"\n    share: float')
    said = line_of("metrics", "mine", text, tmp_path)
    assert said.endswith("'share' needs a default, because scenarios have no keys for metrics")


def test_a_metric_called_as_a_column_of_every_study_is_refused(tmp_path: Path) -> None:
    text = EXAMPLE["metrics"].read_text(encoding="utf-8")
    said = line_of("metrics", "success", text, tmp_path)
    assert said.endswith("every study has a column 'success' of its own; rename the file")


@pytest.mark.parametrize(
    ("folder", "said"),
    [
        ("taks", "/taks: unknown collection 'taks'; did you mean 'tasks'?"),
        ("tasks", "/tasks: no task files (*.py) here"),
        (".git", ": no plug-ins here; needs a folder with the name of a collection: robots, "),
    ],
)
def test_a_folder_that_holds_no_plug_ins_is_answered_in_one_line(
    folder: str, said: str, tmp_path: Path
) -> None:
    (tmp_path / folder).mkdir()
    (line,) = refused("list", "--plugins", tmp_path)
    assert line.startswith(f"error: {tmp_path}{said}")


def test_all_mistakes_are_told_at_once_and_a_mended_file_is_read(tmp_path: Path) -> None:
    first = write(tmp_path, "tasks/first.py", "x = 1\n")
    write(tmp_path, "limits/second.py", "import nothing\n")
    with pytest.raises(CoopqpError) as caught:
        Catalog((), (tmp_path,))
    assert len(str(caught.value).splitlines()) == 2
    first.write_text(TASK, encoding="utf-8")
    assert len(refused("list", "--plugins", tmp_path)) == 1


def test_a_folder_given_twice_counts_once() -> None:
    catalog = Catalog((EXAMPLES / "tasks",), (EXAMPLES, EXAMPLES))
    assert isinstance(catalog.entries("tasks")["hold_height"], Entry)


@pytest.mark.parametrize("out", ["out", "tasks/out", "."])
def test_results_are_not_written_into_a_folder_of_plugins(tmp_path: Path, out: str) -> None:
    """They would be a collection that nobody knows, from then on."""
    (tmp_path / "tasks").mkdir()
    found = typed("compare", "point_on_point", "--plugins", tmp_path, "--out", tmp_path / out)
    assert found.exit_code == 2
    assert "folder of plug-ins" in found.output
    assert [path.name for path in tmp_path.rglob("*")] == ["tasks"]
