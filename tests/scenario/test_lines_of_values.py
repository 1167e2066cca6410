"""A fault has the line of the value itself, however deep in the file it is."""

from __future__ import annotations

from pathlib import Path

import pytest
from scenario_files import GOOD

from coopqp.base.errors import ScenarioError
from coopqp.scenario.loader import load

TABLE = """\
robot:
  mdh_table:
    rows:
      - name: r1
        alpha_deg: -90
        r: -0.1
      - name: r2
        antecedent: r1
        alpha_deg: 90
      - name: l1
        alpha_deg: -90
        r: 0.1
      - name: l2
        antecedent: l1
        alpha_deg: 90
    tips:
      r_hand:
        parent: r2
        offset: [0.05, 0, 0]
    arms:
      right: r_hand
      left:
        tip: l2
    locked:
      []
start:
  right: [0.1, 0.2]
  left:
    [0.1, 0.2]
tasks:
  - minimum_velocity
secondary:
  - posture:
      goal:
        l1: 0.1
        left:
          [0.1, 0.2]
limits:
  - joint_position
  - joint_acceleration:
      max: 10
      joints:
        r2: 5
  - workspace:
      normal: [0, 0, 1]
      through: [0, 0, -9]
      frames:
        - r_hand
        - l2
duration: 1.0
"""


@pytest.mark.parametrize(
    ("old", "new", "line", "words"),
    [
        ("      - name: l2\n", "      - name: r2\n", 13, "robot: MDH table mdh_table: two rows"),
        ("antecedent: l1", "antecedent: l9", 13, "robot: row l2: unknown antecedent 'l9'"),
        ("        r: -0.1\n", "        r: -1.0e+5\n", 4, "robot.mdh_table.rows[0]: found"),
        ("parent: r2", "parent: r9", 17, "robot: tip r_hand: unknown row 'r9'"),
        ("right: r_hand", "right: hand", 21, "robot: arm right: unknown frame 'hand'"),
        ("tip: l2", "tip: l9", 22, "robot: arm left: unknown frame 'l9'"),
        ("      []\n", "      r9: 0.1\n", 25, "robot: locked: unknown joint 'r9'"),
        ("    [0.1, 0.2]\ntasks", "    [0.1]\ntasks", 28, "start: left: found 1 number, needs 2"),
        ("  left:\n    [0.1", "  lift:\n    [0.1", 28, "start: unknown arm or joint 'lift'"),
        (
            "  left:\n    [0.1",
            "  left:\n    [1.0e+5",
            28,
            "start: left: found [100000.0, 0.2]",
        ),
        ("        l1: 0.1", "        l9: 0.1", 35, "secondary[0]: posture.goal: unknown arm or"),
        ("          [0.1, 0.2]", "          [0.1]", 36, "secondary[0]: posture.left: found 1"),
        ("        r2: 5", "        r9: 5", 43, "limits[1]: joint_acceleration.joints: unknown"),
        ("        - l2\n", "        - l9\n", 49, "limits[2]: workspace: unknown frame 'l9'"),
        ("tasks:", 'description: "\\u2028\\u2029\\x85"\ntaskz:', 31, "taskz: unknown key 'taskz'"),
    ],
)
def test_a_fault_names_the_line_of_the_value(
    tmp_path: Path, old: str, new: str, line: int, words: str
) -> None:
    assert old in TABLE
    path = tmp_path / "s.yaml"
    path.write_text(TABLE.replace(old, new, 1), encoding="utf-8")
    with pytest.raises(ScenarioError) as caught:
        load(path)
    assert f"{path}:{line}: {words}" in str(caught.value)


def test_lines_are_those_that_editors_count(tmp_path: Path) -> None:
    """YAML breaks lines at signs that no editor breaks them at."""
    path = tmp_path / "s.yaml"
    path.write_text(f"# \u2028 \u2029 \x85\n{GOOD}nonsense: 1\n", encoding="utf-8")
    with pytest.raises(ScenarioError, match=rf"s\.yaml:{GOOD.count(chr(10)) + 2}: nonsense"):
        load(path)


def test_a_plant_that_cannot_be_built_is_a_fault_of_the_file(tmp_path: Path) -> None:
    path = tmp_path / "s.yaml"
    plant = "plant:\n  rigid_body:\n    time_step: 0.003\n"
    path.write_text(GOOD + plant, encoding="utf-8")
    line = GOOD.count("\n") + 3
    with pytest.raises(
        ScenarioError, match=rf"s\.yaml:{line}: plant: time_step: found 0.003 s.*such as"
    ):
        load(path)


def test_a_contact_beside_the_face_of_an_object_without_a_size_is_told_at_the_object(
    tmp_path: Path,
) -> None:
    pytest.importorskip("mujoco")
    text = load("nao_presses").source
    size = next(line for line in text.splitlines() if "size: [" in line)
    path = tmp_path / "s.yaml"
    path.write_text(text.replace(f"{size}\n", ""), encoding="utf-8")
    line = 1 + text.splitlines().index("object:")
    with pytest.raises(ScenarioError, match=rf"s.yaml:{line}: object: .* from the object's face"):
        load(path)
