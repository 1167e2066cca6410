"""Laws in closed form: the kernel's answers are those of the formulas in Python."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from chains import short_pair
from laws import NEAR, problem
from side_by_side import needs_kernel

from coopqp.controller import Controller, Law
from coopqp.controllers import (
    DampedPseudoinverse,
    Pseudoinverse,
    PseudoinverseNullSpace,
    WeightedLeastNorm,
)
from coopqp.execution.comparison import summarize
from coopqp.execution.controller_run import run
from coopqp.kernel import formula
from coopqp.model.closed_chain import ClosedChain
from coopqp.report.cells import cells
from coopqp.scenario.loader import load
from coopqp.solver import Status
from coopqp.tasks import JointCentering, Manipulability, PointOnPlane, PointOnPoint
from coopqp.trace import Trace

pytestmark = needs_kernel

FORMULAS = (Pseudoinverse(), PseudoinverseNullSpace(), DampedPseudoinverse(), WeightedLeastNorm())
SECONDARY = (JointCentering(gain=0.5, weight=2.0), Manipulability(gain=0.5))
SCENARIOS = ("point_on_point", "two_pandas", "three_ur", "tiago_torso", "pr2_circle", "two_so101")


def by_python(law: Law, controller: Controller) -> Law:
    """The same law without the kernel."""
    other = controller.build(law.problem)
    other._whole = None  # type: ignore[attr-defined]
    return other


@pytest.mark.parametrize("controller", FORMULAS, ids=lambda c: c.name)
@pytest.mark.parametrize("name", SCENARIOS)
def test_formulas_agree(name: str, controller: Controller, rng: np.random.Generator) -> None:
    """To 1e-12 of the larger of the velocity and 1 rad/s, along motions with limits in sight."""
    given = replace(load(name).problem(), limits=(), wrenches=(), secondary=SECONDARY)
    law = controller.build(given)
    plain, state = by_python(law, controller), law.start()
    for k in range(60):
        if k % 20 == 10:
            state.q += 0.02 * rng.normal(size=given.chain.n)
        other = law.start(state.q)
        other.v[:], other.t = state.v, state.t
        wanted = plain.tick(other).v
        command = law.tick(state)
        assert law.compiled
        assert not plain.compiled
        assert command.status is Status.OPTIMAL
        most = 1e-12 * max(1.0, np.abs(wanted).max())
        np.testing.assert_allclose(command.v, wanted, rtol=0.0, atol=most)
        np.testing.assert_allclose(state.J_ext, other.J_ext, atol=1e-13)
        state.advance(command.v, given.dt)


@pytest.mark.parametrize("controller", FORMULAS, ids=lambda c: c.name)
def test_ranks_are_decided_in_python(controller: Controller, chain: ClosedChain) -> None:
    """Where rows are dependent the answer is that of singular values; damped ones have no rank."""
    tasks = (
        PointOnPoint(goal=NEAR),
        PointOnPlane(name="again", normal=(0.0, 0.0, 1.0), through=(0.0, 0.0, 0.06)),
    )
    law = controller.build(problem(chain, *tasks))
    command = law.tick(law.start())
    wanted = by_python(law, controller).tick(law.start()).v
    assert law.compiled == isinstance(controller, DampedPseudoinverse)
    np.testing.assert_allclose(command.v, wanted, atol=1e-11)


def test_python_does_what_the_kernel_cannot(chain: ClosedChain) -> None:
    """Loops that change, measured joints, states that are none."""
    varying = Pseudoinverse().build(problem(short_pair(), JointCentering(gain=0.5)))
    assert formula.why_not(varying.problem) or not varying.tick(varying.start()).messages
    law = Pseudoinverse().build(problem(chain, PointOnPoint(goal=NEAR)))
    assert law.tick(law.start(q_measured=chain.q_start)).status is Status.OPTIMAL
    assert not law.compiled
    state = law.start()
    state.q[0] = np.nan
    assert law.tick(state).status is Status.NOT_FINITE
    assert law.tick(law.start()).status is Status.OPTIMAL
    assert law.compiled


def test_a_table_shows_no_time_of_python_beside_the_kernels() -> None:
    """It compares laws, and not languages."""
    scenario = replace(load("point_on_point"), duration=0.1)
    names = ("qp", "pseudoinverse", "saturation_null_space")
    traces: dict[str, Trace] = {name: run(scenario, controller=name) for name in names}
    found = summarize(scenario, traces)
    of = {n: cells(traces[n], found.metrics[n], traces.values())["tick"].lines for n in names}
    assert [lines[1] for lines in of.values()] == ["C++", "C++", "Python"]
    assert [lines[0] == "-" for lines in of.values()] == [False, False, True]
    alone = cells(traces[names[2]], found.metrics[names[2]])["tick"].lines
    assert float(alone[0]) > 0.0
