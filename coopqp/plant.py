"""What is controlled: the plant takes a command and says where the joints are dt later."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Annotated, ClassVar

import numpy as np
from pydantic import AfterValidator, Field

from coopqp.base.errors import unknown_name
from coopqp.base.spec import Array, Name, NonNegative, Positive, Vector3, spec
from coopqp.controller import Command, ControlProblem
from coopqp.model.state import State


@spec
class Push:
    """A constant wrench on the object for a while."""

    force: Vector3 = (0.0, 0.0, 0.0)
    """In the world, at the object's origin [N]."""
    torque: Vector3 = (0.0, 0.0, 0.0)
    """In the world [N m]."""
    start: NonNegative
    """When it begins [s]."""
    duration: Positive
    """How long it lasts [s]."""

    def wrench(self, t: float) -> Array | None:
        """(force; torque) at time t [s], None when there is none."""
        if self.start <= t < self.start + self.duration:
            return np.array([*self.force, *self.torque])
        return None


Length = Annotated[float, Field(ge=0.0, le=0.02)]
"""Of an error of the model [m]; with more the model is of another robot."""
Angle = Annotated[float, Field(ge=0.0, le=0.1)]
"""Of an error of the model [rad]."""

#: Of a time that is counted in control periods [s].
ROUNDING = 1e-9


@spec
class Slip:
    """The object slips in the hand of the last arm that holds it."""

    at: NonNegative
    """When it begins [s]."""
    by: Annotated[float, Field(gt=0.0, le=0.02)]
    """How far [m]."""

    #: How long it takes [s].
    DURATION: ClassVar[float] = 0.1

    def distance(self, t: float) -> float:
        """How far it has slipped at time t [m]."""
        return self.by * min(max((t - self.at) / self.DURATION, 0.0), 1.0)


#: The kinds of faults, and what each is told beside its times.
FAULTS: Mapping[str, tuple[str, ...]] = {
    "encoder_reversed": ("joint",), "encoder_stuck": ("joint",), "encoders_swapped": ("joints",),
    "encoder_offset_jump": ("joint", "by"), "encoders_in_degrees": (), "readings_lost": (),
    "motor_reversed": ("joint",), "motor_stuck": ("joint",), "motors_swapped": ("joints",),
    "force_dead": ("arm",), "force_stuck": ("arm",), "force_reversed": ("arm",),
    "force_scaled": ("arm", "by"),
}  # fmt: skip


def _known(kind: str) -> str:
    if kind not in FAULTS:
        stuck = kind.replace("dead", "stuck")
        if stuck in FAULTS:  # what people call it
            raise ValueError(f"unknown fault '{kind}'; did you mean '{stuck}'?")
        raise ValueError(unknown_name("fault", kind, FAULTS))
    return kind


@spec
class Fault:
    """A sensor that says, or a motor that does, something else than it should.

    Sensors are what the controller reads; the servos of the joints have sound ones of their own.
    """

    kind: Annotated[str, AfterValidator(_known), Field(json_schema_extra={"enum": list(FAULTS)})]
    """What is wrong."""
    joint: Name | None = None
    """Whose encoder or motor it is."""
    joints: tuple[Name, Name] | None = None
    """Whose encoders or motors are swapped."""
    arm: Name | None = None
    """Whose hand has the force sensor."""
    by: float | None = None
    """How far an encoder's offset jumps [rad, m], or over what the force should be."""
    start: NonNegative = 0.0
    """When it begins [s]."""
    duration: Positive | None = None
    """How long it lasts [s]; to the end if omitted."""

    def __post_init__(self) -> None:
        needs = FAULTS[self.kind]
        for key in ("joint", "joints", "arm", "by"):
            given = getattr(self, key) is not None
            if key in needs and not given:
                raise ValueError(f"{self.kind} needs {key}")
            if given and key not in needs:
                takes = " and ".join(needs) or "no key but start and duration"
                raise ValueError(f"{self.kind} has no key {key}; it takes {takes}")

    def acts(self, t: float) -> bool:
        """Whether it is there at time t [s]."""
        since = t - self.start + ROUNDING
        return since >= 0.0 and (self.duration is None or since < self.duration)

    @property
    def description(self) -> str:
        """What is wrong from when on: "encoder_stuck of left.3 from 0.5 s"."""
        where = " and ".join(self.joints or filter(None, (self.joint or self.arm,)))
        size = "" if self.by is None else f" by {self.by:g}"
        lasting = "" if self.duration is None else f" for {self.duration:g} s"
        of = f" of {where}" if where else ""
        return f"{self.kind}{of}{size} from {self.start:g} s{lasting}"


@spec
class Disturbance:
    """All that the controller does not know; all plants know errors of the model and slip."""

    object_mass: Positive = 1.0
    """Mass and inertia of the real object over those of the model."""
    object_com: Vector3 = (0.0, 0.0, 0.0)
    """How far the real centre of mass is from the modelled one, in the object [m]."""
    friction: Positive = 1.0
    """Of the real contacts over the modelled one."""
    push: Push | None = None
    """On the object."""
    noise_position: NonNegative = 0.0
    """Standard deviation of each measured joint position [rad, m]."""
    noise_velocity: NonNegative = 0.0
    """Standard deviation of each measured joint velocity, which torque controllers read [rad/s]."""
    delay: Annotated[int, Field(ge=0, le=1000)] = 0
    """Ticks that a command is late."""
    link_length: Length = 0.0
    """Each link is longer or shorter than the model says by this [m]."""
    encoder_offset: Angle = 0.0
    """Each turning joint's encoder says more or less than its angle by this [rad]."""
    grasp_offset: Length = 0.0
    """Each hand holds the object this far from where the model says [m]."""
    grasp_offset_angle: Angle = 0.0
    """And turned by this [rad]."""
    slip: Slip | None = None
    """Of the object in a hand."""
    faults: tuple[Fault, ...] = ()
    """Of sensors and motors, one after the other."""

    @property
    def kinematic(self) -> Disturbance:
        """The part that does not need masses."""
        kept = ("link_length", "encoder_offset", "grasp_offset", "grasp_offset_angle", "slip")
        return Disturbance(**{key: getattr(self, key) for key in (*kept, "faults")})

    def slipped(self, t: float) -> float:
        return self.slip.distance(t) if self.slip else 0.0

    def wrench(self, t: float) -> Array | None:
        return self.push.wrench(t) if self.push else None


class PlantModel(ABC):
    """A plant built for one problem.

    Attributes:
        signals: what the plant tells beside the state, by name, written by each step, recorded.
        measured: measured joint positions, shape (n,) [rad, m], where a run and each phase begin;
            None where joints follow their commands exactly.
        lost: which hand has lost the object and why, where the plant cannot go on; else empty.
    """

    ideal: bool = False
    """Whether a step is :meth:`State.advance` alone, so that many may be done at once."""

    def __init__(self) -> None:
        self.lost = ""
        self.signals: dict[str, Array] = {}
        self.measured: Array | None = None

    @property
    def hand_wrench(self) -> Array | None:
        """What the force sensors say now, ``State.hand_wrench``; None where there are none."""
        measured = self.signals.get("hand_wrench")
        return None if measured is None else measured.copy()

    @abstractmethod
    def step(self, state: State, command: Command) -> None:
        """Carry the command out for one dt: writes t, q, v and what is measured of the state.

        After a velocity command q is the commanded configuration and v the commanded velocity,
        :meth:`State.advance`, and q_measured is the measured one: limits, damping and the Baumgarte
        correction use the commands, not what a servo has made of them so far. After
        a torque command q and v are measured, and q_measured is None. Plants that know what the
        hands do to the object write hand_wrench.
        """

    def truth(self, state: State) -> State:
        """The true joints, object and loops, up to date; for an ideal plant the state itself."""
        return state

    @abstractmethod
    def resume(self, before: PlantModel) -> None:
        """Go on from where the previous phase's plant, of this type, stopped; other arms hold."""


@spec
class Plant(ABC):
    """A plug-in in ``plants/``: settings, and how to build the plant."""

    takes_torques: ClassVar[bool] = True
    """Whether torques can be commanded, and all disturbances have an effect."""
    feels: ClassVar[tuple[str, ...]] = ()
    """Without torques: keys of a disturbance that have an effect beside errors of the model."""

    @abstractmethod
    def build(self, problem: ControlProblem, seed: int, disturbance: Disturbance) -> PlantModel:
        """Make the plant of the controller's problem, at rest at the chain's start; or CoopqpError.

        ``seed`` is that of everything random, the disturbance is unknown to the controller.
        """
