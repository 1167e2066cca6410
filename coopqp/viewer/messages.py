"""Messages between the player, the page and the explainer; arrays and text alone.

The page first sends its port, or as a text why it cannot be served.
Letters: b bodies, n joints, s segments. Poses are x, y, z, qx, qy, qz, qw.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

from coopqp.base.spec import Array
from coopqp.model.state import Kept
from coopqp.report.scene.bodies import Body
from coopqp.scenario.planned import Way

Tone = Literal["reached", "moving", "blocked", "broken", "waiting"]


@dataclass(frozen=True)
class Gizmo:
    """A handle to drag in a phase: name of its task, whether it can be moved and turned."""

    label: str
    phase: int
    moves: bool
    turns: bool


Key = tuple[Any, ...]
"""Of a number: tasks, phase, index and field; secondary, index and field; kappa; input, index."""


@dataclass(frozen=True)
class Dial:
    """A slider for a number: its range, step and first value; the label has the unit."""

    key: Key
    group: str
    label: str
    low: float
    high: float
    step: float
    value: float


@dataclass(frozen=True)
class PageSetup:
    """All that does not change while a scenario is played."""

    title: str
    description: str
    laws: Mapping[str, str]  # colour such as "#0072B2" by controller
    bodies: tuple[Body, ...]  # of the robot and its surroundings
    size: tuple[float, float, float]  # edges of the object [m]
    low: Array  # low, high: corners of the visible space [m]
    high: Array
    gizmos: tuple[Gizmo, ...]
    dials: tuple[Dial, ...]  # gains and the like
    knobs: tuple[Dial, ...]  # inputs without a gizmo, a number each
    phases: tuple[str, ...]  # names; one for scenarios without phases
    forces: bool  # whether the plant gives the hands' wrenches
    folder: str  # for recordings; empty if there is none


@dataclass(frozen=True)
class ControllerFrame:
    """One controller at one instant."""

    bodies: Array  # poses of their joints, shape (b, 7)
    held: Array  # pose of the object, shape (7,)
    # distance of each of the robot's joints to its nearer limit over half its range, shape (n,)
    left: Array
    arrows: Array  # start and end of the hands' forces, shape (., 2, 3) [m]
    weight: Array  # of the object's
    reached: bool
    errors: str  # distance to the goals
    broken: str  # what is violated, such as a joint limit, or empty


@dataclass(frozen=True)
class Explanation:
    """Whether geometry keeps the arms from their goals, and why; active limits of the tick."""

    blocked: bool = False
    sentence: str = ""
    active: tuple[str, ...] = ()
    detail: str = ""


@dataclass(frozen=True)
class Frame:
    """Everything at one instant."""

    t: float  # since the beginning [s]
    phase: int
    playing: bool
    factor: float  # measured speed of time
    laws: tuple[ControllerFrame, ...]  # in the order of ``PageSetup.laws``
    main: int  # index of the one that is explained
    gizmos: tuple[Array | None, ...]  # poses, shape (7,); None in other phases
    outlines: Array  # of the tasks' markers, shape (s, 2, 3) [m]
    tone: Tone
    sentence: str
    explanation: Explanation  # the last one
    explained: bool  # whether the explainer is alive
    recorded: float  # duration of the recording [s]
    note: str  # remarks on it
    tick_us: float  # longest tick of the last second [us]
    # somewhere along the way round that is offered; None where none is
    ghost: ControllerFrame | None = None


@dataclass(frozen=True)
class Action:
    """What somebody has done on the page."""

    what: str  # play, pause, step, reset, speed, drag, carry, dial, knob, main, save or follow
    which: int | Key = 0  # index of a gizmo or controller, key of a dial or knob
    value: tuple[float, ...] = ()  # a pose, a position, or one number


@dataclass(frozen=True)
class Snapshot:
    """A state to explain, and the targets of its inputs, by name."""

    law: str  # the controller, with the values of its dials
    dials: Mapping[Key, float]
    starts: tuple[Array, ...]  # q where each later phase has begun, shape (n,) each
    state: Kept
    targets: Mapping[str, Array]
    rests: bool


@dataclass(frozen=True)
class WayRound:
    """What is said of a way round, and the way tick by tick; None where there is none."""

    sentence: str
    way: Way | None = None
