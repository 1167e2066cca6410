"""Files that once ended in a traceback, a hang or garbage: each runs, or is refused in one line."""

from __future__ import annotations

import os
import re
from pathlib import Path

import pytest
from command_line import refused, refused_in_one_line, typed
from scenario_files import GOOD, needs_robots

from coopqp.base.errors import UnreadableFileError
from coopqp.base.reading import read_text

CASES = Path(__file__).parent / "cases"

#: Exit code, and what is said after "error: " and the folder of the cases.
REFUSED = {
    "emptyfloat.yaml": r"emptyfloat.yaml:14: tag '!!float' does not fit ''; leave it out",
    "scalarset.yaml": r"scalarset.yaml:3: tag '!!set' does not fit ''; leave it out",
    "yaml_228.yaml": r"yaml_228.yaml:4: not YAML: found incompatible YAML document",
    "deep_list300.yaml": r"deep_list300.yaml:22: values inside values are more than 40 deep",
    "phases_scalar_tag.yaml": r"phases_scalar_tag.yaml:10: tag '!x' is not read here",
    "surrogate.yaml": r"surrogate.yaml:12: the text has half a character",
    "laughs.yaml": r"laughs.yaml:\d: the file has more than 20000 values, aliases written out",
    "laughs_map.yaml": r"laughs_map.yaml:\d: the file has more than 20000 values, aliases",
    "dur1e9.yaml": r"dur1e9.yaml:20: duration: found 100000000000 ticks, more than are kept",
    "dt1e-9.yaml": r"dt1e-9.yaml:19: dt: found 3000000000 ticks, more than are kept",
    "m2609.yaml": r"m2609.yaml:17: found 1e308; needs 0, or a number of 1e-30 to 1e\+20",
    "m104070.yaml": r"m104070.yaml:35: found 1e200; needs 0, or a number of",
    "m104769.yaml": r"m104769.yaml:72: found 5e-324; needs 0, or a number of",
    "mjcf_postxt/s.yaml": r"s.yaml:3: robot: .*m.xml:1: <body name=\"rb\"> pos: found 'a b c': ",
    "mj_rangetxt/s.yaml": r"s.yaml:3: robot: .*m.xml:1: <joint name=\"r1\"> range: found 'a b': ",
    "mj_incbomb/s.yaml": r"s.yaml:3: robot: .*<include>: file 'j.xml' is included already",
    "mj_classmissing/s.yaml": r"s.yaml:3: robot: .*m.xml:1: <joint .* class: unknown .* 'zz'",
    "enc_bogus/s.yaml": r"s.yaml:3: robot: .*m.urdf:1: unknown encoding: klingon; save",
}  # fmt: skip


@pytest.mark.parametrize("name", REFUSED)
def test_a_bad_file_is_refused_in_one_line_with_its_place(name: str) -> None:
    said = refused("compare", CASES / name)
    assert re.fullmatch(rf"error: \S*{REFUSED[name]}.*\n", said), said


@pytest.mark.parametrize("name", ["samelinkjoint/s.yaml", "lim_hugelim/s.yaml"])
def test_an_odd_robot_that_can_be_meant_runs(name: str) -> None:
    result = typed("compare", CASES / name)
    assert result.exit_code == 0, result.stderr
    assert "0 of 20" in result.output  # failed ticks


def test_a_push_that_breaks_the_simulation_leaves_the_arms_standing() -> None:
    result = typed("compare", CASES / "m100567.yaml", "--json")
    assert result.exit_code == 0, result.stderr
    assert "stands still: what is controlled broke down, or its simulation did" in result.output
    assert len(result.stderr.splitlines()) <= 1


def test_every_case_is_tried() -> None:
    tried = {*REFUSED, "samelinkjoint/s.yaml", "lim_hugelim/s.yaml", "m100567.yaml"}
    assert tried == {str(path.relative_to(CASES)) for path in CASES.rglob("*.yaml")}


@needs_robots
def test_a_floating_base_that_a_urdf_does_not_have_may_be_locked(tmp_path: Path) -> None:
    path = tmp_path / "talos.yaml"
    robot = (
        "robot: {example_robot: {name: talos_full_v2, locked: [root_joint], "
        "arms: {right: gripper_right_base_link, left: gripper_left_base_link}}}\n"
    )
    path.write_text(robot + "start: {}\ntasks: [minimum_velocity]\nduration: 1\n")
    assert "root_joint" not in typed("validate", path).output


@pytest.mark.parametrize("command", ["validate", "compare", "mobility"])
def test_pipes_devices_and_long_names_are_refused_at_once(command: str, tmp_path: Path) -> None:
    pipe = tmp_path / "pipe.yaml"
    os.mkfifo(pipe)
    for name, why in (
        (pipe, "is a pipe or a device, needs a file"),
        ("/dev/zero", "is a pipe or a device, needs a file"),
        ("x" * 300 + ".yaml", "File name too long"),
        (tmp_path, "is a folder, needs a file"),
    ):
        said = refused_in_one_line(command, name)
        assert said.endswith(why)


def test_a_large_file_is_not_read_to_its_end(tmp_path: Path) -> None:
    large = tmp_path / "large.yaml"
    with open(large, "wb") as stream:
        stream.truncate(1 << 40)  # bytes of nothing, which take no room on the disk
    assert typed("validate", large).stderr.endswith(
        "is larger than 1 MiB, the most that is read of such a file\n"
    )
    with pytest.raises(UnreadableFileError, match="larger"):
        read_text(large, 1000)


def test_the_line_of_what_is_no_text_is_said(tmp_path: Path) -> None:
    path = tmp_path / "latin.yaml"
    path.write_bytes(GOOD.replace("rigid", "r\xfcgid").encode("latin-1"))
    line = GOOD[: GOOD.index("rigid")].count("\n") + 1
    assert f"latin.yaml:{line}: is not a text file in UTF-8" in typed("validate", path).stderr


def test_numbers_mean_what_they_mean_in_yaml_1_2(tmp_path: Path) -> None:
    from coopqp.scenario.yaml import read_yaml

    path = tmp_path / "numbers.yaml"
    words = {
        "0x1F": 31, "0o17": 15, "0b101": 5, "007": 7, "1_000": 1000, "-.5": -0.5, "1e3": 1000.0,
        "+1.": 1.0, "yes": "yes", "True": True, "~": None, "1:30": "1:30", "'1'": "1", "": None,
        "2026-11-21": "2026-11-21", "!!str 1": "1", "!!float 1": 1.0, "1e": "1e",
    }  # fmt: skip
    path.write_text("".join(f"k{i}: {word}\n" for i, word in enumerate(words)), encoding="utf-8")
    found = read_yaml(path).data
    assert list(found.values()) == list(words.values())
    assert [type(value) for value in found.values()] == [type(value) for value in words.values()]


def test_what_stands_for_another_place_is_read_with_its_line(tmp_path: Path) -> None:
    from coopqp.scenario.yaml import read_yaml

    path = tmp_path / "merged.yaml"
    path.write_text("a: &a\n  x: 1\n  y: [1, 2]\nb:\n  <<: *a\n  x: 2\nc: *a\n", encoding="utf-8")
    file = read_yaml(path)
    assert file.data["b"] == {"x": 2, "y": [1, 2]}
    assert file.place(["b", "x"]).endswith(":6: b.x")
    assert file.place(["c", "y", 1]).endswith(":3: c.y[1]")
