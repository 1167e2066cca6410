"""What plug-ins of a user's own raise in a run: the arms stand still, and it is said who did it."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from command_line import refused, typed
from laws import NEAR, problem
from scenario_files import GOOD

from coopqp.base.qp import QP
from coopqp.base.spec import spec
from coopqp.controllers import QPController, TorqueQp
from coopqp.limits import JointPosition, JointVelocity
from coopqp.model.closed_chain import ClosedChain
from coopqp.solver import Solution, Solve, Solver, Status
from coopqp.tasks import PointOnPoint

TASK = '''
from coopqp import Task, spec

@spec
class Bad(Task):
    """Raises late."""
    def rows(self, chain):
        return ("z",)
    def bind(self, start):
        def evaluate(state, rows):
            rows.e[0], rows.J[0] = 0.0, state.J_task[2]
            if state.t > {late}:
                raise ZeroDivisionError("late")
        return evaluate
'''
LIMIT = '''
from coopqp import Limit, spec

@spec
class Bad(Limit):
    """Raises late."""
    def bind(self, chain, dt):
        def tighten(state, rows):
            if state.t > 0.05:
                raise ZeroDivisionError("late")
        return tighten
    def margins(self, chain, q, v, dt):
        raise KeyError("margins")
'''
METRIC = '''
from coopqp import Metric, spec

@spec
class Bad(Metric):
    """Raises."""
    def measure(self, trace):
        return {what}
'''


def _plugin(folder: Path, kind: str, text: str) -> Path:
    (folder / "own" / kind).mkdir(parents=True)
    (folder / "own" / kind / f"bad_{kind}.py").write_text(text, encoding="utf-8")
    return folder / "own"


def _compared(folder: Path, scenario: str, own: Path) -> dict[str, object]:
    path = folder / "s.yaml"
    path.write_text(scenario.replace("duration: 3.0", "duration: 2.01"), encoding="utf-8")
    result = typed("compare", path, "--plugins", own, "--json", "--controllers", "qp,pseudoinverse")
    assert result.exit_code == 0, result.stderr
    found: dict[str, object] = json.loads(result.stdout)["controllers"]
    return found


def test_a_task_that_raises_in_the_middle_is_named_and_the_arms_stand(tmp_path: Path) -> None:
    own = _plugin(tmp_path, "tasks", TASK.format(late=1.5))
    found = _compared(tmp_path, GOOD.replace("secondary:", "  - bad_tasks: {}\nsecondary:"), own)
    for metrics in found.values():
        assert isinstance(metrics, dict)
        assert metrics["failed_ticks"] == 51
        failure = metrics["failures"][0]
        assert failure["tick"] == 150
        assert "task 'bad_tasks': " in failure["cause"]
        assert failure["cause"].endswith("bad_tasks.py:13: raises ZeroDivisionError: late")


def test_a_run_in_which_a_task_raises_is_drawn_and_explained(tmp_path: Path) -> None:
    own = _plugin(tmp_path, "tasks", TASK.format(late=1.5))
    path, out = tmp_path / "s.yaml", tmp_path / "out"
    text = GOOD.replace("secondary:", "  - bad_tasks: {}\nsecondary:")
    path.write_text(text.replace("duration: 3.0", "duration: 2.01"), encoding="utf-8")
    drawn = typed("compare", path, "--plugins", own, "--controllers", "qp", "--out", out)
    assert drawn.exit_code == 0, drawn.stderr
    assert (out / "report.html").exists()
    whole = typed("explain", out, "--plugins", own)
    assert whole.exit_code == 0, whole.stderr
    assert "stands still in 51 of 201 ticks: code of a task" in whole.stdout
    tick = typed("explain", out, "--plugins", own, "--tick", "170")
    assert tick.exit_code == 2
    assert "tick 170 of 'qp' has no QP: task 'bad_tasks': " in tick.stderr


def test_a_limit_that_raises_stops_those_that_heed_it(tmp_path: Path) -> None:
    own = _plugin(tmp_path, "limits", LIMIT)
    limits = "limits: [joint_position, joint_velocity, bad_limits]\nsecondary:"
    found = _compared(tmp_path, GOOD.replace("secondary:", limits), own)
    qp, other = found["qp"], found["pseudoinverse"]
    assert isinstance(qp, dict)
    assert isinstance(other, dict)
    assert "limit 'bad_limits': " in qp["failures"][0]["cause"]
    assert not other["failures"]


@pytest.mark.parametrize(
    ("what", "said"), [("1 / 0", "ZeroDivisionError"), ("{1, 2}", "TypeError")]
)
def test_a_metric_that_raises_costs_its_own_number_alone(
    tmp_path: Path, what: str, said: str
) -> None:
    own = _plugin(tmp_path, "metrics", METRIC.format(what=what))
    path = tmp_path / "s.yaml"
    path.write_text(GOOD, encoding="utf-8")
    result = typed("compare", path, "--plugins", own, "--controllers", "qp", "--json")
    assert result.exit_code == 0
    assert "warning: metric 'bad_metrics': " in result.stderr
    assert said in result.stderr
    assert json.loads(result.stdout)["controllers"]["qp"]["bad_metrics"] is None


def test_a_task_whose_marks_raise_is_refused_with_its_line(tmp_path: Path) -> None:
    marks = TASK.format(late=1e9) + "    def marks(self, t):\n        raise KeyError('marks')\n"
    own = _plugin(tmp_path, "tasks", marks)
    path = tmp_path / "s.yaml"
    path.write_text(GOOD.replace("secondary:", "  - bad_tasks: {}\nsecondary:"), encoding="utf-8")
    assert "raises KeyError: 'marks'" in refused("validate", path, "--plugins", own)


def test_motors_hold_the_weight_while_a_torque_law_has_no_answer(
    hinged_box: ClosedChain, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = problem(hinged_box, PointOnPoint(goal=NEAR), limits=(JointPosition(), JointVelocity()))
    law = TorqueQp().build(asked)
    state = law.start()
    wanted = law._level.dynamics  # type: ignore[attr-defined]
    monkeypatch.setattr(type(law), "assemble", lambda *_: 1 / 0)
    command = law.tick(state)
    assert command.status is Status.RAISED
    assert command.tau is not None
    # What balances gravity with the loops closed: no acceleration is left.
    wanted.update(state.q, state.v)
    np.testing.assert_allclose(wanted.direct(command.tau).a, 0.0, atol=1e-8)


def test_one_controller_that_cannot_be_built_leaves_the_others(tmp_path: Path) -> None:
    path = tmp_path / "s.yaml"
    named = "controllers: [qp, torque_qp]\n"
    text = "\n".join(line for line in GOOD.splitlines() if not line.startswith("controllers:"))
    path.write_text(f"{text}\n{named}".replace("duration: 3.0", "duration: 2.01"), encoding="utf-8")
    result = typed("compare", path, "--out", tmp_path / "out")
    assert result.exit_code == 0
    assert (
        "warning: torque_qp is left out: controller 'torque_qp' commands torques" in result.stderr
    )
    assert "no effect on torque_qp" not in result.stderr
    kept = json.loads((tmp_path / "out" / "metrics.json").read_text())
    assert list(kept["controllers"]) == ["qp"]
    assert "commands torques" in kept["refused"]["torque_qp"]
    said = refused("compare", path, "--controllers", "torque_qp")
    assert said.splitlines()[-1].startswith("error: controller 'torque_qp' commands torques")


@spec
class Raises(Solver):
    """Raises in every tick."""

    def open(self, qp: QP, solution: Solution) -> Solve:
        def solve() -> None:
            raise OSError("no licence")

        return solve


def test_a_solver_that_raises_is_named(chain: ClosedChain) -> None:
    law = QPController().build(problem(chain, PointOnPoint(goal=NEAR), solver=Raises()))
    command = law.tick(law.start())
    assert command.status is Status.RAISED
    assert not command.v.any()
    assert command.note.startswith("solver '")
    assert command.note.endswith("raises OSError: no licence")
