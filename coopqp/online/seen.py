"""What a loop shows of itself: its scenario, its phases, and what runs now."""

from __future__ import annotations

from coopqp.controller import ControlProblem, Law
from coopqp.online.phases import Phases
from coopqp.online.played_again import text_of_begun
from coopqp.phase_run import PhaseRun
from coopqp.scenario.scenario import Phase, Scenario
from coopqp.state import State


class Seen:
    """A loop, to be looked at."""

    controller: str
    _given: Scenario
    _phases: Phases

    @property
    def scenario(self) -> Scenario:
        """As begun: its start is where the robot was."""
        return self._phases.scenario

    @property
    def source(self) -> str:
        """Its text, with what the loop has changed; empty where it was made in Python."""
        return text_of_begun(self.scenario, self._given, self.controller)

    @property
    def phases(self) -> tuple[PhaseRun, ...]:
        """The phases so far, the last one that which runs; none before the beginning."""
        return self._phases.done

    @property
    def state(self) -> State:
        """What the last tick decided from: commanded joints, kinematics, inputs."""
        return self._phases.now.state

    @property
    def law(self) -> Law:
        """The controller, built for this phase."""
        return self._phases.now.law

    @property
    def problem(self) -> ControlProblem:
        """What it was built for."""
        return self._phases.now.problem

    @property
    def phase(self) -> Phase:
        """The phase that runs."""
        return self._phases.now.phase
