"""One tree of errors: wrong values given in Python raise CoopqpError, in the words of a file."""

from __future__ import annotations

import dataclasses
import pickle
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import coopqp
from coopqp import ClosedChain, CoopqpError, InvalidValueError, State, UnknownNameError, spec
from coopqp.base.spec import Pose, type_name
from coopqp.closed_loop.constraint_equations import scheme
from coopqp.closed_loop.dynamics import ClosedLoopDynamics
from coopqp.closed_loop.mobility import mobility
from coopqp.controllers import QPController
from coopqp.grasps import Rigid
from coopqp.limits import JointPosition, ObjectSpeed, Workspace
from coopqp.model.grasp_configuration import HeldObject
from coopqp.model.profile import Profile
from coopqp.report import strict_json
from coopqp.robots import Several, Urdf
from coopqp.scenario.catalog import Catalog
from coopqp.scenario.loader import load
from coopqp.scenario.scenario import Scenario
from coopqp.scenario.start_solver import solve_start
from coopqp.tasks import JointCentering, PointOnPoint, Posture, Twist

Build = Callable[[], object]


@pytest.fixture(scope="module")
def scenario() -> Scenario:
    return load("planar_pair")


def said(build: Build) -> str:
    """What building it answers."""
    with pytest.raises(CoopqpError) as caught:
        build()
    return str(caught.value)


# Specs.

WRONG: dict[str, tuple[Callable[[], object], list[str]]] = {
    "too few numbers": (
        lambda: PointOnPoint(goal=(1, 2)),  # type: ignore[arg-type]
        ["PointOnPoint.goal: found [1, 2]; needs 3 numbers"],
    ),
    "an array": (
        lambda: PointOnPoint(goal=np.zeros(2)),  # type: ignore[arg-type]
        ["PointOnPoint.goal: found [0.0, 0.0]; needs 3 numbers"],
    ),
    "a sign": (
        lambda: JointPosition(margin=-1),
        ["JointPosition.margin: found -1; needs greater than or equal to 0"],
    ),
    "a key": (
        lambda: QPController(enginee="python"),  # type: ignore[call-arg]
        ["QPController.enginee: unknown key 'enginee'; did you mean 'engine'?"],
    ),
    "a key inside": (
        lambda: PointOnPoint(goal=(0, 0, 0), profile={"durration": 1}),  # type: ignore[arg-type]
        ["PointOnPoint.profile.durration: unknown key 'durration'; did you mean 'duration'?"],
    ),
    "nothing": (lambda: PointOnPoint(), ["PointOnPoint.goal: is missing"]),  # type: ignore[call-arg]
    "no key": (
        lambda: JointPosition(0.1),  # type: ignore[misc]
        ["JointPosition: found 0.1 without a key; needs every value as KEY=VALUE"],
    ),
    "not a number": (
        lambda: JointPosition(margin=float("nan")),
        ["JointPosition.margin: found NaN; needs a finite number"],
    ),
    "a choice": (
        lambda: Profile(kind="jump"),  # type: ignore[arg-type]
        [
            "Profile.kind: found \"jump\"; needs 'step', 'constant_velocity', 'trapezoid', "
            "'quintic', 'fastest' or 'table'"
        ],
    ),
    "a table without shares": (
        lambda: Profile(kind="table"),
        [
            'Profile: found {"kind": "table"}; needs shares that rise from 0 to 1 where its kind '
            "is table, and only there"
        ],
    ),
    "two at once": (
        lambda: QPController(damping=-1, error_damping=-2),
        [
            "QPController.damping: found -1; needs greater than 0",
            "QPController.error_damping: found -2; needs greater than or equal to 0",
        ],
    ),
    "together": (
        lambda: ObjectSpeed(),
        ["ObjectSpeed: found {}; needs linear (m/s), angular (rad/s) or both"],
    ),
    "an object no body can be": (
        lambda: HeldObject(mass=-1.0),
        ["HeldObject.mass: found -1.0; needs greater than or equal to 0"],
    ),
    "no robot": (
        lambda: Several(robots={"a": {"robot": 3}}),  # type: ignore[dict-item]
        ["Several.robots.a.robot: found 3; needs a robot"],
    ),
    "a thing": (
        lambda: Twist(velocity={"x": 1.0}, point=3),  # type: ignore[arg-type]
        ["Twist.point: found 3; needs 3 numbers"],
    ),
    "a changed copy": (
        lambda: replace(JointPosition(), margin=-1.0),
        ["JointPosition.margin: found -1.0; needs greater than or equal to 0"],
    ),
}


@pytest.mark.parametrize(("build", "lines"), WRONG.values(), ids=list(WRONG))
def test_a_wrong_value_in_python_is_told_in_the_words_of_a_file(
    build: Build, lines: list[str]
) -> None:
    with pytest.raises(InvalidValueError) as caught:
        build()
    assert str(caught.value).splitlines() == lines
    assert isinstance(caught.value, ValueError)
    assert isinstance(caught.value, CoopqpError)
    # Nothing of pydantic's is printed below a traceback either.
    assert caught.value.__cause__ is None
    assert caught.value.__suppress_context__


def test_a_value_that_is_no_json_is_shown_as_python_shows_it() -> None:
    message = said(lambda: Posture(goal={1: {2}}))  # type: ignore[dict-item]
    assert "found {1: {2}}" in message


def test_steps_of_pydantic_are_not_part_of_a_place() -> None:
    message = said(lambda: Posture(goal={"left": "x"}))  # type: ignore[dict-item]
    assert {line.split(": ")[0] for line in message.splitlines()} == {
        "Posture.goal",
        "Posture.goal.left",
    }


@spec
class _Inner:
    """A part."""

    size: float = 1.0
    """[m]"""


@spec
class _Outer:
    """A part with parts."""

    parts: tuple[_Inner, ...]
    """Of it."""


def test_every_fault_of_the_parts_of_a_spec_keeps_its_place() -> None:
    message = said(lambda: _Outer(parts=({"size": "a"}, {}, {"sice": 1})))  # type: ignore[arg-type]
    assert [line.split(": ")[0] for line in message.splitlines()] == [
        "_Outer.parts[0].size",
        "_Outer.parts[2].sice",
    ]
    assert "did you mean 'size'?" in message


def test_a_file_still_tells_all_faults_with_their_lines(tmp_path: Path) -> None:
    path = tmp_path / "wrong.yaml"
    path.write_text(
        "robot: planar_pair\n"
        "start: {left: [0, 0, 0], right: [0, 0, 0]}\n"
        "tasks:\n"
        "  - point_on_point:\n"
        "      goal: [1, 2]\n"
        "      gain: -1\n"
        "      profile: {durration: 1}\n"
        "duration: 1.0\n"
    )
    lines = said(lambda: load(path)).splitlines()
    assert lines == [
        f"{path}:6: tasks[0].point_on_point.gain: found -1; needs greater than 0",
        f"{path}:5: tasks[0].point_on_point.goal: found [1, 2]; needs 3 numbers",
        f"{path}:7: tasks[0].point_on_point.profile.durration: unknown key 'durration'; did you "
        "mean 'duration'?",
    ]


def test_specs_can_still_be_pickled_copied_and_inspected() -> None:
    task = PointOnPoint(goal=(0.1, 0.2, 0.3), gain=3.0)
    again = pickle.loads(pickle.dumps(task))
    assert again == task == replace(task)
    assert replace(task, gain=4.0).gain == 4.0
    assert dataclasses.asdict(task)["goal"] == (0.1, 0.2, 0.3)
    with pytest.raises(dataclasses.FrozenInstanceError):
        task.gain = 1.0  # type: ignore[misc]


# Names.


@pytest.mark.parametrize("kind", ["tasks", "controllers"])
def test_the_name_of_a_type_is_its_yaml_name(kind: str) -> None:
    for name, entry in Catalog().entries(kind).items():
        assert type_name(entry.cls) == name


def test_tasks_and_controllers_are_named_after_their_type_in_python_too() -> None:
    assert PointOnPoint(goal=(0, 0, 0)).name == "point_on_point"
    assert PointOnPoint(goal=(0, 0, 0), name="").name == "point_on_point"
    assert PointOnPoint(goal=(0, 0, 0), name="reach").name == "reach"
    assert QPController().name == "qp"


def test_a_type_that_lies_in_no_folder_is_named_after_its_class() -> None:
    class HoldStill:
        pass

    HoldStill.__module__ = "__main__"
    assert type_name(HoldStill) == "hold_still"


# Problems.


def test_a_problem_tells_all_that_cannot_be_asked_at_once(scenario: Scenario) -> None:
    reach = PointOnPoint(goal=(0, 0, 0), gain=500.0)
    centre = JointCentering(mode="hard")
    message = said(
        lambda: replace(
            scenario.problem(),
            tasks=(reach, reach),
            secondary=(centre,),
            kappa=101.0,
            on_infeasible="scael",  # type: ignore[arg-type]
        )
    )
    wrong_gain = "'point_on_point': gain 500.0 1/s overshoots; needs at most 1/dt = 100 1/s"
    assert message.splitlines() == [
        "kappa: found 101.0; needs at most 1/dt = 100 1/s",
        "tasks[1]: the name 'point_on_point' is taken; add 'name:' to tell them apart",
        f"tasks[0]: {wrong_gain}",
        f"tasks[1]: {wrong_gain}",
        "secondary[0]: 'joint_centering' is hard, secondary objectives are soft; put it under "
        "tasks",
        "on_infeasible: unknown choice 'scael'; did you mean 'scale'?",
    ]


def test_a_file_says_the_same_of_a_problem(tmp_path: Path) -> None:
    path = tmp_path / "wrong.yaml"
    path.write_text(
        "robot: planar_pair\n"
        "start: {left: [0, 0, 0], right: [0, 0, 0]}\n"
        "tasks:\n"
        "  - point_on_point: {goal: [0, 0, 0], gain: 500}\n"
        "  - point_on_point: {goal: [0, 0, 0]}\n"
        "secondary:\n"
        "  - joint_centering: {mode: hard}\n"
        "kappa: 101\n"
        "duration: 1.0\n"
    )
    assert said(lambda: load(path)).splitlines() == [
        f"{path}:8: kappa: found 101.0; needs at most 1/dt = 100 1/s",
        f"{path}:5: tasks[1]: the name 'point_on_point' is taken; add 'name:' to tell them apart",
        f"{path}:4: tasks[0]: 'point_on_point': gain 500.0 1/s overshoots; needs at most 1/dt = "
        "100 1/s",
        f"{path}:7: secondary[0]: 'joint_centering' is hard, secondary objectives are soft; put "
        "it under tasks",
    ]


def test_a_secondary_objective_may_have_the_name_of_a_task(scenario: Scenario) -> None:
    reach = PointOnPoint(goal=(0, 0, 0))
    problem = replace(scenario.problem(), tasks=(reach,), secondary=(reach,))
    assert problem.tasks[0].name == problem.secondary[0].name


def test_limits_say_of_a_gain_what_tasks_say(scenario: Scenario) -> None:
    wall = Workspace(normal=(0, 1, 0), through=(0, -1, 0), gain=101.0)
    message = said(lambda: wall.bind(scenario.chain, 0.01))
    assert message == "workspace: gain 101.0 1/s overshoots; needs at most 1/dt = 100 1/s"


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ("nothing", "actuated: unknown joint 'nothing'"),
        ("left_1", "actuated: left_1 given more than once"),
    ],
)
def test_statics_and_dynamics_say_the_same_of_motors(
    scenario: Scenario, wrong: str, message: str
) -> None:
    names = ["left_1", "left_2", wrong]
    for ask in (
        lambda: scheme(scenario.chain, names),
        lambda: ClosedLoopDynamics(scenario.chain, actuated=names),
    ):
        assert said(ask).startswith(message)


# Everything else that is public.


def entries(s: Scenario) -> dict[str, tuple[Build, str]]:
    """Wrong input of every public entry, and what is said of it."""
    chain, robot = s.chain, s.robot_model
    q, n, rigid, held = robot.configuration(s.start), chain.n, Rigid(), HeldObject()

    def scenario(**changes: Any) -> Build:
        return lambda: coopqp.compare(replace(s, **changes))

    hold = ClosedChain.attach
    return {
        "chain, words": (
            lambda: hold(robot, ["a"] * n, rigid, held),
            "q_start: found",
        ),  # type: ignore[arg-type]
        "chain, ragged": (
            lambda: hold(robot, [[1], [1, 2]], rigid, held),
            "needs numbers",
        ),  # type: ignore[arg-type]
        "chain, NaN": (
            lambda: hold(robot, np.nan * q, rigid, held),
            "needs finite numbers",
        ),
        "chain, moved": (lambda: chain.moved(np.zeros(2)), f"found shape (2,), needs ({n},)"),
        "chain, handed over": (lambda: chain.handed_over(np.zeros(2)), "found shape (2,)"),
        "chain, pose": (lambda: chain.object_pose(np.zeros(2)), "found shape (2,)"),
        "state": (lambda: State(chain, [1.0, 2.0]), f"q: found shape (2,), needs ({n},)"),
        "state, words": (lambda: State(chain, "abc"), "q: found 'abc', needs numbers"),
        "law": (lambda: QPController().build(s.problem()).start([1.0]), "found shape (1,)"),
        "configuration": (lambda: robot.configuration({"left": "abc"}), "left: found 'abc'"),  # type: ignore[dict-item]
        "dt": (scenario(dt=0.0), "dt: found 0.0 s; needs a finite time"),
        "duration": (scenario(duration=float("nan")), "duration: found nan s; needs a finite time"),
        "start": (scenario(start={"lft": [1.0]}), "did you mean 'left'"),
        "controllers": (scenario(controllers={}), "controllers: none given"),
        "run": (lambda: coopqp.run(s, controller="q"), "did you mean 'qp'?"),
        "load": (lambda: coopqp.load("nothing"), "no such file, and unknown shipped scenario"),
        "load a folder": (lambda: coopqp.load("/"), "cannot be read"),
        "mobility, seed": (lambda: mobility(chain, seed=-1), "seed: found -1"),
        "mobility, samples": (lambda: mobility(chain, samples=0), "samples: found 0"),
        "mobility, rows": (
            lambda: mobility(chain, task_rows=[("up", np.zeros((2, 2)))]),
            f"task 'up': found rows of shape (2, 2), needs (k, {n})",
        ),
        "solve start": (
            lambda: solve_start(
                robot, Rigid(object_in_hand=Pose()), HeldObject(pose=Pose()), seed=-1
            ),
            "seed: found -1",
        ),
        "robot": (lambda: Urdf(path=Path("/nothing"), arms={"a": "b"}).build(), "cannot be read"),  # type: ignore[dict-item]
    }


def test_public_entries_let_no_error_of_a_library_through(scenario: Scenario) -> None:
    for name, (ask, message) in entries(scenario).items():
        assert message in said(ask), name


def test_an_unknown_name_is_no_value_error_but_in_the_tree(scenario: Scenario) -> None:
    with pytest.raises(UnknownNameError):
        coopqp.run(scenario, controller="nothing")


def test_json_has_null_for_what_it_has_no_word_for() -> None:
    value = {"a": [1.0, float("nan")], "b": (float("inf"), True, "x", None)}
    assert strict_json.finite(value) == {"a": [1.0, None], "b": [None, True, "x", None]}
    assert "NaN" not in strict_json.text(value)
