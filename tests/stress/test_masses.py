"""The stress test on plants with masses: a small share of it, its statics and its detectors."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from rich.console import Console
from scenario_files import needs_robots

from coopqp.base.errors import MissingDependencyError
from coopqp.plant import Disturbance
from coopqp.plants import Mujoco, RigidBody
from coopqp.solvers import Osqp, Proxqp
from coopqp.study.engine import Engine
from stress.draw import Draw, draw
from stress.judgement import Rollout
from stress.masses import MARGIN, Run, Squeeze, draw_with_masses, saturates, squeezes
from stress.summary import summarize, table
from stress.trial import one_rollout, stress

#: They rest, without noise, in spite of errors of the model: TIAGo, after a slip, and three UR.
AT_REST = (4, 13)


@pytest.fixture(scope="module")
def pairs() -> list[Rollout]:
    pytest.importorskip("mujoco")
    return [one_rollout(seed, plant=Mujoco()) for seed in AT_REST]


# A small share of it.


@needs_robots
def test_a_small_share_breaks_no_promise(pairs: list[Rollout]) -> None:
    assert [(r.seed, r.broken) for r in pairs if r.broken] == []
    assert all(r.errors == "some" for r in pairs)


@needs_robots
def test_what_squeezes_in_mujoco_is_what_the_statics_explain(pairs: list[Rollout]) -> None:
    """MuJoCo's forces against a linear system of our own; its welds give way a little."""
    for r in pairs:
        assert r.force > 0.1
        assert r.force == pytest.approx(r.explained, rel=0.1)


def test_draws_are_wide() -> None:
    drawn = [draw_with_masses(seed) for seed in range(40)]
    assert {d.errors for d in drawn} == {"none", "some"}
    assert {d.goal for d in drawn} == {"in reach", "anywhere"}
    assert {d.grasp for d in drawn} == {"rigid", "revolute", "revolute one"}
    assert {d.kappa for d in drawn} == {"0.1/dt", "1/dt"}
    assert {d.disturbance.delay for d in drawn} == {0, 1, 2}
    assert any(d.disturbance.slip for d in drawn)
    assert any(d.disturbance.push for d in drawn)
    assert all(0.5 <= d.disturbance.object_mass <= 2.0 for d in drawn)
    assert all(d.disturbance.encoder_offset < MARGIN for d in drawn)
    assert all(d.without_errors.kinematic == Disturbance() for d in drawn)


@pytest.mark.parametrize("drawing", [draw, draw_with_masses])
@pytest.mark.parametrize("solver", [Osqp(), Proxqp()])
def test_a_solver_changes_nothing_of_what_is_drawn(
    drawing: Callable[..., Draw], solver: Osqp | Proxqp
) -> None:
    mine, default = drawing(5, solver), drawing(5)
    assert mine.problem.solver == solver
    assert np.array_equal(mine.problem.chain.q_start, default.problem.chain.q_start)
    assert mine.problem.tasks == default.problem.tasks
    assert mine.problem.limits == default.problem.limits


@pytest.mark.full
@pytest.mark.parametrize("solver", [Osqp(), Proxqp()])
def test_other_solvers_keep_the_promise(solver: Osqp | Proxqp) -> None:
    rollout = one_rollout(3, solver)
    assert rollout.broken == ()
    assert rollout.ticks >= 200


# Detectors.


def run(force: float, *, rests: bool = True, weight: float = 0.0, noise: float = 0.0) -> Run:
    """A made-up run of seed 34, with no motor at its limit."""
    none = np.zeros(draw_with_masses(34).problem.chain.n, bool)
    found = Squeeze(weight=weight, noise=noise, tau=np.zeros(len(none)))
    return Run(Rollout(34), force, rests, found, none, none)


def test_more_force_than_without_errors_and_than_explained_is_a_squeeze() -> None:
    clean = run(1.0)
    assert squeezes(run(1.1), clean) == ()
    assert "squeezes with 1.2 N" in squeezes(run(1.2), clean)[0]
    assert squeezes(run(1.2, weight=1.2), clean) == ()
    assert squeezes(run(1.2, noise=0.1), clean) == ()
    assert squeezes(run(float("nan")), clean)


def test_who_does_not_rest_is_said_to_squeeze_and_not_to_rest() -> None:
    assert "does not rest" in squeezes(run(2.0, rests=False), run(1.0))[0]


def test_a_motor_at_its_limit_counts_where_neither_weight_nor_clean_run_asks_for_it() -> None:
    drawn, clean = draw_with_masses(34), run(1.0)
    full = clean.saturated.copy()
    full[0] = True
    now = replace(clean, saturated=full)
    assert drawn.problem.chain.joint_names[0] in saturates(drawn, now, clean)[0]
    assert saturates(drawn, now, now) == ()
    assert saturates(drawn, replace(now, overloaded=full), clean) == ()


# What people see.


def test_table_can_be_read_at_80_columns() -> None:
    some = Rollout(
        1, "two_pandas", "rigid", kappa="0.1/dt", goal="anywhere", errors="some",
        outcome="at rest", squeezed=True, broken=("squeezes",), force=1.0,
    )  # fmt: skip
    console = Console(width=80, record=True, file=open(os.devnull, "w"))  # noqa: SIM115
    console.print(table(summarize([some]), "mujoco"))
    console.file.close()
    text = console.export_text()
    assert "…" not in text
    assert all(len(line.rstrip()) <= 80 for line in text.splitlines())
    for words in ("on mujoco", "satu-", "squee-", "firm", "anywhere", "errors some", "1.00 N"):
        assert words in text
    assert "start" not in text


def test_a_plant_that_is_not_installed_is_said_in_words(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "mujoco", None)
    with pytest.raises(MissingDependencyError, match=r"coopqp\[mujoco\]"):
        stress(2, partial(one_rollout, plant=Mujoco()), engine=Engine(jobs=1))


def test_what_raises_is_a_broken_promise(monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(*_: object) -> None:
        raise ZeroDivisionError("here")

    monkeypatch.setattr(RigidBody, "build", fails)
    assert one_rollout(3, plant=RigidBody()).broken == ("raised ZeroDivisionError: here",)
