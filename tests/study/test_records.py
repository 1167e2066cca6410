"""Ticks kept in files, and solved again."""

from __future__ import annotations

import json
import re
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import qpsolvers
from kept_ticks import POSE, at, first_tick, problem, record
from laws import LIMITS, NEAR, STEP, UNREACHABLE, ticks

from coopqp.base.errors import CoopqpError
from coopqp.base.qp import names_of
from coopqp.controllers import QPController
from coopqp.execution.comparison import Comparison
from coopqp.limits import JointAcceleration, ObjectSpeed
from coopqp.model.closed_chain import ClosedChain
from coopqp.qp_law.law import QPLaw
from coopqp.solver import Budget, Solver, Status
from coopqp.solvers import Daqp, Osqp, Proxqp, Qpsolvers
from coopqp.study.explanation import explain
from coopqp.study.tick_record import TickRecord, replay
from coopqp.tasks import Orientation, PointOnPoint

HARD_AND_SOFT = (
    PointOnPoint(name="far", goal=UNREACHABLE, mode="hard"),
    Orientation(name="turn", rpy_deg=(10.0, 0.0, 20.0)),
)
SCALED = PointOnPoint(name="beside", goal=NEAR, profile=STEP, mode="scaled")


def relaxed(chain: ClosedChain) -> TickRecord:
    """A second after a hard task was asked for more than limits and loops leave."""
    law = QPController().plain(problem(chain, *HARD_AND_SOFT))
    state = law.start()
    for _ in ticks(law, state, 100):
        pass
    return record(law, state, 100)


@pytest.fixture(scope="module")
def records(compared: Comparison, law: QPLaw, chain: ClosedChain) -> dict[str, TickRecord]:
    everything = (*LIMITS, ObjectSpeed(linear=0.05), JointAcceleration(max=30.0))
    point = PointOnPoint(name="reach", goal=NEAR, profile=STEP)
    return {
        "late": record(law, at(compared, law, 250), 250),
        "early": record(law, at(compared, law, 10), 10),
        "every limit": first_tick(chain, point, limits=everything),
        "no limit": first_tick(chain, point, limits=()),
        "hard": first_tick(chain, replace(point, mode="hard")),
        "scaled": first_tick(chain, replace(point, mode="scaled"), limits=everything),
        "impossible": first_tick(chain, POSE),
        "relaxed": relaxed(chain),
    }


KINDS = ("late", "early", "every limit", "no limit", "hard", "scaled", "impossible", "relaxed")
each_kind = pytest.mark.parametrize("kind", KINDS)


@each_kind
def test_record_comes_back_from_its_file_bit_for_bit(
    kind: str, records: dict[str, TickRecord], tmp_path: Path
) -> None:
    kept = records[kind]
    path = tmp_path / "tick.json"
    path.write_text(kept.text(), encoding="utf-8")
    again = TickRecord.read(path)
    assert again == kept
    for name in ("P", "q", "C", "lower", "upper"):
        np.testing.assert_array_equal(getattr(again.qp(), name), getattr(kept.qp(), name))
    assert explain(again) == explain(kept)
    json.loads(path.read_text(encoding="utf-8"), parse_constant=pytest.fail)  # no NaN, no Infinity


def test_record_is_the_program_that_the_law_solved(compared: Comparison, law: QPLaw) -> None:
    state = at(compared, law, 250)
    kept = record(law, state, 250)
    law.assemble(state)
    for name in ("P", "q", "C", "lower", "upper"):
        np.testing.assert_array_equal(getattr(kept.qp(), name), getattr(law.first.qp, name))
    assert names_of(kept.variables) == state.chain.joint_names
    assert names_of(kept.task_rows) == ("task[reach].x", "task[reach].y", "task[reach].z")
    lower, upper = np.array(kept.lower[:10]), np.array(kept.upper[:10])
    for i, (low, high) in enumerate(
        zip(names_of(kept.lb_rows), names_of(kept.ub_rows), strict=True)
    ):
        joint = state.chain.joint_names[i]
        slowest = -state.chain.velocity[i] == lower[i]
        assert low == f"limit.{'velocity' if slowest else 'position'}[{joint}].lower"
        fastest = state.chain.velocity[i] == upper[i]
        assert high == f"limit.{'velocity' if fastest else 'position'}[{joint}].upper"


SOLVERS: dict[str, Solver] = {
    "daqp": Daqp(),
    "osqp": Osqp(),
    "proxqp": Proxqp(),
    "quadprog": Qpsolvers(backend="quadprog"),
}


@pytest.mark.parametrize("solver", SOLVERS.values(), ids=SOLVERS.keys())
@each_kind
def test_replay_gives_the_same_motion_with_every_solver(
    kind: str, solver: Solver, records: dict[str, TickRecord]
) -> None:
    """Against quadprog, asked directly; the status tells nothing but small differences apart."""
    kept = records[kind]
    qp = kept.qp()
    expected = qpsolvers.solve_qp(
        qp.P, qp.q, qp.G if qp.p else None, qp.h if qp.p else None, qp.A, qp.b,
        np.maximum(qp.lb, -1e6), np.minimum(qp.ub, 1e6), solver="quadprog",
    )  # fmt: skip
    found = replay(kept, solver)
    assert found.status in (Status.OPTIMAL, Status.INACCURATE)
    assert found.primal_residual < 1e-7
    np.testing.assert_allclose(found.v, expected, atol=1e-5)
    assert found.difference == pytest.approx(
        np.abs(found.v - np.array(kept.first_answer)).max(), abs=1e-15
    )


def test_replay_repeats_a_tick_without_a_secondary_exactly(chain: ClosedChain) -> None:
    """The saved answer is the answer: difference 0, status as saved."""
    for mode in ("soft", "hard", "scaled"):
        task = PointOnPoint(name="reach", goal=NEAR, profile=STEP, mode=mode)
        kept = first_tick(chain, task)
        again = replay(kept, Daqp())
        assert again.difference < 1e-12
        assert again.status.name == kept.status


def test_replay_repeats_a_tick_with_a_secondary(compared: Comparison, law: QPLaw) -> None:
    """On the way, where joint centring moves the arms."""
    assert replay(record(law, at(compared, law, 50), 50), Daqp()).difference < 1e-9


def test_replay_of_an_impossible_tick_reports_the_failure(chain: ClosedChain) -> None:
    kept = first_tick(chain, replace(POSE, mode="hard"), on_infeasible="hold")
    assert kept.status == "INFEASIBLE"
    for solver in SOLVERS.values():
        assert not replay(kept, solver).status.usable


@pytest.mark.parametrize("beside", [(), (SCALED,)], ids=["alone", "scaled"])
def test_a_relaxed_tick_is_kept_as_the_least_squares_that_were_solved(
    beside: tuple[PointOnPoint, ...], chain: ClosedChain
) -> None:
    """What the rows of the hard task do is decided there; every later level keeps it.

    Their damping grows by what they lack.
    """
    kept = first_tick(chain, replace(POSE, mode="hard"), *beside)
    assert kept.status == "TASKS_RELAXED"
    assert {row.kind for row in kept.equality_rows} == {"loop"}
    rows = [i for i, row in enumerate(kept.task_rows) if row.owner == "carry"]
    J, wanted = np.array(kept.J)[rows], np.array(kept.wanted)[rows]
    A, b = kept.qp().A, kept.qp().b
    free = np.linalg.svd(A)[2][np.linalg.matrix_rank(A) :].T
    closing = np.linalg.lstsq(A, b)[0]
    damped = np.vstack([J @ free, np.sqrt(kept.damping) * np.eye(free.shape[1])])
    lacks = np.concatenate([wanted - J @ closing, np.zeros(free.shape[1])])
    best = closing + free @ np.linalg.lstsq(damped, lacks)[0]
    np.testing.assert_allclose(J @ np.array(kept.first_answer), J @ best, atol=1e-6)
    np.testing.assert_allclose(J @ np.array(kept.answer), J @ best, atol=1e-6)
    for solver in SOLVERS.values():
        again = replay(kept, solver)
        assert again.status.usable
        assert again.difference < 1e-6


def test_a_relaxed_tick_later_on_is_kept_as_it_was_solved(
    records: dict[str, TickRecord],
) -> None:
    kept = records["relaxed"]
    assert kept.status == "TASKS_RELAXED"
    assert any(kept.memory)
    assert replay(kept, Daqp()).difference < 1e-12
    J, hard = np.array(kept.J), [row.owner == "far" for row in kept.task_rows]
    first, last = (J[hard] @ np.array(v) for v in (kept.first_answer, kept.answer))
    np.testing.assert_allclose(first, last, atol=1e-9)
    assert np.abs(last - np.array(kept.wanted)[hard]).max() > 1e-2


def test_replay_checks_against_the_budget_of_the_run(chain: ClosedChain) -> None:
    """Rounding alone breaks a budget of 1e-30."""
    point = PointOnPoint(name="reach", goal=NEAR, profile=STEP)
    strict = first_tick(chain, point, budget=Budget(equality=1e-30))
    assert replay(strict, Daqp()).status is Status.EQUALITY_RESIDUAL
    assert replay(replace(strict, budget=Budget()), Daqp()).status is Status.OPTIMAL


def test_recording_a_stop_keeps_the_memory_from_before_the_tick(chain: ClosedChain) -> None:
    """The state that the tick began with had not stopped yet."""
    law = QPController().plain(problem(chain, replace(POSE, mode="hard"), on_infeasible="stop"))
    kept = record(law, law.start())
    assert kept.memory == [0.0] * len(law.start().memory.numbers)


@pytest.mark.parametrize(
    "text",
    ["", "{", "[]", "[1, 2]", "null", "3", '"tick"', "{}", '{"tick": 3}', "\x00\x01"],
    ids=repr,
)
def test_file_that_is_no_record_is_refused(text: str, tmp_path: Path) -> None:
    path = tmp_path / "tick.json"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(CoopqpError, match="is not a tick saved by"):
        TickRecord.read(path)


def test_binary_missing_and_unreadable_files_are_refused(tmp_path: Path) -> None:
    binary = tmp_path / "binary.json"
    binary.write_bytes(b"\xff\xfe\x00\x80")
    with pytest.raises(CoopqpError, match="is not a text file in UTF-8"):
        TickRecord.read(binary)
    with pytest.raises(CoopqpError, match="cannot be read: No such file"):
        TickRecord.read(tmp_path / "none.json")
    with pytest.raises(CoopqpError, match="cannot be read: is a folder"):
        TickRecord.read(tmp_path)


@pytest.fixture
def saved(chain: ClosedChain, tmp_path: Path) -> Path:
    path = tmp_path / "tick.json"
    record = first_tick(chain, PointOnPoint(name="reach", goal=NEAR, profile=STEP))
    path.write_text(record.text(), encoding="utf-8")
    return path


@pytest.mark.parametrize("name", [field.name for field in fields(TickRecord)])
def test_record_with_a_field_missing_is_refused(name: str, saved: Path) -> None:
    data = json.loads(saved.read_text(encoding="utf-8"))
    del data[name]
    saved.write_text(json.dumps(data), encoding="utf-8")
    with pytest.raises(CoopqpError, match="is not a tick saved by"):
        TickRecord.read(saved)


def test_truncated_or_extended_record_is_refused(saved: Path) -> None:
    text = saved.read_text(encoding="utf-8")
    for broken in (text[: len(text) // 2], text[:-3], text.rstrip()[:-1] + ', "more": 1}'):
        saved.write_text(broken, encoding="utf-8")
        with pytest.raises(CoopqpError, match="is not a tick saved by"):
            TickRecord.read(saved)


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("P", "large"),
        ("P", [[1.0]]),
        ("C", [[0.0, 1.0]]),
        ("lower", [None]),
        ("q_cost", [1.0]),
        ("J", [[1.0, 2.0, 3.0]]),
        ("wanted", "up"),
        ("variables", 10),
        ("damping", "little"),
        ("answer", []),
        ("lb_rows", []),
    ],
    ids=lambda value: repr(value)[:20],
)
def test_record_with_rubbish_in_a_field_is_refused(field: str, value: Any, saved: Path) -> None:
    data = json.loads(saved.read_text(encoding="utf-8"))
    data[field] = value
    saved.write_text(json.dumps(data), encoding="utf-8")
    with pytest.raises(CoopqpError):
        TickRecord.read(saved)


@pytest.mark.parametrize(
    ("mark", "field", "value"),
    [
        ("P", "P[1][0]", 7.0),
        ("q_cost", "q_cost", [1.0]),
        ("C", "C[2]", [1.0]),
        ("J", "J[0][1]", "one"),
        ("variables", "variables[3].kind", "bone"),
        ("modes", "modes.reach", "fast"),
        ("dt", "dt", 0.0),
        ("inequalities", "inequalities", 99),
    ],
)
def test_a_refusal_names_the_line(mark: str, field: str, value: Any, saved: Path) -> None:
    """A mark is put where the value is, and looked for in the text."""
    data = json.loads(saved.read_text(encoding="utf-8"))
    holder, keys = data, re.findall(r"\w+", field)
    for key in keys[:-1]:
        holder = holder[int(key) if key.isdigit() else key]
    last = int(keys[-1]) if keys[-1].isdigit() else keys[-1]
    holder[last] = "MARK"
    marked = json.dumps(data, indent=1).splitlines()
    line = next(i for i, text in enumerate(marked, 1) if "MARK" in text)
    holder[last] = value
    saved.write_text(json.dumps(data, indent=1), encoding="utf-8")
    with pytest.raises(CoopqpError, match=rf"tick\.json:{line}: is not a tick .*: {mark}"):
        TickRecord.read(saved)


def test_a_broken_text_names_the_line_at_which_it_breaks(saved: Path) -> None:
    lines = saved.read_text(encoding="utf-8").splitlines(keepends=True)
    for wrong in ("oops,\n", '"half a\n'):
        saved.write_text("".join([*lines[:7], wrong, *lines[8:]]), encoding="utf-8")
        with pytest.raises(CoopqpError, match=r"tick\.json:8: is not a tick"):
            TickRecord.read(saved)
