"""Answers of ``coopqp reach`` and ``coopqp plan`` as text, JSON and files."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rich.table import Table

from coopqp.base.reading import absolute
from coopqp.planning import Plan, Reach
from coopqp.report import strict_json
from coopqp.report.files import write_one
from coopqp.scenario.scenario import Scenario

PATH = "plan.csv"


def configurations(found: Reach) -> Table:
    """A line for each way in which the arms bend, with the best configuration of it."""
    table = Table(box=None, pad_edge=False)
    for title in ("bend of the arms", "found", "joint margin", "clearance", "q [rad, m]"):
        table.add_column(title, justify="left" if title[0] in "bq" else "right")
    for bends, group in found.groups.items():
        best = group[0]
        room = f"{1e3 * best.clearance:.1f} mm" if np.isfinite(best.clearance) else "-"
        q = " ".join(f"{x:.4f}" for x in best.q)
        table.add_row(bends, f"{len(group)}", f"{best.joint_margin:.3f}", room, q)
    return table


def reach_json(found: Reach) -> str:
    """The same for machines."""
    rows = [
        {
            "q": one.q.tolist(), "bends": one.bends, "joint_margin": one.joint_margin,
            "clearance": one.clearance,
        }
        for one in found.found
    ]  # fmt: skip
    return strict_json.text({
        "reachable": bool(found.found), "proven_unreachable": found.proven,
        "sentence": found.sentence, "tried": found.tried, "configurations": rows,
    })  # fmt: skip


def plan_json(found: Plan) -> str:
    """A plan without its points."""
    seen = found.verification
    data: dict[str, Any] = {
        "found": found.found, "sentence": found.sentence, "length": found.length,
        "duration": float(found.t[-1]) if len(found.t) else 0.0, "seconds": found.seconds,
        "verified": {"points": seen.points, "open": seen.open} if seen else None,
    }  # fmt: skip
    return strict_json.text(data)


def write_plan(
    found: Plan, scenario: Scenario, folder: Path, keep: Sequence[str] = ()
) -> list[Path]:
    """Write the path, and the scenario with it, and the tasks to keep, as its reference.

    Raises:
        CoopqpError: it cannot be written.
    """
    path = folder / PATH
    write_one(path, found.csv)
    if not scenario.source:
        return [path]
    follows = folder / f"{scenario.name}.yaml"
    named = PATH if scenario.folder is None else str(absolute(path))
    keys = {"plan": named, **({"keep": list(keep)} if keep else {})}
    write_one(follows, _with_reference(scenario.portable, keys))
    return [path, follows]


def _with_reference(text: str, keys: dict[str, Any]) -> str:
    if text.lstrip().startswith("{"):
        return json.dumps({**json.loads(text), "reference": keys}, indent=2) + "\n"
    end = "" if text.endswith("\n") else "\n"
    return f"{text}{end}reference: {json.dumps(keys)}\n"
