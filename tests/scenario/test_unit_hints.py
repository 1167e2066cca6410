"""Degrees for radians, millimetres for metres: one line that says so."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from pathlib import Path

import pytest
from command_line import refused, refused_in_one_line, typed
from scenario_files import HEAD, TAIL, write

from coopqp.base.errors import InvalidValueError, ScenarioError
from coopqp.base.spec import Pose
from coopqp.scenario.loader import load
from coopqp.scenario.notes import notes
from coopqp.task import Task
from coopqp.tasks import PointOnPlane, PointOnPoint

GOAL = "duration: 1.0\ntasks:\n  - point_on_point: {name: reach, goal: [0.17, 0.01, 0.06]}\n"
TEXT = HEAD + GOAL + TAIL
RIGHT = (0.7, -0.2, 1.2, 0.9, 0.1)


def in_degrees(text: str) -> str:
    """The start of NAO's arms as people think of it."""
    for sign in (1, -1):
        values = [RIGHT[0], sign * RIGHT[1], sign * RIGHT[2], sign * RIGHT[3], sign * RIGHT[4]]
        degrees = [round(math.degrees(x), 1) for x in values]
        assert str(values) in text
        text = text.replace(str(values), str(degrees))
    return text


def test_a_hand_that_is_far_from_the_object_is_a_note(tmp_path: Path) -> None:
    """NAO's hands are 209 mm apart: half of that, less half of the object's width."""
    assert not any(
        "from the object's surface" in line for line in notes(load(write(tmp_path, TEXT)))
    )
    small = TEXT.replace("size: [0.08, 0.19, 0.08]", "size: [0.002, 0.002, 0.002]")
    told = [line for line in notes(load(write(tmp_path, small))) if "object's surface" in line]
    assert [line.split(" and holds")[0] for line in told] == [
        "the tip of right is 103 mm from the object's surface",
        "the tip of left is 103 mm from the object's surface",
    ]


def test_degrees_under_start_are_one_line(tmp_path: Path) -> None:
    with pytest.raises(ScenarioError) as caught:
        load(write(tmp_path, in_degrees(TEXT)))
    (fault,) = caught.value.faults
    assert "scenario.yaml:4: start: " in str(fault)
    assert str(fault).endswith("did you mean start_deg?")
    load(write(tmp_path, in_degrees(TEXT).replace("start:", "start_deg:")))


@pytest.mark.parametrize("arm", ["right", "left"])
def test_one_arm_in_degrees_is_one_line_that_names_it(tmp_path: Path, arm: str) -> None:
    own = re.compile(rf"  {arm}: .*")
    (degrees,) = own.findall(in_degrees(TEXT))
    with pytest.raises(ScenarioError) as caught:
        load(write(tmp_path, own.sub(degrees, TEXT)))
    (fault,) = caught.value.faults
    assert f"start.{arm}: found angles of more than a turn" in str(fault)
    assert str(fault).endswith("in degrees; start is in radians, start_deg all in degrees")


def test_a_start_that_is_outside_in_degrees_too_is_told_joint_by_joint(tmp_path: Path) -> None:
    with pytest.raises(ScenarioError, match=r"start\.right\[0\]: RShoulderPitch starts at 700 rad"):
        load(write(tmp_path, TEXT.replace("right: [0.7,", "right: [700,")))


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("goal: [0.17, 0.01, 0.06]", "goal: [170, 10, 60]", r"goal of 'reach' is 180 m from"),
        (
            "controllers:",
            "limits:\n  - obstacles: {shapes: {post: {sphere: 0.1, position: [300, 0, 400]}}}\n"
            "controllers:",
            r"obstacles: post is \d+ m from all bodies",
        ),
    ],
)
def test_what_is_nowhere_near_is_a_note(tmp_path: Path, old: str, new: str, words: str) -> None:
    file = write(tmp_path, TEXT.replace(old, new, 1))
    result = typed("validate", file)
    assert result.exit_code == 0
    (line,) = (line for line in result.stderr.splitlines() if "metres" in line)
    assert line.startswith("note: ")
    assert "; lengths are metres" in line
    assert re.search(words, line)
    assert ("are these millimetres?" in line) == ("goal" in words)
    assert not any("metres" in line for line in notes(load(write(tmp_path, TEXT))))


@pytest.mark.parametrize(
    ("old", "new", "place"),
    [
        (
            "size: [0.08, 0.19, 0.08]",
            "size: [80, 190, 80]",
            ":3: object.size: found an edge of 190 m",
        ),
        (
            "controllers:",
            "limits:\n  - obstacles: {shapes: {post: {box: [80, 80, 80]}}}\ncontrollers:",
            "limits[0]: obstacles: ",
        ),
    ],
)
def test_millimetres_for_metres_are_one_line(
    tmp_path: Path, old: str, new: str, place: str
) -> None:
    with pytest.raises(ScenarioError) as caught:
        load(write(tmp_path, TEXT.replace(old, new, 1)))
    (fault,) = caught.value.faults
    assert place in str(fault)
    assert str(fault).endswith("; lengths are metres")


@pytest.mark.parametrize(
    ("task", "error"),
    [
        (PointOnPoint(name="up", goal=(0.5, 0.0, 0.1)), "z, 0.1 m"),
        (PointOnPlane(name="up", normal=(0, 0, 1), through=(0, 0, 0.1)), "normal, 0.1 m"),
        (PointOnPoint(name="up", goal=(0.5, 0.0, 0.0)), ""),
        (PointOnPoint(name="up", goal=(9.0, 0.0, 0.0)), ""),  # far, but in the arms' plane
        (PointOnPlane(name="up", normal=(1, 0, 1), through=(0, 0, 0.1)), ""),  # reached in x
    ],
)
def test_what_no_joint_of_a_planar_pair_moves_is_a_note(task: Task, error: str) -> None:
    told = [
        line for line in notes(replace(load("planar_pair"), tasks=(task,))) if "no motion" in line
    ]
    words = "the goal of 'up' is unreachable, whatever the limits: no motion of the joints changes"
    assert told == ([f"{words} its error in {error}"] if error else [])


def test_a_far_goal_comes_before_all_other_notes(tmp_path: Path) -> None:
    text = TEXT.replace("goal: [0.17, 0.01, 0.06]", "mode: hard, priority: 3, goal: [170, 10, 60]")
    first, second = notes(load(write(tmp_path, text)))
    assert first.endswith("lengths are metres: are these millimetres?")
    assert second.startswith("priority: 3 of 'reach' has no effect: hard tasks come before")


def test_an_orientation_of_many_turns_is_in_degrees() -> None:
    with pytest.raises(InvalidValueError, match=r"rpy: found -90 rad; did you mean rpy_deg\?"):
        Pose(rpy=(0.0, -90.0, 10.0))
    assert Pose(rpy=(0.0, 7.0, 0.0)).angles == (0.0, 7.0, 0.0)


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("limits: 5", "found 5; needs a list"),
        ("weights: [1]", "needs a mapping, such as {key: value}"),
        ("dt: x", 'found "x"; needs a number'),
        ("seed: 1.5", "needs a whole number"),
        ("start_outside: 3", "needs true or false"),
        ("description: 3", "needs a text"),
        ("reactions: {load_heavier: rest}", "reactions: is an argument of OnlineLoop"),
        ("controllers: []", "needs at least 1 in it"),
        ("limits: [{self_collision: {ignore: [[a]]}}]", 'ignore[0]: found ["a"]; needs at least 2'),
        ("limits: [{obstacles: {shapes: {}}}]", "found {}; needs at least 1 in it"),
    ],
)
def test_faults_are_told_in_the_words_of_yaml(tmp_path: Path, line: str, words: str) -> None:
    key = line.partition(":")[0]
    kept = [old for old in TEXT.splitlines() if not old.startswith(f"{key}:")]
    with pytest.raises(ScenarioError) as caught:
        load(write(tmp_path, "\n".join([*kept, line, ""])))
    assert words in str(caught.value)
    for theirs in ("valid", "array", "object;", "dictionary", "item"):
        assert theirs not in str(caught.value).partition("; ")[2]


def test_a_name_without_an_end_is_cut(tmp_path: Path) -> None:
    for old, new in (("nao_t14", "r" * 100_000), ("dt: 0.01", "z" * 900 + ": 1")):
        with pytest.raises(ScenarioError) as caught:
            load(write(tmp_path, TEXT.replace(old, new, 1)))
        assert len(str(caught.value)) < 700
        assert "..." in str(caught.value)


def test_no_path_puts_control_characters_on_the_screen(tmp_path: Path) -> None:
    file, out = write(tmp_path, TEXT.replace("1.0", "1.01")), tmp_path / "a\nb\x1b[31m"
    result = typed("compare", file, "--controllers", "qp", "--out", out)
    assert result.exit_code == 0
    assert "\x1b" not in result.output
    assert sum(line.startswith("wrote ") for line in result.stdout.splitlines()) == 4
    assert "\x1b" not in refused_in_one_line("explain", tmp_path / "no\nsuch\x1b")


@pytest.mark.parametrize("option", ["--out", "--html"])
def test_an_empty_path_to_write_to_is_refused(option: str) -> None:
    command = "compare" if option == "--out" else "mobility"
    assert "is empty; needs a name" in refused(command, "point_on_point", option, "")


@pytest.mark.parametrize("by", ["feed", "feed_file"])
def test_an_input_that_is_sent_millimetres_is_noted(by: str, tmp_path: Path) -> None:
    (tmp_path / "far.csv").write_text("t,x,y,z\n0,0.15,0,0.06\n0.5,150,0,60\n", encoding="utf-8")
    ways = "{times: [0, 0.5], values: [[0.15, 0, 0.06], [150, 0, 60]]}"
    fed = {"feed": f"feed: {{waypoints: {ways}}}", "feed_file": "feed_file: far.csv"}[by]
    text = TEXT.replace("[0.17, 0.01, 0.06]", "{input: hand}")
    found = notes(
        load(write(tmp_path, text.replace("tasks:", f"inputs: {{hand: {{{fed}}}}}\ntasks:")))
    )
    (line,) = [line for line in found if "metres" in line]
    assert line.startswith("the input 'hand' is sent a place 161 m from where the object starts")
