"""Problems, laws built for them, and the loop of perfect joint servos around a law."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from coopqp.base.spec import Array
from coopqp.controller import Command, Controller, ControlProblem, Law
from coopqp.controllers import QPController
from coopqp.execution.rollout import drive, rollout
from coopqp.limit import Limit
from coopqp.limits import JointPosition, JointVelocity
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.profile import Profile
from coopqp.model.state import State
from coopqp.plant import Disturbance
from coopqp.plants import Kinematic
from coopqp.plants.kinematic import KinematicModel
from coopqp.solver import Budget, Status
from coopqp.solvers import Daqp
from coopqp.task import Task
from coopqp.trace import Trace

DT = 0.01  # [s]
STEP = Profile(kind="step")
UNREACHABLE = (0.19, 0.1, 0.25)
NEAR = (0.19, 0.01, 0.06)  # of the object's place in NAO's hands [m]
LIMITS: tuple[Limit, ...] = (JointPosition(), JointVelocity())


#: For fast motions of one tick, where the optimum is looked at and not the step.
WIDE = Budget(accuracy=1e-2, loop_position=1.0, loop_orientation=1.0)
#: Without damping that grows with the error, ticks are alike whatever is given up.
PLAIN = QPController(damping=1e-6, error_damping=0.0)


def problem(chain: ClosedChain, *tasks: Task, **settings: Any) -> ControlProblem:
    """DAQP a hundred times a second, drift corrected in one tick, no limits unless told."""
    given = {"solver": Daqp(), "dt": DT, **settings}
    if "kappa" not in given:
        given["kappa"] = 1.0 / given["dt"]
    return ControlProblem(chain=chain, tasks=tasks, **given)


def answer(controller: Controller, problem: ControlProblem, q: Array | None = None) -> Array:
    """One tick's joint velocity, at the chain's start or at q."""
    law = controller.build(problem)
    command = law.tick(law.start(q))
    assert command.status is Status.OPTIMAL
    return command.v.copy()


def step(state: State, v: Array, dt: float) -> None:
    """What perfect joint servos make of a command in one period."""
    state.v[:] = v
    state.q += dt * state.v
    state.t += dt


def ticks(law: Law, state: State, count: int) -> Iterator[Command]:
    """Tick and step by turns; each command is given out before its step is made."""
    plant = KinematicModel(law.problem.dt)
    for command, _ in drive(law, plant, state, count):
        yield command


def run(controller: Controller, problem: ControlProblem, count: int) -> Trace:
    """The trace of so many ticks with perfect joint servos."""
    plant = Kinematic().build(problem, 0, Disturbance())
    return rollout(controller.build(problem), plant, count, controller="qp", solver="daqp")


def distances(trace: Trace, goal: tuple[float, float, float]) -> Array:
    """Of the object from its goal, shape (T + 1,) [m]."""
    return np.asarray(np.linalg.norm(trace.position - goal, axis=1))


def reach(state: State, goal: tuple[float, float, float], gain: float = 5.0) -> tuple[Array, Array]:
    """Rows and wanted velocity of the object's origin that goes to a point at once."""
    return state.J_task[:3], -gain * (state.p_WO - goal)
