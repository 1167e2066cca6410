"""Results of a calibration: a table, sentences, and lines to paste into the scenario."""

import dataclasses
from collections.abc import Iterator
from typing import Any

import numpy as np
import pinocchio as pin
from rich import box
from rich.table import Table

from coopqp.base.spec import Array
from coopqp.model.grasp_configuration import with_passive_joints
from coopqp.scenario.scenario import Scenario
from coopqp.scenario.start import by_arm
from coopqp.scenario.start_solver import DIGITS, start_text
from coopqp.study.calibration import Calibration


def table(result: Calibration) -> Table:
    """One row an offset; fits 80 columns."""
    out = Table(box=box.SIMPLE_HEAD, padding=0, show_edge=False)
    for heading in ("offset", "", "standard deviation", ""):
        out.add_column(heading, justify="right" if heading else "left")
    for offset in result.offsets:
        unit, deviation = f" m{offset.unit}", (f"{1e3 * offset.deviation:.3f}", f" m{offset.unit}")
        if not np.isfinite(offset.deviation):
            deviation = ("not shown" if np.isinf(offset.deviation) else "one tick", "")
        out.add_row(offset.name, f"{1e3 * offset.value:.3f}{unit}", *deviation)
    return out


def sentences(result: Calibration, *, encoders: bool) -> Iterator[str]:
    """The offsets' effect, and how reliable they are."""
    yield (
        f"The hands were {_both(result.before)} from where the model has them (root mean square, "
        f"{result.ticks} tick{'s' * (result.ticks > 1)}); with these offsets {_both(result.after)}"
        + (f", of which noise is {_both(result.noise)}." if result.ticks > 1 else ".")
    )
    if result.predicted is None:
        yield (
            f"warning: the joints moved by {1e3 * result.travel:.2g} mrad or mm at most: this "
            "makes one pose right, and does not tell whether the hands or the arms are wrong."
        )
    elif result.explains:
        yield f"What the ticks near the start tell leaves {_both(result.predicted)} far from it."
    else:
        wrong, rest = "The object's place in the hands does", "links or encoders (try --encoders)"
        if encoders:
            wrong, rest = "Object and encoders do", "links"
        yield (
            f"warning: {wrong} not explain the run: what the ticks near the start tell leaves "
            f"{_both(result.predicted)} far from it. The rest is of the arms themselves, {rest}, "
            "or the object has slipped."
        )
    if result.hidden:
        yield (
            f"The motion does not show {result.hidden} combination{'s' * (result.hidden > 1)} of "
            f"{', '.join(result.not_shown)}; taken for zero."
        )
    for i in result.chain.passive:
        yield (
            f"{result.chain.joint_names[i]}: its reading is taken for true; its own zero cannot be "
            "told from the object's place along or about it."
        )
    if encoders:
        yield "Subtract the encoders' offsets from what they say; the lines below count on it."


def as_json(result: Calibration) -> dict[str, Any]:
    """All numbers; those that the motion does not show are null."""
    chain = result.chain
    same = ("before", "after", "noise", "predicted", "explains", "hidden", "ticks")
    return {
        "offsets": result.offsets,
        "object_in_hand": {a: _pose(_object_in_hand(result, a)) for a in chain.hold.holders},
        "start": dict(zip(chain.joint_names, chain.q_start.tolist(), strict=True)),
        **{key: getattr(result, key) for key in same},
    }


def yaml_text(result: Calibration, scenario: Scenario) -> str:
    """The grasps and the start of the scenario, corrected."""
    chain = result.chain
    lines = ["grasps:   # instead of grasp, grasps and grasp_of"]
    for arm in chain.robot.arms:
        grasp = chain.grasps[arm.name]
        entries = scenario.catalog.entries("grasps").items()
        name = next(name for name, entry in entries if entry.cls is type(grasp))
        own = ((field, getattr(grasp, field.name)) for field in dataclasses.fields(grasp))
        settings = {field.name: value for field, value in own if value != field.default}
        settings.pop("object_in_hand", None)
        if arm.name in chain.hold.holders or grasp.object_in_hand:
            settings["object_in_hand"] = _pose(_object_in_hand(result, arm.name))
        lines.append(f"  {arm.name}: {{{name}: {_flow(settings)}}}")
    if scenario.held.pose:
        pose = _flow(_pose(chain.object_pose(chain.q_start)))
        lines += ["object:   # beside what is there, instead of its pose", f"  pose: {pose}"]
    value = dict(zip(chain.joint_names, chain.q_start.tolist(), strict=True))
    remark = "instead of start and start_deg"
    return "\n".join([*lines, start_text(by_arm(chain.robot, value), remark)])


def _object_in_hand(result: Calibration, arm: str) -> pin.SE3:
    """Pose of the object in the tip's frame, with passive joints at zero."""
    hold = result.chain.hold
    model, ends = with_passive_joints(hold.robot, hold.passive)
    data = model.createData()
    pin.framesForwardKinematics(model, data, np.array(pin.neutral(model)))
    tip = next(a.tip for a in hold.robot.arms if a.name == arm)
    X_TE = data.oMf[model.getFrameId(tip)].actInv(data.oMf[model.getFrameId(ends[arm])])
    return X_TE * hold.X_EO[arm]


def _pose(X: pin.SE3) -> dict[str, Any]:
    parts = {"position": X.translation, "rpy": pin.rpy.matrixToRpy(X.rotation)}
    return {key: (np.round(part, DIGITS) + 0.0).tolist() for key, part in parts.items()}


def _flow(value: Any) -> str:
    if isinstance(value, dict):
        return "{" + ", ".join(f"{key}: {_flow(v)}" for key, v in value.items()) + "}"
    if isinstance(value, tuple | list):
        return "[" + ", ".join(map(_flow, value)) + "]"
    return f"{value:.{DIGITS}f}" if isinstance(value, float) else str(value)


def _both(sizes: Array) -> str:
    return f"{1e3 * sizes[0]:.2g} mm and {1e3 * sizes[1]:.2g} mrad"
