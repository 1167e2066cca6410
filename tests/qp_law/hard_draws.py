"""Unreachable hard and scaled tasks: ``python -m tests.qp_law.hard_draws --draws 1000``.

Each draw has one hard or scaled task, unreachable by 0 to 50 mm, and one to three soft ones
(tests/unreachable_goals.py). It runs for 12 s, and again with the firm task as soft of priority 0.
Told are draws that oscillate (:mod:`coopqp.assessment.oscillation`) and draws whose firm task ends
farther off than as soft by more than 0.2 mm and 1 %. Of the latter those are at fault that are
still farther off after both have gone on for 120 s from where the firm run has come to; the others
have come to another minimum, or not yet to rest.
Exit code 1 if there are oscillations or faults. ``--seed S --draws 1`` runs a draw again;
``--file scenario.yaml`` runs the hard task of a scenario in the same way.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import click

sys.path.insert(0, str(Path(__file__).parents[1]))  # what tests share

from stress.firmness import as_soft
from unreachable_goals import FARTHER_OFF, Ended, draw, run, shortfall

from coopqp.scenario.loader import load
from coopqp.study.engine import Engine, Lost


@dataclass(frozen=True)
class Outcome:
    """What a draw has come to.

    Attributes:
        seed: of the draw.
        where: robot, grasp and firm task, in words.
        mode: of the firm task.
        found: with the firm task as drawn. reference: with it as soft of priority 0.
        short: why it ends farther off than that, in words; empty otherwise.
        raised: what was raised instead; empty otherwise.
    """

    seed: int
    where: str = ""
    mode: str = ""
    found: Ended | None = None
    reference: Ended | None = None
    short: str = ""
    raised: str = ""

    @property
    def oscillates_as_soft(self) -> bool:
        """Whether it oscillates with the firm task as soft too."""
        return self.reference is not None and self.reference.oscillates

    @property
    def faults(self) -> tuple[str, ...]:
        """What is wrong, in words."""
        if self.raised or self.found is None or self.reference is None:
            return (self.raised or "did not run",)
        kind = "oscillates, as soft too" if self.oscillates_as_soft else "oscillates"
        oscillates = (kind,) if self.found.oscillates else ()
        return (*oscillates, *([self.short] if self.short == FARTHER_OFF else []))


def outcome(seed: int) -> Outcome:
    """What one draw comes to."""
    sys.path.insert(0, str(Path(__file__).parents[1]))
    try:
        drawn = draw(seed)
        firm = drawn.firm
        where = f"{drawn.robot} {drawn.grasp}, {firm.mode} {type(firm).__name__}"
        found = run(drawn.problem, firm)
        short = shortfall(found, drawn.ended, drawn.problem, firm)
        return Outcome(seed, where, firm.mode, found, drawn.ended, short)
    except Exception as error:  # noqa: BLE001 - a draw that raises is a fault of its own
        return Outcome(seed, raised=f"raised {type(error).__name__}: {error}")


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.qp_law.hard_draws", description=__doc__)
    parser.add_argument("--draws", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0, help="of the first; others count up")
    parser.add_argument("--jobs", type=int, default=2, help="processes")
    parser.add_argument("--show", type=int, default=40, help="how many failing draws to name")
    parser.add_argument("--file", type=Path, nargs="+", help="scenarios with one hard task each")
    asked = parser.parse_args()
    if asked.file:
        return max([of_file(path) for path in asked.file])
    before, done = time.perf_counter(), list[Outcome]()
    seeds = range(asked.seed, asked.seed + asked.draws)
    found = Engine(asked.jobs).results(outcome, seeds)
    with click.progressbar(found, length=asked.draws, label="draws", file=sys.stderr) as bar:
        for seed, one in bar:
            done.append(Outcome(seed, raised=one.reason) if isinstance(one, Lost) else one)
    tell(sorted(done, key=lambda one: one.seed), asked.show)
    click.echo(f"{time.perf_counter() - before:.0f} s")
    return 1 if any(one.faults for one in done) else 0


def tell(done: Sequence[Outcome], shown: int) -> None:
    """Counts by mode, what the ticks say, and the draws that fail."""
    for mode in ("hard", "scaled"):
        of_mode = [one for one in done if one.mode == mode]
        faults = Counter(fault for one in of_mode for fault in one.faults)
        of_soft = sum(one.oscillates_as_soft for one in of_mode)
        click.echo(
            f"{mode}: {len(of_mode)} draws, {faults['oscillates']} oscillate and "
            f"{faults['oscillates, as soft too']} more that oscillate as soft too ({of_soft} do); "
            f"{faults[FARTHER_OFF]} farther off than as soft of priority 0"
        )
        for short in sorted({one.short for one in of_mode} - {"", FARTHER_OFF}):
            seeds = [str(one.seed) for one in of_mode if one.short == short]
            click.echo(f"  {len(seeds)} end farther off, {short}: {', '.join(seeds)}")
        said = sum((one.found.statuses for one in of_mode if one.found), Counter[str]())
        for what, count in said.most_common():
            click.echo(f"  {count / said.total():7.2%} of the ticks: {what}")
    failing = [one for one in done if one.faults]
    for one in failing[:shown]:
        click.echo(f"--seed {one.seed} --draws 1: {', '.join(one.faults)}; {one.where}{_how(one)}")
    if len(failing) > shown:
        click.echo(f"and {', '.join(str(one.seed) for one in failing[shown:])}")


def _how(one: Outcome) -> str:
    if one.found is None or one.reference is None:
        return ""
    found, reference = one.found, one.reference
    return (
        f"; ends {1e3 * found.error:.3f} mm off, {1e3 * reference.error:.3f} mm as soft; "
        f"paths: {found.paths}, {reference.paths} as soft"
    )


def of_file(path: Path) -> int:
    """Run the hard task of a scenario, and the same as soft of priority 0; 1 where it fails."""
    problem = load(path).problem()
    firm = next(task for task in problem.tasks if task.mode != "soft")
    found, reference = run(problem, firm), run(as_soft(problem, firm), firm)
    if found.rests:
        ends = "rests"
    else:
        ends = f"moves by {1e3 * found.object_path:.2f} mm in {1e3 * found.object_range:.2f} mm"
    click.echo(
        f"{path.name}: {ends} in the last 6 of 12 s; '{firm.name}' ends "
        f"{1e3 * found.error:.4f} mm off, {1e3 * reference.error:.4f} mm as soft of priority 0; "
        f"{dict(found.statuses)}"
    )
    return int(not found.rests or shortfall(found, reference, problem, firm) == FARTHER_OFF)


if __name__ == "__main__":
    sys.exit(main())
