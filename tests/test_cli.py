"""The command line: what a person types, what comes back, and exit codes."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest
from command_line import refused, typed
from forking import program
from scenario_files import LOADABLE

from coopqp.scenario.loader import shipped


@pytest.fixture(scope="module")
def short(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A scenario of a tenth of a second."""
    text = shipped()["point_on_point"].read_text(encoding="utf-8")
    path = tmp_path_factory.mktemp("short") / "short.yaml"
    text = text.replace("duration: 3.0", "duration: 0.1").replace("duration: 2.0", "duration: 0.1")
    path.write_text(text, encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def written(short: Path) -> Path:
    """The folder of its report."""
    out = short.parent / "out"
    assert typed("compare", short, "--out", out).exit_code == 0
    return out


def test_compare_prints_a_table_and_writes_the_report(short: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    result = typed("compare", short, "--out", out)
    assert result.exit_code == 0
    assert "pseudoinverse" in result.output
    for name in ("report.html", "metrics.json", "trace.csv"):
        assert (out / name).stat().st_size > 0
        assert name in result.output


def test_compare_in_json_is_json_alone(short: Path) -> None:
    result = typed("compare", short, "--json", "--controllers", "qp, damped_pseudoinverse")
    assert set(json.loads(result.stdout)["controllers"]) == {"qp", "damped_pseudoinverse"}


def test_run_takes_one_controller_and_a_solver(short: Path) -> None:
    result = typed("run", short, "--controller", "qp", "--solver", "proxqp", "--json")
    assert json.loads(result.stdout)["controllers"]["qp"]["solver"] == "proxqp"


def test_validate_reports_every_file(short: Path, tmp_path: Path) -> None:
    assert typed("validate", *LOADABLE).exit_code == 0
    bad = tmp_path / "bad.yaml"
    bad.write_text("robot: nao\n", encoding="utf-8")
    result = typed("validate", short, bad)
    assert result.exit_code == 2
    assert f"{short}: ok" in result.stdout
    assert f"error: {bad}:1: robot: unknown robot 'nao'" in result.stderr


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["compare", "no_such"], "no_such: no such file, and unknown shipped scenario"),
        (["compare", "SHORT", "--controllers", "qpp"], "unknown controller 'qpp'; did you mean"),
        (["compare", "SHORT", "--solver", "dapq"], "unknown solver 'dapq'; did you mean 'daqp'?"),
        (["run", "SHORT"], "Missing option '--controller'"),
        (["compare", "SHORT", "--tasks", "/no/such"], "does not exist"),
        (["list", "taks"], "'taks' is not one of"),
        (["compare", "SHORT", "--out", "SHORT"], "not a folder"),
    ],
)
def test_bad_input_ends_with_exit_code_2_and_no_traceback(
    short: Path, words: list[str], message: str
) -> None:
    said = refused(*[short if word == "SHORT" else word for word in words])
    assert message in " ".join(said.split())


def test_nothing_is_written_when_the_scenario_is_refused(tmp_path: Path) -> None:
    bad, out = tmp_path / "bad.yaml", tmp_path / "out"
    bad.write_text("robot: nao_t14\n", encoding="utf-8")
    assert typed("compare", bad, "--out", out).exit_code == 2
    assert not out.exists()


def test_list_names_everything_with_help() -> None:
    listed = json.loads(typed("list", "--json").stdout)
    assert "point_on_plane" in listed["tasks"]
    assert all(text for lines in listed.values() for text in lines.values())
    assert "joint_velocity" in typed("list", "limits").output


def test_schema_is_a_json_schema() -> None:
    schema = json.loads(typed("schema").stdout)
    assert schema["required"] == ["robot"]
    assert schema["anyOf"] == [{"required": ["tasks", "duration"]}, {"required": ["phases"]}]


def test_help_imports_nothing_heavy() -> None:
    code = "import sys, coopqp.cli; print('pinocchio' in sys.modules or 'numpy' in sys.modules)"
    answer = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    )
    assert answer.stdout.strip() == "False"


def test_explain_says_what_was_in_the_way_and_replay_solves_it_again(tmp_path: Path) -> None:
    out, saved = tmp_path / "out", tmp_path / "tick.json"
    assert (
        typed("compare", "joint_limit_stress", "--controllers", "qp", "--out", out).exit_code == 0
    )
    explained = typed("explain", out, "--tick", "200", "--save", saved)
    assert explained.exit_code == 0
    assert "RElbowRoll (upper)" in explained.output
    assert "task[reach].x" in explained.output
    answers = json.loads(typed("replay", saved, "--json").stdout)
    assert {"daqp", "osqp", "proxqp"} <= set(answers)
    assert all(answer["difference"] < 1e-5 for answer in answers.values())


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["explain", "/no/such"], "cannot be read"),
        (["explain", "point_on_point"], "'coopqp compare point_on_point --out DIR' writes one"),
        (
            ["explain", "scenarios/my.yaml"],
            "is not a recorded run; 'coopqp compare scenarios/my.yaml",
        ),
        (["explain", "OUT", "--tick", "99"], "has no tick 99; it has 0 to 9"),
        (
            ["explain", "OUT", "--tick", "3", "--controller", "pseudoinverse"],
            "unknown QP controller",
        ),
        (["explain", "OUT", "--controller", "nobody"], "unknown controller 'nobody'"),
        (["replay", "OUT/metrics.json"], "is not a tick saved by"),
        (["replay", "/no/such"], "cannot be read"),
        (["stress", "--rollouts", "0", "--help"], "are a test now: python -m tests.stress"),
        (["statistics", "--goals", "9"], "are a test now: python -m tests.random_goals"),
    ],
)
def test_explain_replay_and_what_has_moved_refuse_in_words(
    written: Path, words: list[str], message: str
) -> None:
    said = refused(*[word.replace("OUT", str(written)) for word in words])
    assert message in " ".join(said.split())


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs a device that is full")
def test_where_what_is_printed_cannot_be_written_it_is_said() -> None:
    code = """
        import sys
        from coopqp.cli import main

        sys.stdout = open("/dev/full", "w")
        main(["list", "tasks", "--json"])
    """
    with program(code) as listing:
        assert listing.out.read() == (
            "error: cannot write what the command prints: No space left on device\n"
        )
        assert listing.ended() == 2


def test_a_reader_that_goes_away_is_no_fault_of_coopqp() -> None:
    """As in ``coopqp list tasks | true``; the tables are printed by rich."""
    code = "from coopqp.cli import main; main(['list', 'tasks'])"
    command = f'{sys.executable} -c "{code}" | true; echo ${{PIPESTATUS[0]}}'
    done = subprocess.run(["bash", "-c", command], capture_output=True, text=True, check=True)
    assert done.stdout.split()[-1] == "1"
    assert "fault of coopqp" not in done.stderr
