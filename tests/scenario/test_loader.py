"""Scenario files: what is read, and what is refused in which words."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from scenario_files import GOOD, write

from coopqp.base.errors import ScenarioError, UnknownNameError
from coopqp.execution.controller_run import run
from coopqp.scenario.catalog import Catalog
from coopqp.scenario.form import file_model
from coopqp.scenario.loader import load, shipped, with_solver

#: what to replace, by what, and what the message must say.
FAULTS = [
    ("nao_t14", "nao_t15", "2: robot: unknown robot 'nao_t15'; did you mean 'nao_t14'?"),
    ("goal: [0.13, 0.05, 0.03]", "goal: [0, 0]", "goal: found [0, 0]; needs 3 numbers"),
    ("goal: [0.13, 0.05, 0.03]", "goal: [0, 0, x]", 'goal[2]: found "x"; needs a number'),
    ("gain: 5.0", "gian: 5.0", "gian: unknown key 'gian'; did you mean 'gain'"),
    ("goal: [0.13", "gaol: [0.13", "gaol: unknown key 'gaol'; did you mean 'goal'?"),
    ("gain: 5.0", "gain: 5.0\n      gain: 6", "key 'gain' is given twice"),
    ("gain: 5.0", "gain: 500.0", "overshoots; needs at most 1/dt = 100"),
    ("point_on_point:", "point_on_pont:", "did you mean 'point_on_point'"),
    ("dt: 0.01", "dt: 0", "dt: found 0; needs greater than 0"),
    ("dt: 0.01", "dt: .nan", "dt: found NaN; needs a finite number"),
    ("dt: 0.01", "dt: '0.01'", "dt: found \"0.01\"; needs a number"),
    ("0.7, -0.2, 1.2", "0.7, -0.2, 3.2", "start.right[2]: RElbowYaw starts at 3.2 rad, outside"),
    ("right: [0.7, ", "right: [.nan, ", "start.right[0]: found NaN; needs a finite number"),
    ("[0.7, -0.2", "[0.1, 0.7, -0.2", "right: found 6 numbers, needs 5: RShoulderPitch"),
    ("  right:", "  rihgt:", "unknown arm or joint 'rihgt'; did you mean 'right'?"),
    ("duration: 2.0", "duration: 20.0", "arrives at 20 s, after the end at 3 s"),
    ("kind: quintic", "kind: qintic", "kind: found \"qintic\"; needs 'step', "),
    ("kappa: 100", "kappa: 101", "kappa: found 101.0; needs at most 1/dt"),
    ("mass: 0.2", "mass: -1", "mass: found -1; needs greater than or equal to 0"),
    ("[qp, ", "[qp, qp, ", "controllers[1]: the name 'qp' is taken"),
    ("tasks:", "tasks:\n  - pose: {name: p, goal: {position: [0.1, 0, 0]}, profile: {duration: 1}}"
     "\n  - point_on_point: {name: p.position, goal: [0.1, 0, 0]}",
     "tasks[1]: 'p.position' would be a part of 'p' too; give 'p.position' another name"),
    ("goal: [", "goal: [1.0e9, 0, 0]  # [", "tasks[0]: row x: is"),
    ("robot: nao_t14\n", "", "robot: is missing"),
    ("robot: nao_t14", "robot: nao_t14\nsolver: dapq", "unknown solver 'dapq'; did you mean"),
    ("grasp: rigid", "grasp: {rigid: {}, firm: {}}", "needs one grasp by name, such as"),
    (
        "grasp: rigid",
        "grasp: {rigid: {object_in_hand: {position: [0.1, 0, 0]}}}",
        "the grasp does not close at the start: the grasp of arm 'left' puts the object",
    ),
    ("grasp: rigid", "grasps: {right: rigid}", "no grasp for arm left"),
    ("dt: 0.01", "dt: 0.01\nlimits: [{joint_position: {margin: 0.05}}, {joint_velocity: {}}, "
     "{joint_acceleration: {max: 10}}]", "limits[2]: margin: found 0, needs at least"),
    ("joint_centering: {gain", "joint_centering: {mode: hard, gain",
     "secondary[0]: 'joint_centering' is hard, secondary objectives are soft"),
    ("tasks:", "tasks:\n  - posture: {goal: {rihgt: [1, 2]}}", "tasks[0]: posture.goal: "),
    ("dt: 0.01", "dt: 0.01\nlimits: [{workspace: {normal: [0, 0, 1], through: [0, 0, 0]}}, "
     "{workspace: {normal: [0, 1, 0], through: [0, -1, 0]}}]", "limits[1]: another limit has a row "
     "'limit.workspace.object[0]' too; add 'name:'"),
    ("dt: 0.01", "dt: 0.01\nlimits: [{workspace: {normal: [0, 0, 1], through: [0, 0, 0], "
     "frames: [RHnd]}}]", "limits[0]: workspace: unknown frame 'RHnd'; did you mean 'RHand'"),
    ("start: ", "start_deg: {right: [0, 0, 0, 20, 0]}\nstart: ", "give one of start (radians)"),
]  # fmt: skip


@pytest.mark.parametrize(("old", "new", "message"), FAULTS)
def test_a_fault_is_answered_with_its_place_and_its_fix(
    tmp_path: Path, old: str, new: str, message: str
) -> None:
    assert old in GOOD
    path = write(tmp_path, GOOD.replace(old, new, 1))
    with pytest.raises(ScenarioError) as caught:
        load(path)
    assert message in str(caught.value)
    assert str(caught.value).startswith(f"{path}:")
    assert len(caught.value.faults) == 1


def test_all_faults_come_at_once(tmp_path: Path) -> None:
    text = (
        GOOD.replace("dt: 0.01", "dt: -1").replace("nao_t14", "nao").replace("gain: 5", "gian: 5")
    )
    with pytest.raises(ScenarioError) as caught:
        load(write(tmp_path, text))
    assert len(caught.value.faults) == 3


def test_a_zero_normal_is_refused(tmp_path: Path) -> None:
    text = shipped()["point_on_plane"].read_text(encoding="utf-8")
    with pytest.raises(ScenarioError, match=r"normal: .*all three numbers are zero"):
        load(write(tmp_path, text.replace("normal: [0, 0, 1]", "normal: [0, 0, 0]")))


@pytest.mark.parametrize(
    ("text", "message"),
    [("", "empty"), ("- 1", "needs a mapping"), ("a: [1", "not YAML"), ("\t: x", "not YAML")],
)
def test_a_file_that_is_no_scenario_is_refused(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(ScenarioError, match=message):
        load(write(tmp_path, text))


def test_a_misspelt_shipped_scenario_names_the_nearest() -> None:
    with pytest.raises(ScenarioError, match=r"no such file.*did you mean 'point_on_plane'"):
        load("point_on_plnae")


def test_a_missing_or_binary_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ScenarioError, match=r"cannot be read: No such file"):
        load(tmp_path / "none.yaml")
    binary = tmp_path / "binary.yaml"
    binary.write_bytes(b"\xff\xfe\x00\x80")
    with pytest.raises(ScenarioError, match="not a text file"):
        load(binary)


def test_degrees_and_radians_give_the_same_start(tmp_path: Path) -> None:
    radians = load("point_on_point")
    degrees = {arm: np.degrees(values).tolist() for arm, values in radians.start.items()}
    before, after = GOOD.split("start:", 1)
    text = f"{before}start_deg: {json.dumps(degrees)}\ntasks:{after.split('tasks:', 1)[1]}"
    loaded = load(write(tmp_path, text))
    assert np.allclose(loaded.chain.q_start, radians.chain.q_start, atol=1e-12)


def test_an_angle_given_twice_or_not_at_all_is_refused(tmp_path: Path) -> None:
    text = shipped()["tilting_plane"].read_text(encoding="utf-8")
    twice = text.replace("angle_deg: 30", "angle: 0.5\n        angle_deg: 30")
    with pytest.raises(ScenarioError, match="not both"):
        load(write(tmp_path, twice))
    with pytest.raises(ScenarioError, match="needs angle"):
        load(write(tmp_path, text.replace("angle_deg: 30", "")))


def test_the_schema_covers_every_plug_in() -> None:
    catalog = Catalog()
    text = json.dumps(file_model(catalog).model_json_schema())
    for kind in ("robots", "grasps", "tasks", "limits", "controllers", "solvers", "plants"):
        for name in catalog.entries(kind):
            assert f'"{name}"' in text


def test_the_schema_says_what_every_key_means() -> None:
    """In the words of the docstring under the field, which may be a base's."""
    kinds = file_model(Catalog()).model_json_schema()["$defs"]
    silent = [
        f"{kind}.{key}"
        for kind, schema in kinds.items()
        for key, shown in schema.get("properties", {}).items()
        if not shown.get("description")
    ]
    assert silent == []
    said = {key: shown["description"] for key, shown in kinds["PointOnPlane"]["properties"].items()}
    assert said["through"] == "A point of the line or plane at the start, in the world [m]."
    assert said["gain"] == "How fast the error decays [1/s]; at most 1/dt."


def test_a_solver_can_be_changed_by_name() -> None:
    scenario = load("point_on_point")
    assert with_solver(scenario, "osqp").solver_name == "osqp"
    with pytest.raises(UnknownNameError, match="did you mean 'daqp'"):
        with_solver(scenario, "dapq")


TASKS = Path(__file__).parents[2] / "examples" / "plugins" / "tasks"


def test_a_users_task_is_one_file(tmp_path: Path) -> None:
    catalog = Catalog((TASKS,))
    keys = file_model(catalog).model_json_schema()["$defs"]["HoldHeight"]["properties"]
    assert keys["height"]["description"] == "Of the object's origin, in the world [m]."
    text = GOOD.split("tasks:", 1)[0] + "tasks:\n  - hold_height: {height: 0.06}\nduration: 2\n"
    trace = run(load(write(tmp_path, text), catalog), controller="qp")
    assert abs(trace.position[-1, 2] - 0.06) < 1e-4


def test_catalogues_share_a_form_where_they_can_name_the_same() -> None:
    assert file_model(Catalog()) is file_model(Catalog())
    mine = file_model(Catalog((TASKS,)))
    assert mine is file_model(Catalog((TASKS,)))
    assert mine is not file_model(Catalog())
