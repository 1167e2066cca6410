"""What Python and the compiled kernel share, as a C++ header made from Python's own names.

``python -m tests.kernel.shared`` writes ``coopqp/kernel/core/shared.hpp`` anew, after a constant, a
kind or an outcome has changed in Python; a test says when that is to be done.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path

from coopqp import limit, program, robot, signal, solver
from coopqp.kernel import compiled
from coopqp.kernel.compiled import Outcome
from coopqp.limits import _keep_apart
from coopqp.model import geometry, loop_observer, profile
from coopqp.online import following
from coopqp.qp_law import equations, level, limit_recovery, nearest, priorities, safety
from coopqp.tasks import manipulability

HEADER = Path(compiled.__file__).parent / "core" / "shared.hpp"

#: Where Python has each constant, and what C++ calls it where that is another name.
CONSTANTS: Mapping[object, Mapping[str, str]] = {
    equations: {
        name: name
        for name in (
            "SCALE_WEIGHT", "ALL_OF_IT", "LEAST_SPEED", "MOST_DAMPING", "GROWS", "MOST_GROWN",
            "FADES_IN", "FADES_AFTER", "SWINGS_AT", "REVERSALS", "FORGETS", "NO_REVERSAL", "BENDS",
            "LETS_GO", "FIRM",
        )
    },
    nearest: {
        name: name
        for name in ("WHOLE", "LITTLE", "SLOW", "FAST", "LESS", "MET", "NEAR", "ASIDE")
    },
    level: {"DECIDED": "DECIDED", "UNSEEN": "UNSEEN"},
    priorities: {"IDLE": "IDLE", "NOISE": "NOISE", "WALL": "WALL"},
    safety: {"HALVINGS": "HALVINGS", "SHORTEST": "SHORTEST"},
    limit_recovery: {name: name for name in ("LEAST_RECOVERY", "LEAST_MOTION", "KEPT")},
    limit: {"ROUNDING": "OUTSIDE", "SHALLOW": "SHALLOW"},
    _keep_apart: {
        "BACK": "BACK", "ROWS": "CORNER_ROWS", "EACH": "CORNERS_EACH", "CLOSE": "WITH_CORNERS",
        "SLAB": "CORNER_SLAB", "LATER": "CORNERS_LATER", "EVEN": "EVEN",
    },
    profile: {"RAMP": "RAMP"},
    geometry: {"TINY": "TINY", "CONE": "CONE"},
    loop_observer: {
        **{
            name: name
            for name in (
                "AFTER", "SOONER", "SOONEST", "LOUDER", "FEELS", "SLIGHT", "MOVES", "REST",
                "TURN_COUNTS", "STALLED", "SPANS", "HAPPENED",
            )
        },
        "FARTHEST": "FARTHEST", "SHAPED": "SHAPED", "DOUBT": "DOUBT", "TINY": "SAG_ROUNDING",
    },
    following: {
        "NOISE": "READING_NOISE", "LAG_NOISE": "LAG_NOISE", "INERTIA_NOISE": "INERTIA_NOISE",
        "STIFFNESS_NOISE": "STIFFNESS_NOISE", "OF_SECOND_DIFFERENCES": "OF_SECOND_DIFFERENCES",
        "SINGULAR": "SINGULAR", "SUSPICIOUS": "SUSPICIOUS", "LEAP": "LEAP",
    },
    signal: {"ENDLESS": "ENDLESS"},
    solver: {"LAST_DIGITS": "LAST_DIGITS", "DEPENDENT": "SAME_ROW"},
    manipulability: {"LARGE": "LARGE_PHI", "REGULAR": "REGULAR"},
}  # fmt: skip

#: Outcomes from here on are added to one of those before.
ADDED = Outcome.RELAXED


def header() -> str:
    """The text of the header."""
    return "\n".join(_lines()) + "\n"


def _lines() -> Iterator[str]:
    yield "// Made by `python -m tests.kernel.shared` from Python, where the names are explained."
    yield "#pragma once"
    yield ""
    yield "namespace coopqp {"
    for module, names in CONSTANTS.items():
        yield ""
        yield f"// {getattr(module, '__name__', module)}"
        for name, here in names.items():
            yield f"constexpr double {here} = {float(getattr(module, name))!r};"
    outcomes = {_camel(o.name): o for o in Outcome if 0 <= o < ADDED}
    flags = {o.name: o for o in Outcome if o < 0 or o >= ADDED}
    yield ""
    yield "// coopqp.kernel.compiled.Outcome"
    yield from _enum("enum class Status : int", outcomes)
    yield f"constexpr int {', '.join(f'{name} = {int(o)}' for name, o in flags.items())};"
    yield ""
    yield "// coopqp.program.Kind, limit.Bounded, robot.Form and model.profile.KINDS"
    yield from _enum("enum class Kind", {_camel(k.name): k for k in program.Kind})
    yield from _enum("enum class Bounded", {_camel(k.name): k for k in limit.Bounded})
    yield from _enum("enum class Form", {_camel(k.name): k for k in robot.Form})
    kinds = {_camel(name): i for i, name in enumerate(profile.KINDS)}
    yield from _enum("enum class ProfileKind", kinds)
    yield ""
    yield "}  // namespace coopqp"


def _enum(head: str, members: Mapping[str, int]) -> Iterator[str]:
    yield f"{head} {{"
    yield from (f"    {name} = {int(value)}," for name, value in members.items())
    yield "};"


def _camel(name: str) -> str:
    return "".join(part.capitalize() for part in name.split("_"))


if __name__ == "__main__":
    HEADER.write_text(header(), encoding="utf-8")
