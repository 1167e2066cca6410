"""A plant that cannot break a rollout: where it fails, the joints stay where they were."""

from __future__ import annotations

import numpy as np

from coopqp.base.spec import Array
from coopqp.base.wording import raised
from coopqp.controller import Command
from coopqp.model.state import State
from coopqp.plant import PlantModel
from coopqp.solver import Status

#: Joints that are beyond these are nowhere [rad or m], [rad/s or m/s].
FARTHEST, FASTEST = 1e8, 1e12


class GuardedPlant(PlantModel):
    """Wraps a plant; where it raises or leaves all numbers, everything stays where it was.

    Attributes:
        broken: the failure; empty so far.
        why: that as a status.
    """

    def __init__(self, plant: PlantModel) -> None:
        super().__init__()
        self._plant, self.broken, self.why = plant, "", Status.PLANT_FAILED
        self.signals, self.measured = plant.signals, plant.measured
        self.ideal = plant.ideal
        self._true: State | None = None  # what is true, where that is not the state itself

    def step(self, state: State, command: Command) -> None:
        if self.broken:
            return
        if self._plant.lost:  # where it was lost everything stays
            self.broken = f"the object is lost: {self._plant.lost}"
            self.why = Status.OBJECT_LOST
            return
        true = self.truth(state)
        before = [_Kept(state)] if true is state else [_Kept(state), _Kept(true)]
        why = ""
        try:
            with np.errstate(all="ignore"):  # what overflows is found below
                self._plant.step(state, command)
                self.measured = self._plant.measured
                self._true = None
                true = self.truth(state)
                if not (_bounded(state) and (true is state or _bounded(true))):
                    why = "its joints run away"
        except KeyboardInterrupt:
            raise
        except BaseException as error:  # noqa: BLE001 - a plant may be the user's, or blow up
            why = raised(error)
        if why:
            self.broken = f"the plant: {why}"
            for kept in before:
                kept.put_back()
            self._true = before[-1].state
            for signal in self.signals.values():
                signal[:] = 0.0

    def truth(self, state: State) -> State:
        """As the plant says after its last step that did not fail."""
        if self._true is None:
            self._true = self._plant.truth(state)
        return self._true

    def resume(self, before: PlantModel) -> None:
        self._plant.resume(before)


class _Kept:
    """Joints of a state, to be put back at rest."""

    def __init__(self, state: State) -> None:
        self.state, self._t, self._q = state, state.t, state.q.copy()
        self._measured = state.q_measured

    def put_back(self) -> None:
        state = self.state
        state.t, state.q[:], state.q_measured = self._t, self._q, self._measured
        state.v[:] = 0.0
        state.update()


def _bounded(state: State) -> bool:
    q, v = state.q, state.v
    return bool(q.dot(q) < FARTHEST**2 and v.dot(v) < FASTEST**2)


def settled(q: Array, v: Array) -> bool:
    """Whether joints stayed within bounds at all instants, shapes (T, n) [rad, m; rad/s, m/s]."""
    far, fast = (np.einsum("ti,ti->t", x, x) for x in (q, v))
    return bool((far < FARTHEST**2).all() and (fast < FASTEST**2).all())
