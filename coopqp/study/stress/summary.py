"""One line for each kind of rollout."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

from coopqp.study.stress.judgement import Rollout


@dataclass(frozen=True)
class Summary:
    """One line of the table: rollouts of one kind.

    Attributes:
        kind: such as "baxter", "outside" or "all".
        count: of rollouts.
        outcomes: by name.
        frozen, swinging, worse, never_back: rollouts that showed these signs.
        saturated, squeezed: the same on plants with masses.
        broken: rollouts that broke a promise.
        compared, ticks, fallbacks, inaccurate, plain: of all rollouts.
        position_excess, velocity_excess, loop_position, loop_orientation, force: the worst of them.
    """

    kind: str
    count: int
    outcomes: dict[str, int]
    frozen: int
    swinging: int
    worse: int
    never_back: int
    saturated: int
    squeezed: int
    broken: int
    compared: int
    ticks: int
    fallbacks: int
    inaccurate: int
    plain: int
    position_excess: float
    velocity_excess: float
    loop_position: float
    loop_orientation: float
    force: float


def summarize(rollouts: list[Rollout]) -> list[Summary]:
    """By robot and by what else was drawn, and all together."""
    kinds: dict[str, list[Rollout]] = {}
    drawn = [r for r in rollouts if r.robot]
    for words in (_robot, _grasp, _goal, _start, _limits, _kappa, _errors):
        for r in sorted(drawn, key=words):
            if kind := words(r):
                kinds.setdefault(kind, []).append(r)
    lines = [_summary(kind, of_kind) for kind, of_kind in kinds.items()]
    return [*lines, _summary("all", rollouts)]


def _robot(r: Rollout) -> str:
    return r.robot


def _grasp(r: Rollout) -> str:
    return r.errors and ("firm" if r.grasp == "rigid" else "hinged")


def _goal(r: Rollout) -> str:
    return r.goal


def _start(r: Rollout) -> str:
    return r.start and f"start {r.start}"


def _limits(r: Rollout) -> str:
    return r.limits and f"{r.limits} limits"


def _kappa(r: Rollout) -> str:
    return r.kappa and f"kappa {r.kappa}"


def _errors(r: Rollout) -> str:
    return r.errors and f"errors {r.errors}"


def _summary(kind: str, rollouts: list[Rollout]) -> Summary:
    return Summary(
        kind,
        len(rollouts),
        dict(sorted(Counter(r.outcome or "raised" for r in rollouts).items())),
        sum(r.frozen for r in rollouts),
        sum(r.swinging for r in rollouts),
        sum(r.worse for r in rollouts),
        sum(r.never_back for r in rollouts),
        sum(r.saturated for r in rollouts),
        sum(r.squeezed for r in rollouts),
        sum(bool(r.broken) for r in rollouts),
        sum(r.compared for r in rollouts),
        sum(r.ticks for r in rollouts),
        sum(r.fallbacks for r in rollouts),
        sum(r.inaccurate for r in rollouts),
        sum(r.plain for r in rollouts),
        max(r.position_excess for r in rollouts),
        max(r.velocity_excess for r in rollouts),
        max(r.loop_position for r in rollouts),
        max(r.loop_orientation for r in rollouts),
        max(r.force for r in rollouts),
    )
