"""What of a scenario is odd but no fault, in words: what has no effect, or a likely wrong unit."""

from collections.abc import Iterator, Mapping
from contextlib import suppress
from functools import partial

import numpy as np
import pinocchio as pin

from coopqp.base.spec import Array
from coopqp.base.table import read_table
from coopqp.base.wording import counted
from coopqp.closed_loop.forces import StaticHold, contact_notes
from coopqp.closed_loop.hands import WrenchStack
from coopqp.closed_loop.mobility import hidden_freedom
from coopqp.closed_loop.screw import LENGTH
from coopqp.controller import Controller
from coopqp.controllers.qp import QPController
from coopqp.controllers.torque_qp import TorqueQp
from coopqp.kernel import native
from coopqp.limit import SHALLOW
from coopqp.limits import JointPosition, JointVelocity, Obstacles, SelfCollision
from coopqp.model import marker
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.state import State
from coopqp.scenario.input import InputSettings, wanted
from coopqp.scenario.scenario import Scenario
from coopqp.scenario.start import too_far
from coopqp.signal import POINT, POSE, Kind, Moment
from coopqp.task import TaskStack
from coopqp.torque_law.hand_wrenches import unreachable_wrenches
from coopqp.torque_law.task_dynamics import leaks

#: A push along an axis without a spring that is felt by less than this share is not worth a word.
LEAKS = 0.05
#: A hand that is fastened to the object, this far from it, is worth a word [m].
FAR_HAND = 0.1
#: How many instants of a signal, or configurations, are looked at.
LOOKS = 9
#: Singular values of Jacobians below this are 0 [m/rad].
UNMOVED = 1e-9
#: The limits of every scenario that names none; that baselines ignore them is their point.
USUAL_LIMITS = (JointPosition(), JointVelocity())


def notes(
    scenario: Scenario,
    controllers: Mapping[str, Controller] | None = None,
    *,
    steered: bool = False,
) -> list[str]:
    """One sentence for parts of the scenario that the same controllers do not support.

    Before it come goals that are far or out of every motion's way; after it priorities without
    effect, that the kernel is not built, what limits cannot bound, pads that reach beyond the
    object, hands that are far from it, a freedom that rounded values hide, ticks that are too long.

    The controllers, the scenario's own when omitted, say what they support; ``steered`` says that
    people send to inputs that nothing feeds.
    """
    chosen = scenario.controllers if controllers is None else controllers
    hidden = hidden_freedom(scenario.chain)
    of_limits = (line for k in scenario.limits for line in k.notes(scenario.chain))
    kernel = any(isinstance(c, QPController) and c.engine == "auto" for c in chosen.values())
    return [
        *_far(scenario),
        *_unmovable(scenario),
        *_unsupported(scenario, chosen),
        *_idle_priorities(scenario),
        *([native.MISSING] if kernel and native.module() is None else []),
        *of_limits,
        *contact_notes(scenario.chain),
        *_far_hands(scenario.chain),
        *([hidden.describe()] if hidden else []),
        *_coarse_steps(scenario),
        *_of_inputs(scenario, steered=steered),
        *_of_forces(scenario, chosen),
        *_of_springs(scenario, chosen),
        *_of_friction(scenario),
        *_of_sag(scenario),
        *of_faults(scenario),
    ]


def _unsupported(scenario: Scenario, chosen: Mapping[str, Controller]) -> Iterator[str]:
    parts: dict[tuple[str, ...], list[str]] = {}
    for part, what in _stated(scenario):
        names = tuple(name for name, c in chosen.items() if part not in c.supports)
        parts.setdefault(names, []).append(what)
    for names, unsupported in parts.items():
        if names:
            yield f"no effect on {' and '.join(names)}: {', '.join(unsupported)}"


def _idle_priorities(scenario: Scenario) -> Iterator[str]:
    for phase in scenario.schedule:
        for task in phase.tasks:
            if task.mode != "soft" and task.priority:
                yield (
                    f"priority: {task.priority} of '{task.name}' has no effect: {task.mode} tasks "
                    "come before all soft ones, which alone have priorities"
                )


def _of_inputs(scenario: Scenario, *, steered: bool) -> Iterator[str]:
    start = State(scenario.chain)
    wanted(scenario.problem().all_tasks, start)
    waiting = {clock for clock, joints in start.inputs.ways if joints}
    for clock in sorted({clock for clock, _ in start.inputs.ways} - waiting):
        yield f"the clock '{clock}' waits for nobody: no posture's way-points name it"
    followed = scenario.followed()
    for name, settings in scenario.inputs.items():
        if name not in followed:
            yield f"no task follows the input '{name}'"
        elif settings.feed is None and settings.feed_file is None and not steered:
            yield (
                f"nobody sends to the input '{name}' here, so that its tasks stay where they are; "
                "give it feed or feed_file"
            )


def _of_forces(scenario: Scenario, chosen: Mapping[str, Controller]) -> Iterator[str]:
    """Forces beyond what motors give, for who squeezes by velocities and does not know them."""
    problem = scenario.problem()
    pressing = [name for name, c in chosen.items() if isinstance(c, QPController) and c.admittance]
    if not (pressing and problem.wrenches and problem.chain.holding > 1):
        return
    start = State(problem.chain)
    stack = WrenchStack(problem.wrenches, start)
    stack.update(start)
    for message in unreachable_wrenches(StaticHold(problem.chain, safety=1.0), stack):
        yield f"{' and '.join(pressing)}: {message}"


def _of_springs(scenario: Scenario, chosen: Mapping[str, Controller]) -> Iterator[str]:
    """Axes without a spring along which a push is felt along those that have one."""
    torque_laws = {name: c for name, c in chosen.items() if isinstance(c, TorqueQp)}
    unaware = [name for name, c in torque_laws.items() if c.external_wrench == "unknown"]
    found = leaks(scenario.problem()) if unaware else None
    if found is None:
        return
    *axes, force = found
    turns = [axis.startswith("rot_") for axis in axes]
    units = ["N m" if turn else "N" for turn in turns]
    sprung, pushed = (
        f"about {axis.removeprefix('rot_')}" if turn else f"along {axis}"
        for axis, turn in zip(axes, turns, strict=True)
    )
    lengths = [LENGTH if turn else 1.0 for turn in turns]
    if abs(force) * lengths[1] / lengths[0] > LEAKS:
        yield (
            f"{' and '.join(unaware)}: nobody knows the push, so that a push {pushed} by 1 "
            f"{units[1]} moves the springs {sprung} as {force:.2g} {units[0]} would, "
            "by the inertia that they share: F/K is not all; give all six axes a stiffness, or say "
            "torque_qp: {external_wrench: observed}"
        )


def _of_sag(scenario: Scenario) -> Iterator[str]:
    given, chain = scenario.observer.stiffness, scenario.chain
    if isinstance(given, Mapping):
        names = np.delete(np.array(chain.joint_names), chain.passive).tolist()
        left = [name for name in names if name not in given]
        if left:
            more = f" and {counted(len(left) - 1, 'other joint')}" if len(left) > 1 else ""
            yield f"observer.stiffness: {left[0]}{more} without one count as rigid"


def _of_friction(scenario: Scenario) -> Iterator[str]:
    grasps = scenario.chain.grasps.values()
    if scenario.disturbance.friction != 1.0 and not any(grasp.contact for grasp in grasps):
        yield "disturbance.friction has no effect: no hand holds by pressing"


def of_faults(scenario: Scenario) -> Iterator[str]:
    """Faults that the run has, so that nobody takes them for the controller's."""
    if faults := scenario.disturbance.faults:
        yield f"injected: {', '.join(fault.description for fault in faults)}"


def _coarse_steps(scenario: Scenario) -> Iterator[str]:
    """Distances that a tick can use up by curvature alone: r a^2 / 2 at reach r, of a turn by a."""
    chain, dt = scenario.chain, scenario.dt
    turns = np.array([unit == "rad" for unit in chain.joint_units]) & np.isfinite(chain.velocity)
    slowed = min([k.scale for k in scenario.limits if isinstance(k, JointVelocity)], default=1.0)
    angle = slowed * dt * float(chain.velocity[turns].max(initial=0.0))
    off = 0.5 * chain.reach * angle**2
    for limit in scenario.limits:
        if isinstance(limit, SelfCollision | Obstacles) and off > max(limit.distance, SHALLOW):
            yield (
                f"{limit.name}: in a tick joints turn by up to {angle:.2g} rad, which can bring "
                f"bodies about {1e3 * off:.2g} mm nearer than distance ({1e3 * limit.distance:g} "
                "mm); make dt shorter, joints slower or distance larger"
            )


def _stated(scenario: Scenario) -> Iterator[tuple[str, str]]:
    """The parts that this scenario has beyond what every scenario has."""
    tasks = [task for phase in scenario.schedule for task in phase.tasks]
    parts = (
        ("limits", "the limits", scenario.limits != USUAL_LIMITS),
        ("modes", "that tasks are hard or scaled", any(task.mode != "soft" for task in tasks)),
        ("priorities", "the priorities of tasks", any(task.priority for task in tasks)),
        ("forces", "the forces that are asked for", any(task.of_forces for task in tasks)),
        ("secondary", "the secondary objectives", scenario.secondary),
        ("on_infeasible", "on_infeasible", scenario.on_infeasible != "scale"),
    )
    return ((part, words) for part, words, stated in parts if stated)


def _far_hands(chain: ClosedChain) -> Iterator[str]:
    model, X_WO = chain.model, chain.object_pose(chain.q_start)
    data, half = model.createData(), 0.5 * np.array(chain.held.size)
    pin.framesForwardKinematics(model, data, chain.q_start)
    for arm in chain.arms[: len(chain.hold.holders)]:
        if chain.grasps[arm.name].contact:
            continue
        p_OT = X_WO.actInv(data.oMf[model.getFrameId(arm.tip)]).translation
        away = float(np.linalg.norm(np.maximum(np.abs(p_OT) - half, 0.0)))
        if away > FAR_HAND:
            yield (
                f"the tip of {arm.name} is {1e3 * away:.0f} mm from the object's surface and holds "
                "it as if a rigid link joined them; see object.size, object_in_hand and the start"
            )


def _far(scenario: Scenario) -> Iterator[str]:
    chain, distances = scenario.chain, list[tuple[str, float]]()
    for phase in scenario.schedule:
        for task in phase.tasks:
            marks = marker.marks_of(task.name, partial(task.marks, Moment(phase.duration)), [])
            far = max((_distance(mark, chain.start_position) for mark in marks), default=0.0)
            distances.append((f"the goal of '{task.name}' is", far))
    for name, kind in scenario.followed().items():
        if kind in (POINT, POSE):
            places = _sent(scenario.inputs[name], kind, scenario.duration)
            offsets = (float(np.linalg.norm(p - chain.start_position)) for p in places)
            distances.append((f"the input '{name}' is sent a place", max(offsets, default=0.0)))
    for what, far in distances:
        if words := too_far(far, chain):
            yield f"{what} {far:.3g} m from where the object starts, {words}"


def _unmovable(scenario: Scenario) -> Iterator[str]:
    """A sentence on each goal with what no joint moves: 0 at random configurations is 0 at all."""
    problems = scenario.problems(lambda _: scenario.chain.q_start)
    ways = np.random.default_rng(0).uniform(-1.0, 1.0, (LOOKS, scenario.chain.n))
    for phase, problem in zip(scenario.schedule, problems, strict=True):
        chain, state = problem.chain, State(problem.chain)
        for task in () if phase.released and not chain.standing else phase.tasks:
            if task.joint_space or task.of_forces or task.asks_velocity or task.impedance:
                continue
            jacobians, at, names = list[Array](), 0, task.rows(chain)
            with suppress(Exception):  # of a user's own code, of which the run tells
                stack = TaskStack([task], State(chain))
                for state.t, state.q[:] in ((phase.duration, chain.q_start + way) for way in ways):
                    state.update()
                    stack.update(state)
                    jacobians.append(stack.J.copy())
            for part in task.parts(chain) if len(jacobians) == LOOKS else ():
                rows = slice(at, at := at + part.rows)
                U, values, _ = np.linalg.svd(np.hstack(jacobians)[rows], full_matrices=False)
                still = U[:, values < UNMOVED]
                off = float(np.linalg.norm(still.T @ stack.e[rows]))
                if off > part.tolerance:
                    own = (name for name, u in zip(names[rows], still, strict=True) if u @ u > 0.5)
                    yield (
                        f"the goal of '{task.name}' is unreachable, whatever the limits: no motion "
                        f"of the joints changes its error in {' and '.join(own) or 'part'}, "
                        f"{off:.3g} {part.unit}"
                    )


def _sent(settings: InputSettings, kind: Kind, duration: float) -> Iterator[Array]:
    """Places that are sent in a comparison, some of a signal's and all of a file's."""
    if settings.feed_file is not None:
        yield from read_table(settings.feed_file).take(POINT.columns)
    elif settings.feed is not None:
        course = settings.feed.bind(kind, Moment(), None)
        for t in np.linspace(0.0, duration, LOOKS).tolist():
            course.update(Moment(t))
            yield course.value[:3].copy()


def _distance(mark: marker.Marker, p: Array) -> float:
    """How far a point is from what a mark shows [m]; 0 where that has no place."""
    match mark:
        case marker.PointMarker():
            return float(np.linalg.norm(mark.at - p))
        case marker.PoseMarker() if mark.position is not None:
            return float(np.linalg.norm(mark.position - p))
        case marker.PlaneMarker():
            return abs(float(mark.normal @ (mark.through - p)))
        case marker.LineMarker() if mark.through is not None:
            return float(np.linalg.norm(np.cross(mark.direction, mark.through - p)))
        case marker.SphereMarker() | marker.CircleMarker():
            return abs(float(np.linalg.norm(mark.center - p)) - mark.radius)
    return 0.0
