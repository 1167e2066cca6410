"""From a scenario file to a scenario, or to all that is wrong with the file."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import coopqp
from coopqp.base.errors import Fault, ScenarioError, UnknownNameError, unknown_name
from coopqp.base.reading import absolute
from coopqp.base.spec import type_name
from coopqp.grasps import Rigid
from coopqp.model.grasp_configuration import grasp_of_each
from coopqp.model.profile import FASTEST
from coopqp.scenario.catalog import Catalog
from coopqp.scenario.checks import Known, at, check_start, contradictions, placed_tasks, refuse
from coopqp.scenario.form import SOLVE, check, chosen, fields_of, given
from coopqp.scenario.planned import PlanReference, following
from coopqp.scenario.scenario import Scenario
from coopqp.scenario.start import Start, from_degrees
from coopqp.scenario.start_solver import Progress, StartSolution, close_start, solve_start
from coopqp.scenario.yaml import YamlFile, has_files, parsed, read_yaml
from coopqp.solver import Solver
from coopqp.solvers import qpsolvers


def load(path: str | Path, catalog: Catalog | None = None) -> Scenario:
    """Read and check a scenario file; ``start: solve`` is solved.

    Args:
        path: of a YAML file, or the name of a shipped scenario.
        catalog: what it can name; shipped and installed plug-ins when omitted.

    Raises:
        ScenarioError: with every fault, its line and its likely fix.
    """
    return load_file(read_yaml(find(path)), catalog or Catalog())


def load_text(path: Path, text: str, catalog: Catalog) -> Scenario:
    """The same from the text of a scenario that stands in another file."""
    return load_file(parsed(path, text), catalog)


def load_file(file: YamlFile, catalog: Catalog, known: Known | None = None) -> Scenario:
    """The same from a file that has been read; ``known`` is shared by variants of one file."""
    known = known or Known()
    with file.lines():
        scenario, planned = _read(file, catalog)
        of_robot = file.data.get("robot"), file.data.get("folder")
        if before := known.get("robot", of_robot):
            vars(scenario)["robot_model"] = before
        if file.data.get("start") == SOLVE:
            scenario = scenario.changed(start=_solved(file, scenario, scenario.seed, None).start)
        elif file.data.get("start_deg") is not None:
            with at(["robot"]):
                robot = scenario.robot_model
            scenario = scenario.changed(start=from_degrees(robot, scenario.grasps, scenario.start))
        for place, task, _ in placed_tasks(scenario):
            if task.way and task.way.kind == FASTEST:
                with at([*place, type_name(type(task)), "profile"]):
                    scenario = coopqp.with_fastest_profiles(scenario)
                break
        if planned:
            with at(["reference"]):
                scenario = following(scenario, planned)
        check_start(file.data, scenario, known)
        known.keep("robot", of_robot, scenario.robot_model)
        return scenario


def _read(
    file: YamlFile, catalog: Catalog, *, needs_start: bool = True
) -> tuple[Scenario, PlanReference | None]:
    """The scenario as the file says it, of which nothing is built yet, and what it follows."""
    read: Any = check(file, catalog)
    keys = given(read)
    scenario = Scenario(
        **{
            **fields_of(keys),
            "name": file.path.stem,
            "grasps": keys.get("grasps") or keys.get("grasp") or Rigid(),
            "start": keys.get("start") or keys.get("start_deg") or {},
            "controllers": {controller.name: controller for controller in keys["controllers"]},
            "solver_name": getattr(keys["solver"], "backend", chosen(read.solver)[0]),
            "source": file.text,
            "folder": absolute(file.folder) if has_files(file.data) else None,
            "catalog": catalog,
        }
    )
    refuse(contradictions(keys, scenario, needs_start=needs_start))
    return scenario, keys.get("reference")


def load_and_solve(
    path: str | Path,
    catalog: Catalog | None = None,
    *,
    seed: int | None = None,
    progress: Progress | None = None,
) -> StartSolution:
    """Solve for a start of a scenario file, whatever start it has; else as :func:`load`.

    ``seed`` is of the random configurations, the scenario's when omitted; ``progress`` is called
    after each try.
    """
    file = read_yaml(find(path))
    with file.lines():
        scenario, _ = _read(file, catalog or Catalog(), needs_start=False)
        return _solved(file, scenario, scenario.seed if seed is None else seed, progress)


def _solved(
    file: YamlFile, scenario: Scenario, seed: int, progress: Progress | None
) -> StartSolution:
    with at(["robot"]):
        robot = scenario.robot_model
    near: Start = file.data.get("start_near") or {}
    with at(["start_near"]):
        robot.configuration(near)
    with at(["grasps"]):
        grasp_of_each(robot, scenario.grasps)
    with at(["start"]):
        grasps, held = scenario.grasps, scenario.held
        begin: Start = near or scenario.start
        if not near and file.data.get("start_deg") is not None:
            begin = from_degrees(robot, grasps, scenario.start)
        if held.pose is None and begin:
            return close_start(robot, grasps, held, begin)
        return solve_start(
            robot, grasps, held, near=near, seed=seed, progress=progress, fits=scenario.fits
        )


#: Folders of files that come with coopqp, and what one of them is.
FILES = {"scenarios": "scenario", "studies": "study"}


def shipped(folder: str = "scenarios") -> dict[str, Path]:
    """The files that come with coopqp, by name."""
    files = (Path(__file__).parents[1] / folder).glob("*.yaml")
    return {path.stem: path for path in sorted(files)}


def find(path: str | Path, folder: str = "scenarios") -> Path:
    """The file behind a path or a shipped one's name; ScenarioError if there is neither."""
    given, known = Path(path), shipped(folder)
    if os.path.exists(given) or given.suffix or given.name != str(path):
        return given
    if given.name not in known:
        words = f"no such file, and {unknown_name(f'shipped {FILES[folder]}', given.name, known)}"
        raise ScenarioError([Fault(str(path), words)])
    return known[given.name]


def with_solver(scenario: Scenario, name: str) -> Scenario:
    """The scenario with another QP solver; UnknownNameError names the nearest."""
    return replace(scenario, solver=solver_by_name(name, scenario.catalog), solver_name=name)


def solver_by_name(name: str, catalog: Catalog) -> Solver:
    """A solver of the catalogue, or an installed backend of qpsolvers; or UnknownNameError."""
    entries = catalog.entries("solvers")
    if name not in solver_names(catalog):
        raise UnknownNameError("solver", name, solver_names(catalog))
    chosen = entries[name].cls() if name in entries else qpsolvers.Qpsolvers(backend=name)
    assert isinstance(chosen, Solver)  # what the catalogue holds there
    return chosen


def solver_names(catalog: Catalog) -> tuple[str, ...]:
    """Every solver that can be named here."""
    return tuple(sorted({*catalog.entries("solvers"), *qpsolvers.installed()} - {"qpsolvers"}))
