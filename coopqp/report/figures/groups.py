"""The figures of the page in groups, most relevant first, with explanations.

With the figures of task errors, of open loops, and of the time of a tick: quartiles as a box, 1 and
99 percent as whiskers, the slowest a cross, in a figure for each language.
"""

import html
import math
from dataclasses import dataclass, field

import numpy as np

from coopqp.assessment.thresholds import LOOP_CLOSED, LOOP_CLOSED_ANGLE
from coopqp.base.spec import Array
from coopqp.closed_loop.screw import LENGTH
from coopqp.execution.comparison import Comparison
from coopqp.report import audit, curves
from coopqp.report.cells import LANGUAGES, length, tick_times_in
from coopqp.report.curves import ALWAYS, Chart, Figure, Json, Lines, Window
from coopqp.report.figures import joints
from coopqp.report.figures.object import freedom_figures, object_figures
from coopqp.trace import TaskInfo

FLOOR = 1e-12  # smallest value on log scales [m, rad]; less is drawn here
MAX_FIRST = 3  # tasks that are shown first
MAX_TICKS = 5  # as many as fit side by side on a narrow page
PAPER = (
    " The paper's figures 4 to 8 are q1 to q5 of the right arm: its pseudo is pseudoinverse here, "
    "its joint limit motion pseudoinverse_null_space."
)


@dataclass(frozen=True, kw_only=True)
class Group:
    """Figures that belong together, with a hint how to read them, and words explained."""

    title: str
    hint: str
    terms: dict[str, str] = field(default_factory=dict)
    figures: list[Figure] = field(default_factory=list)
    folded: list[Figure] = field(default_factory=list)  # shown on demand, and on paper
    more: str = ""  # what those are
    leads: bool = False  # whether it stands directly below the result


def groups(comparison: Comparison) -> list[Group]:
    """Those that have figures, in the order of the page."""
    chart = Chart(comparison)
    decisive, near, other_joints = joints.joint_figures(chart)
    where, other_points = object_figures(chart)
    errors, other_errors = task_errors(chart)
    hands, loads = joints.hands(chart), joints.load_shares(chart)
    internal, active = joints.internal_forces(chart), audit.timeline(chart.traces, chart.styles)
    others_near = "others that come near" if decisive else "ones that come nearest to"
    of_paper = comparison.scenario.robot_model.name == joints.PAPER_ROBOT
    every = (
        Group(
            title="The joint nearest to a limit",
            hint="The one that comes nearest to a limit or goes farthest beyond it, with the same "
            "joint of the other arm. Hatched: beyond a limit. A cross marks where a joint leaves "
            "its limits.",
            figures=decisive,
            leads=True,
        ),
        Group(
            title="Where the object is",
            hint="Dashed black: the goal of a task, where it fixes the coordinate. Dotted: the "
            "reference, which leads from the start to the goal in the task's own time.",
            terms={"Tilt": "the angle between the object's z axis and the world's."},
            figures=where,
            folded=other_points,
            more="Other points of the object that tasks steer",
        ),
        Group(
            title="How far the tasks are from done",
            hint="First to the goal itself, then to the reference that leads there: a law that "
            "follows well is near zero there all the time, long before it is at the goal.",
            figures=errors,
            folded=other_errors,
            more="The other tasks",
        ),
        Group(
            title="Margins to the limits",
            hint="Hatched: beyond a limit, where the robot cannot go.",
            terms={
                "Margin": "distance of the joint nearest to its limit. It tells whether limits are "
                "kept.",
                "Criterion φ": "the sum over all joints of ((q - middle) / range)²: 0 with every "
                "joint in the middle of its range, a quarter for each joint at a limit. "
                "joint_centering as the null-space term Z of the paper's eq. (33) goes down its "
                "gradient. φ can fall while one joint leaves its limits: a small φ is no promise.",
                "Null-space term": "motion of the joints that neither tasks nor loops feel, so "
                "that it is free for a second purpose.",
            },
            figures=joints.limit_figures(chart),
        ),
        Group(
            title="Joints",
            hint=f"The {others_near} a limit, with the same joint of the other arm."
            f"{PAPER if of_paper else ''}",
            figures=near,
            folded=other_joints,
            more=f"The other {len(other_joints)} joints",
        ),
        Group(
            title="How freely the object can be moved",
            hint="Of the matrix M = J N: N are the joint motions that keep the loops closed, J is "
            f"what the tasks measure (angles count {LENGTH:g} m a radian), by the controller's "
            "model.",
            terms={
                "Condition": "its largest singular value over its smallest: how much more the "
                "joints have to move for the hardest direction than for the easiest. It grows "
                "without bound near a singular posture, where the pseudoinverse asks for speeds "
                "without bound.",
                "Manipulability": "the product of its singular values (Yoshikawa): 0 where a "
                "direction is lost.",
            },
            figures=freedom_figures(chart),
        ),
        Group(
            title="Hands that press",
            hint="Hatched: beyond friction, where the object slips along the hand, and beyond a "
            "pad's edge, over which it tips.",
            terms={
                "Friction": "the coefficient that the hand's wrench needs, over the real one. What "
                "a controller counts on is less, by its safety factor.",
                "Pressure": "where the normal force is on the pad: 0 in the middle, 1 at the edge.",
            },
            figures=hands,
            folded=loads if hands else [],
            more="Share of the load by arm",
        ),
        Group(
            title="Torques and forces",
            hint="Hatched: beyond what the motor can do.",
            terms={
                "Internal force": "what the hands do to each other through the object: it squeezes "
                "the object and does not move it.",
                "Squeeze": "its part along the line between two hands: above zero they press.",
            }
            if internal
            else {},
            figures=[*joints.squeeze_of_fastened(chart), *internal],
            folded=[*joints.torques(chart), *([] if hands else loads)],
            more="Torque of each motor"
            + (", share of the load by arm" if loads and not hands else ""),
        ),
        Group(
            title="Loops, active limits and computing time",
            hint="",
            terms={
                "Loop error": "how far apart two arms carry the object; Baumgarte stabilisation "
                "with the gain κ pulls it back.",
                "Active": "a limit that the QP is at, which then decides with it what is done.",
            },
            folded=[*loop_errors(chart), *([active] if active else []), *tick_times(chart)],
            more="Loop errors, active limits, time of a tick",
        ),
    )
    return [group for group in every if group.figures or group.folded]


def task_errors(chart: Chart) -> tuple[list[Figure], list[Figure]]:
    """To goals and moving references, of tasks that miss most, and of others; each in order."""
    tasks: dict[tuple[str, int | None], TaskInfo] = {}
    for trace in (chart.any, *chart.traces.values()):  # whose tasks may differ
        for task in trace.tasks:
            tasks.setdefault((task.name, task.rows.start), task)

    def missed(key: tuple[str, int | None]) -> float:
        """Its largest error at the end, over its tolerance; NaN is the worst."""
        ends = [error[-1] for error in _by_trace(chart, tasks[key], "goal_error").values()]
        return max(1.0, float(np.nan_to_num(np.max(ends), nan=np.inf)) / tasks[key].tolerance)

    order = sorted(tasks, key=missed, reverse=True)
    first, others = list[Figure](), list[Figure]()
    for key, task in tasks.items():
        (first if key in order[:MAX_FIRST] else others).extend(_of_task(chart, task))
    return first, others


def _by_trace(chart: Chart, task: TaskInfo, kind: str) -> Lines:
    found: Lines = {}
    for name, trace in chart.traces.items():
        for i, own in enumerate(trace.tasks):
            if (own.name, own.rows.start) == (task.name, task.rows.start):
                found[name] = getattr(trace, kind)[task.rows, i]
    return found


def _of_task(chart: Chart, task: TaskInfo) -> list[Figure]:
    scale, unit = length(1.0, task.unit)
    goal, reference = (_by_trace(chart, task, kind) for kind in ("goal_error", "task_error"))
    parts = [(f"'{task.name}': error to the goal", goal)]
    if not all(np.array_equal(goal[k], reference[k], equal_nan=True) for k in goal):
        parts.append((f"'{task.name}': error to the moving reference", reference))
    arrives = [curves.upright(task.end, "reference arrives")] if 0 < task.end < chart.end else []
    good = scale * task.tolerance
    return [
        _log(chart, title, unit, {k: scale * y for k, y in lines.items()}, scale, good, "reached",
             *arrives, rows=task.rows)
        for title, lines in parts
    ]  # fmt: skip


def loop_errors(chart: Chart) -> list[Figure]:
    """How far apart the arms carry the object."""
    position = chart.lines(lambda trace: 1e3 * trace.loop_position)
    turn = chart.lines(lambda trace: 1e3 * trace.loop_orientation)
    title = f"Loop error, {{}}, κ = {chart.any.kappa:g} 1/s"
    good, good_angle = 1e3 * LOOP_CLOSED, 1e3 * LOOP_CLOSED_ANGLE
    return [
        _log(chart, title.format("position"), "mm", position, 1e3, good, "closed"),
        _log(chart, title.format("orientation"), "mrad", turn, 1e3, good_angle, "closed"),
    ]


def _log(
    chart: Chart,
    title: str,
    unit: str,
    lines: Lines,
    scale: float,
    good: float,
    word: str,
    *levels: Json,
    rows: slice = ALWAYS,
) -> Figure:
    """On a log scale, with the bound below which errors are good."""
    lines = {name: np.maximum(y, scale * FLOOR) for name, y in lines.items()}
    known = np.concatenate([y[np.isfinite(y)] for y in lines.values()])
    # All but the rare dips towards zero; at least two decades.
    bottom, top = min(float(np.percentile(known, 3)), good), max(float(known.max()), good)
    shown = Window(bottom / 3.0, max(3.0 * top, 100.0 * bottom))
    bound = curves.level(good, f"counts as {word}: {good:.3g}", log=True)
    return chart.figure(title, unit, lines, shown, bound, *levels, log=True, rows=rows)


def tick_times(chart: Chart) -> list[Figure]:
    """One for each language in which ticks were timed, with a box a controller."""
    timed = {name: tick_times_in(chart.traces[name]) for name in chart.names}
    figures = []
    for language in LANGUAGES:
        if times := {name: of[language] for name, of in timed.items() if language in of}:
            figures.append(_times(chart, language, times))
    return figures


def _times(chart: Chart, language: str, times: Lines) -> Figure:
    layout = curves.layout(chart.end, {"type": "category", "automargin": True})
    every = np.concatenate(list(times.values()))
    low, high = float(every.min() / 1.3), float(every.max() * 1.3)
    for steps in ((1, 2, 5), (1, 5), (1,)):  # of a log scale, fewer where those are too many
        ticks = [m * 10.0**e for e in range(-1, 8) for m in steps if low <= m * 10.0**e <= high]
        if len(ticks) <= MAX_TICKS:
            break
    layout["xaxis"] |= {"type": "log", "range": [math.log10(low), math.log10(high)]}
    layout["xaxis"] |= {"tickvals": ticks, "ticktext": [f"{v:g}" for v in ticks], "tickangle": 0}
    layout["xaxis"] |= {"title": {"text": "time [µs]", "standoff": 4}}
    layout["height"] = max(curves.HEIGHT, 70 + 36 * len(times))
    return Figure(
        title=f"Time of a tick in {language}",
        unit="µs, log scale; box: half of all ticks, whiskers: 98 percent, cross: the slowest",
        data=[part for name in reversed(times) for part in _box(chart, name, times[name])],
        layout=layout,
        over_time=False,
    )


def _box(chart: Chart, name: str, us: Array) -> list[Json]:
    style, y = chart.styles[name], html.escape(name)
    p1, q1, median, q3, p99 = np.percentile(us, [1, 25, 50, 75, 99]).tolist()
    box: Json = {"type": "box", "orientation": "h", "legendgroup": name, "y": [y]}
    box |= {"lowerfence": [p1], "q1": [q1], "median": [median], "q3": [q3], "upperfence": [p99]}
    box |= {"line": {"color": style.color, "width": 1.6}, "hoverinfo": "x"}
    return [box, curves.mark(name, style, float(us.max()), y, "x")]
