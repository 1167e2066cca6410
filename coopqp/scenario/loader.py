"""From a scenario file to a scenario, or to all that is wrong with the file."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from pydantic import BaseModel

from coopqp.checked import taken_names
from coopqp.closed_loop.admittance import unstated
from coopqp.controller import TELL_APART, Controller, problem_faults
from coopqp.controllers.qp import QPController
from coopqp.errors import CoopqpError, Fault, ScenarioError, UnknownNameError, unknown_name
from coopqp.grasp import Grasp
from coopqp.grasps import Rigid
from coopqp.hold import grasp_of_each
from coopqp.plant import Plant
from coopqp.reading import absolute
from coopqp.robot import RobotModel
from coopqp.scenario.catalog import Catalog
from coopqp.scenario.checks import built, check_start, placed_tasks
from coopqp.scenario.form import SOLVE, check, chosen
from coopqp.scenario.known import Known
from coopqp.scenario.phase import Phase
from coopqp.scenario.scenario import Scenario, Start, from_degrees
from coopqp.scenario.start_solver import Progress, StartSolution, close_start, solve_start
from coopqp.scenario.trial import blamed
from coopqp.scenario.yaml import YamlFile, parsed, read_yaml
from coopqp.solver import Solver
from coopqp.solvers import qpsolvers
from coopqp.task import Task
from coopqp.wording import Location

#: Keys whose values are paths, of robots, obstacles, way-points and what was sent.
FILE_KEYS = {"path", "mesh", "file", "feed_file"}


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
    """The same from the text of a scenario that stands in another file.

    Args:
        path: of that file, for faults.
        text: of the scenario.
        catalog: what it can name.

    Raises:
        ScenarioError: as :func:`load`.
    """
    return load_file(parsed(path, text), catalog)


def load_file(file: YamlFile, catalog: Catalog, known: Known | None = None) -> Scenario:
    """The same from a file that has been read.

    Args:
        file: read.
        catalog: what it can name.
        known: the same for all variants of one file, so that each only builds and tries what is
            different from the one before.

    Raises:
        ScenarioError: as :func:`load`.
    """
    known, scenario = known or Known(), _Reader(file, catalog).scenario()
    known.lend_robot(file.data, scenario)
    if file.data.get("start") == SOLVE:
        scenario = _starting(scenario, _solved(file, scenario, scenario.seed, None).start)
    elif file.data.get("start_deg") is not None:
        robot = built(file, ["robot"], lambda: scenario.robot_model)
        scenario = _starting(scenario, from_degrees(robot, scenario.grasps, scenario.start))
    check_start(file, scenario, known)
    return scenario


def _starting(scenario: Scenario, start: Start) -> Scenario:
    """The scenario with a start; its robot, which is built by now, is not built again."""
    changed = replace(scenario, start=start)
    vars(changed)["robot_model"] = scenario.robot_model
    return changed


def load_and_solve(
    path: str | Path,
    catalog: Catalog | None = None,
    *,
    seed: int | None = None,
    progress: Progress | None = None,
) -> StartSolution:
    """Solve for a start of a scenario file, whatever start it has.

    Args:
        path: of a YAML file, or the name of a shipped scenario.
        catalog: what it can name; shipped and installed plug-ins when omitted.
        seed: of the random configurations; the scenario's when omitted.
        progress: called after each try.

    Raises:
        ScenarioError: with every fault, its line and its likely fix.
    """
    file = read_yaml(find(path))
    scenario = _Reader(file, catalog or Catalog(), needs_start=False).scenario()
    return _solved(file, scenario, scenario.seed if seed is None else seed, progress)


def _solved(
    file: YamlFile, scenario: Scenario, seed: int, progress: Progress | None
) -> StartSolution:
    robot = built(file, ["robot"], lambda: scenario.robot_model)
    near: Start = file.data.get("start_near") or {}
    built(file, ["start_near"], lambda: robot.configuration(near))
    built(file, ["grasps"], lambda: grasp_of_each(robot, scenario.grasps))

    def solved() -> StartSolution:
        grasps, held = scenario.grasps, scenario.held
        given = near or _given_start(file, robot, scenario)
        if held.pose is None and given:
            return close_start(robot, grasps, held, given)
        return solve_start(robot, grasps, held, near=near, seed=seed, progress=progress)

    return built(file, ["start"], solved)


def _given_start(file: YamlFile, robot: RobotModel, scenario: Scenario) -> Start:
    """The start that a file has, in radians; empty where it is to be solved."""
    if file.data.get("start_deg") is not None:
        return from_degrees(robot, scenario.grasps, scenario.start)
    return {} if file.data.get("start") == SOLVE else scenario.start


def shipped() -> dict[str, Path]:
    """The scenarios that come with coopqp, by name."""
    folder = Path(__file__).parents[1] / "scenarios"
    return {path.stem: path for path in sorted(folder.glob("*.yaml"))}


def find(path: str | Path) -> Path:
    """The file behind a path or the name of a shipped scenario.

    Raises:
        ScenarioError: it looks like a name, and there is neither such a file nor such a scenario.
    """
    given, known = Path(path), shipped()
    if os.path.exists(given) or given.suffix or given.name != str(path):
        return given
    if given.name not in known:
        words = f"no such file, and {unknown_name('shipped scenario', given.name, known)}"
        raise ScenarioError([Fault(str(path), words)])
    return known[given.name]


def with_solver(scenario: Scenario, name: str) -> Scenario:
    """The scenario with another QP solver.

    Args:
        scenario: as read.
        name: a solver of its catalogue, or an installed backend of qpsolvers.

    Raises:
        UnknownNameError: no such solver; names the nearest.
    """
    return replace(scenario, solver=solver_by_name(name, scenario.catalog), solver_name=name)


def solver_by_name(name: str, catalog: Catalog) -> Solver:
    """A solver of the catalogue, or an installed backend of qpsolvers.

    Raises:
        UnknownNameError: no such solver; names the nearest.
    """
    entries = catalog.entries("solvers")
    if name not in solver_names(catalog):
        raise UnknownNameError("solver", name, solver_names(catalog))
    chosen = entries[name].cls() if name in entries else qpsolvers.Qpsolvers(backend=name)
    assert isinstance(chosen, Solver)  # what the catalogue holds there
    return chosen


def plant_by_name(name: str, catalog: Catalog) -> Plant:
    """A plant of the catalogue with its defaults.

    Raises:
        UnknownNameError: no such plant; names the nearest.
    """
    entries = catalog.entries("plants")
    if name not in entries:
        raise UnknownNameError("plant", name, entries)
    plant = entries[name].cls()
    assert isinstance(plant, Plant)  # what the catalogue holds there
    return plant


def solver_names(catalog: Catalog) -> tuple[str, ...]:
    """Every solver that can be named here."""
    return tuple(sorted({*catalog.entries("solvers"), *qpsolvers.installed()} - {"qpsolvers"}))


def has_files(value: Any) -> bool:
    """Whether something in a file, such as its robot or an obstacle, is given by another file."""
    if isinstance(value, list):
        return any(map(has_files, value))
    if isinstance(value, dict):
        return bool(FILE_KEYS & set(value)) or any(map(has_files, value.values()))
    return False


class _Reader:
    """From the file to the scenario; collects the faults that only show together."""

    def __init__(self, file: YamlFile, catalog: Catalog, *, needs_start: bool = True) -> None:
        self._file, self._catalog, self._needs_start = file, catalog, needs_start
        self._read: BaseModel = check(file, catalog)
        self._faults: list[Fault] = []

    def scenario(self) -> Scenario:
        """The scenario, or all that is wrong with it."""
        read: Any = self._read
        solver_name, solver = chosen(read.solver)
        scenario = Scenario(
            name=self._file.path.stem,
            description=read.description,
            robot=chosen(read.robot)[1],
            grasps=self._grasps(),
            grasp_of={name: chosen(slot)[1] for name, slot in read.grasp_of.items()},
            held=read.object,
            weights=read.weights,
            start=self._start(),
            tasks=_plugins(read.tasks or ()),
            phases=self._phases(),
            secondary=_plugins(read.secondary),
            limits=_plugins(read.limits),
            controllers=self._controllers(),
            plant=chosen(read.plant)[1],
            inputs=read.inputs,
            disturbance=read.disturbance,
            solver=solver,
            solver_name=getattr(solver, "backend", solver_name),
            budget=read.budget,
            dt=read.dt,
            duration=read.duration or 0.0,
            kappa=math.inf if read.kappa is None else read.kappa,
            seed=read.seed,
            on_infeasible=read.on_infeasible,
            source=self._file.text,
            folder=self._folder() if has_files(self._file.data) else None,
            catalog=self._catalog,
        )
        self._check_problems(scenario)
        for name in scenario.grasp_of:
            if name not in scenario.controllers:
                self._fault(
                    ["grasp_of", name], unknown_name("controller", name, scenario.controllers)
                )
        needs_masses = scenario.disturbance != scenario.disturbance.kinematic
        if needs_masses and not scenario.plant.takes_torques:
            self._fault(["disturbance"], "has no effect on this plant; use one with masses")
        if self._faults:
            raise ScenarioError(list(dict.fromkeys(self._faults)))
        return scenario

    def _fault(self, location: Location, message: str) -> None:
        self._faults.append(Fault(self._file.place(location), message))

    def _grasps(self) -> Grasp | dict[str, Grasp]:
        read: Any = self._read
        if read.grasp and read.grasps:
            self._fault(["grasps"], "give grasp (all arms) or grasps (by arm), not both")
        if read.grasps:
            return {arm: chosen(slot)[1] for arm, slot in read.grasps.items()}
        return chosen(read.grasp)[1] if read.grasp else Rigid()

    def _folder(self) -> Path:
        """Where relative paths begin."""
        read: Any = self._read
        return absolute(self._file.path.parent / str(read.folder))

    def _start(self) -> Start:
        read: Any = self._read
        both = read.start is not None and read.start_deg is not None
        if both or (self._needs_start and read.start is None and read.start_deg is None):
            place = [] if read.start is None else ["start_deg"]
            self._fault(place, "give one of start (radians) and start_deg (degrees)")
        return read.start or read.start_deg or {}

    def _phases(self) -> tuple[Phase, ...]:
        read: Any = self._read
        phases = tuple(
            Phase(
                name=phase.name,
                tasks=_plugins(phase.tasks),
                duration=phase.duration,
                released=tuple(phase.released),
            )
            for phase in read.phases or ()
        )
        for i, taken in taken_names([phase.name for phase in phases]):
            self._fault(["phases", i, "name"], taken)
        return phases

    def _controllers(self) -> dict[str, Controller]:
        read: Any = self._read
        controllers = _plugins(read.controllers)
        for i, taken in taken_names([controller.name for controller in controllers]):
            self._fault(["controllers", i], f"{taken}; {TELL_APART}")
        return {controller.name: controller for controller in controllers}

    def _check_problems(self, scenario: Scenario) -> None:
        """Say of each phase what a controller could not be built for, and what it cannot end."""
        shortest = min(phase.duration for phase in scenario.schedule)
        if scenario.dt > shortest:
            self._fault(["dt"], f"found {scenario.dt} s; needs at most the duration")
        for i, phase in enumerate(scenario.schedule):
            inside: Location = ["phases", i] if scenario.phases else []
            found = problem_faults(
                scenario.dt, scenario.drift_gain, phase.tasks, scenario.secondary
            )
            for place, message in found:
                self._fault([*inside, *place] if place[0] == "tasks" else place, message)
        for place, task, phase in placed_tasks(scenario):
            self._check_end(place, task, phase.duration)
            if task.of_forces and not scenario.plant.takes_torques:
                words = f"asks '{task.name}' for a force, and this plant has none; use plant: "
                self._fault(place, f"{words}rigid_body or mujoco")
        self._check_stiffness(scenario)

    def _check_stiffness(self, scenario: Scenario) -> None:
        forces = [task.name for _, task, _ in placed_tasks(scenario) if task.of_forces]
        for i, controller in enumerate(scenario.controllers.values()):
            if forces and isinstance(controller, QPController) and not controller.admittance:
                self._fault(["controllers", i], unstated(forces[0]))

    def _check_end(self, place: Location, task: Task, duration: float) -> None:
        try:
            with blamed(task):
                end = task.end
        except CoopqpError as error:
            self._fault(place, str(error))
            return
        if not end <= duration + 1e-9:
            self._fault(
                place,
                f"the reference of '{task.name}' arrives at {end:g} s, after the end at "
                f"{duration:g} s; make it shorter or the duration longer",
            )


def _plugins(slots: Sequence[BaseModel]) -> tuple[Any, ...]:
    return tuple(chosen(slot)[1] for slot in slots)
