"""One case: a file made of a seed by mutations, and what coopqp makes of it."""

from __future__ import annotations

import difflib
import io
import json
import shutil
import tempfile
import traceback
from collections.abc import Callable
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from random import Random
from typing import Any

from coopqp.base.errors import CoopqpError, InternalError, ScenarioError
from coopqp.execution.comparison import compare
from coopqp.report import files
from coopqp.scenario.catalog import Catalog
from coopqp.scenario.loader import load, solver_by_name
from coopqp.scenario.scenario import Scenario
from coopqp.scenario.yaml import read_yaml
from coopqp.study import explanation
from coopqp.study.explanation.explained_phase import explained_phases
from coopqp.study.tick_record import TickRecord, replay
from coopqp.study.trace_file import measured_run, recorded_tick, trace_from_file

from . import meshes, mutations, trees
from .lines import Mutated, wrong_line

SEEDS = Path(__file__).parent / "seeds"
SHIPPED = Path(__file__).parents[2] / "scenarios"
#: What is mutated; a scenario more often than the others.
KINDS = ("scenario", "scenario", "scenario", "robot", "mesh", "trace", "tick")
TICKS = 3
#: Seeds that need no package of robots.
NAMES = ("phases", "pushed", "tasks", "urdf", "mjcf", "table", "several", "things")
#: How often a file is none, but a folder, a pipe, a device or a giant.
SPECIAL = 0.02
#: What was done to a file, and what coopqp is to do with it.
Case = tuple[Mutated, Callable[[], object]]


@dataclass(frozen=True)
class Outcome:
    """What came of a case.

    Attributes:
        kind: what was mutated.
        seed: of the case.
        ended: "runs", "refused", or what is wrong: "raises", "prints", "no line", "wrong line" (of
            the mutated file), "other line" (of another one that it has nothing to do with).
        words: what was said.
    """

    kind: str
    seed: int
    ended: str
    words: str = ""

    @property
    def wrong(self) -> bool:
        return self.ended not in ("runs", "refused")


def run_case(seed: int, folder: Path) -> Outcome:
    """Make the case of a seed in a folder, and run it."""
    rng = Random(seed)
    kind = rng.choice(KINDS)
    for old in folder.iterdir():
        shutil.rmtree(old) if old.is_dir() else old.unlink()
    heard = io.StringIO()
    try:
        mutated, run = MAKERS[kind](rng, folder)
        if rng.random() < SPECIAL:
            meshes.special(rng, mutated.path)
        with redirect_stdout(heard), redirect_stderr(heard):
            run()
    except InternalError as error:
        return Outcome(kind, seed, "raises", str(error))
    except CoopqpError as error:
        return _refusal(kind, seed, error, mutated)
    except Exception:  # noqa: BLE001 - what it is for
        return Outcome(kind, seed, "raises", traceback.format_exc())
    return Outcome(kind, seed, "prints" if heard.getvalue() else "runs", heard.getvalue())


def _refusal(kind: str, seed: int, error: CoopqpError, mutated: Mutated) -> Outcome:
    """A refusal, and whether it names the right lines."""
    said = str(error)
    if ": raises " in said:  # of shipped code; a user's words would be better
        return Outcome(kind, seed, "raises", said)
    faults = map(str, error.faults) if isinstance(error, ScenarioError) else said.splitlines()
    if wrong := wrong_line(list(faults), mutated):
        return Outcome(kind, seed, wrong, f"{said}\n{_shown(mutated)}")
    return Outcome(kind, seed, "refused", said)


def _shown(mutated: Mutated) -> str:
    """What was done to a file."""
    a, b = mutated.old.splitlines(), mutated.new.splitlines()
    return "\n".join([*difflib.unified_diff(a, b, lineterm="", n=0)][2:40])


@cache
def catalog() -> Catalog:
    """Of what is shipped."""
    return Catalog()


def _scenario(rng: Random, folder: Path) -> Case:
    path, other = _copied(rng, folder), _seed(rng)
    old = path.read_text(encoding="utf-8")
    if rng.random() < 0.4:
        new = mutations.text(rng, old, other.read_text(encoding="utf-8"))
    else:
        tree, deep = read_yaml(path).data, rng.choice((2, 4, 100, 100))
        old = mutations.yaml(tree, deep)
        new = mutations.yaml(mutations.data(rng, tree, read_yaml(other).data), deep)
    path.write_bytes(new.encode("utf-8", "surrogatepass"))
    pages = rng.random() < 0.01
    return Mutated(path, old, new, trees.of_yaml), lambda: _run(path, pages=pages)


def _robot(rng: Random, folder: Path) -> Case:
    name = rng.choice(("urdf", "mjcf", "several"))
    shutil.copytree(SEEDS, folder, dirs_exist_ok=True)
    file = folder / ("dual.xml" if name == "mjcf" else "dual.urdf")
    other = (folder / ("dual.urdf" if name == "mjcf" else "dual.xml")).read_text(encoding="utf-8")
    old = file.read_text(encoding="utf-8")
    mutate = mutations.text if rng.random() < 0.4 else mutations.xml
    new = mutate(rng, old, other)
    file.write_bytes(new.encode("utf-8", "surrogatepass"))
    pages = rng.random() < 0.01
    return Mutated(file, old, new, trees.of_xml), lambda: _run(folder / f"{name}.yaml", pages=pages)


def _mesh(rng: Random, folder: Path) -> Case:
    """A mesh that is a thing in the world and a part of a robot."""
    shutil.copytree(SEEDS, folder, dirs_exist_ok=True)
    name = rng.choice(("m.obj", "t.stl", "b.stl", "m.dae"))
    file, old = folder / name, (folder / name).read_bytes()
    if name == "b.stl":
        new = meshes.binary(rng, old)
    else:
        other = (folder / rng.choice(("m.obj", "t.stl", "m.dae"))).read_text(encoding="utf-8")
        changed = meshes.text(rng, old.decode(), other)
        new = changed.encode("utf-8", "surrogatepass")
    file.write_bytes(new)
    scenario = folder / rng.choice(("things.yaml", "things.yaml", "urdf.yaml", "mjcf.yaml"))
    pages = rng.random() < 0.1
    mutated = Mutated(file, old.decode("latin-1"), new.decode("latin-1"), trees.of_lines)
    return mutated, lambda: _run(scenario, pages=pages)


def _seed(rng: Random) -> Path:
    shipped = [p for p in sorted(SHIPPED.glob("*.yaml")) if "example_robot" not in p.read_text()]
    return rng.choice([*(SEEDS / f"{name}.yaml" for name in NAMES), *shipped])


def _copied(rng: Random, folder: Path) -> Path:
    """A seed in the folder, beside the robots' files."""
    shutil.copytree(SEEDS, folder, dirs_exist_ok=True)
    return Path(shutil.copy(_seed(rng), folder / "s.yaml"))


def _run(path: Path, *, pages: bool) -> None:
    """Load a scenario and run it for a few ticks."""
    comparison = compare(_short(load(path, catalog())))
    if pages:
        files.write(comparison, path.parent / "out")
    files.metrics_json(comparison)
    files.trace_csv(comparison)
    internal = [why for why in comparison.refused.values() if "raises" in why]
    if internal or comparison.faults:
        raise InternalError("; ".join([*internal, *comparison.faults]))


def _short(scenario: Scenario) -> Scenario:
    short = TICKS * scenario.dt
    phases = tuple(replace(phase, duration=short) for phase in scenario.phases[:3])
    return replace(scenario, duration=short, phases=phases)


@cache
def _kept(name: str = "phases") -> tuple[Scenario, str]:
    """A short run: its scenario and its trace."""
    scenario = _short(load(SEEDS / f"{name}.yaml", catalog()))
    return scenario, files.trace_csv(compare(scenario))


def _trace(rng: Random, folder: Path) -> Case:
    scenario, written = _kept(rng.choice(("phases", "pushed")))
    lines = written.splitlines(keepends=True)
    path = folder / "trace.csv"
    if rng.random() < 0.5:
        content = mutations.text(rng, "".join(lines), (SEEDS / "urdf.yaml").read_text())
    else:
        cells = [line.rstrip("\n").split(",") for line in lines]
        mutated = mutations.data(rng, cells, [["x", "nan", "", "1e400"]])
        rows = mutated if isinstance(mutated, list) else []
        content = "".join(
            ",".join(map(str, row)) + "\n" if isinstance(row, list) else f"{row}\n" for row in rows
        )
    path.write_bytes(content.encode("utf-8", "surrogatepass"))
    asked, name = rng.choice(("tick", "run", "joints")), rng.choice(list(scenario.controllers))
    tick = rng.choice((None, None, 0, 1))

    def run() -> None:
        if asked == "joints":
            measured_run(path, scenario, name)
        elif asked == "run":
            list(explained_phases(scenario.held_by(name), trace_from_file(path, scenario, name)))
        else:
            explanation.explain(recorded_tick(path, scenario, None, tick))

    return Mutated(path, written, content, trees.of_csv), run


@cache
def _tick_text() -> str:
    scenario, written = _kept()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "trace.csv"
        path.write_text(written, encoding="utf-8")
        return recorded_tick(path, scenario, "qp", 1).text()


def _tick(rng: Random, folder: Path) -> Case:
    content = _tick_text()
    if rng.random() < 0.4:
        content = mutations.text(rng, content, '{"a": [1, 2]}')
    else:
        tree: Any = json.loads(content)
        content = json.dumps(mutations.data(rng, tree, tree), indent=1) + "\n"
    path = folder / "tick.json"
    path.write_bytes(content.encode("utf-8", "surrogatepass"))
    solver = solver_by_name(rng.choice(("daqp", "osqp", "proxqp")), catalog())
    mutated = Mutated(path, _tick_text(), content, trees.of_json)
    return mutated, lambda: replay(TickRecord.read(path), solver)


MAKERS = {
    "scenario": _scenario, "robot": _robot, "mesh": _mesh, "trace": _trace, "tick": _tick,
}  # fmt: skip
