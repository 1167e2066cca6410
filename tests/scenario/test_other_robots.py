"""Scenarios of robots that nobody here wrote: rank, mobility, motion."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from importlib import metadata
from typing import Any

import numpy as np
import pytest
from scenario_files import LOADABLE, needs_robots
from shipped_runs import comparison

from coopqp.base.errors import ScenarioError
from coopqp.closed_loop.mobility import Mobility, mobility
from coopqp.grasps import Rigid
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.grasp_configuration import HeldObject
from coopqp.model.state import State
from coopqp.robots import ExampleRobot, Several, example_robot
from coopqp.scenario.catalog import Catalog
from coopqp.scenario.loader import find, load, load_file
from coopqp.scenario.yaml import read_yaml

# ---- what each scenario allows ---------------------------------------------------------------


#: joints, rank, freedom, freedom of the object, of those the motors decide.
MOBILITY = {
    "baxter_tray": (14, 6, 8, 6, 6),
    "tiago_torso": (15, 6, 9, 6, 6),
    "two_pandas": (14, 6, 8, 6, 6),
    "three_ur": (18, 12, 6, 6, 6),
    "yeo_4_5": (10, 6, 4, 4, 4),
    "two_so101": (10, 6, 4, 4, 4),
    "planar_pair": (6, 3, 3, 3, 3),
    "point_on_point": (10, 6, 4, 4, 4),
    "rigid_vs_passive": (12, 6, 6, 6, 6),
}


@cache
def study(name: str) -> Mobility:
    return mobility(load(name).chain)


@pytest.mark.parametrize("name", [name for name in MOBILITY if name in LOADABLE])
def test_rank_and_mobility_are_right(name: str) -> None:
    found = study(name)
    assert (
        len(found.joints), found.rank, found.freedom, found.object_freedom, found.motor_freedom
    ) == MOBILITY[name]  # fmt: skip
    assert found.rank_start == found.rank, "the start is regular"
    assert found.object_freedom_start == found.object_freedom
    # Grübler's count for each loop of six rows, three for the planar one.
    loops = len(load(name).chain.arms) - 1
    assert found.rank == loops * (3 if name == "planar_pair" else 6)


@pytest.mark.parametrize("name", [name for name in MOBILITY if name in LOADABLE])
def test_there_is_a_good_scheme_at_the_start(name: str) -> None:
    found = study(name)
    assert found.freedom == len(found.schemes[0].joints)
    assert any(scheme.admissible_start for scheme in found.schemes)


def test_a_scheme_that_moves_no_loop_is_inadmissible() -> None:
    """Yeo's arms: the left hand's roll stays at zero, for the right hand cannot roll."""
    schemes = study("yeo_4_5").schemes
    assert study("yeo_4_5").schemes_complete
    assert not any(scheme.admissible_start for scheme in schemes if "l5" in scheme.joints)
    J = load("yeo_4_5").chain.loop_jacobian(load("yeo_4_5").chain.q_start)
    free = np.linalg.svd(J)[2][6:]
    roll = load("yeo_4_5").chain.joint_names.index("l5")
    assert np.abs(free[:, roll]).max() < 1e-9


@needs_robots
def test_three_rigid_arms_of_seven_joints_have_rank_12_and_mobility_9() -> None:
    def panda(angle: float) -> dict[str, Any]:
        robot = ExampleRobot(name="panda", arms={"arm": "panda_hand_tcp"})
        x, y = np.cos(angle), np.sin(angle)
        return {"robot": robot, "position": (x, y, 0.0), "rpy": (0.0, 0.0, angle + np.pi)}

    names = ("a", "b", "c")
    robots = {name: panda(2 * np.pi * i / 3) for i, name in enumerate(names)}
    robot = Several(robots=robots).build()
    home = [0.0, -0.3, 0.0, -2.0, 0.0, 1.9, 0.7]
    q = robot.configuration({f"{name}/arm": home for name in names})
    found = mobility(ClosedChain.attach(robot, q, Rigid(), HeldObject()))
    assert (found.rank, found.freedom, found.object_freedom) == (12, 9, 6)


@needs_robots
def test_a_shared_torso_moves_the_object_and_opens_no_loop() -> None:
    chain = load("tiago_torso").chain
    state = State(chain)
    lift = chain.joint_names.index("torso_lift_joint")
    np.testing.assert_allclose(state.J_task[:, lift], [0, 0, 1, 0, 0, 0], atol=1e-12)
    np.testing.assert_allclose(state.J_rel[:, lift], 0.0, atol=1e-12)
    alone = np.eye(chain.n)[lift]
    assert np.abs(state.J_rel @ alone).max() < 1e-12


# ---- what the controllers do -----------------------------------------------------------------


NEW = ("baxter_tray", "tiago_torso", "two_pandas", "three_ur", "yeo_4_5", "two_so101")


def of(name: str, controller: str) -> Mapping[str, Any]:
    return comparison(name).metrics[controller]


@pytest.mark.parametrize("name", [name for name in NEW if name in LOADABLE])
def test_the_qp_reaches_its_goals_with_loops_closed_inside_the_limits(name: str) -> None:
    metrics = of(name, "qp")
    assert metrics["reached"]
    assert max(metrics["task_error"].values()) < 1e-4
    assert metrics["limit_violation_max"] == 0.0
    assert metrics["velocity_violation_max"] == 0.0
    assert metrics["loop_error_max"]["position"] < 1e-5
    assert metrics["loop_error_max"]["orientation"] < 1e-5
    trace = comparison(name).traces["qp"]
    assert 0.05 < np.linalg.norm(trace.position[-1] - trace.position[0]) < 0.2


@needs_robots
def test_the_tray_stays_level_all_the_way() -> None:
    """Against our own tasks: the angle between the tray's normal and the vertical."""
    trace = comparison("baxter_tray").traces["qp"]
    up = trace.rotation.reshape(-1, 3, 3)[:, 2, 2]
    assert np.arccos(np.clip(up, -1.0, 1.0)).max() < 1e-3


@needs_robots
def test_the_torso_keeps_its_limits_with_the_qp_alone() -> None:
    assert of("tiago_torso", "pseudoinverse")["limit_violation_max"] > 1e-3
    assert of("tiago_torso", "pseudoinverse")["velocity_violation_max"] > 0.01
    trace = comparison("tiago_torso").traces["qp"]
    lift = trace.joints.index("torso_lift_joint")
    assert trace.q[-1, lift] - trace.q[0, lift] > 0.05  # it takes part


@needs_robots
def test_only_the_qp_keeps_an_so101_out_of_its_own_base() -> None:
    assert of("two_so101", "pseudoinverse")["limit_violation_max"] > 0.1
    base = "limit.self_collision[left/upper_arm_link|left/base_link]"
    left = {
        name: of("two_so101", name)["limits_audit"][base]["margin_min"]
        for name in ("qp", "pseudoinverse", "pseudoinverse_null_space")
    }
    assert left["qp"] > -1e-4
    assert left["pseudoinverse"] < -0.01  # less than nothing of the 10 mm: they are in each other
    assert left["pseudoinverse_null_space"] < -0.01


def test_without_the_package_a_scenario_says_what_to_install(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    class Empty:
        PackageNotFoundError = metadata.PackageNotFoundError

        @staticmethod
        def distribution(name: str) -> None:
            raise metadata.PackageNotFoundError(name)

    monkeypatch.setattr(example_robot, "metadata", Empty)
    for name in ("baxter_tray", "two_pandas"):  # by itself, and one of several
        with pytest.raises(ScenarioError, match=r"robot: .*pip install 'coopqp\[robots\]'"):
            load_file(read_yaml(find(name)), Catalog())  # which is read anew
