"""A scenario: everything about one motion, read from YAML and checked, ready to build."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel

from coopqp.catalog import Catalog
from coopqp.closed_chain import ClosedChain, arm_weights
from coopqp.controller import Controller, ControlProblem, OnInfeasible
from coopqp.disturbance import Disturbance
from coopqp.errors import (
    CoopqpError,
    Fault,
    InvalidValueError,
    ScenarioError,
    UnknownNameError,
    unknown_name,
)
from coopqp.grasp import Grasp
from coopqp.grasps import Rigid
from coopqp.held_object import HeldObject
from coopqp.limit import Limit
from coopqp.limits import JointPosition, JointVelocity
from coopqp.plant import Plant
from coopqp.plants import Kinematic
from coopqp.robot import Robot, RobotModel
from coopqp.scenario_file import SOLVE, check, chosen, file_model
from coopqp.solver import Budget, Solver
from coopqp.solvers import Daqp, qpsolvers
from coopqp.start_solver import Progress, StartSolution, solve_start
from coopqp.task import Task
from coopqp.yaml_file import Location, YamlFile, read_yaml

Start = Mapping[str, float | Sequence[float]]
T = TypeVar("T")


@dataclass(frozen=True, kw_only=True)
class Scenario:
    """One motion to be controlled, and with what.

    Attributes:
        name: of its file.
        robot, held, grasps, start: who holds what, how, and where it begins (start by arm, joint
            or passive joint [rad, m]).
        weights: of the arms in the object's pose, by arm; all the same when None.
        grasp_of: grasps of controllers that hold the object otherwise, by controller.
        tasks, secondary, limits: what shall happen and what must not.
        controllers: by name; what is compared.
        plant, disturbance: what is controlled, and what the controllers are not told of it.
        solver, solver_name, budget: how QPs are solved.
        dt, duration: [s]. kappa: drift correction [1/s]. seed: of everything random.
        on_infeasible: see :class:`coopqp.controller.ControlProblem`.
        source: text of the file it was read from.
    """

    name: str
    robot: Robot
    start: Start
    tasks: tuple[Task, ...]
    duration: float
    description: str = ""
    grasps: Grasp | Mapping[str, Grasp] = field(default_factory=Rigid)
    grasp_of: Mapping[str, Grasp] = field(default_factory=dict)
    held: HeldObject = field(default_factory=HeldObject)
    weights: Mapping[str, float] | None = None
    secondary: tuple[Task, ...] = ()
    limits: tuple[Limit, ...] = field(default_factory=lambda: (JointPosition(), JointVelocity()))
    controllers: Mapping[str, Controller] = field(default_factory=dict)
    plant: Plant = field(default_factory=Kinematic)
    disturbance: Disturbance = field(default_factory=Disturbance)
    solver: Solver = field(default_factory=Daqp)
    solver_name: str = "daqp"
    budget: Budget = field(default_factory=Budget)
    dt: float = 0.01
    kappa: float = 0.0
    seed: int = 0
    on_infeasible: OnInfeasible = "scale"
    source: str = ""

    def held_by(self, controller: str) -> Scenario:
        """The scenario with the grasp that this controller uses."""
        grasp = self.grasp_of.get(controller)
        if grasp is None:
            return self
        start = _start_of(self.robot_model, self.start)[0]  # other grasps, other passive joints
        return replace(self, grasps=grasp, grasp_of={}, start=start)

    @property
    def ticks(self) -> int:
        """Number of control periods."""
        return max(1, round(self.duration / self.dt))

    @cached_property
    def robot_model(self) -> RobotModel:
        """The robot, built once."""
        return self.robot.build()

    @cached_property
    def chain(self) -> ClosedChain:
        """The closed chain, built once."""
        robot = self.robot_model
        start, passive = _start_of(robot, self.start)
        return ClosedChain(
            robot,
            robot.configuration(start),
            self.grasps,
            self.held,
            alpha=self.weights,
            passive_start=passive,
        )

    def problem(self) -> ControlProblem:
        """What the controllers are built for."""
        return ControlProblem(
            chain=self.chain,
            tasks=self.tasks,
            secondary=self.secondary,
            limits=self.limits,
            dt=self.dt,
            kappa=self.kappa,
            solver=self.solver,
            budget=self.budget,
            on_infeasible=self.on_infeasible,
        )


def _start_of(robot: RobotModel, start: Start) -> tuple[Start, dict[str, float]]:
    """The start of the robot's joints, and of the grasps' passive joints ("right.hinge")."""
    arms = _arm_names(robot)
    own, passive = dict(start), {}
    for key, value in start.items():
        arm, dot, _ = key.rpartition(".")
        if dot and arm in arms and key not in robot.joint_names:
            numbers = np.atleast_1d(np.asarray(own.pop(key), float))
            if numbers.shape != (1,) or not np.isfinite(numbers).all():
                raise InvalidValueError(f"{key}: found {value}, needs one finite number")
            passive[key] = float(numbers[0])
    return own, passive


def _arm_names(robot: RobotModel) -> set[str]:
    return {arm.name for arm in robot.arms}


def load(path: str | Path, catalog: Catalog | None = None) -> Scenario:
    """Read and check a scenario file; ``start: solve`` is solved.

    Args:
        path: of a YAML file, or the name of a shipped scenario.
        catalog: what it can name; the shipped plug-ins when omitted.

    Raises:
        ScenarioError: with every fault, its line and its likely fix.
    """
    file = read_yaml(find(path))
    read = check(file, file_model(catalog or Catalog()))
    scenario = _Reader(file, read).scenario()
    if file.data.get("start") == SOLVE:
        scenario = replace(scenario, start=_solved(file, scenario, scenario.seed, None).start)
    _check_start(file, scenario)
    return scenario


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
        catalog: what it can name; the shipped plug-ins when omitted.
        seed: of the random configurations; the scenario's when omitted.
        progress: called after each try.

    Raises:
        ScenarioError: with every fault, its line and its likely fix.
    """
    file = read_yaml(find(path))
    read = check(file, file_model(catalog or Catalog()))
    scenario = _Reader(file, read, needs_start=False).scenario()
    return _solved(file, scenario, scenario.seed if seed is None else seed, progress)


def _solved(
    file: YamlFile, scenario: Scenario, seed: int, progress: Progress | None
) -> StartSolution:
    robot = _built(file, ["robot"], lambda: scenario.robot_model)
    return _built(
        file,
        ["start"],
        lambda: solve_start(robot, scenario.grasps, scenario.held, seed=seed, progress=progress),
    )


def shipped() -> dict[str, Path]:
    """The scenarios that come with coopqp, by name."""
    folder = Path(__file__).parent / "scenarios"
    return {path.stem: path for path in sorted(folder.glob("*.yaml"))}


def find(path: str | Path) -> Path:
    """The file behind a path or the name of a shipped scenario."""
    given = Path(path)
    return given if given.exists() else shipped().get(str(path), given)


class _Reader:
    """From the checked file to the scenario; collects the faults that only show together."""

    def __init__(self, file: YamlFile, read: BaseModel, *, needs_start: bool = True) -> None:
        self._file, self._read, self._needs_start = file, read, needs_start
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
            tasks=self._named("tasks"),
            secondary=self._named("secondary"),
            limits=tuple(chosen(slot)[1] for slot in read.limits),
            controllers={c.name: c for c in self._named("controllers")},
            plant=chosen(read.plant)[1],
            disturbance=read.disturbance,
            solver=solver,
            solver_name=getattr(solver, "backend", solver_name),
            budget=read.budget,
            dt=read.dt,
            duration=read.duration,
            kappa=read.kappa,
            seed=read.seed,
            on_infeasible=read.on_infeasible,
            source=self._file.path.read_text(encoding="utf-8"),
        )
        self._check_times(scenario)
        for name in scenario.grasp_of:
            if name not in scenario.controllers:
                self._fault(
                    ["grasp_of", name], unknown_name("controller", name, scenario.controllers)
                )
        if not scenario.disturbance.none and not scenario.plant.takes_torques:
            self._fault(["disturbance"], "has no effect on this plant; use one with masses")
        if self._faults:
            raise ScenarioError(self._faults)
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

    def _start(self) -> Start:
        read: Any = self._read
        both = read.start is not None and read.start_deg is not None
        if both or (self._needs_start and read.start is None and read.start_deg is None):
            place = [] if read.start is None else ["start_deg"]
            self._fault(place, "give one of start (radians) and start_deg (degrees)")
        if read.start_deg is None:
            return read.start or {}
        return {key: np.radians(value).tolist() for key, value in read.start_deg.items()}

    def _named(self, key: str) -> tuple[Any, ...]:
        """The plug-ins of a list, each with a name of its own."""
        named: list[Any] = []
        for i, slot in enumerate(getattr(self._read, key)):
            name, plugin = chosen(slot)
            plugin = plugin if plugin.name else replace(plugin, name=name)
            if plugin.name in (other.name for other in named):
                self._fault(
                    [key, i], f"the name '{plugin.name}' is taken; add 'name:' to tell them apart"
                )
            named.append(plugin)
        return tuple(named)

    def _check_times(self, scenario: Scenario) -> None:
        if scenario.dt > scenario.duration:
            self._fault(["dt"], f"found {scenario.dt} s; needs at most the duration")
        top = 1.0 / scenario.dt * (1.0 + 1e-9)
        if scenario.kappa > top:
            self._fault(["kappa"], f"found {scenario.kappa}; needs at most 1/dt = {top:g} 1/s")
        for key in ("tasks", "secondary"):
            for i, task in enumerate(getattr(scenario, key)):
                self._check_task([key, i], task, scenario, top)

    def _check_task(self, place: Location, task: Task, scenario: Scenario, top: float) -> None:
        if task.gain > top:
            self._fault(place, f"gain {task.gain} 1/s overshoots; needs at most 1/dt = {top:g} 1/s")
        if task.end > scenario.duration + 1e-9:
            self._fault(
                place,
                f"the reference of '{task.name}' arrives at {task.end:g} s, after the end at "
                f"{scenario.duration:g} s; make it shorter or the duration longer",
            )
        if place[0] == "secondary" and not task.joint_space:
            self._fault(place, f"'{task.name}' steers the object; put it under tasks")


def _check_start(file: YamlFile, scenario: Scenario) -> None:
    """Build what can fail and refuse a start outside the limits."""
    key = "start" if "start" in file.data else "start_deg"
    robot = _built(file, ["robot"], lambda: scenario.robot_model)
    of_robot, passive = _built(file, [key], lambda: _start_of(robot, scenario.start))
    q = _built(file, [key], lambda: robot.configuration(of_robot))
    strangers = [name for name in scenario.weights or {} if name not in _arm_names(robot)]
    place = ["weights", *strangers[:1]]
    _built(file, place, lambda: arm_weights(robot, scenario.weights))
    allowed = file.data.get("start_outside", False)
    faults = (
        []
        if allowed
        else [
            Fault(file.place(location), message)
            for location, message in outside_limits(robot, of_robot, q, key)
        ]
    )
    if faults:
        raise ScenarioError(faults)
    try:
        chain = scenario.chain
    except CoopqpError as error:
        name = error.name if isinstance(error, UnknownNameError) else ""
        grasp = "grasps" if "grasps" in file.data else "grasp"
        place = [key, name] if name in passive else [grasp]
        raise ScenarioError([Fault(file.place(place), str(error))]) from None
    if not allowed:
        _check_passive(file, chain, passive, key)


def _check_passive(
    file: YamlFile, chain: ClosedChain, passive: Mapping[str, float], key: str
) -> None:
    faults = []
    for name in passive:
        i = chain.joint_names.index(name)
        value, low, high = chain.q_start[i], chain.lower[i], chain.upper[i]
        if not low <= value <= high:
            words = _outside(name, value, low, high, in_degrees=key.endswith("deg"))
            faults.append(Fault(file.place([key, name]), words))
    if faults:
        raise ScenarioError(faults)


def outside_limits(
    robot: RobotModel, start: Start, q: NDArray[np.float64], key: str
) -> list[tuple[Location, str]]:
    """Where a start leaves the position limits, and by how much."""
    faults: list[tuple[Location, str]] = []
    lower, upper = robot.model.lowerPositionLimit, robot.model.upperPositionLimit
    arms = {arm.name: robot.arm_joints(arm) for arm in robot.arms}
    for joint, value, low, high in zip(robot.joint_names, q, lower, upper, strict=True):
        if low <= value <= high:
            continue
        location: list[str | int] = [key, joint]
        for arm, joints in arms.items():
            if arm in start and joint in joints and joint not in start:
                location = [key, arm, joints.index(joint)]
        faults.append((location, _outside(joint, value, low, high, in_degrees=key.endswith("deg"))))
    return faults


def _outside(joint: str, value: float, low: float, high: float, *, in_degrees: bool) -> str:
    scale, unit = (math.degrees(1.0), "degrees") if in_degrees else (1.0, "rad")
    return (
        f"{joint} starts at {value * scale:.6g} {unit}, outside its limits "
        f"{low * scale:.6g} to {high * scale:.6g}; or say start_outside: true to see it come back"
    )


def _built(file: YamlFile, location: Location, build: Callable[[], T]) -> T:
    try:
        return build()
    except ScenarioError:
        raise
    except CoopqpError as error:
        raise ScenarioError([Fault(file.place(location), str(error))]) from None


def with_solver(scenario: Scenario, name: str, catalog: Catalog) -> Scenario:
    """The scenario with another QP solver.

    Args:
        scenario: as read.
        name: a solver of the catalogue, or an installed backend of qpsolvers.
        catalog: what can be named.

    Raises:
        UnknownNameError: no such solver; names the nearest.
    """
    return replace(scenario, solver=solver_by_name(name, catalog), solver_name=name)


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


def solver_names(catalog: Catalog) -> tuple[str, ...]:
    """Every solver that can be named here."""
    return tuple(sorted({*catalog.entries("solvers"), *qpsolvers.installed()} - {"qpsolvers"}))
