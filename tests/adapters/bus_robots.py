"""Two SO-101 on simulated buses, in radians, with one mistake of wiring, units or sensors.

``python -m tests.adapters.bus_robots --robots 100`` checks so many sound ones, and each fault.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from pathlib import Path

import click
import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))  # what tests share

from adapters.servos import TURN, Servos
from coopqp.base.spec import Array
from coopqp.online.joint_check import JointCheck, check_joints, pose_faults
from coopqp.online.loop import OnlineLoop
from coopqp.scenario.loader import load
from coopqp.scenario.scenario import Scenario

#: A start in which every joint tells its sign, and is like no other.
POSE = [0.4, -0.9, 1.35, -0.45, 0.75], [-0.6, -1.15, 1.0, 0.7, -0.3]
COUNTS = TURN / (2 * np.pi)
#: Faults of one joint, then of two or all; of reading, commanding, or both alike.
OF_ONE = "sign", "dead", "silent"
OF_MORE = "swapped", "arms", "degrees"


@cache
def scenario() -> Scenario:
    """Two SO-101 in the pose that tells all joints apart."""
    start = {"left/arm": POSE[0], "right/arm": POSE[1]}
    return replace(load("two_so101"), start=start, dt=0.02, kappa=50.0)


class BusRobot:
    """A driver with lag, backlash, sag and whole counts; ``fault`` is such as "sign read"."""

    def __init__(self, seed: int, fault: str = "", joint: int = 0) -> None:
        rng = np.random.default_rng(seed)
        self.kind, _, self.where = fault.partition(" ")
        self.joint, self.start = joint, scenario().chain.q_start.copy()
        n = len(self.start)
        self.other = joint - 1 if joint % 5 else joint + 1
        self.zero = rng.uniform(1900.0, 2200.0, n)  # counts where a joint is at 0
        load = rng.uniform(-0.6, 0.6, n) * np.array([0.0, 1.0, 1.0, 0.5, 0.0] * 2)
        put = self.start + rng.normal(0.0, 0.03, n)  # by hand
        self.servos = Servos(
            put * COUNTS + self.zero, load, backlash=rng.uniform(0.0, 14.8),
            stiffness=rng.uniform(0.0, 20.0),
        )  # fmt: skip
        self.servos.joint = self.servos.joint + rng.uniform(-0.3, 0.3, n)
        self.rng, self.stuck = rng, self._wrong((self.servos.read() - self.zero) / COUNTS, "read")

    def read(self) -> Array | None:
        """What the encoders say, with a count of noise."""
        counts = self.servos.read() + self.rng.integers(-1, 2, len(self.zero))
        q = self._wrong((counts - self.zero) / COUNTS, "read")
        if self.kind == "dead":
            q[self.joint] = self.stuck[self.joint]
        if self.kind == "silent":
            q[self.joint] = np.nan
        return q

    def write(self, q: Array, v: Array) -> None:
        """Goals, and what the motors do in a period."""
        self.servos.write(self._wrong(q.copy(), "write") * COUNTS + self.zero)
        self.servos.step(scenario().dt)

    def _wrong(self, q: Array, where: str) -> Array:
        if self.where not in (where, "both"):
            return q
        i, j = self.joint, self.other
        if self.kind == "sign":
            q[i] = -q[i]
        elif self.kind == "swapped":
            q[[i, j]] = q[[j, i]]
        elif self.kind == "arms":
            q = np.roll(q, 5)
        elif self.kind == "degrees":
            q = np.degrees(q) if where == "read" else np.radians(q)
        return q


def faults() -> Iterator[tuple[str, int]]:
    """Each fault, and the joint that has it."""
    for joint in range(10):
        for kind in ("sign", "swapped"):
            yield from ((f"{kind} {where}", joint) for where in ("read", "write", "both"))
        yield "dead sensor", joint
        yield "silent sensor", joint
    for kind in ("arms", "degrees"):
        yield from ((f"{kind} {where}", 0) for where in ("read", "write", "both"))


def checked(robot: BusRobot) -> str:
    """What ``coopqp check-robot --posed`` says; empty if nothing."""
    said = robot.read()
    wrong = pose_faults(scenario().chain, said) if said is not None else {}
    if wrong:
        return "; ".join(f"{joint} {words}" for joint, words in wrong.items())
    try:
        found: JointCheck = check_joints(OnlineLoop(scenario(), clock=None), robot)
    except Exception as error:  # noqa: BLE001 - as on a command line
        return str(error)
    return "" if found.ok else str(found)


def names(robot: BusRobot, words: str) -> bool:
    """Whether the words tell the joint and what is wrong with it, or the arms, or the units."""
    joint = scenario().chain.joint_names[robot.joint]
    asked = {
        "sign": (f"sign of {joint}", "its sign", "the other way"),
        "swapped": ("swapped?", "swapped or"),
        "dead": ("is its motor on, its encoder alive",),
        "silent": ("reads nan", "no finite number"),
        "arms": ("arms swapped",),
        "degrees": ("degrees",),
    }[robot.kind]
    told = any(word in words for word in asked)
    return told and (robot.kind in ("arms", "degrees") or joint in words)


@click.command()
@click.option("--robots", type=click.IntRange(0), default=100, help="Sound ones.")
def main(robots: int) -> None:
    """Check sound robots and each fault; exit code 1 with a false alarm or one that is missed."""
    bad = 0
    for seed in range(robots):
        if words := checked(BusRobot(seed)):
            bad += 1
            click.echo(f"false alarm {seed}: {words}")
    click.echo(f"{bad} false alarms on {robots} sound robots")
    missed = count = 0
    for k, (fault, joint) in enumerate(faults()):
        robot = BusRobot(1000 + k, fault, joint)
        words, count = checked(robot), count + 1
        if not names(robot, words):
            missed += 1
            click.echo(f"{fault} of joint {joint} is not named: {words!r}")
    click.echo(f"{missed} of {count} faults missed or named wrongly")
    raise SystemExit(bool(bad or missed))


if __name__ == "__main__":
    main()
