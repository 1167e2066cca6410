"""One controller with its plant, tick by tick, phase by phase; people send its inputs."""

import math
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import replace

import numpy as np

from coopqp.assessment.thresholds import torn
from coopqp.base.errors import CoopqpError
from coopqp.base.spec import Array
from coopqp.controller import Command
from coopqp.execution.controller_run import PhaseRun, begin_phase, controller_of
from coopqp.execution.rollout import GuardedPlant, drive
from coopqp.model.state import State
from coopqp.online.arrivals import in_columns
from coopqp.scenario.input import Arrival, Clock, Feed, Inputs, InputSettings
from coopqp.scenario.planned import CLOCK, Way, way_tasks
from coopqp.scenario.scenario import Scenario
from coopqp.task import TaskStack

ARRIVED = 1e-6  # an input nearer to its target has arrived
Hands = Mapping[str, list[float]]
"""What people send, by the input's name; it replaces the input's own feed."""


class HandFeed(Feed):
    """The inputs of a phase: from people, or from the scenario's feeds until people send."""

    def __init__(
        self, settings: Mapping[str, InputSettings], inputs: Inputs, since: float, hands: Hands
    ) -> None:
        super().__init__(settings, inputs, since)
        self._hands = hands
        self.arrived: list[Arrival] = []

    def step(self, state: State) -> None:
        known = self.inputs.channels
        fed = [
            (name, np.array(in_columns(known[name].kind, value)).tolist(), when)
            for name, value, when in self.arrivals(state.t)
            if name not in self._hands
        ]
        sent = [(name, list(x), state.t) for name, x in self._hands.items() if name in known]
        self.arrived = [*fed, *sent]
        self.inputs.step(state, self.arrived)


class SimulatedController:
    """A controller that is played; CoopqpError: it or the plant cannot be built."""

    run: PhaseRun  # the current phase
    feed: HandFeed
    command: Command  # of the last tick
    goals: TaskStack  # error of each task to its goal, by the tasks' rows

    def __init__(self, scenario: Scenario, name: str, hands: Hands) -> None:
        self.name, self._hands = name, hands
        self.us = 0.0  # time that the last tick took [us]
        self.starts: list[Array] = []  # q at the start of each later phase
        self.torn = False  # whether the hands were once too far apart for one object, or lost it
        self.follows: Clock | None = None  # the time along a way round, in the tasks' place
        self._ending = False
        self._enter(begin_phase(scenario.held_by(name), controller_of(scenario, name)))

    @property
    def state(self) -> State:
        return self.run.state

    @property
    def fed(self) -> bool:
        """Whether something has arrived at all inputs, and nothing is refused."""
        channels = self.feed.inputs.channels.values()
        return all(c.sent > -math.inf for c in channels) and not self.state.inputs.refused

    @property
    def at_targets(self) -> bool:
        channels = self.feed.inputs.channels.values()
        return all(np.abs(c.value - c.target).max(initial=0.0) < ARRIVED for c in channels)

    @property
    def t(self) -> float:
        """Since the scenario began [s]."""
        return self.run.since + self.state.t

    def tick(self) -> None:
        """Carry out the last command, and compute the next one."""
        if self.follows and self.follows.value[0] > self._way_ends:
            self._leave_way()
        if self.run.over and not self.run.is_last and not self.follows:
            self._end()
            self.starts.append(self.run.q.copy())
            self._enter(begin_phase(self.run.scenario, self.run.controller, self.run))
        self.command, self.us = next(self._ticks)
        self.run.ticks += 1
        held = self.plant.signals.get("held")
        if held is not None:  # hands that press may move along the object
            self.torn |= self.run.ticks > 1 and not held[0] > 0.0
        else:
            true = self.plant.truth(self.state)
            self.torn |= torn(true.loop_position_error, true.loop_orientation_error)

    def change(self, scenario: Scenario) -> None:
        """Go on from the current state with other gains and the like; CoopqpError: it cannot."""
        if self.follows is not None:
            self._leave_way()
        run, other = self.run, scenario.held_by(self.name)
        problem = other.problem(other.schedule[run.index], run.problem.chain)
        law = run.controller.build(problem)
        self._end()
        self.run = replace(run, scenario=other, problem=problem, law=law)
        self._start_driving()

    def follow(self, way: Way) -> None:
        """Go along a way, from where its clock waits for the joints, then on with the own tasks."""
        self._leave_way()
        run, problem = self.run, self.run.problem
        tasks = way_tasks(way, problem.dt, problem.chain.standing, run.controller)
        start = State(run.problem.chain, run.state.q)
        law = run.controller.build(replace(run.problem, tasks=tasks))
        self.follows = Inputs({}, tasks, start, run.problem.dt).clocks[CLOCK]
        run.inputs.clocks[CLOCK] = run.state.inputs[CLOCK] = self.follows
        self._way_ends = float(way.t[-1])
        self._end()
        self.run = replace(run, law=law)
        self._start_driving()

    def _leave_way(self) -> None:
        if self.follows is not None:
            self.follows = None
            del self.run.inputs.clocks[CLOCK], self.run.state.inputs[CLOCK]
            self.change(self.run.scenario)

    def _enter(self, run: PhaseRun) -> None:
        assert run.plant is not None  # no robot takes its place
        self.run, self.plant = run, GuardedPlant(run.plant)
        self.feed = HandFeed(run.scenario.inputs, run.inputs, run.since, self._hands)
        self._start_driving()

    def _start_driving(self) -> None:
        run = self.run
        at_start = State(run.problem.chain, run.state.q, run.state.t)
        at_start.inputs = run.state.inputs
        self.goals = TaskStack([task.at_goal() for task in run.problem.tasks], at_start)
        self._ending = False
        self._ticks: Iterator[tuple[Command, float]] = drive(
            run.law, self.plant, run.state, iter(lambda: self._ending, True), self.feed
        )

    def _end(self) -> None:
        """Let the plant carry out the last command."""
        self._ending = True
        next(self._ticks, None)

    def targets(self) -> dict[str, Array]:
        """Targets of its inputs, by name, with what people have sent since the last tick."""
        channels = self.feed.inputs.channels
        targets = {name: channel.target.copy() for name, channel in channels.items()}
        for name in channels.keys() & self._hands.keys():
            with suppress(CoopqpError):  # what cannot be used is refused by the next tick
                targets[name] = channels[name].kind.read(self._hands[name])
        return targets
