"""What is said of a run that did not reach its goal."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

from coopqp.study.explanation.shares import Share
from coopqp.study.explanation.unmet import Relaxed


@dataclass(frozen=True, kw_only=True)
class MissedPart:
    """A part of a task that ended outside its tolerance."""

    task: str
    error: float
    unit: str


@dataclass(frozen=True, kw_only=True)
class HeldBack:
    """A limit that holds back, with its share of the force."""

    limit: str
    words: str
    share: float


@dataclass(frozen=True, kw_only=True)
class Needed:
    """What a limit would have to give [rad or m]."""

    limit: str
    words: str
    amount: float
    unit: str


@dataclass(frozen=True, kw_only=True)
class RunExplanation:
    """Why a run did not reach its goal.

    Attributes:
        controller: whose run.
        phase: that missed, empty where there is one only.
        tick: its last.
        kind: reached, broken, open, input, lost, limits, elsewhere, reach, contradiction,
            freedom, speed, budget, short, rest, model, motors, springs, way, weight, failed or
            unplaced.
        sentence: all of it in words.
        missed: what ended outside its tolerance, hard and scaled tasks first, then the worst.
        held_back: limits by their share of the force.
        needed: what limits would have to give.
        tried: whether a rerun with all of that, or with the time needed, reached the goal; None
            where nothing was tried.
        tasks: that contradict each other, or are out of reach.
        any_robot: whether they would on any other robot.
        distance: out of reach by so much, in the unit of what is missed most.
        way: unit vector to the goal from the nearest point, where that is one of the world's.
        time: that would do, or at which the object was lost [s].
        relaxed: hard and scaled tasks that were not met in full on the way.
    """

    controller: str
    phase: str
    tick: int
    kind: str = ""
    sentence: str = ""
    missed: tuple[MissedPart, ...] = ()
    held_back: tuple[HeldBack, ...] = ()
    needed: tuple[Needed, ...] = ()
    tried: bool | None = None
    tasks: tuple[str, ...] = ()
    any_robot: bool = False
    distance: float | None = None
    way: tuple[float, ...] = ()
    time: float | None = None
    relaxed: tuple[Relaxed, ...] = ()

    def because(
        self, kind: str, words: str, shares: Sequence[Share] = (), **more: Any
    ) -> RunExplanation:
        """The same with its cause, said after what it misses, and more attributes."""
        said = f"{self.sentence}; {words}" if self.sentence else words
        held = tuple(HeldBack(limit=s.row.name, words=s.row.words, share=s.share) for s in shares)
        return replace(self, kind=kind, sentence=said, held_back=held, **more)

    def as_json(self) -> dict[str, Any]:
        """For machines."""
        return asdict(self)
