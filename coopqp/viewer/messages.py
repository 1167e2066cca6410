"""Messages between the player, the page and the explainer; arrays and text alone.

The page first sends its port, or as a text why it cannot be served.
Letters: b bodies, n joints, s segments. Poses are x, y, z, qx, qy, qz, qw.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from coopqp.base.spec import Array
from coopqp.signal import Kind

Tone = Literal["reached", "moving", "blocked", "broken", "waiting"]


@dataclass(frozen=True)
class Surface:
    """A body: index of its joint, None if it is fixed; vertices (v, 3) [m], corners (t, 3)."""

    joint: int | None
    vertices: Array
    corners: NDArray[np.int64]


@dataclass(frozen=True)
class Gizmo:
    """A handle to drag in a phase: name of its task, whether it can be moved and turned."""

    label: str
    phase: int
    moves: bool
    turns: bool


@dataclass(frozen=True)
class Dial:
    """A slider for a number: its range, step and first value; the label has the unit."""

    key: str
    group: str
    label: str
    low: float
    high: float
    step: float
    value: float


@dataclass(frozen=True)
class PageSetup:
    """All that does not change while a scenario is played.

    Attributes:
        laws: colour such as "#0072B2" by controller. bodies: of the robot and its surroundings.
        size: edges of the object [m]. low, high: corners of the visible space [m].
        dials: gains and the like. knobs: inputs without a gizmo, a number each.
        phases: names; one for scenarios without phases.
        forces: whether the plant gives the hands' wrenches.
        folder: for recordings; empty if there is none.
    """

    title: str
    description: str
    laws: Mapping[str, str]
    bodies: tuple[Surface, ...]
    size: tuple[float, float, float]
    low: Array
    high: Array
    gizmos: tuple[Gizmo, ...]
    dials: tuple[Dial, ...]
    knobs: tuple[Dial, ...]
    phases: tuple[str, ...]
    forces: bool
    folder: str


@dataclass(frozen=True)
class ControllerFrame:
    """One controller at one instant.

    Attributes:
        bodies: poses of their joints, shape (b, 7). held: pose of the object, shape (7,).
        left: distance of each joint to its nearer limit over half its range, shape (n,).
        arrows: start and end of the hands' forces, shape (., 2, 3) [m]. weight: of the object's.
        words: distance to the goals. broken: what is violated, such as a joint limit, or empty.
    """

    bodies: Array
    held: Array
    left: Array
    arrows: Array
    weight: Array
    reached: bool
    words: str
    broken: str


@dataclass(frozen=True)
class Explanation:
    """Whether geometry keeps the arms from their goals, and why; active limits of the tick."""

    blocked: bool = False
    sentence: str = ""
    active: tuple[str, ...] = ()
    detail: str = ""


@dataclass(frozen=True)
class Frame:
    """Everything at one instant.

    Attributes:
        t: since the beginning [s]. factor: measured speed of time.
        laws: in the order of ``PageSetup.laws``. main: index of the one that is explained.
        gizmos: poses, shape (7,); None in other phases.
        outlines: of the tasks' markers, shape (s, 2, 3) [m].
        explanation: the last one. explained: whether the explainer is alive.
        recorded: duration of the recording [s]. note: remarks on it.
        tick_us: longest tick of the last second [us].
        ghost: somewhere along the way round that is offered; None where none is.
    """

    t: float
    phase: int
    playing: bool
    factor: float
    laws: tuple[ControllerFrame, ...]
    main: int
    gizmos: tuple[Array | None, ...]
    outlines: Array
    tone: Tone
    sentence: str
    explanation: Explanation
    explained: bool
    recorded: float
    note: str
    tick_us: float
    ghost: ControllerFrame | None = None


@dataclass(frozen=True)
class Action:
    """What somebody has done on the page.

    Attributes:
        what: play, pause, step, reset, speed, drag, carry, dial, knob, main, save or follow.
        which: index of a gizmo or controller, key of a dial or knob.
        value: a pose, a position, or one number.
    """

    what: str
    which: int | str = 0
    value: tuple[float, ...] = ()


@dataclass(frozen=True)
class Snapshot:
    """A state to explain; inputs with kind, value and rate, and their targets, by name.

    Attributes:
        law: the controller, with the values of its dials.
        starts: q where each later phase has begun, shape (n,) each.
    """

    law: str
    dials: Mapping[str, float]
    starts: tuple[Array, ...]
    t: float
    q: Array
    v: Array
    memory: Array
    gap: Array
    corrected: float
    measured: Array | None
    hand_wrench: Array | None
    inputs: Mapping[str, tuple[Kind, Array, Array]]
    targets: Mapping[str, Array]
    rests: bool


def _no_rows() -> Array:
    return np.zeros((0, 1))


@dataclass(frozen=True)
class Way:
    """A way round tick by tick, and what is said of it; without rows where there is none.

    Attributes:
        t: shape (T,) [s]. q: joints, shape (T, n) [rad, m]. object: poses, shape (T, 7).
    """

    sentence: str
    t: Array = field(default_factory=_no_rows)
    q: Array = field(default_factory=_no_rows)
    object: Array = field(default_factory=_no_rows)
