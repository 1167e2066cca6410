"""What of a scenario can only be checked by building it: start, grasps, phases and tasks."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from typing import Any, TypeVar

from coopqp.checked import Array
from coopqp.closed_chain import ClosedChain
from coopqp.closed_loop.forces import contact_faults
from coopqp.controller import TELL_APART
from coopqp.errors import (
    CoopqpError,
    Fault,
    MissingDependencyError,
    ScenarioError,
    unknown_name,
)
from coopqp.hold import arm_weights, grasp_of_each
from coopqp.input import Feed, Inputs, wanted
from coopqp.limits import JointAcceleration, JointPosition
from coopqp.robot import RobotModel
from coopqp.row import names_of
from coopqp.scenario.known import Alike, Checked, Known
from coopqp.scenario.phase import Phase
from coopqp.scenario.scenario import Scenario, Start, arm_names, start_of
from coopqp.scenario.trial import Places, blamed, try_limit, try_task
from coopqp.scenario.unit_hints import like_degrees, too_large
from coopqp.scenario.yaml import YamlFile
from coopqp.state import State
from coopqp.task import Task
from coopqp.wording import Location

T = TypeVar("T")
Placed = tuple[Location, Task, Phase]
"""A task with its place in the file, and its phase."""

#: A control period that no robot has; with it, dt is what makes a run too long [s].
SHORT = 1e-4


def placed_tasks(scenario: Scenario) -> Iterator[Placed]:
    """Every task with its place in the file; secondary ones count in the shortest phase."""
    for i, phase in enumerate(scenario.schedule):
        inside: Location = ["phases", i] if scenario.phases else []
        for j, task in enumerate(phase.tasks):
            yield [*inside, "tasks", j], task, phase
    shortest = min(scenario.schedule, key=lambda phase: phase.duration)
    for j, task in enumerate(scenario.secondary):
        yield ["secondary", j], task, shortest


def check_start(file: YamlFile, scenario: Scenario, known: Known) -> None:
    """Build what can fail and refuse a start outside the limits.

    Args:
        file: of the scenario.
        scenario: as read.
        known: what is the same as before is not tried again; written.
    """
    key = "start" if "start" in file.data else "start_deg"
    robot = built(file, ["robot"], lambda: scenario.robot_model)
    of_robot, passive = built(file, [key], lambda: start_of(robot, scenario.start))
    q = built(file, [key], lambda: robot.configuration(of_robot))
    built(file, ["weights"], lambda: arm_weights(robot, scenario.weights))
    built(file, ["grasps"], lambda: grasp_of_each(robot, scenario.grasps))
    allowed = file.data.get("start_outside", False)
    faults = _released(file, scenario)
    if not allowed:
        faults += [
            Fault(file.place(location), message)
            for location, message in outside_limits(robot, of_robot, q, key)
        ]
    if faults:
        raise ScenarioError(faults)
    built(file, _longest(scenario), scenario.check_size)
    alike = known.lend_chain(file.data, scenario)
    try:
        chain = scenario.chain
    except CoopqpError as error:
        argument, *inside = error.keys or ("grasps",)
        grasp = "grasps" if "grasps" in file.data else "grasp"
        location = {"passive_start": key, "robot": "robot"}.get(str(argument), grasp)
        where = [location] if location == "grasp" else [location, *inside]
        raise ScenarioError([Fault(file.place(where), str(error))]) from None
    if wrong := too_large(chain):
        raise ScenarioError([Fault(file.place(["object", "size"]), wrong)])
    if not allowed:
        _check_passive(file, chain, passive, key)
    places = _places(scenario, alike)
    _check_contacts(file, places)
    first, others = places[scenario.schedule[0].name], [
        placed for placed in placed_tasks(scenario) if not alike.task(*placed[:2])
    ]  # fmt: skip
    faults = _broken_tasks(file, others, places)
    faults += [] if alike.limits else _broken_limits(file, scenario, first)
    faults = faults or list(_broken_inputs(file, scenario, others, places))
    if not allowed and not faults and not alike.limits:
        faults = [
            Fault(file.place(["limits", i]), words)
            for i, limit in enumerate(scenario.limits)
            for words in limit.start_faults(scenario.chain)
        ]
    if faults:
        raise ScenarioError(faults)
    _check_plant(file, scenario)
    known.last = Checked(file.data, scenario, places)


def _check_plant(file: YamlFile, scenario: Scenario) -> None:
    """Build what is controlled, unless a package for it is missing: running says so."""
    problem = next(scenario.problems(lambda _: scenario.chain.q_start))
    try:
        with blamed(scenario.plant, "build"):
            scenario.plant.build(problem, scenario.seed, scenario.disturbance)
    except MissingDependencyError:
        return
    except CoopqpError as error:
        location = "disturbance" if "disturbance" in error.keys else "plant"
        raise ScenarioError([_fault(file, [location], error)]) from None


def _check_contacts(file: YamlFile, places: Mapping[str, Places]) -> None:
    """Refuse hands that press away from the object, or cannot hold it at rest, in some phase."""
    faults = []
    found = (fault for place in places.values() for fault in contact_faults(place.start.chain))
    for arm, words in dict.fromkeys(found):
        where: Location = ["grasps", arm] if arm and "grasps" in file.data else ["grasps"]
        place = where if "grasps" in file.data else ["grasp"]
        faults.append(
            Fault(file.place(place), words if where[1:] or not arm else f"{arm}: {words}")
        )
    if faults:
        raise ScenarioError(faults)


def _longest(scenario: Scenario) -> Location:
    """What makes a run long: a phase's duration, or the control period where that is shorter."""
    if scenario.dt < SHORT:
        return ["dt"]
    durations = [phase.duration for phase in scenario.phases]
    return ["phases", durations.index(max(durations)), "duration"] if durations else ["duration"]


def _released(file: YamlFile, scenario: Scenario) -> list[Fault]:
    """Phases in which an arm lets go that does not exist, or all of them."""
    arms, faults = arm_names(scenario.robot_model), []
    for i, phase in enumerate(scenario.phases):
        place = file.place(["phases", i, "released"])
        strangers = [name for name in phase.released if name not in arms]
        faults += [Fault(place, unknown_name("arm", name, arms)) for name in strangers]
        if arms.issubset(phase.released):
            faults.append(Fault(place, "no arm is left that holds the object; keep at least one"))
    return faults


def _places(scenario: Scenario, alike: Alike) -> dict[str, Places]:
    """Where plug-ins are tried, by phase.

    The later phases are tried where the first begins: nobody knows yet where the motion leads.
    """
    problems = scenario.problems(lambda _: scenario.chain.q_start)
    phases = zip(scenario.schedule, problems, strict=True)
    return {phase.name: Places(problem.chain, alike.place(phase.name)) for phase, problem in phases}


def _broken_tasks(
    file: YamlFile, tasks: Sequence[Placed], places: Mapping[str, Places]
) -> list[Fault]:
    """Tasks that name what is not there or break a promise; each is tried in its phase."""
    faults = []
    for place, task, phase in tasks:
        try:
            try_task(task, places[phase.name], phase.duration)
        except CoopqpError as error:
            faults.append(_fault(file, place, error))
    return faults


def _broken_inputs(
    file: YamlFile, scenario: Scenario, tasks: Sequence[Placed], places: Mapping[str, Places]
) -> Iterator[Fault]:
    """Inputs that are not there, or cannot be what the tasks want, and files that feed others."""
    for place, task, phase in tasks:
        start, used = State(places[phase.name].start.chain), partial(_used, file.data, place)
        for name, (_, here) in wanted([task], start).items():
            if name not in scenario.inputs:
                words = unknown_name("input", name, scenario.inputs)
                yield Fault(file.place(used(name)), words)
                continue
            try:
                asked = (task, *scenario.secondary)
                Feed(scenario.inputs, Inputs(scenario.inputs, asked, start, scenario.dt))
            except CoopqpError as error:
                where = used(name) if here is None else ["inputs", name]
                yield Fault(file.place(where), str(error))
    try:
        for phase in scenario.schedule:
            chain = places[phase.name].start.chain
            wanted((*phase.tasks, *scenario.secondary), State(chain))
    except CoopqpError as error:
        yield Fault(file.place(["inputs"]), str(error))


def _used(data: Any, place: Location, name: str) -> Location:
    """Where in a task an input is used."""
    for key in place:
        data = data[key]
    waiting: list[tuple[list[str | int], Any]] = [([*place], data)]
    while waiting:
        where, found = waiting.pop()
        if isinstance(found, dict):
            given = found.get("input")
            if given == name or (isinstance(given, dict) and given.get("name") == name):
                return where
            waiting += [([*where, key], inside) for key, inside in found.items()]
    return place


def _broken_limits(file: YamlFile, scenario: Scenario, places: Places) -> list[Fault]:
    """Limits that name what is not there or break a promise, and two rows with one name."""
    taken, faults = set[str](), []
    for i, limit in enumerate(scenario.limits):
        try:
            try_limit(limit, places, scenario.dt)
        except CoopqpError as error:
            faults.append(_fault(file, ["limits", i], error))
            continue
        rows = set(names_of(limit.rows(scenario.chain)))
        if twice := sorted(rows & taken):
            cure = TELL_APART if hasattr(limit, "name") else "leave one of them out"
            words = f"another limit has a row '{twice[0]}' too; {cure}"
            faults.append(Fault(file.place(["limits", i]), words))
        taken |= rows
    return [*faults, *_late_brakes(file, scenario)]


def _late_brakes(file: YamlFile, scenario: Scenario) -> list[Fault]:
    """Joints that would brake for a bound behind the one that they must not pass."""
    margin = max((k.margin for k in scenario.limits if isinstance(k, JointPosition)), default=0.0)
    return [
        Fault(
            file.place(["limits", i]),
            f"margin: found {limit.margin:g}, needs at least joint_position's {margin:g}, so that "
            "joints brake in time",
        )
        for i, limit in enumerate(scenario.limits)
        if isinstance(limit, JointAcceleration) and limit.margin < margin
    ]


def _check_passive(
    file: YamlFile, chain: ClosedChain, passive: Mapping[str, float], key: str
) -> None:
    faults = []
    for name in passive:
        i = chain.joint_names.index(name)
        value, low, high = chain.q_start[i], chain.lower[i], chain.upper[i]
        if not low <= value <= high:
            words = _outside(name, value, (low, high), _unit(chain.joint_units[i], key))
            faults.append(Fault(file.place([key, name]), words))
    if faults:
        raise ScenarioError(faults)


def outside_limits(
    robot: RobotModel, start: Start, q: Array, key: str
) -> list[tuple[Location, str]]:
    """Where a start leaves the position limits, and by how much."""
    if key == "start" and like_degrees(robot, q):
        words = "found angles of more than a turn, which are inside the limits in degrees"
        return [([key], f"{words}; did you mean start_deg?")]
    faults: list[tuple[Location, str]] = []
    lower, upper = robot.model.lowerPositionLimit, robot.model.upperPositionLimit
    arms = {arm.name: robot.arm_joints(arm) for arm in robot.arms}
    joints_of_robot = zip(robot.joint_names, robot.joint_units, q, lower, upper, strict=True)
    for joint, unit, value, low, high in joints_of_robot:
        if low <= value <= high:
            continue
        location: list[str | int] = [key, joint]
        for arm, joints in arms.items():
            if arm in start and joint in joints and joint not in start:
                location = [key, arm, joints.index(joint)]
        faults.append((location, _outside(joint, value, (low, high), _unit(unit, key))))
    return faults


def _unit(unit: str, key: str) -> str:
    """The unit in which the file gives a joint's start."""
    return "degrees" if unit == "rad" and key == "start_deg" else unit


def _outside(joint: str, value: float, limits: tuple[float, float], unit: str) -> str:
    scale = math.degrees(1.0) if unit == "degrees" else 1.0
    low, high = limits
    return (
        f"{joint} starts at {value * scale:.6g} {unit}, outside its limits "
        f"{low * scale:.6g} to {high * scale:.6g}; or say start_outside: true to see it come back"
    )


def built(file: YamlFile, location: Location, build: Callable[[], T]) -> T:
    """What a function builds; its error gets a place in the file.

    Raises:
        ScenarioError: with one fault.
    """
    try:
        return build()
    except ScenarioError:
        raise
    except CoopqpError as error:
        raise ScenarioError([_fault(file, location, error)]) from None


def _fault(file: YamlFile, location: Location, error: CoopqpError) -> Fault:
    """An error that was raised by what is at a location, or by what is in it."""
    return Fault(file.place(location, error.keys), str(error))
