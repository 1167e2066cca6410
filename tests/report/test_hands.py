"""What reports and verdicts say of hands that press."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from command_line import typed
from scenario_files import cut, needs_robots, write

import coopqp
from coopqp.assessment import assess
from coopqp.assessment.verdict import verdict
from coopqp.base.errors import InvalidValueError
from coopqp.execution.comparison import Comparison, compare
from coopqp.metrics.edge_margin import EdgeMargin
from coopqp.metrics.friction_margin import FrictionMargin
from coopqp.metrics.held import Held
from coopqp.report.figures.groups import groups
from coopqp.report.page import how_to_read, render
from coopqp.solver import Status
from coopqp.trace import Failure

SHIPPED = Path(coopqp.__file__).parent / "scenarios"


@pytest.fixture(scope="module")
def pressed() -> Comparison:
    return compare(cut(coopqp.load("nao_presses"), 60))


def test_the_page_draws_forces_and_friction_with_its_edge(pressed: Comparison) -> None:
    (group,) = (g for g in groups(pressed) if g.title == "Hands that press")
    titles = [figure.title for figure in group.figures]
    assert "Normal force of right" in titles
    assert "Friction that left needs over what there is" in titles
    assert "slips" in json.dumps([figure.layout for figure in group.figures])
    assert [figure.title for figure in group.folded] == [
        "Share of the load on right",
        "Share of the load on left",
    ]


def test_the_verdict_tells_what_friction_is_left(pressed: Comparison) -> None:
    (name,) = pressed.verdicts
    margin = pressed.metrics[name]["friction_margin"]
    words = f"Holds the object with {100.0 * margin:.0f} % of the friction unused"
    assert pressed.verdicts[name].startswith(words)
    assert 0.4 < margin < 0.6


def test_the_verdict_tells_a_pad_on_its_edge_apart_from_friction(pressed: Comparison) -> None:
    """The same run, its pressure moved to an edge: as much friction is left as before."""
    (name,) = pressed.traces
    trace, metrics = pressed.traces[name], pressed.metrics[name]
    assert "on its edge" not in pressed.verdicts[name]
    edge = trace.signals["edge_use"].copy()
    edge[-1, 0] = 1.0
    tipping = replace(trace, signals={**trace.signals, "edge_use": edge})
    told = {"edge_margin": EdgeMargin(), "friction_margin": FrictionMargin()}
    found = {key: metric.measure(tipping) for key, metric in told.items()}
    assert found == {"edge_margin": 0.0, "friction_margin": metrics["friction_margin"]}
    said = verdict(assess(tipping), {**metrics, **found})
    assert "% of the friction unused and a pad on its edge; " in said


def test_the_verdict_does_not_say_held_of_what_still_slips(pressed: Comparison) -> None:
    (name,) = pressed.traces
    trace, metrics = pressed.traces[name], pressed.metrics[name]
    slip = np.zeros_like(trace.signals["slip"])
    slip[:, 0] = np.linspace(0.0, 0.089, trace.ticks)
    slipping = replace(trace, signals={**trace.signals, "slip": slip})
    said = verdict(assess(slipping), {**metrics, "slip_distance": 0.089})
    assert said.startswith("Lets the object slip, by 89 mm and still at the end; ")
    slip[: trace.ticks // 4, 0], slip[trace.ticks // 4 :, 0] = 0.0, 0.089  # and lies there
    slow = replace(slipping, dt=0.02)
    assert verdict(assess(slow), {**metrics, "slip_distance": 0.089}).startswith("Holds the object")


def test_a_lost_object_reaches_no_goal(pressed: Comparison) -> None:
    (name,) = pressed.traces
    trace = pressed.traces[name]
    held = np.ones_like(trace.signals["held"])
    held[40:] = 0.0
    lost = replace(trace, signals={**trace.signals, "held": held})
    metrics = {**pressed.metrics[name], "held": Held().measure(lost)}
    assert verdict(assess(lost), metrics).startswith("Loses the object at 0.082 s; reaches no goal")
    assert not Held().measure(lost)["held"]  # type: ignore[index]
    ended = replace(
        lost,
        status=(*trace.status[:41], *[Status.OBJECT_LOST.name] * (trace.ticks - 41)),
        failures=tuple(
            Failure(k, Status.OBJECT_LOST.value, "the object is lost: right slips")
            for k in range(41, trace.ticks)
        ),
    )
    said = verdict(assess(ended), metrics)
    assert said.startswith("Loses the object at 0.082 s: right slips; reaches no goal")


def test_mobility_says_how_hard_the_hands_can_squeeze(tmp_path: Path) -> None:
    """The whole pads, as in the reference notes, and what is counted on of them by default."""
    text = (SHIPPED / "nao_presses.yaml").read_text(encoding="utf-8")
    text = re.sub(r"duration: [\d.]+", "duration: 0.1", text)  # of the run and of its way
    whole = text.replace("friction: 0.5", "friction: 0.5\n      reach: 1.0\n      least: 0.0")
    given = write(tmp_path, whole)
    result = typed("mobility", given, "--json")
    assert result.exit_code == 0
    found = json.loads(result.stdout)
    (squeeze,) = found["forces"]["squeeze"]
    assert squeeze["least"]["value"] == pytest.approx(4.16, rel=5e-3)
    assert squeeze["most"]["value"] == pytest.approx(12.1, rel=5e-3)
    assert "motor RShoulderRoll" in squeeze["most"]["by"]
    assert found["forces"]["all"]["commanded"] == 6
    assert "Squeeze of right and left at rest: 4.16 to 12.1 N" in found["verdict"]
    counted = json.loads(typed("mobility", write(tmp_path, text), "--json").stdout)
    (counted,) = counted["forces"]["squeeze"]
    assert 4.16 < counted["most"]["value"] < squeeze["most"]["value"]


def test_a_force_on_a_plant_without_forces_is_refused_where_it_is_simulated(
    tmp_path: Path,
) -> None:
    scenario = coopqp.load("nao_presses")
    text = scenario.source.replace("plant: mujoco", "plant: kinematic").replace(
        "tasks:\n", "tasks:\n  - internal_wrench: {squeeze: 9}\n"
    )
    told = coopqp.load(write(tmp_path, text))
    assert not coopqp.OnlineLoop(told, "torque_qp").begun  # a robot has forces
    with pytest.raises(InvalidValueError, match="torques, which this plant does not take"):
        coopqp.run(told, controller="torque_qp")


def test_the_page_explains_forces_where_there_are_some_and_laws_where_they_are_compared(
    pressed: Comparison,
) -> None:
    said = " ".join(how_to_read(pressed))
    assert "coefficient of friction times the normal force" in said
    assert "pseudoinverse" not in said
    assert "spring" not in said
    plain = " ".join(how_to_read(compare(cut(coopqp.load("point_on_point"), 5))))
    assert "pseudoinverse" in plain
    assert "friction" not in plain


@needs_robots
def test_fastened_hands_have_no_section_of_pressing_ones() -> None:
    yielding = compare(cut(coopqp.load("position_pair"), 5))
    titles = {group.title: group for group in groups(yielding)}
    assert "Hands that press" not in titles
    told = [figure.title for figure in titles["Torques and forces"].folded]
    assert [title for title in told if title.startswith("Share of the load")]
    said = " ".join(how_to_read(yielding))
    assert "there is a spring" in said
    assert "squeeze is the force" in said


def test_a_page_draws_hands_that_touch_nothing_for_a_while(pressed: Comparison) -> None:
    """What there is none of is left out; JSON would not take it."""
    (name,) = pressed.traces
    trace = pressed.traces[name]
    uses = {key: trace.signals[key].copy() for key in ("friction_use", "edge_use")}
    for use in uses.values():
        use[10:20] = np.nan
    apart = replace(trace, signals={**trace.signals, **uses})
    page = render(replace(pressed, traces={name: apart}))
    assert "Pressure of left from the middle of its pad to the edge" in page
