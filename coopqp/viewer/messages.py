"""What goes between the player, the page and the explainer; arrays and words alone.

Letters: b bodies, n joints, s segments.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from coopqp.base.spec import Array
from coopqp.signal import Kind

Tone = Literal["reached", "moving", "blocked", "broken", "waiting"]


@dataclass(frozen=True)
class Surface:
    """What a joint carries, None for what stands still; vertices (v, 3) [m], corners (t, 3)."""

    joint: int | None
    vertices: Array
    corners: NDArray[np.int64]


@dataclass(frozen=True)
class LawLook:
    """A law as the page shows it; its colour is such as "#0072B2"."""

    name: str
    color: str
    keeps_limits: bool


@dataclass(frozen=True)
class Gizmo:
    """Something to drag in a phase: the task's name, and what can be done to it."""

    label: str
    phase: int
    moves: bool
    turns: bool


@dataclass(frozen=True)
class Dial:
    """A number that can be turned, from a value at first; its label says its unit."""

    key: str
    group: str
    label: str
    low: float
    high: float
    step: float
    value: float


@dataclass(frozen=True)
class Show:
    """All that does not change while a scenario is played.

    Attributes:
        bodies: of the robot, and what stands around. joints: names, shape (n,).
        size: edges of the object [m]. low, high: corners of the space that is seen [m].
        dials: gains and the like. knobs: inputs without a gizmo, a number each.
        phases: names; one for scenarios without.
        forces: whether the plant tells what the hands press with.
        folder: where recordings go; empty where nowhere.
    """

    title: str
    description: str
    laws: tuple[LawLook, ...]
    bodies: tuple[Surface, ...]
    joints: tuple[str, ...]
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
class LawFrame:
    """One law at one instant.

    Attributes:
        bodies: where their joints are, x, y, z, qx, qy, qz, qw each, shape (b, 7).
        held: where the object is, likewise, shape (7,).
        left: of each joint's half range what is left to its nearer limit; below 0 beyond it,
            shape (n,).
        arrows: of the hands' forces, from and to, shape (., 2, 3) [m]. weight: of the object's.
        words: how far from its goals, and what is wrong.
        broken: what of it must not be, such as a joint past its limit; empty if nothing.
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
class Frame:
    """Everything at one instant.

    Attributes:
        t: since the beginning [s].
        speed: how fast time shall go on. factor: how fast it does.
        laws: by the order of ``Show.laws``. main: the one that is explained.
        gizmos: where each is, shape (7,); None where its phase is not on.
        outlines: of what tasks ask for, shape (s, 2, 3) [m].
        active: limits at their bound, by name.
        detail: of the last tick that was explained. explained: whether ticks still are.
        recorded: time since the beginning that a recording has [s]. note: what to say of it.
        tick_us: longest tick of the last second [us].
    """

    t: float
    phase: int
    playing: bool
    speed: float
    factor: float
    laws: tuple[LawFrame, ...]
    main: int
    gizmos: tuple[Array | None, ...]
    outlines: Array
    tone: Tone
    sentence: str
    active: tuple[str, ...]
    detail: str
    explained: bool
    recorded: float
    note: str
    tick_us: float


@dataclass(frozen=True)
class Asked:
    """What somebody has done on the page.

    Attributes:
        what: play, pause, step, reset, speed, drag, carry, dial, knob, main or save.
        which: a gizmo or a law by number, a dial or a knob by key.
        value: numbers: a pose x, y, z, qx, qy, qz, qw, a place, or one number.
    """

    what: str
    which: int | str = 0
    value: tuple[float, ...] = ()


@dataclass(frozen=True)
class Opened:
    """The page answers, or why it does not."""

    port: int = 0
    fault: str = ""


@dataclass(frozen=True)
class Placed:
    """The law that is explained, its dials, and where each phase but the first has begun."""

    law: str
    dials: Mapping[str, float]
    starts: tuple[Array, ...]


@dataclass(frozen=True)
class Look:
    """An instant to explain: of the state, and by name what inputs follow and what they go to."""

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


@dataclass(frozen=True)
class Told:
    """Whether geometry keeps the arms from their goals and why, and what is so in this tick."""

    blocked: bool
    sentence: str
    active: tuple[str, ...]
    detail: str
