"""``coopqp ros`` where there is no ROS."""

from __future__ import annotations

import sys

import pytest
from command_line import refused, refused_in_one_line


def test_a_missing_rclpy_is_named_with_what_to_do(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "rclpy", None)
    said = refused_in_one_line("ros", "point_on_point", "--ros-args", "-p", "controllers:=[a]")
    assert said.startswith("error: 'coopqp ros' needs: rclpy; source the setup.bash")


def test_what_is_for_ros_comes_after_its_word() -> None:
    said = refused("ros", "point_on_point", "--controller", "qp")
    assert "found --controller; what is for ROS comes after --ros-args" in said
