"""What of a loop lasts as long as a phase: the problem, its law, its inputs and its state."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from coopqp.checked import Array
from coopqp.closed_chain import ClosedChain
from coopqp.controller import Controller, ControlProblem, Law
from coopqp.errors import InvalidValueError
from coopqp.input import Inputs
from coopqp.online.arrivals import Arrivals
from coopqp.online.braking import Braking
from coopqp.scenario.scenario import Phase, Scenario
from coopqp.state import State

#: What force sensors say arrives as an input of this name with every tick; ``State.hand_wrench``.
HAND_WRENCH = "hand_wrench"


@dataclass
class Leg:
    """A phase while it runs.

    Attributes:
        index: of the phase in the schedule.
        phase: of the scenario.
        first: how many ticks of the phases before it there have been.
        problem, law, inputs, arrivals: for this phase.
        braking: what brings it to rest.
        state: now.
        ticks: how many its law has done.
    """

    index: int
    phase: Phase
    first: int
    problem: ControlProblem
    law: Law
    inputs: Inputs
    arrivals: Arrivals
    braking: Braking
    state: State
    ticks: int = 0

    @property
    def over(self) -> bool:
        """Whether its time is up."""
        return self.ticks >= self.phase.ticks(self.problem.dt)

    def take_up(self, q: Array, *, observed: bool) -> None:
        """Go on from where the robot is, at rest, at the time where the phase has stopped.

        Args:
            q: as measured, shape (n,).
            observed: whether q stays a measurement, from which commands may differ.
        """
        before = self.state
        self.state = begin_state(self.law, q, observed=observed)
        self.state.t, self.state.inputs = before.t, before.inputs
        self.rest_inputs()

    def feel(self, inputs: Any) -> Any:
        """Take what the force sensors say out of what has arrived, where hands squeeze by it.

        Args:
            inputs: by name.

        Returns:
            The others.
        """
        if not self.law.squeezer:
            return inputs
        self.state.hand_wrench = None
        if not isinstance(inputs, Mapping) or HAND_WRENCH not in inputs:
            return inputs
        self.state.hand_wrench = inputs[HAND_WRENCH]  # anything; the law looks at it
        return {name: given for name, given in inputs.items() if name != HAND_WRENCH}

    def rest_inputs(self) -> None:
        """Let what follows the inputs stand where it is."""
        for channel in self.inputs.channels.values():
            channel.rate[:] = channel.acceleration[:] = 0.0
            if channel.kind.velocity:
                channel.value[:] = 0.0


def begin_state(law: Law, q: Array | None, *, observed: bool) -> State:
    """The state of a law's first tick.

    Args:
        law: of a chain.
        q: as measured, shape (n,); the chain's start when omitted.
        observed: whether q stays a measurement, from which commands may differ.
    """
    return law.start(q_measured=q) if observed and q is not None else law.start(q)


def begin_leg(
    scenario: Scenario,
    controller: Controller,
    index: int,
    first: int,
    chain: ClosedChain,
    q: Array | None,
    *,
    observed: bool,
) -> Leg:
    """Build what a phase needs.

    Args:
        scenario: whose phase.
        controller: which law.
        index: of the phase.
        first: how many ticks of the phases before it there have been.
        chain: at the start of the phase.
        q: as measured there, shape (n,); the chain's start when omitted.
        observed: whether q stays a measurement, from which commands may differ.

    Raises:
        CoopqpError: the law cannot be built, or an input is not there; hands squeeze by admittance,
            and commands do not integrate.
    """
    phase = scenario.schedule[index]
    problem = scenario.problem(phase, chain)
    law = controller.build(problem)
    if law.squeezer and not observed:
        raise InvalidValueError(
            'reference: found "measured"; hands that squeeze by admittance need "commanded", '
            "because what they press is how far the commands lead"
        )
    state = begin_state(law, q, observed=observed)
    tasks = (*problem.tasks, *problem.wrenches, *problem.secondary)
    inputs = Inputs(scenario.inputs, tasks, state, problem.dt)
    names = {*scenario.inputs, *([HAND_WRENCH] if law.squeezer else [])}
    return Leg(
        index=index,
        phase=phase,
        first=first,
        problem=problem,
        law=law,
        inputs=inputs,
        arrivals=Arrivals(inputs, names, first * problem.dt),
        braking=Braking(problem, law.squeezer),
        state=state,
    )
