"""Where the object is and how it leans over time, and how freely it can be moved for the tasks.

Of each task with a mark, the coordinates that the mark fixes have a goal g(t): all of a point's,
those across a line or a plane that lies along the world's axes. With s the share of the way that
the task's profile has gone and x_0 the coordinate at the start, the reference is

    x_r(t) = g(t) + (1 - s(t)) (x_0 - g(0)),   R_r(t) = exp(s(t) log(R_g R_0')) R_0

How freely it can be moved say condition and manipulability of M = J N. J are the rows of all tasks
of the phase that steer the object, N an orthonormal basis of the joint motions that keep the loops
closed (the null space of J_c, eq. (14)), so that M is what the joints can still do to the tasks.
Its smallest singular value is zero where they cannot move the object in some direction that a task
asks for. Angles count as lengths, ``LENGTH`` to the radian, so that one number compares all rows.
Manipulability after Yoshikawa 1985, of closed chains after Bicchi and Prattichizzo 2000; passive
joints move like any other.

Letters: i instants, k rows of the tasks.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import ClassVar

import numpy as np
import pinocchio as pin

from coopqp.base.rank import RANK_TOLERANCE, null_space
from coopqp.base.spec import Array
from coopqp.base.wording import suppressed
from coopqp.closed_loop.screw import LENGTH
from coopqp.controller import ControlProblem
from coopqp.model import marker
from coopqp.model.marker import Marker, marks_of
from coopqp.model.state import State
from coopqp.report import curves
from coopqp.report.curves import Chart, Figure, Json, Window
from coopqp.signal import Moment
from coopqp.task import LENGTHS, TaskStack

MAX_INSTANTS = 200  # of a goal
ALIGNED = 1e-9  # smaller components of a unit vector count as zero
REACH = 2.0  # lines are shown this many heights of the calmest one beyond it
SAME = 1e-6  # references that are closer count as equal
ORIGIN = (0.0, 0.0, 0.0)
GOAL = {"color": "#000000", "dash": "6px,3px", "width": 1.3}
REFERENCE = {"color": "#000000", "dash": "1.5px,2.5px", "width": 1.5}


@dataclass(frozen=True, kw_only=True)
class Coordinate:
    """Coordinate of a point of the object [m]; axis 0, 1, 2 for the world's x, y, z."""

    unit: ClassVar[str] = "m"
    min_height: ClassVar[float] = 0.02  # of its figure [m]
    floor: ClassVar[float] = -np.inf
    axis: int
    point: tuple[float, float, float] = ORIGIN

    @property
    def title(self) -> str:
        """Names the point if it is not the origin."""
        name = "xyz"[self.axis]
        if self.point == ORIGIN:
            return f"{name} of the object"
        return f"{name} of the object's point ({', '.join(f'{p:g}' for p in self.point)})"

    def of(self, position: Array, rotation: Array) -> Array:
        """Its value along a motion of the object, shape (T,) [m]."""
        return np.asarray(position[:, self.axis] + rotation[:, self.axis] @ np.array(self.point))

    def goal(self, marks: Sequence[Marker]) -> float:
        """The goal of a task with these markers [m]; NaN if it is free or of another point."""
        if any(isinstance(m, marker.TrackedMarker) and m.point != self.point for m in marks):
            return np.nan
        return next((x for x in map(self._fixed, marks) if not np.isnan(x)), np.nan)

    def reference(self, start: pin.SE3, marks: Sequence[Sequence[Marker]], share: Array) -> Array:
        """Straight to the goal, by the share of the way, shape (i,) [m]."""
        goal = np.array([self.goal(then) for then in marks])
        begin = self.of(start.translation[None], start.rotation[None])[0]
        return np.asarray(goal + (1.0 - share) * (begin - goal[0]))

    def _fixed(self, mark: Marker) -> float:
        """The coordinate that all points of a marker have in common, or NaN."""
        i, place, normal = self.axis, None, None
        match mark:
            case marker.PointMarker():
                place = mark.at
            case marker.PoseMarker():
                place = mark.position
            case marker.LineMarker() if abs(mark.direction[i]) < ALIGNED:
                place = mark.through
            case marker.PlaneMarker():
                place, normal = mark.through, mark.normal
            case marker.CircleMarker():
                place, normal = mark.center, mark.normal
        across = normal is not None and np.abs(np.delete(normal, i)).max() > ALIGNED
        return np.nan if place is None or across else float(place[i])


@dataclass(frozen=True, kw_only=True)
class Tilt:
    """Angle between the object's z axis and the world's [degrees]."""

    unit: ClassVar[str] = "degrees"
    min_height: ClassVar[float] = 2.0
    floor: ClassVar[float] = 0.0
    title: ClassVar[str] = "Tilt of the object"

    def of(self, position: Array, rotation: Array) -> Array:
        """Its value, by sine and cosine to be exact near 0 [degrees]."""
        sine = np.hypot(rotation[:, 0, 2], rotation[:, 1, 2])
        return np.degrees(np.arctan2(sine, rotation[:, 2, 2]))

    def goal(self, marks: Sequence[Marker]) -> float:
        """The goal of a task with an orientation [degrees], or NaN."""
        poses = [mark for mark in marks if isinstance(mark, marker.PoseMarker)]
        return float(self.of(np.zeros((1, 3)), poses[0].rotation[None])[0]) if poses else np.nan

    def reference(self, start: pin.SE3, marks: Sequence[Sequence[Marker]], share: Array) -> Array:
        """About one axis to the goal [degrees]; NaN for a goal that turns."""
        goals = [m.rotation for then in marks for m in then if isinstance(m, marker.PoseMarker)]
        if any(not np.array_equal(R, goals[0]) for R in goals):
            return np.full(len(share), np.nan)
        turn = pin.log3(goals[0] @ start.rotation.T)
        turned = np.array([pin.exp3(s * turn) @ start.rotation for s in share])
        return self.of(np.zeros((len(share), 3)), turned)


Quantity = Coordinate | Tilt


@dataclass(frozen=True)
class Target:
    """A task's goal of a quantity at times t [s], shape (i,) each; NaN where it is free."""

    task: str
    t: Array
    goal: Array
    references: dict[str, Array] = field(default_factory=dict)  # that move, by controller


def object_figures(chart: Chart) -> tuple[list[Figure], list[Figure]]:
    """Coordinates and tilt of the object, and the coordinates of other points that tasks steer."""
    tasks = [task for phase in chart.comparison.scenario.schedule for task in phase.tasks]
    marks = [m for task in tasks for m in marks_of(task.name, partial(task.marks, Moment()), [])]
    steered = dict.fromkeys(mark.point for mark in marks if isinstance(mark, marker.TrackedMarker))
    # The origin comes first if it is one of them.
    first, *others = sorted(steered, key=lambda point: point != ORIGIN) or [ORIGIN]
    shown: list[Quantity] = [*(Coordinate(axis=i, point=first) for i in range(3)), Tilt()]
    hidden = [Coordinate(axis=i, point=point) for point in others for i in range(3)]
    return [_figure(chart, of) for of in shown], [_figure(chart, of) for of in hidden]


def targets(chart: Chart, quantity: Quantity) -> list[Target]:
    """The goals of a quantity of all tasks of all phases."""
    scenario, trace, t, every = chart.comparison.scenario, chart.any, chart.any.t, []
    instants = chart.instants(trace, MAX_INSTANTS)
    for number, (phase, rows) in enumerate(zip(scenario.schedule, instants, strict=True)):
        first = int(rows[0])
        for task in phase.tasks:
            nows = [trace.moment(k, float(t[k] - t[first])) for k in rows.tolist()]
            marks = [marks_of(task.name, partial(task.marks, now), []) for now in nows]
            goal = np.array([quantity.goal(then) for then in marks])
            if np.isnan(goal).all():
                continue
            way, times = task.way, (t[rows] - t[first]).tolist()
            share = np.array([way.at(now)[0] if way else 1.0 for now in times])
            references = {}
            for name in chart.names if (share < 1.0).any() else ():
                chain = chart.problems[name][number].chain
                start = chain.object_pose(chart.traces[name].commanded[first])
                references[name] = quantity.reference(start, marks, share)
            every.append(Target(task.name, t[rows], goal, references))
    return every


def _figure(chart: Chart, quantity: Quantity) -> Figure:
    lines = chart.lines(lambda trace: quantity.of(trace.position, trace.rotation))
    wanted = targets(chart, quantity)
    calm = min((y for y in lines.values() if np.isfinite(y).all()), key=np.ptp, default=np.zeros(1))
    known = np.concatenate([calm, *(target.goal for target in wanted)])
    low, high = float(np.nanmin(known)), float(np.nanmax(known))
    missing = max(0.0, quantity.min_height - (high - low))
    low = max(low - 0.5 * missing, quantity.floor)
    high = max(high + 0.5 * missing, low + quantity.min_height)
    shown = curves.window(low, high, list(lines.values()), REACH * (high - low))
    extra, unit = [line for target in wanted for line in _drawn(chart, target)], quantity.unit
    return chart.figure(quantity.title, unit, lines, shown, extra=extra, noted=unit)


def _drawn(chart: Chart, target: Target) -> list[Json]:
    """The reference, once where it is the same for all, and the goal."""

    def line(kind: str, y: Array, look: Json) -> Json:
        rows = [0, -1] if (y == y[0]).all() else slice(None)
        return curves.aside(f"{kind} of '{target.task}'", target.t[rows], y[rows], look)

    lines, each = [], list(target.references.values())
    alike = each and np.nanmax(np.abs(np.array(each) - each[0]), initial=0.0) < SAME
    for name, y in target.references.items():
        own = {} if alike else {"legendgroup": name}
        look = {} if alike else {"color": chart.styles[name].color}
        lines.append(line("reference", y, REFERENCE | look) | own)
    return [*lines[: 1 if alike else None], line("goal", target.goal, GOAL)]


MAX_SOLVED = 300  # of each controller and phase
WORST = 1e6  # larger conditions are drawn here
_Curve = tuple[Array, Array]  # time and value
LESS = "The tasks ask for more than the loops leave free; what they leave is drawn."


def freedom_figures(chart: Chart) -> list[Figure]:
    """Condition and manipulability; none where no joints can move the object for a task."""
    ratio, product, less = dict[str, _Curve](), dict[str, _Curve](), False
    for name, trace in ((name, chart.traces[name]) for name in chart.names):
        phases = zip(chart.problems[name], chart.instants(trace, MAX_SOLVED), strict=True)
        known = [(t := trace.t[k], singular_values(p, t - t[0], trace.q[k])) for p, k in phases]
        less |= any(left(sigma).shape[1] < sigma.shape[1] for _, sigma in known)
        if movable := [(t, sigma) for t, sigma in known if left(sigma).size]:
            t = np.concatenate([t for t, _ in movable])
            ratio[name] = t, np.concatenate([condition(sigma) for _, sigma in movable])
            product[name] = t, np.concatenate([manipulability(sigma) for _, sigma in movable])
    if not ratio:
        return []
    worst, best = (max(float(np.nanmax(y)) for _, y in of.values()) for of in (ratio, product))
    lowest = min(float(np.nanmin(y)) for _, y in ratio.values())
    log = curves.logarithmic(Window(min(1.0, lowest), max(10.0, 2.0 * worst)))
    powers = {"exponentformat": "power", "automargin": True, "nticks": 4}
    linear = curves.linear(Window(0.0, 1.1 * best or 1.0)) | powers
    return [
        Figure(
            title=title,
            unit=unit,
            data=[curves.curve(name, chart.styles[name], t, y) for name, (t, y) in of.items()],
            layout=chart.layout(axis),
            notes=(LESS,) * less,
        )
        for title, unit, of, axis in (
            ("Condition", "1, log scale", ratio, log),
            ("Manipulability", "product of the singular values", product, linear),
        )
    ]


def singular_values(problem: ControlProblem, t: Array, q: Array) -> Array:
    """Of M at each instant, largest first, shape (i, k); NaN where a task raises an error.

    At times since the phase began, shape (i,) [s], and configurations, shape (i, n).
    """
    chain = problem.chain
    steering = [task for task in problem.tasks if not task.joint_space]
    state, tasks = State(chain), TaskStack(steering, State(chain))
    parts = [part for task in steering for part in task.parts(chain)]
    lengths = np.array([1.0 if p.unit in LENGTHS else LENGTH for p in parts for _ in range(p.rows)])
    sigma = np.full((len(t), len(lengths)), np.nan)
    for k in np.flatnonzero(np.isfinite(q).all(axis=1)).tolist() if len(lengths) else ():
        state.t, state.q[:] = float(t[k]), q[k]
        state.update()
        with suppressed():  # of a task's error, which the tick has met and names
            tasks.update(state)
            M = lengths[:, None] * tasks.J @ null_space(chain.loop_jacobian(q[k]))
            values = np.linalg.svd(M, compute_uv=False)
            sigma[k] = np.pad(values, (0, len(lengths) - len(values)))
    return sigma


def left(sigma: Array) -> Array:
    """The singular values but those that are zero all along, shape (i, .)."""
    largest = np.nanmax(sigma, axis=0, initial=0.0)
    return sigma[:, largest > RANK_TOLERANCE * max(float(largest.max(initial=0.0)), 1e-300)]


def condition(sigma: Array) -> Array:
    """Largest over smallest singular value, at most ``WORST``, shape (i,)."""
    kept = left(sigma)
    return np.asarray(kept[:, 0] / np.maximum(kept[:, -1], kept[:, 0] / WORST))


def manipulability(sigma: Array) -> Array:
    """Product of the singular values, sqrt(det(M M')), shape (i,)."""
    return np.asarray(left(sigma).prod(axis=1))
