"""Ticks that are kept, with all that the law solved in them."""

from __future__ import annotations

from functools import partial
from typing import Any

import laws
from laws import LIMITS, STEP

from coopqp.base.spec import Pose as PoseValue
from coopqp.controllers import QPController
from coopqp.execution.comparison import Comparison
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.state import State
from coopqp.qp_law.law import QPLaw
from coopqp.solver import Budget
from coopqp.study.tick_record import TickRecord, record_tick
from coopqp.task import Task
from coopqp.tasks import Pose

WIDE = Budget(loop_position=1.0, loop_orientation=3.0)
problem = partial(laws.problem, limits=LIMITS, budget=WIDE)


def record(law: QPLaw, state: State, tick: int = 0) -> TickRecord:
    return record_tick(law, state, scenario="made here", controller="qp", tick=tick)


def first_tick(chain: ClosedChain, *tasks: Task, **settings: Any) -> TickRecord:
    law = QPController().plain(problem(chain, *tasks, **settings))
    return record(law, law.start())


def at(compared: Comparison, law: QPLaw, tick: int) -> State:
    """The state before a tick, from the trace in memory."""
    trace = compared.traces["qp"]
    state = law.start(trace.q[tick])
    state.t = float(trace.t[tick])
    state.v[:] = trace.v[tick - 1] if tick else 0.0
    state.memory.numbers[:] = trace.memory[tick]
    return state


POSE = Pose(
    name="carry",
    goal=PoseValue(position=(0.175, 0.008, 0.020), rpy_deg=(-9, 12, 0)),
    profile=STEP,
)
