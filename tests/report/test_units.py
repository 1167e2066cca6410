"""Joints that slide are told in metres: at the start, in tables, figures and playback."""

from __future__ import annotations

import io
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from explained import ADVICE
from rich.console import Console
from scenario_files import needs_robots

import coopqp
from coopqp.base.errors import ScenarioError
from coopqp.execution.comparison import Comparison, summarize
from coopqp.limits import JointAcceleration, Workspace
from coopqp.report import audit
from coopqp.report.cells import COLUMNS, cells
from coopqp.report.curves import Chart
from coopqp.report.figures.joints import limit_figures, torques
from coopqp.report.scene.playback import scene
from coopqp.report.table import summary
from coopqp.robots import NaoT14
from coopqp.scenario.catalog import Catalog
from coopqp.scenario.form import file_model
from coopqp.scenario.loader import find, load
from coopqp.trace import Trace

SCENARIO = """
robot: {urdf: {path: GANTRY, arms: {right: r_tip, left: l_tip}}}
grasp: GRASP
object: {size: [0.1, 0.3, 0.1], mass: 0.5}
START
tasks: [point_on_point: {goal: [0.65, 0.0, 0.0], profile: {duration: 0.2}}]
controllers: [qp, pseudoinverse]
plant: PLANT
dt: 0.01
duration: 0.2
kappa: 100.0
"""
#: Both hands in front of the cart, in degrees.
BEND = {"right": [-20, 60, -40], "left": [20, -60, 40]}
BY_ARM = "start_deg: {right: [RAIL, -20, 60, -40], left: [RAIL, 20, -60, 40]}"
BY_JOINT = "start_deg: {rail: RAIL, r_j1: -20, r_j2: 60, r_j3: -40, l_j1: 20, l_j2: -60, l_j3: 40}"
IN_RADIANS = (
    "start: {rail: RAIL, r_j1: -0.349066, r_j2: 1.047198, r_j3: -0.698132, l_j1: 0.349066, "
    "l_j2: -1.047198, l_j3: 0.698132}"
)
Write = Callable[..., Path]


@pytest.fixture
def write(tmp_path: Path) -> Write:
    """A function that writes a scenario of two arms of three hinges on a cart that slides."""

    def write(
        start: str = BY_ARM, rail: float = 0.1, grasp: str = "rigid", plant: str = "kinematic"
    ) -> Path:
        text = SCENARIO.replace("START", start.replace("RAIL", str(rail)))
        text = text.replace("GANTRY", str(ADVICE / "gantry.urdf"))
        path = tmp_path / "gantry.yaml"
        path.write_text(text.replace("GRASP", grasp).replace("PLANT", plant), encoding="utf-8")
        return path

    return write


def faults(path: Path) -> str:
    with pytest.raises(ScenarioError) as caught:
        load(path)
    return str(caught.value)


# ---- joints ----------------------------------------------------------------------------------


def test_robot_and_chain_know_which_joints_slide(write: Write) -> None:
    chain = load(write()).chain
    units = dict(zip(chain.robot.joint_names, chain.robot.joint_units, strict=True))
    assert units.pop("rail") == "m"
    assert set(units.values()) == {"rad"}
    assert chain.joint_units == chain.robot.joint_units  # no passive joints


def test_passive_joints_have_their_units_too(write: Write) -> None:
    chain = load(write(grasp="{prismatic: {axis: [1, 0, 0]}}")).chain
    units = dict(zip(chain.joint_names, chain.joint_units, strict=True))
    slides = {name for name, unit in units.items() if unit == "m"}
    assert slides == {"rail", "right.slide", "left.slide"}
    assert chain.robot.joint_units.count("m") == 1


def test_a_robot_of_hinges_has_radians() -> None:
    assert set(NaoT14().build().joint_units) == {"rad"}


# ---- start -----------------------------------------------------------------------------------


@pytest.mark.parametrize("start", [BY_ARM, BY_JOINT])
def test_sliding_joints_keep_metres_in_start_deg(write: Write, start: str) -> None:
    chain = load(write(start)).chain
    expected = {"rail": 0.1}
    for side, angles in BEND.items():
        expected |= {f"{side[0]}_j{i}": np.radians(a) for i, a in enumerate(angles, 1)}
    for name, q in zip(chain.joint_names, chain.q_start, strict=True):
        assert q == pytest.approx(expected[name], abs=1e-15)


def test_passive_slides_keep_metres_and_hinges_have_degrees(write: Write) -> None:
    both = f"{BY_ARM[:-1]}, left.slide: 0.02}}"
    chain = load(write(both, grasp="{prismatic: {axis: [1, 0, 0]}}")).chain
    assert chain.q_start[chain.joint_names.index("left.slide")] == 0.02
    both = f"{BY_ARM[:-1]}, left.hinge: 3}}"
    chain = load(write(both, grasp="{revolute: {axis: [0, 0, 1]}}")).chain
    hinge = chain.q_start[chain.joint_names.index("left.hinge")]
    assert hinge == pytest.approx(np.radians(3.0))


@pytest.mark.parametrize("start", [BY_ARM, BY_JOINT, IN_RADIANS])
def test_a_slide_outside_its_limits_is_told_in_metres(write: Write, start: str) -> None:
    found = faults(write(start, rail=0.5))
    assert "rail starts at 0.5 m, outside its limits -0.3 to 0.3; or say" in found
    assert len(found.splitlines()) == 1


def test_a_hinge_outside_its_limits_is_told_as_it_was_given(write: Write) -> None:
    found = faults(write(BY_ARM.replace("60, -40]", "150, -40]", 1)))
    assert "r_j2 starts at 150 degrees, outside its limits -143.239 to 143.239" in found
    found = faults(write(IN_RADIANS.replace("1.047198", "2.6", 1)))
    assert "r_j2 starts at 2.6 rad, outside its limits -2.5 to 2.5" in found


@pytest.mark.parametrize("start", [BY_ARM, IN_RADIANS])
def test_a_passive_slide_outside_its_limits_is_told_in_metres(write: Write, start: str) -> None:
    grasp = "{prismatic: {axis: [1, 0, 0], lower: -0.01, upper: 0.01}}"
    found = faults(write(f"{start[:-1]}, left.slide: 0.02}}", grasp=grasp))
    assert "left.slide starts at 0.02 m, outside its limits -0.01 to 0.01" in found


@pytest.mark.parametrize(
    ("start", "words"),
    [
        ("start_deg: {right: [RAIL, 1, 2], left: [RAIL, 20, -60, 40]}", "right: found 3 numbers"),
        ("start_deg: {rial: 0.1}", "unknown arm or joint 'rial'; did you mean 'rail'"),
    ],
)
def test_wrong_names_and_counts_in_degrees_are_refused(
    write: Write, start: str, words: str
) -> None:
    assert words in faults(write(start))


def test_the_schema_says_that_slides_keep_metres() -> None:
    fields = file_model(Catalog()).model_fields
    assert "metres" in str(fields["start_deg"].description)


@needs_robots
def test_tiagos_torso_starts_in_metres(tmp_path: Path) -> None:
    text = find("tiago_torso").read_text(encoding="utf-8")
    assert text.count("[0.21356988, ") == 2
    path = tmp_path / "high.yaml"
    path.write_text(text.replace("[0.21356988, ", "[0.5, "), encoding="utf-8")
    assert "torso_lift_joint starts at 0.5 m, outside its limits 0 to 0.35" in faults(path)


# ---- report ----------------------------------------------------------------------------------


@pytest.fixture
def compared(write: Write) -> Comparison:
    return coopqp.compare(load(write()))


def with_limits(comparison: Comparison, joint: str, margin: float) -> Comparison:
    """As if a joint had had this much margin above the farthest it went; others have plenty."""

    def limited(trace: Trace) -> Trace:
        upper = np.full(len(trace.joints), 50.0)
        i = trace.joints.index(joint)
        upper[i] = trace.q[:, i].max() + margin
        return replace(trace, lower=np.full(len(upper), -50.0), upper=upper)

    traces = {name: limited(trace) for name, trace in comparison.traces.items()}
    return summarize(comparison.scenario, traces)


@pytest.mark.parametrize(("joint", "unit"), [("rail", "m"), ("r_j2", "rad")])
def test_margins_and_violations_have_the_unit_of_the_worst_joint(
    compared: Comparison, joint: str, unit: str
) -> None:
    inside, beyond = with_limits(compared, joint, 0.25), with_limits(compared, joint, -0.125)
    for name in compared.traces:
        row = cells(inside.traces[name], inside.metrics[name])
        assert row["margin"].lines == (f"0.25 {unit}",)
        assert row["limit"].lines == ("0",)
        assert not row["limit"].bad
        row = cells(beyond.traces[name], beyond.metrics[name])
        assert row["margin"].lines == (f"-0.125 {unit}",)
        assert row["limit"].lines == (f"0.125 {unit}",)
        trace, i = beyond.traces[name], beyond.traces[name].joints.index(joint)
        began_there = trace.q[0, i] == trace.q[:, i].max()
        assert row["limit"].bad is (None if began_there else True)
        far = "125 mm" if unit == "m" else "0.12 rad"
        assert f"{joint} {far} beyond" in beyond.verdicts[name]


@pytest.mark.parametrize(("joint", "unit"), [("rail", "m/s"), ("l_j3", "rad/s")])
def test_speeds_have_the_unit_of_the_worst_joint(
    compared: Comparison, joint: str, unit: str
) -> None:
    trace = compared.traces["qp"]
    v, i = np.zeros_like(trace.v), trace.joints.index(joint)
    v[3, i] = -(trace.velocity[i] + 0.5)
    found = summarize(compared.scenario, {"qp": replace(trace, v=v)})
    row = cells(found.traces["qp"], found.metrics["qp"])
    assert row["speed"].lines == (f"0.5 {unit}",)
    assert row["speed"].bad


def test_no_heading_promises_radians(compared: Comparison) -> None:
    assert not any("rad" in re.split(r"\W", column.unit) for column in COLUMNS.values())
    console = Console(width=100, record=True, file=io.StringIO())
    console.print(summary(with_limits(compared, "rail", -0.125)))
    shown = console.export_text()
    assert "[rad]" not in shown
    assert "0.125 m" in shown


def test_metrics_say_that_their_unit_is_the_joints() -> None:
    units = {name: entry.cls().unit for name, entry in Catalog().entries("metrics").items()}  # type: ignore[attr-defined]
    assert units["limit_violation_max"] == units["limit_margin_min"] == "rad or m"
    assert units["velocity_violation_max"] == "rad/s or m/s"


def test_the_playback_tells_margins_of_slides_and_hinges_apart(compared: Comparison) -> None:
    trace = compared.traces["qp"]
    readout = scene(compared)["controllers"][0]["readout"]
    margin = np.minimum(trace.q - trace.lower, trace.upper - trace.q)
    rail = trace.joints.index("rail")
    hinges = np.delete(margin, rail, axis=1).min(axis=1)
    for k, lines in enumerate(readout):
        assert lines[-1] == f"limit margin {hinges[k]:.3g} rad, {margin[k, rail]:.3g} m"


def test_margins_of_slides_have_a_figure_of_their_own(compared: Comparison) -> None:
    found = {
        figure.title: figure
        for figure in limit_figures(Chart(compared))
        if "Margin" in figure.title
    }
    assert {title: figure.unit for title, figure in found.items()} == {
        "Margin of the joint nearest to its limit": "rad, negative beyond the limit",
        "Margin of the sliding joint nearest to its limit": "m, negative beyond the limit",
    }
    slides = found["Margin of the sliding joint nearest to its limit"]
    trace = compared.traces["qp"]
    q = trace.q[:, trace.joints.index("rail")]
    (line,) = (line for line in slides.data if line.get("name") == "qp")
    np.testing.assert_allclose(line["y"], np.minimum(q + 0.3, 0.3 - q), rtol=1e-6)


def test_a_figure_of_slides_that_leave_the_chart_says_metres(compared: Comparison) -> None:
    found = limit_figures(Chart(with_limits(compared, "rail", -20.0)))
    (slides,) = (figure for figure in found if "sliding" in figure.title)
    assert slides.notes
    assert all(note.endswith(" m") for note in slides.notes)


def test_a_motor_that_slides_has_a_force(write: Write) -> None:
    found = torques(Chart(coopqp.compare(load(write(plant="rigid_body")), controllers=["qp"])))
    units = {figure.title: figure.unit for figure in found}
    assert units["Force of rail"] == "N"
    assert units["Torque of r_j1"] == "N m"


def test_the_audit_tells_each_limit_in_its_unit(write: Write) -> None:
    scenario = load(write())
    wall = Workspace(normal=(-1, 0, 0), through=(0.9, 0, 0))
    limits = (*scenario.limits, JointAcceleration(max=50.0), wall)
    compared = coopqp.compare(replace(scenario, limits=limits), controllers=["qp"])
    trace, units = compared.traces["qp"], {}
    for row in trace.margins:
        alone = {"qp": replace(trace, margins={row: trace.margins[row]})}
        (cell, *_) = re.findall(r"<td>([^<]*)</td>", audit.rows(alone))
        least, units[row.name] = cell.removeprefix("✗ ").replace("&lt; 1e-9", "0").split()
        per_unit = 1e3 if units[row.name] == "mm" else 1.0
        margin = per_unit * trace.margins[row].min()
        assert float(least) == pytest.approx(margin, rel=1e-2, abs=1e-9)
    for joint, unit, place in (("rail", "m", "mm"), ("r_j2", "rad", "rad")):
        for kind, per in (("velocity", "/s"), ("acceleration", "/s2")):
            assert units[f"limit.{kind}[{joint}].upper"] == f"{unit}{per}"
        assert units[f"limit.position[{joint}].upper"] == place
        assert units[f"limit.braking[{joint}].lower"] == place
    assert units["limit.workspace.object[0]"] == "mm"
