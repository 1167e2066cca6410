"""A scenario: everything about one motion, ready to build."""

from __future__ import annotations

import functools
import itertools
import math
import types
import typing
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import MISSING, dataclass, field, replace
from functools import cached_property
from numbers import Integral, Real
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field

from coopqp.assessment.limits import audit
from coopqp.base.errors import CoopqpError, Fault, InvalidValueError, ScenarioError
from coopqp.base.reading import absolute
from coopqp.base.spec import Array, Name, NonNegative, Pose, Positive, type_name
from coopqp.base.table import Table
from coopqp.base.wording import dotted
from coopqp.closed_loop.forces import contact_faults
from coopqp.controller import Controller, ControlProblem, OnInfeasible, period_fault
from coopqp.grasp import Grasp
from coopqp.grasps import Rigid
from coopqp.limit import Limit
from coopqp.limits import JointPosition, JointVelocity
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.grasp_configuration import HeldObject
from coopqp.model.loop_observer import Observer
from coopqp.model.state import State
from coopqp.plant import Disturbance, Plant, PlantModel
from coopqp.plants import Kinematic
from coopqp.robot import Robot, RobotModel
from coopqp.scenario.catalog import Catalog
from coopqp.scenario.faulty_plant import FaultyPlant, Injected
from coopqp.scenario.input import STANDS, InputSettings, wanted
from coopqp.scenario.start import Start, joints_outside, passive_outside, pose_of, start_of
from coopqp.scenario.start_solver import solve_start
from coopqp.scenario.yaml import Wrong, has_files, parsed, with_keys
from coopqp.signal import Kind
from coopqp.solver import Budget, Solver
from coopqp.solvers import Daqp
from coopqp.task import Task

#: Most ticks times joints of all controllers together: traces of 0.6 GB, reports of 2 GB.
MAX_KEPT = 4_000_000

#: Fields from which the closed chain follows, beside the robot.
OF_CHAIN = {"start", "grasps", "grasp_of", "held", "weights", "phases"}
UNIONS = (typing.Union, types.UnionType)


class Key(NamedTuple):
    """How a file says a field, where it does so otherwise than Python."""

    name: str = ""  # there; the field's own if empty
    form: Any = None  # type there; the field's own if None
    default: Any = MISSING  # there; the field's own if omitted, and the key is needed if ``...``


#: Marks a field that no key of a file stands for alone.
NO_KEY = Key("-")

Tasks = Annotated[tuple[Task, ...], Field(min_length=1)]
"""What a file has in it where it has tasks."""


@dataclass(frozen=True, kw_only=True)
class Phase:
    """A part of a scenario in which the same arms hold the object and the same tasks count.

    Between two phases arms let go of the object or take hold of it
    (:meth:`ClosedChain.handed_over`). Time, and with it every reference, begins anew in each phase.
    """

    name: Annotated[str, Key(form=Name, default=...)] = ""
    """Yours."""
    duration: Positive
    """Length [s]; time begins anew in each phase."""
    released: tuple[str, ...] = ()
    """Arms that do not hold the object; all others do. Where none does it stands."""
    tasks: Annotated[Sequence[Task], Key(form=Tasks)]
    """What shall happen."""
    leads: Annotated[bool, NO_KEY] = False
    """Whether it is the way of a plan to where the next one's tasks are met."""

    def ticks(self, dt: float) -> int:
        """Number of control periods of dt [s]."""
        return max(1, round(self.duration / dt))


@dataclass(frozen=True, kw_only=True)
class Scenario:
    """One motion to be controlled, and with what.

    The fields with a docstring are the keys of a scenario file, with those that only files have
    (:class:`coopqp.scenario.form.FileKeys`). InvalidValueError: a field is of another type, or a dt
    or duration is no time.
    """

    name: Annotated[str, NO_KEY]  #: Of its file.
    description: str = ""
    """One sentence for the report."""
    robot: Robot
    """Which robot."""
    start: Annotated[Start, NO_KEY]  #: Where it begins, by arm, joint or passive joint [rad, m].
    start_outside: bool = False
    """Whether joints may start outside their limits."""
    #: How the arms hold the object; one for all, or by arm.
    grasps: Annotated[Grasp | Mapping[str, Grasp], NO_KEY] = field(default_factory=Rigid)
    grasp_of: Mapping[str, Grasp] = field(default_factory=dict)
    """Grasp of controllers that hold it otherwise, by name."""
    held: Annotated[HeldObject, Key("object")] = field(default_factory=HeldObject)
    """What is held."""
    weights: Mapping[str, NonNegative] | None = None
    """Weight of each arm in the object's pose, sum 1; the same if omitted."""
    tasks: Annotated[tuple[Task, ...], Key(form=Tasks | None, default=None)] = ()
    """What the object shall do."""
    phases: Annotated[
        tuple[Phase, ...],
        Key(form=Annotated[list[Phase], Field(min_length=1)] | None, default=None),
    ] = ()
    """One after the other, instead of tasks and duration, when arms let go of the object or take
    hold of it."""
    #: Those of controllers that do not follow the plan of the others, by name.
    phases_of: Annotated[Mapping[str, tuple[Phase, ...]], NO_KEY] = field(default_factory=dict)
    secondary: tuple[Task, ...] = ()
    """Objectives for what the tasks leave free."""
    limits: tuple[Limit, ...] = field(default_factory=lambda: (JointPosition(), JointVelocity()))
    """Hard bounds; joint position and velocity if omitted."""
    controllers: Annotated[
        Mapping[str, Controller],
        Key(
            form=Annotated[list[Controller], Field(min_length=1)],
            default=["qp", "pseudoinverse", "pseudoinverse_null_space"],
        ),
    ] = field(default_factory=dict)
    """What is compared."""
    plant: Plant = field(default_factory=Kinematic)
    """What is controlled."""
    inputs: Mapping[str, InputSettings] = field(default_factory=dict)
    """Values that arrive from outside while it runs, by name; tasks follow them by input: NAME."""
    disturbance: Disturbance = field(default_factory=Disturbance)
    """Errors and disturbances unknown to the controllers."""
    solver: Solver = field(default_factory=Daqp)
    """For the QP controllers."""
    solver_name: Annotated[str, NO_KEY] = "daqp"
    budget: Budget = field(default_factory=Budget)
    """What a solution may be off by."""
    dt: Positive = 0.01
    """Control period [s]."""
    duration: Annotated[float, Key(form=Positive | None, default=None)] = 0.0
    """Length of the run [s]."""
    kappa: Annotated[float, Key(form=NonNegative | None, default=None)] = math.inf
    """Baumgarte gain, J_c v = -kappa e [1/s]; at most 1/dt, the default, and 10 by torques; 0 is
    the paper's law."""
    on_infeasible: OnInfeasible = "scale"
    """scale, hold or stop when not all can hold."""
    observer: Observer = field(default_factory=Observer)
    """How the model's error is told from a squeeze, where joints are measured."""
    seed: Annotated[int, Field(ge=0)] = 0
    """Of everything random."""
    source: Annotated[str, NO_KEY] = ""  #: Text of the file it was read from.
    #: In which relative paths of the source begin; None where it has none.
    folder: Annotated[Path | None, NO_KEY] = None
    #: The plan that it follows.
    follows: Annotated[Table | None, NO_KEY] = field(default=None, repr=False, compare=False)
    #: What it can name; its metrics are measured.
    catalog: Annotated[Catalog, NO_KEY] = field(default_factory=Catalog, repr=False, compare=False)

    def __post_init__(self) -> None:
        wrong_types = {key: _wrong_type(getattr(self, key), hint) for key, hint in _hints().items()}
        if found := [f"{key}: {message}" for key, message in wrong_types.items() if message]:
            raise InvalidValueError("\n".join(found))
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
        """The source, or else JSON, as it can be read from another folder on this machine."""
        return with_keys(self.source, {"folder": str(self.folder)}) if self.folder else self.source

    def keys_with(self, plan: Path) -> dict[str, Any]:
        """What the source's folder, None for none, and reference become beside a plan."""
        data = parsed(Path(self.name), self.source).data
        reference = data.pop("reference", None) or {}
        others = has_files(data)
        reference["plan"] = str(absolute(plan)) if others else plan.name
        return {"folder": str(self.folder) if others else None, "reference": reference}

    def held_by(self, controller: str) -> Scenario:
        """The scenario with the grasp that this controller uses, and its phases."""
        phases = self.phases_of.get(controller)
        own = self if phases is None else self.changed(phases=phases, phases_of={})
        grasp = self.grasp_of.get(controller)
        if grasp is None:
            return own
        start = start_of(self.robot_model, self.start)[0]  # other grasps, other passive joints
        return own.changed(grasps=grasp, grasp_of={}, start=start)

    def changed(self, **changes: Any) -> Scenario:
        """With other fields than these; robot and chain that do not change are not built again."""
        other, built = replace(self, **changes), {"robot_model", "chain"} & vars(self).keys()
        kept = (
            set() if "robot" in changes else built - {"chain"} if OF_CHAIN & {*changes} else built
        )
        vars(other).update({name: vars(self)[name] for name in kept})
        return other

    def fits(self, start: Start) -> bool:
        """Whether the first phase may begin there, by all limits of place that can be asked."""
        with suppress(CoopqpError):
            problem = self.changed(start=start).problem()
            q, v = np.vstack([problem.chain.q_start] * 2), np.zeros((1, problem.chain.n))
            found = audit(problem.limits, problem.chain, q, v, self.dt).margins
            return all(margin.min() >= 0.0 for row, margin in found.items() if row.of_place)
        return True

    def placed(
        self,
        *,
        object_pose: Pose | ArrayLike | None = None,
        start: Start | Literal["solve"] | None = None,
    ) -> Scenario:
        """The same scenario with the object elsewhere, the arms, or both, in some milliseconds.

        Args:
            object_pose: in the world, instead of the file's ``object.pose``: a :class:`Pose`, or x,
                y, z [m] and a quaternion x, y, z, w.
            start: by arm or joint, instead of the file's [rad, m]; "solve" finds the one nearest to
                the file's in which hands reach their ``object_in_hand``, which takes a second.

        Raises:
            CoopqpError: what a file with this start and pose would be refused for. Tasks are not
                tried again.
        """
        robot, held = self.robot_model, self.held
        if object_pose is not None:
            held = replace(held, pose=pose_of(object_pose, self.chain))
        if isinstance(start, str) and start == "solve":
            near = start_of(robot, self.start)[0]
            start = solve_start(
                robot, self.grasps, held, near=near, seed=self.seed, fits=self.fits
            ).start
        elif not isinstance(start, Mapping | None):
            found = repr(start) if isinstance(start, str) else f"a {type(start).__name__}"
            words = "needs joints or solve; joints by arm or by name"
            raise InvalidValueError(f"start: found {found}, {words}").at("start")
        other = self.changed(source="", held=held, start=self.start if start is None else start)
        of_robot, passive = start_of(robot, other.start)
        allowed, q = self.start_outside, robot.configuration(of_robot)
        wrong = [] if allowed else [*joints_outside(robot, of_robot, q, "start")]
        if not wrong:
            chain = other.chain
            wrong = [Wrong(["grasps", arm], words) for arm, words in contact_faults(chain)]
            if not allowed:
                wrong += passive_outside(chain, passive, "start")
                if self.follows and (words := off_plan(chain, self.follows)):
                    wrong.append(Wrong(["reference"], words))
                for i, limit in enumerate(self.limits):
                    wrong += [Wrong(["limits", i], words) for words in limit.start_faults(chain)]
        if wrong:
            raise ScenarioError([Fault(dotted(where), words) for where, words, *_ in wrong])
        return other

    @cached_property
    def schedule(self) -> tuple[Phase, ...]:
        """The phases one after the other; one where all arms hold on throughout."""
        return self.phases or (Phase(tasks=self.tasks, duration=self.duration),)

    @cached_property
    def first_ticks(self) -> tuple[int, ...]:
        """At which tick each phase begins."""
        ticks = [phase.ticks(self.dt) for phase in self.schedule]
        return tuple(itertools.accumulate(ticks[:-1], initial=0))

    @property
    def stands(self) -> bool:
        """Whether no arm holds the object in some phase."""
        arms = {arm.name for arm in self.robot_model.arms}
        return any(arms.issubset(phase.released) for phase in self.phases)

    @property
    def ticks(self) -> int:
        """Number of control periods."""
        return self.first_ticks[-1] + self.schedule[-1].ticks(self.dt)

    def check_size(self) -> None:
        """Refuse runs of which more would be kept than ``MAX_KEPT``."""
        each = max(1, len(self.controllers)) * len(self.robot_model.joint_names)
        if self.ticks * each > MAX_KEPT:
            raise InvalidValueError(
                f"found {self.ticks} ticks, more than are kept; needs at most {MAX_KEPT // each} "
                f"with {len(self.controllers)} controllers and {len(self.robot_model.joint_names)} "
                "joints, so make the run shorter, or dt longer"
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
        return ClosedChain.attach(
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
        """What controllers are built for, in a phase and its first chain; by default the first."""
        phase = phase or self.schedule[0]
        tasks = phase.tasks
        return ControlProblem(
            chain=(chain or self.chain).keeping_away(self._away(phase)),
            tasks=tuple(task for task in tasks if not task.of_forces),
            wrenches=tuple(task for task in tasks if task.of_forces),
            secondary=self.secondary,
            limits=self.limits,
            dt=self.dt,
            kappa=self.kappa,
            solver=self.solver,
            budget=self.budget,
            on_infeasible=self.on_infeasible,
            observer=self.observer,
        )

    def _away(self, phase: Phase) -> tuple[str, ...]:
        """Arms that are released in a phase, with its planned way, or the one before or after."""
        part = list(itertools.accumulate((not one.leads for one in self.schedule), initial=0))
        for i, one in zip(part, self.schedule, strict=False):
            if one is phase or (phase.name and one.name == phase.name):
                near = [x for k, x in zip(part, self.schedule, strict=False) if abs(k - i) < 2]
                return tuple(a for a in phase.released if all(a in x.released for x in near))
        return ()

    def simulated(self, problem: ControlProblem) -> PlantModel:
        """The plant of one of its problems, with the faults of sensors and motors."""
        faults = [Injected(i, x, problem.chain) for i, x in enumerate(self.disturbance.faults)]
        plant = self.plant.build(problem, self.seed, self.disturbance)
        return FaultyPlant(plant, problem, faults) if faults else plant

    def problems(self, where: Callable[[int], Array]) -> Iterator[ControlProblem]:
        """The problem of each phase; ``where`` gives the q in which a later one begins, if due."""
        chain = self.chain
        for phase, first in zip(self.schedule, self.first_ticks, strict=True):
            if first:
                chain = chain.handed_over(where(first), phase.released)
            yield self.problem(phase, chain)

    def followed(self) -> dict[str, Kind]:
        """What the inputs are that tasks of any phase follow, by name."""
        found = dict[str, Kind]()
        for problem in self.problems(lambda _: self.chain.q_start):
            inputs = wanted(problem.all_tasks, State(problem.chain))
            found |= {name: kind for name, (kind, _) in inputs.items()}
        return found


#: What Python may give where a field says so, and what it is called in messages.
WIDER: dict[Any, tuple[Any, str]] = {
    float: (Real, "a number"), int: (Integral, "a whole number"), str: (str, "a text"),
    bool: (bool, "true or false"), Literal: (str, "a text"), tuple: (Sequence, "a Sequence"),
    Mapping: (Mapping, "a mapping"),
}  # fmt: skip


@functools.cache
def _hints() -> dict[str, Any]:
    return typing.get_type_hints(Scenario)


def _wrong_type(value: Any, hint: Any) -> str:
    """What is wrong with a value that is of another type than it must be; empty where it is not."""
    options = typing.get_args(hint) if typing.get_origin(hint) in UNIONS else (hint,)
    needed = []
    for option in options:
        origin = typing.get_origin(option) or option
        kind, called = WIDER.get(origin, (origin, f"a {origin.__name__}"))
        truth = isinstance(value, bool) and kind is not bool
        truth = truth or (isinstance(value, str) and kind is Sequence)
        if isinstance(value, kind) and not truth:
            part = [p for p in typing.get_args(option) if isinstance(p, type) and p is not str]
            inside = value.values() if isinstance(value, Mapping) else value
            words = [words for x in inside if (words := _wrong_type(x, part[0]))] if part else []
            return words[0].replace(", needs", " in it, needs") if words else ""
        needed += [called] if option is not type(None) else []
    return f"found {value!r:.60}, needs {' or '.join(needed)}"


def off_plan(chain: ClosedChain, plan: Table) -> str:
    """Where a plan begins elsewhere; empty if near enough that a run goes to where it begins."""
    off = np.abs(plan.take(chain.joint_names)[0] - chain.q_start)
    joint = chain.joint_names[int(off.argmax())]
    words = f"begins {off.max():.3g} from the start of {joint}; plan the way anew from here"
    words += " (is it in degrees?)" if off.max() > 2.0 * np.pi else ""
    return f"{plan.path}: {words}" if off.max() > STANDS else ""


def needs_scenario(found: object) -> None:
    """InvalidValueError of what is no scenario, such as the name of one."""
    if not isinstance(found, Scenario):
        words = "use coopqp.load" if isinstance(found, str) else "needs a Scenario"
        raise InvalidValueError(f"scenario: found {found!r}; {words}")
