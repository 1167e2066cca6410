"""``coopqp ros`` where there is no ROS."""

from __future__ import annotations

import sys

import pytest
from command_line import typed


def test_a_missing_rclpy_is_named_with_what_to_do(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "rclpy", None)
    result = typed("ros", "point_on_point", "--ros-args", "-p", "controllers:=[a]")
    assert result.exit_code == 2
    assert result.stderr.startswith("error: 'coopqp ros' needs: rclpy; source the setup.bash")
    assert len(result.stderr.splitlines()) == 1


def test_what_is_for_ros_comes_after_its_word() -> None:
    result = typed("ros", "point_on_point", "--controller", "qp")
    assert result.exit_code == 2
    assert "found --controller; what is for ROS comes after --ros-args" in result.stderr
