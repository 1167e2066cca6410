"""One law with its plant, tick by tick, phase by phase; what is sent to it comes from people."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import replace

import numpy as np

from coopqp.assessment.thresholds import torn
from coopqp.checked import Array
from coopqp.controller import Command
from coopqp.controller_run import BegunPhase, begin_phase, controller_of
from coopqp.errors import CoopqpError
from coopqp.input import Arrival, Feed, Inputs, InputSettings
from coopqp.online.arrivals import in_columns
from coopqp.plants._guarded import GuardedPlant
from coopqp.rollout import drive
from coopqp.scenario.scenario import Scenario
from coopqp.state import State
from coopqp.task import TaskStack

Hands = Mapping[str, list[float]]
"""What people send, by the input's name; who feeds an input otherwise is not heard then."""


class HandFeed:
    """Who sends during a phase: people, or who feeds the scenario's inputs until they do.

    Args:
        settings: of the inputs, by name.
        inputs: of the phase.
        since: when it begins [s].
        hands: what people send; looked at anew in each tick.

    Attributes:
        inputs: of the phase.
        arrived: what has been sent for the last tick.
    """

    def __init__(
        self, settings: Mapping[str, InputSettings], inputs: Inputs, since: float, hands: Hands
    ) -> None:
        self.inputs, self._hands = inputs, hands
        self._feed = Feed(settings, inputs, since)
        self.arrived: list[Arrival] = []

    def step(self, state: State) -> None:
        """Let what has been sent arrive, for the tick of a state."""
        known = self.inputs.channels
        fed = [
            (name, np.array(in_columns(known[name].kind, value)).tolist(), when)
            for name, value, when in self._feed.arrivals(state.t)
            if name not in self._hands
        ]
        sent = [(name, list(x), state.t) for name, x in self._hands.items() if name in known]
        self.arrived = [*fed, *sent]
        self.inputs.step(state, self.arrived)


class Lane:
    """A law that is played.

    Args:
        scenario: with inputs for all that can be dragged.
        name: of the controller.
        hands: what people send.

    Raises:
        CoopqpError: the controller or the plant cannot be built.

    Attributes:
        name: of the controller.
        phase: index of the phase that is on. since: when that began [s].
        begun: its problem, law, plant and state.
        plant: guarded.
        feed: who sends to it.
        command: of the last tick. us: time that it took [us].
        starts: configuration in which each phase but the first has begun.
        torn: whether the hands were once too far apart for one object, or have lost it.
        goals: error of each task to its goal, by the tasks' rows.
    """

    command: Command
    feed: HandFeed

    def __init__(self, scenario: Scenario, name: str, hands: Hands) -> None:
        self.name, self._hands = name, hands
        self._scenario = scenario.held_by(name)
        self._chosen = controller_of(scenario, name)
        self.phase, self.since, self.us = 0, 0.0, 0.0
        self.starts: list[Array] = []
        self._ticks, self._before = 0, 0
        self._ending = self.torn = False
        self.begun: BegunPhase
        self._begin(begin_phase(self._scenario, self._chosen, 0, None))

    @property
    def keeps_limits(self) -> bool:
        """Whether the law promises to."""
        return "limits" in self._chosen.heeds

    @property
    def state(self) -> State:
        """That of the last tick."""
        return self.begun.state

    @property
    def followed(self) -> bool:
        """Whether something has arrived at all inputs, and nothing is refused."""
        channels = self.feed.inputs.channels.values()
        return all(c.sent > -math.inf for c in channels) and not self.state.inputs.refused

    @property
    def t(self) -> float:
        """Since the scenario began [s]."""
        return self.since + self.state.t

    @property
    def scenario(self) -> Scenario:
        """As the law holds it."""
        return self._scenario

    def tick(self) -> None:
        """Carry out what was decided, and decide anew."""
        last = self.phase == len(self._scenario.schedule) - 1
        over = self._ticks >= self._scenario.schedule[self.phase].ticks(self._scenario.dt)
        if over and not last:
            self._enter_next()
        self.command, self.us = next(self._run)
        self._ticks += 1
        self.torn = self.torn or self._is_torn()

    def _is_torn(self) -> bool:
        """Whether the hands are too far apart for one object, or have lost it."""
        held = self.plant.signals.get("held")
        if held is not None:  # hands that press may move along the object
            return self._ticks > 1 and not held[0] > 0.0
        true = self.plant.truth(self.state)
        return torn(true.loop_position_error, true.loop_orientation_error)

    def turn(self, scenario: Scenario) -> None:
        """Build the law anew for other gains and the like, and go on from where it is.

        Args:
            scenario: the same but for what has been turned.

        Raises:
            CoopqpError: the law cannot be built for it.
        """
        other = scenario.held_by(self.name)
        problem = other.problem(other.schedule[self.phase], self.begun.problem.chain)
        law = self._chosen.build(problem)
        self._end()
        self._scenario = other
        self.begun = replace(self.begun, problem=problem, law=law)
        self._start_driving()

    def _enter_next(self) -> None:
        self._end()
        self.phase += 1
        self._before += self._ticks
        self._ticks = 0
        self.since = self._before * self._scenario.dt
        self.starts.append(self.begun.q.copy())
        self._begin(begin_phase(self._scenario, self._chosen, self.phase, self.begun))

    def _begin(self, begun: BegunPhase) -> None:
        self.begun, self.plant = begun, GuardedPlant(begun.plant)
        problem, scenario = begun.problem, self._scenario
        tasks = (*problem.tasks, *problem.wrenches, *problem.secondary)
        inputs = Inputs(scenario.inputs, tasks, begun.state, problem.dt)
        self.feed = HandFeed(scenario.inputs, inputs, self.since, self._hands)
        self._start_driving()

    def _start_driving(self) -> None:
        begun, problem = self.begun, self.begun.problem
        at_start = State(problem.chain, begun.state.q, begun.state.t)
        at_start.inputs = begun.state.inputs
        self.goals = TaskStack([task.at_goal() for task in problem.tasks], at_start)
        self._ending = False
        self._run: Iterator[tuple[Command, float]] = drive(
            begun.law, self.plant, begun.state, iter(lambda: self._ending, True), self.feed
        )

    def _end(self) -> None:
        """Let the plant carry out what was decided last."""
        self._ending = True
        next(self._run, None)

    def targets(self) -> dict[str, Array]:
        """What its inputs go to, by name, with what people have sent since the last tick."""
        found = {}
        for name, channel in self.feed.inputs.channels.items():
            found[name] = channel.target.copy()
            if name in self._hands:
                with suppress(CoopqpError):  # what cannot be used is refused by the next tick
                    found[name] = channel.kind.read(self._hands[name])
        return found
