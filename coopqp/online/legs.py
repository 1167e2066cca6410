"""The phases of a loop, one after the other, each begun where the robot is then."""

from __future__ import annotations

import numpy as np

from coopqp.checked import Array
from coopqp.controller import Controller
from coopqp.errors import CoopqpError, InvalidValueError
from coopqp.online.leg import Leg, begin_leg
from coopqp.online.start import as_held
from coopqp.scenario.scenario import Scenario


class Legs:
    """The phases so far.

    Args:
        given: the scenario as it is written.
        controller: which law.
        observed: whether what is measured stays a measurement, from which commands may differ.
        by_time: whether a phase ends by itself.

    Attributes:
        given: as given.
        scenario: as begun.
        done: the phases so far, the last one that which runs; none before the beginning.
        now: the phase that runs, or would.
        fault: why the next phase could not begin; empty if it could.
    """

    def __init__(
        self, given: Scenario, controller: Controller, *, observed: bool, by_time: bool
    ) -> None:
        self.given = self.scenario = given
        self._controller, self._observed, self._by_time = controller, observed, by_time
        self._asked, self.fault = False, ""
        self.done: tuple[Leg, ...] = ()
        self.now = self._leg(0, 0, None)

    def begin(self, q: Array, *, held: bool) -> None:
        """Begin the first phase.

        Args:
            q: as measured, shape (n,).
            held: whether the object is where the hands have it there.

        Raises:
            CoopqpError: it cannot be held so.
        """
        if held and not np.array_equal(q, self.given.chain.q_start):
            self.scenario = as_held(self.given, q)
        self.now = self._leg(0, 0, q)
        self.done = (self.now,)

    def ask(self) -> None:
        """Let the phase end.

        Raises:
            InvalidValueError: it is the last.
        """
        if self._is_last:
            raise InvalidValueError(f"phase '{self.now.phase.name}' is the last")
        self._asked = True

    @property
    def _is_last(self) -> bool:
        return self.now.index + 1 == len(self.scenario.schedule)

    @property
    def over(self) -> bool:
        """Whether the next phase is due."""
        return not self._is_last and (self._asked or (self._by_time and self.now.over))

    def hand_over(self, q: Array) -> bool:
        """Begin the next phase, if the arms can stop in a tick, with the speed that they have.

        Args:
            q: as measured, shape (n,).

        Returns:
            Whether it was tried; :attr:`fault` says if it was in vain.
        """
        before = self.now
        if not before.braking.can_stop(before.state):
            return False
        self._asked = False
        try:
            self.now = self._leg(before.index + 1, before.first + before.ticks, q)
        except CoopqpError as error:
            self.fault = f"phase '{before.phase.name}' does not end: {error}"
            return True
        self.now.state.v[:] = before.state.v
        self.done = (*self.done, self.now)
        return True

    def _leg(self, index: int, first: int, q: Array | None) -> Leg:
        chain = self.scenario.chain
        if index and q is not None:
            released = self.scenario.schedule[index].released
            chain = self.now.problem.chain.handed_over(q, released)
        return begin_leg(
            self.scenario, self._controller, index, first, chain, q, observed=self._observed
        )
