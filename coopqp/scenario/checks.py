"""What of a scenario can only be checked with its parts together, or by building it.

Checks yield what is wrong and where; :meth:`coopqp.scenario.yaml.YamlFile.lines` knows the lines.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import fields
from functools import partial, reduce
from operator import getitem
from typing import Any

from coopqp.base.errors import CoopqpError, MissingDependencyError, ScenarioError, unknown_name
from coopqp.base.qp import names_of
from coopqp.base.spec import taken_names
from coopqp.base.wording import Location
from coopqp.closed_loop.admittance import unstated
from coopqp.closed_loop.forces import contact_faults
from coopqp.controller import TELL_APART, problem_faults
from coopqp.controllers.qp import QPController
from coopqp.limits import JointAcceleration, JointPosition
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.grasp_configuration import arm_weights, grasp_of_each
from coopqp.model.state import State
from coopqp.plant import Disturbance
from coopqp.scenario.input import Feed, Inputs, wanted
from coopqp.scenario.scenario import Phase, Scenario
from coopqp.scenario.start import joints_outside, passive_outside, start_of
from coopqp.scenario.trial import Places, blamed, try_limit, try_task
from coopqp.scenario.yaml import MisplacedError, Wrong
from coopqp.signal import CLOCK
from coopqp.task import Task, TaskStack

Placed = tuple[Location, Task, Phase]
"""A task with its place in the file, and its phase."""

#: A control period that no robot has; with it, dt is what makes a run too long [s].
SHORT = 1e-4
#: Keys of the file from which a chain follows, beside the start and the object.
CHAIN = ("robot", "grasp", "grasps", "weights", "folder")
#: Keys of the object that no task and no limit of the motion sees.
INERTIAL = ("mass", "com", "inertia")
#: An object whose longest edge is this many times the arms' reach cannot be meant [-].
LARGE = 20.0


def refuse(found: Iterable[Wrong]) -> None:
    """Raise all that is wrong; nothing if there is nothing."""
    if listed := list(found):
        raise MisplacedError(listed)


@contextmanager
def at(place: Location) -> Iterator[None]:
    """Give an error of what is built meanwhile the place of what it is built from."""
    try:
        yield
    except ScenarioError:
        raise
    except CoopqpError as error:
        raise MisplacedError([Wrong(place, str(error), error.keys)]) from None


def contradictions(
    given: Mapping[str, Any], scenario: Scenario, *, needs_start: bool
) -> Iterator[Wrong]:
    """What only shows with all keys together, and nothing is built for."""
    if given.get("grasp") and given.get("grasps"):
        yield Wrong(["grasps"], "give grasp (all arms) or grasps (by arm), not both")
    starts = [key for key in ("start", "start_deg") if key in given]
    if len(starts) == 2 or (needs_start and not starts):
        place = ["start_deg"] if "start" in given else []
        yield Wrong(place, "give one of start (radians) and start_deg (degrees)")
    for i, taken in taken_names([phase.name for phase in scenario.phases]):
        yield Wrong(["phases", i, "name"], taken)
    for i, taken in taken_names([controller.name for controller in given["controllers"]]):
        yield Wrong(["controllers", i], f"{taken}; {TELL_APART}")
    yield from _of_problems(scenario)
    for name in scenario.grasp_of:
        if name not in scenario.controllers:
            yield Wrong(["grasp_of", name], unknown_name("controller", name, scenario.controllers))
    given_to, plant = scenario.disturbance, scenario.plant
    for key in () if plant.takes_torques else (own.name for own in fields(Disturbance)):
        ignored = getattr(given_to, key) != getattr(given_to.kinematic, key)
        if ignored and key not in plant.feels:
            yield Wrong(["disturbance", key], "has no effect on this plant; use one with masses")


def _of_problems(scenario: Scenario) -> Iterator[Wrong]:
    """What of each phase a controller could not be built for, and what it cannot end."""
    schedule = scenario.schedule
    if scenario.dt > min(phase.duration for phase in schedule):
        yield Wrong(["dt"], f"found {scenario.dt} s; needs at most the duration")
    for i, phase in enumerate(schedule):
        inside: Location = ["phases", i] if scenario.phases else []
        found = problem_faults(scenario.dt, scenario.drift_gain, phase.tasks, scenario.secondary)
        for place, message in found:
            yield Wrong([*inside, *place] if place[0] == "tasks" else place, message)
    tasks = list(placed_tasks(scenario))
    for place, task, phase in tasks:
        yield from _of_end(place, task, phase.duration)
    forces = [task.name for _, task, _ in tasks if task.of_forces]
    for i, controller in enumerate(scenario.controllers.values()):
        if forces and isinstance(controller, QPController) and not controller.admittance:
            yield Wrong(["controllers", i], unstated(forces[0]))


def _of_end(place: Location, task: Task, duration: float) -> Iterator[Wrong]:
    try:
        with blamed(task):
            end = task.end
    except CoopqpError as error:
        yield Wrong(place, str(error))
        return
    if not end <= duration + 1e-9:
        yield Wrong(
            place,
            f"the reference of '{task.name}' arrives at {end:g} s, after the end at {duration:g} "
            "s; make it shorter or the duration longer",
        )


def placed_tasks(scenario: Scenario) -> Iterator[Placed]:
    """Every task with its place in the file; secondary ones count in the shortest phase."""
    schedule = scenario.schedule
    for i, phase in enumerate(schedule):
        inside: Location = ["phases", i] if scenario.phases else []
        for j, task in enumerate(phase.tasks):
            yield [*inside, "tasks", j], task, phase
    shortest = min(schedule, key=lambda phase: phase.duration)
    for j, task in enumerate(scenario.secondary):
        yield ["secondary", j], task, shortest


class Known:
    """What has been built and tried for one variant of a file after the other.

    Variants of one file differ in a key or two. What follows from the same parts of the file as in
    the variant before is taken from there.
    """

    def __init__(self) -> None:
        self._kept: dict[object, tuple[object, Any]] = {}

    def get(self, what: object, source: object) -> Any:
        """What was kept, if it follows from the same; else None."""
        before, found = self._kept.get(what, (None, None))
        return found if before == source else None

    def keep(self, what: object, source: object, found: Any = True) -> None:
        """Keep what has been built of a part of a file, or that it has passed."""
        self._kept[what] = source, found


def _at(data: Any, place: Location) -> Any:
    return reduce(getitem, place, data)


def check_start(data: Mapping[str, Any], scenario: Scenario, known: Known) -> None:
    """Build what can fail and refuse a start outside the limits."""
    key = "start" if "start" in data else "start_deg"
    allowed = data.get("start_outside", False)
    with at(["robot"]):
        robot = scenario.robot_model
    with at([key]):
        of_robot, passive = start_of(robot, scenario.start)
        q = robot.configuration(of_robot)
    with at(["weights"]):
        arm_weights(robot, scenario.weights)
    with at(["grasps"]):
        grasp_of_each(robot, scenario.grasps)
    outside = [] if allowed else joints_outside(robot, of_robot, q, key)
    refuse([*_released(scenario), *outside])
    with at(_longest(data, scenario)):
        scenario.check_size()
    # All from which a chain follows, but for the object's inertia, which it can exchange.
    released = [phase.released for phase in scenario.schedule]
    held = {k: x for k, x in (data.get("object") or {}).items() if k not in INERTIAL}
    of_chain = *(data.get(key) for key in CHAIN), scenario.start, released, held
    before, tried = known.get("chain", of_chain) or (None, dict[str, Places]())
    if before:
        chain = before.chain
        chain = chain if scenario.held == before.held else chain.carrying(scenario.held)
        vars(scenario)["chain"] = chain
    chain = _closed(data, scenario, key)
    refuse(_of_chain(scenario, chain))
    if not allowed:
        refuse(passive_outside(chain, passive, key))
    problems = list(scenario.problems(lambda _: chain.q_start))
    # Later phases are tried where the first begins: nobody knows yet where the motion leads.
    places = {
        phase.name: Places(problem.chain, tried.get(phase.name))
        for phase, problem in zip(scenario.schedule, problems, strict=True)
    }
    refuse(_badly_held(data, places))
    placed = list(placed_tasks(scenario))
    of_tasks = {
        tuple(place): (of_chain, data.get("inputs"), phase.duration, _at(data, place))
        for place, task, phase in (() if scenario.follows else placed)
        if not task.of_forces
    }
    tasks = [one for one in placed if not known.get(tuple(one[0]), of_tasks.get(tuple(one[0])))]
    of_limits = of_chain, [data.get(key) for key in ("limits", "dt", "start_outside")]
    wrong_plugins = [*_broken_tasks(tasks, places)]
    if new_limits := not known.get("limits", of_limits):
        wrong_plugins += _broken_limits(scenario, next(iter(places.values())))
    refuse(wrong_plugins)
    refuse(_alike(scenario, places))
    wrong_starts = [*_broken_inputs(data, scenario, tasks, places)]
    if not allowed and not wrong_starts and new_limits:
        for i, limit in enumerate(scenario.limits):
            wrong_starts += [Wrong(["limits", i], words) for words in limit.start_faults(chain)]
    refuse(wrong_starts)
    _check_plant(scenario)
    known.keep("chain", of_chain, (scenario, places))
    known.keep("limits", of_limits)
    for place, source in of_tasks.items():
        known.keep(place, source)


def _closed(data: Mapping[str, Any], scenario: Scenario, key: str) -> ClosedChain:
    try:
        return scenario.chain
    except CoopqpError as error:
        argument, *inside = error.keys or ("grasps",)
        grasp = "grasps" if "grasps" in data else "grasp"
        own = {"passive_start": key, "robot": "robot", "object": "object"}
        location = own.get(str(argument), grasp)
        where = [location] if location == "grasp" else [location, *inside]
        raise MisplacedError([Wrong(where, str(error))]) from None


def _of_chain(scenario: Scenario, chain: ClosedChain) -> Iterator[Wrong]:
    """An object that is too large, and joints of the observer that there are not."""
    longest = max(chain.held.size)
    if longest > LARGE * chain.reach:
        words = f"found an edge of {longest:g} m, but the arms reach {chain.reach:.2g} m"
        yield Wrong(["object", "size"], f"{words}; lengths are metres")
    own, names = scenario.observer, chain.joint_names
    if own.stiffness is not None and own.inertial_stiffness is not None:
        yield Wrong(["observer"], "found stiffness and inertial_stiffness; needs one of them")
    for key, given in (("stiffness", own.stiffness), ("dead_band", own.dead_band)):
        for name in given if isinstance(given, Mapping) else ():
            if name not in names:
                yield Wrong(["observer", key, name], unknown_name("joint", name, names))


def _check_plant(scenario: Scenario) -> None:
    """Build what is controlled, unless a package for it is missing: running says so."""
    try:
        with blamed(scenario.plant, "build"):
            scenario.simulated(scenario.problem())
    except MissingDependencyError:
        return
    except CoopqpError as error:
        starts = [i for i, k in enumerate(error.keys) if k in ("disturbance", "object")]
        place = error.keys[starts[0] :] if starts else ["plant"]
        raise MisplacedError([Wrong(place, str(error), error.keys)]) from None


def _badly_held(data: Mapping[str, Any], places: Mapping[str, Places]) -> Iterator[Wrong]:
    """Hands that press away from the object, or cannot hold it at rest, in some phase."""
    found = (fault for place in places.values() for fault in contact_faults(place.start.chain))
    for arm, words in dict.fromkeys(found):
        if "grasps" in data:
            yield Wrong(["grasps", arm] if arm else ["grasps"], words)
        else:
            yield Wrong(["grasp"], f"{arm}: {words}" if arm else words)


def _longest(data: Mapping[str, Any], scenario: Scenario) -> Location:
    """What makes a run long: a phase, the way to it, or the control period where that is short."""
    if scenario.dt < SHORT:
        return ["dt"]
    longest = max(scenario.schedule, key=lambda phase: phase.duration)
    if longest.leads:
        return ["reference", "late"] if "late" in data["reference"] else ["reference"]
    own = [phase for phase in scenario.schedule if not phase.leads]
    return ["phases", own.index(longest), "duration"] if "phases" in data else ["duration"]


def _released(scenario: Scenario) -> Iterator[Wrong]:
    arms = {arm.name for arm in scenario.robot_model.arms}
    for i, phase in enumerate(scenario.phases):
        for name in phase.released:
            if name not in arms:
                yield Wrong(["phases", i, "released"], unknown_name("arm", name, arms))


def _broken_tasks(tasks: Sequence[Placed], places: Mapping[str, Places]) -> Iterator[Wrong]:
    for place, task, phase in tasks:
        try:
            try_task(task, places[phase.name], phase.duration)
        except CoopqpError as error:
            yield Wrong(place, str(error), error.keys)
            continue
        if place[0] != "secondary" and _moves_nothing(task, places[phase.name].start):
            yield Wrong(
                place,
                f"'{task.name}' asks nothing of the hands, and no arm holds the object in this "
                "phase; bring hands to it by relative_motion, or release fewer arms",
            )


def _moves_nothing(task: Task, start: State) -> bool:
    """Whether a task is of an object that stands alone."""
    if not start.chain.standing or task.of_forces:
        return False
    with suppress(Exception):  # of a task that waits for an input; the run tells
        stack = TaskStack([task], start)
        stack.update(start)
        return not stack.J.any()
    return False


def _alike(scenario: Scenario, places: Mapping[str, Places]) -> Iterator[Wrong]:
    """Tasks of which a trace would call a part, or a row, as it calls another task's."""
    known: dict[str, str] = {}
    for place, task, phase in placed_tasks(scenario):
        if place[0] == "secondary":
            continue
        chain = places[phase.name].start.chain
        whole = f"{phase.name}.{task.name}" if scenario.phases else task.name
        inside = (*(part.name for part in task.parts(chain)), *task.rows(chain))
        names = {f"{whole}.{name}" if name else whole for name in inside}
        if alike := sorted(names & known.keys()):
            words = f"'{alike[0]}' would be a part of '{known[alike[0]]}' too"
            yield Wrong(place, f"{words}; give '{task.name}' another name")
        known |= dict.fromkeys(names, whole)


def _broken_inputs(
    data: Mapping[str, Any],
    scenario: Scenario,
    tasks: Sequence[Placed],
    places: Mapping[str, Places],
) -> Iterator[Wrong]:
    """Inputs that are not there, or cannot be what the tasks want, and files that feed others."""
    for place, task, phase in tasks:
        start, used = State(places[phase.name].start.chain), partial(_used, data, place)
        for name, (kind, here) in wanted([task], start).items():
            if kind == CLOCK:
                continue
            if name not in scenario.inputs:
                yield Wrong(used(name), unknown_name("input", name, scenario.inputs))
                continue
            try:
                tasks_of_it = (task, *scenario.secondary)
                Feed(scenario.inputs, Inputs(scenario.inputs, tasks_of_it, start, scenario.dt))
            except CoopqpError as error:
                yield Wrong(used(name) if here is None else ["inputs", name], str(error))
    try:
        for phase in scenario.schedule:
            wanted((*phase.tasks, *scenario.secondary), State(places[phase.name].start.chain))
    except CoopqpError as error:
        yield Wrong(["inputs"], str(error))


def _used(data: Any, place: Location, name: str) -> Location:
    waiting: list[tuple[list[str | int], Any]] = [([*place], _at(data, place))]
    while waiting:
        where, found = waiting.pop()
        if isinstance(found, dict):
            given = found.get("input")
            if given == name or (isinstance(given, dict) and given.get("name") == name):
                return where
            waiting += [([*where, key], inside) for key, inside in found.items()]
    return place


def _broken_limits(scenario: Scenario, places: Places) -> Iterator[Wrong]:
    """Limits that name what is not there or break a promise, and two rows with one name."""
    taken = set[str]()
    for i, limit in enumerate(scenario.limits):
        try:
            try_limit(limit, places, scenario.dt)
        except CoopqpError as error:
            yield Wrong(["limits", i], str(error), error.keys)
            continue
        rows = set(names_of(limit.rows(scenario.chain)))
        if twice := sorted(rows & taken):
            advice = TELL_APART if hasattr(limit, "name") else "leave one of them out"
            yield Wrong(["limits", i], f"another limit has a row '{twice[0]}' too; {advice}")
        taken |= rows
    # Joints that would brake for a bound behind the one that they must not pass.
    margin = max((k.margin for k in scenario.limits if isinstance(k, JointPosition)), default=0.0)
    for i, limit in enumerate(scenario.limits):
        if isinstance(limit, JointAcceleration) and limit.margin < margin:
            words = f"needs at least joint_position's {margin:g}, so that joints brake in time"
            yield Wrong(["limits", i], f"margin: found {limit.margin:g}, {words}")
