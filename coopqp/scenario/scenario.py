"""A scenario: everything about one motion, ready to build."""

from __future__ import annotations

import itertools
import json
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property
from numbers import Integral, Real
from pathlib import Path
from typing import Any

import numpy as np

from coopqp.checked import Array, array, near, type_name
from coopqp.closed_chain import ClosedChain
from coopqp.controller import Controller, ControlProblem, OnInfeasible, period_fault
from coopqp.disturbance import Disturbance
from coopqp.errors import CoopqpError, InvalidValueError, ScenarioError
from coopqp.grasp import Grasp
from coopqp.grasps import Rigid
from coopqp.held_object import HeldObject
from coopqp.input import InputSettings, wanted
from coopqp.limit import Limit
from coopqp.limits import JointPosition, JointVelocity
from coopqp.plant import Plant
from coopqp.plants import Kinematic
from coopqp.robot import Robot, RobotModel, unit_of
from coopqp.scenario.catalog import Catalog
from coopqp.scenario.phase import Phase
from coopqp.scenario.yaml import parsed
from coopqp.signal import Kind
from coopqp.solver import Budget, Solver
from coopqp.solvers import Daqp
from coopqp.state import State
from coopqp.task import Task

#: Most ticks times joints of all controllers together: traces of 0.6 GB, reports of 2 GB.
MOST_KEPT = 4_000_000

Start = Mapping[str, float | Sequence[float]]


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
        phases: instead of tasks and duration, when arms let go or take hold on the way.
        controllers: by name; what is compared.
        inputs: values that arrive from outside, by name: how they are followed.
        plant, disturbance: what is controlled, and what the controllers are not told of it.
        solver, solver_name, budget: how QPs are solved.
        dt, duration: [s]; the latter is 0 where there are phases. kappa: drift correction [1/s],
            1/dt when omitted.
        seed: of everything random.
        on_infeasible: see :class:`coopqp.controller.ControlProblem`.
        source: text of the file it was read from.
        folder: in which relative paths of the source begin; None where it has none.
        catalog: what it can name; its metrics are measured.

    Raises:
        InvalidValueError: dt or a duration is no time; a field is of another type.
    """

    name: str
    robot: Robot
    start: Start
    tasks: tuple[Task, ...] = ()
    duration: float = 0.0
    phases: tuple[Phase, ...] = ()
    description: str = ""
    grasps: Grasp | Mapping[str, Grasp] = field(default_factory=Rigid)
    grasp_of: Mapping[str, Grasp] = field(default_factory=dict)
    held: HeldObject = field(default_factory=HeldObject)
    weights: Mapping[str, float] | None = None
    secondary: tuple[Task, ...] = ()
    limits: tuple[Limit, ...] = field(default_factory=lambda: (JointPosition(), JointVelocity()))
    controllers: Mapping[str, Controller] = field(default_factory=dict)
    plant: Plant = field(default_factory=Kinematic)
    inputs: Mapping[str, InputSettings] = field(default_factory=dict)
    disturbance: Disturbance = field(default_factory=Disturbance)
    solver: Solver = field(default_factory=Daqp)
    solver_name: str = "daqp"
    budget: Budget = field(default_factory=Budget)
    dt: float = 0.01
    kappa: float = math.inf
    seed: int = 0
    on_infeasible: OnInfeasible = "scale"
    source: str = ""
    folder: Path | None = None
    catalog: Catalog = field(default_factory=Catalog, repr=False, compare=False)

    def __post_init__(self) -> None:
        strange = list(_strangers(self))
        if strange:
            raise InvalidValueError("\n".join(strange))
        wrong = period_fault(self.dt)
        found = [f"dt: {wrong}"] if wrong else []
        found += [
            f"duration: found {phase.duration} s; needs a finite time, at least 0"
            for phase in self.schedule
            if not 0.0 <= phase.duration < np.inf
        ]
        if found:
            raise InvalidValueError("\n".join(found))

    @property
    def drift_gain(self) -> float:
        """kappa, or 1/dt where it was omitted [1/s]."""
        return 1.0 / self.dt if self.kappa == math.inf else self.kappa

    @property
    def portable(self) -> str:
        """The source as it can be read from another folder on this machine.

        As JSON where it is written so that no line can be added, such as ``{dt: 0.01, ...}``.
        """
        if self.folder is None:
            return self.source
        path = self.folder / self.name  # for faults, of which none is told
        moved = {**parsed(path, self.source).data, "folder": str(self.folder)}
        kept = [line for line in self.source.splitlines(True) if not line.startswith("folder:")]
        begin = "".join(kept).rstrip("\n")
        text = f"{begin}\nfolder: {json.dumps(str(self.folder))}\n"
        with suppress(ScenarioError):
            if parsed(path, text).data == moved:
                return text
        return json.dumps(moved, indent=2) + "\n"

    def held_by(self, controller: str) -> Scenario:
        """The scenario with the grasp that this controller uses."""
        grasp = self.grasp_of.get(controller)
        if grasp is None:
            return self
        start = start_of(self.robot_model, self.start)[0]  # other grasps, other passive joints
        return replace(self, grasps=grasp, grasp_of={}, start=start)

    @property
    def schedule(self) -> tuple[Phase, ...]:
        """The phases one after the other; one where all arms hold on throughout."""
        return self.phases or (Phase(tasks=self.tasks, duration=self.duration),)

    @property
    def first_ticks(self) -> tuple[int, ...]:
        """At which tick each phase begins."""
        ticks = [phase.ticks(self.dt) for phase in self.schedule]
        return tuple(itertools.accumulate(ticks[:-1], initial=0))

    @property
    def ticks(self) -> int:
        """Number of control periods."""
        return self.first_ticks[-1] + self.schedule[-1].ticks(self.dt)

    def check_size(self) -> None:
        """Refuse runs of which more would be kept than ``MOST_KEPT``.

        Raises:
            InvalidValueError: with how long they may be.
        """
        each = max(1, len(self.controllers)) * len(self.robot_model.joint_names)
        if self.ticks * each > MOST_KEPT:
            raise InvalidValueError(
                f"found {self.ticks} ticks, more than are kept; needs at most {MOST_KEPT // each} "
                f"with {len(self.controllers)} controllers and {len(self.robot_model.joint_names)} "
                "joints, so make the duration shorter, or dt longer"
            )

    @cached_property
    def robot_model(self) -> RobotModel:
        """The robot, built once."""
        try:
            return self.robot.build()
        except CoopqpError as error:
            if error.keys:
                error.at(type_name(type(self.robot)))
            raise

    @cached_property
    def chain(self) -> ClosedChain:
        """The closed chain at the start, built once."""
        robot = self.robot_model
        start, passive = start_of(robot, self.start)
        return ClosedChain.take_hold(
            robot,
            robot.configuration(start),
            self.grasps,
            self.held,
            alpha=self.weights,
            passive_start=passive,
            released=self.schedule[0].released,
        )

    def problem(
        self, phase: Phase | None = None, chain: ClosedChain | None = None
    ) -> ControlProblem:
        """What the controllers are built for.

        Args:
            phase: of the schedule; the first if omitted.
            chain: at the start of the phase; that at the start of the scenario if omitted.
        """
        tasks = (phase or self.schedule[0]).tasks
        return ControlProblem(
            chain=chain or self.chain,
            tasks=tuple(task for task in tasks if not task.of_forces),
            wrenches=tuple(task for task in tasks if task.of_forces),
            secondary=self.secondary,
            limits=self.limits,
            dt=self.dt,
            kappa=self.kappa,
            solver=self.solver,
            budget=self.budget,
            on_infeasible=self.on_infeasible,
        )

    def problems(self, where: Callable[[int], Array]) -> Iterator[ControlProblem]:
        """The problem of each phase in turn.

        Args:
            where: from the first tick of a later phase to the configuration in which it begins;
                asked no sooner than its problem is.
        """
        chain = self.chain
        for phase, first in zip(self.schedule, self.first_ticks, strict=True):
            if first:
                chain = chain.handed_over(where(first), phase.released)
            yield self.problem(phase, chain)

    def followed(self) -> dict[str, Kind]:
        """What the inputs are that tasks of any phase follow, by name."""
        found = dict[str, Kind]()
        for problem in self.problems(lambda _: self.chain.q_start):
            asked = wanted(problem.all_tasks, State(problem.chain))
            found |= {name: kind for name, (kind, _) in asked.items()}
        return found


#: What the fields of a scenario are, and what is in those that hold several.
KINDS: dict[str, tuple[Any, Any]] = {
    "name": (str, None), "description": (str, None), "source": (str, None),
    "solver_name": (str, None), "robot": (Robot, None), "start": (Mapping, None),
    "tasks": (Sequence, Task), "secondary": (Sequence, Task), "limits": (Sequence, Limit),
    "phases": (Sequence, Phase), "controllers": (Mapping, Controller), "grasp_of": (Mapping, Grasp),
    "grasps": (Grasp | Mapping, Grasp), "weights": (Mapping | None, Real), "plant": (Plant, None),
    "held": (HeldObject, None), "disturbance": (Disturbance, None), "solver": (Solver, None),
    "budget": (Budget, None), "seed": (Integral, None), "dt": (Real, None),
    "duration": (Real, None), "kappa": (Real, None), "on_infeasible": (str, None),
    "inputs": (Mapping, InputSettings), "catalog": (Catalog, None), "folder": (Path | None, None),
}  # fmt: skip


def _strangers(scenario: Scenario) -> Iterator[str]:
    """Fields that are of another type than they must be."""
    for name, (kind, part) in KINDS.items():
        value = getattr(scenario, name)
        text = isinstance(value, str) and kind is Sequence
        if text or not isinstance(value, kind) or (isinstance(value, bool) and kind is not bool):
            yield f"{name}: found {value!r:.60}, needs {_called(kind)}"
        elif part is not None and isinstance(value, Mapping | Sequence):
            inside = value.values() if isinstance(value, Mapping) else value
            for found in inside:
                if not isinstance(found, part):
                    yield f"{name}: found {found!r:.60} in it, needs {_called(part)}"


def _called(kind: Any) -> str:
    words = {Real: "a number", Integral: "a whole number", str: "a text", Mapping: "a mapping"}
    return words.get(kind) or f"a {getattr(kind, '__name__', str(kind))}"


def start_of(robot: RobotModel, start: Start) -> tuple[Start, dict[str, float]]:
    """The start of the robot's joints, and of the grasps' passive joints ("right.hinge")."""
    arms = arm_names(robot)
    own, passive = dict(start), {}
    for key, value in start.items():
        arm, dot, _ = key.rpartition(".")
        if dot and arm in arms and key not in robot.joint_names:
            numbers = np.atleast_1d(near(key, array(key, own.pop(key))))
            if numbers.shape != (1,):
                raise InvalidValueError(f"{key}: found {value}, needs one number").at(key)
            passive[key] = float(numbers[0])
    return own, passive


def by_arm(robot: RobotModel, value: Mapping[str, float]) -> dict[str, float | list[float]]:
    """A start by arm, and by name for joints of no arm and passive ones, from one by joint."""
    start: dict[str, float | list[float]] = {
        arm.name: [value[joint] for joint in robot.arm_joints(arm)] for arm in robot.arms
    }
    moved = {joint for arm in robot.arms for joint in robot.arm_joints(arm)}
    return start | {name: x for name, x in value.items() if name not in moved}


def from_degrees(robot: RobotModel, grasps: Grasp | Mapping[str, Grasp], start: Start) -> Start:
    """A start in radians and metres from one in degrees and metres.

    Args:
        robot: whose start it is.
        grasps: one for all arms, or one for each by the arm's name.
        start: by arm, joint or passive joint; degrees, metres where a joint slides.
    """
    units = dict(zip(robot.joint_names, robot.joint_units, strict=True))
    for arm in robot.arms:
        grasp = grasps.get(arm.name) if isinstance(grasps, Mapping) else grasps
        for passive in grasp.passive_joints(np.eye(3)) if grasp else ():
            units[f"{arm.name}.{passive.name}"] = unit_of(passive.joint)
    joints = {arm.name: robot.arm_joints(arm) for arm in robot.arms}
    converted: dict[str, float | list[float]] = {}
    for key, value in start.items():
        # Names and counts that are wrong are refused where the start is used.
        slides = [units.get(joint) == "m" for joint in joints.get(key, (key,))]
        if np.size(value) == len(slides):
            kept = np.reshape(slides, np.shape(value))
            converted[key] = np.where(kept, value, np.radians(value)).tolist()
        else:
            converted[key] = np.radians(value).tolist()
    return converted


def arm_names(robot: RobotModel) -> set[str]:
    """Names of the robot's arms."""
    return {arm.name for arm in robot.arms}
