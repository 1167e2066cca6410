"""Motions of leaders that jump, freeze and go out of reach, followed: no tick stands still in vain.

``python -m tests.adapters.leaders --motions 100``: two leader arms, frame by frame through the
chunk filter to two SO-101, judged as its chunks are; and a leader's point, 60 times a second, which
the object in NAO's hands follows in the loop for robots. There a tick is frozen that commands no
motion though a linear program finds one inside all limits that brings the object nearer.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

import click
import numpy as np
from scipy.optimize import linprog

sys.path.insert(0, str(Path(__file__).parents[1]))  # what tests share

from online_loops import follows

from adapters.adversarial import FPS, Judged, Trial
from adapters.so101_oracle import START
from coopqp.adapters.motors import ARMS, GRIPPERS, KEYS
from coopqp.base.spec import Array
from coopqp.model.state import State
from coopqp.online.loop import OnlineLoop
from coopqp.online.simulated import SimulatedRobot

#: Of a motion [s]; an encoder's count [rad]; a hand's tremor [Hz], and its share of what it does.
LASTS, COUNT, TREMOR, SHAKES = 20.0, 2.0 * np.pi / 4096, 8.0, 0.02
#: Goals' spread: of joints [rad], of the point [m]; how many times as far where out of reach.
JOINTS, POINT, BEYOND = 0.35, 0.02, 5.0
#: A point is sent so often [Hz]; it stands still below these [rad/s], unless it is there [m];
#: motion nearer to it counts from so much on [m/s].
RATE, STILL, THERE, NEARER = 60.0, 1e-5, 2e-3, 1e-3


def led(rng: np.random.Generator, start: Array, spread: float, rate: float) -> Array:
    """What a leader says, (frames, n): from goal to goal with tremor, jumps, freezes, too far."""
    t = np.arange(round(LASTS * rate)) / rate
    goals = start + rng.normal(0.0, spread, (round(LASTS) + 2, len(start)))
    goals[0] = start
    k, s = t.astype(int), (t % 1.0)[:, None]
    x = goals[k] + s**3 * (10.0 - 15.0 * s + 6.0 * s**2) * (goals[k + 1] - goals[k])
    x += SHAKES * spread * np.sin(2.0 * np.pi * TREMOR * t)[:, None]
    for begins in rng.uniform(1.0, LASTS - 4.0, 2):  # out of reach
        too_far = (t > begins) & (t < begins + 3.0)
        x[too_far] = start + BEYOND * (x[too_far] - start)
    for begins in rng.uniform(1.0, LASTS - 2.0, 3):  # jumps there and back
        off = (t > begins) & (t < begins + rng.uniform(0.05, 2.0))
        x[off] += rng.normal(0.0, 3.0 * spread, len(start))
    for begins in rng.uniform(1.0, LASTS - 2.0, 3):  # freezes, and is elsewhere after it
        stands = (t > begins) & (t < begins + rng.uniform(0.2, 1.0))
        x[stands] = x[np.argmax(stands)]
    return np.asarray(x)


def arms(trial: Trial, seed: int) -> Judged:
    """Two leader arms through the filter, one frame at a time; every other pair holds a bar."""
    rng, held = np.random.default_rng(seed), bool(seed % 2)
    x = COUNT * np.round(led(rng, START, JOINTS, FPS) / COUNT)
    start, frames = np.zeros(len(KEYS)), np.zeros((len(x), len(KEYS)))
    start[ARMS], frames[:, ARMS] = np.degrees(START), np.degrees(x)
    start[GRIPPERS] = frames[:, GRIPPERS] = [10.0, 20.0] if held else [80.0, 50.0]
    return trial.judged("leaders", frames, start, held=held, at_once=1)


@dataclass
class Followed:
    """Ticks of a loop; those that stand still though the point is elsewhere, and could move.

    ``beyond`` break a limit.
    """

    ticks: int = 0
    still: int = 0
    frozen: int = 0
    beyond: int = 0


def point(seed: int) -> Followed:
    """A leader's point, which is not sent while it freezes."""
    rng, scenario = np.random.default_rng(seed), follows()
    loop = OnlineLoop(scenario, clock=None)
    robot = SimulatedRobot(loop)
    loop.begin(robot.read())
    sent = led(rng, loop.state.p_WO.copy(), POINT, RATE)
    chain, dt, found, last = loop.problem.chain, scenario.dt, Followed(), -1
    for k in range(round(LASTS / dt)):
        now = int(k * dt * RATE)
        news = now != last and (sent[now] != sent[last]).any()
        command = loop.tick(robot.read(), {"target": sent[now]} if news else {})
        robot.write(loop.setpoint, command.v)
        last, v, state = now, command.v, loop.state
        found.ticks += 1
        over = np.abs(v) > chain.velocity * (1.0 + 1e-9)
        out = (loop.setpoint < chain.lower - 1e-9) | (loop.setpoint > chain.upper + 1e-9)
        found.beyond += bool((over | out).any())
        if np.abs(v).max() < STILL and np.linalg.norm(sent[now] - state.p_WO) > THERE:
            found.still += 1
            found.frozen += _could_move(state, sent[now] - state.p_WO, dt)
    return found


def _could_move(state: State, way: Array, dt: float) -> bool:
    """Whether a motion inside all limits brings the object nearer along a way."""
    chain = state.chain
    least = np.maximum(-chain.velocity, np.minimum((chain.lower - state.q) / dt, 0.0))
    most = np.minimum(chain.velocity, np.maximum((chain.upper - state.q) / dt, 0.0))
    nearer = way @ state.J_task[:3] / np.linalg.norm(way)
    rows = state.J_loop
    best = linprog(-nearer, A_eq=rows, b_eq=np.zeros(len(rows)), bounds=np.stack([least, most]).T)
    return bool(-best.fun > NEARER)


@click.command()
@click.option("--motions", type=click.IntRange(1), default=100, help="Of each of the two kinds.")
@click.option("--seed", type=click.IntRange(0), default=0, help="Of the first; others count up.")
def main(motions: int, seed: int) -> None:
    """Follow leaders; exit code 1 with a frozen tick or a limit that breaks."""
    trial, seeds = Trial(), range(seed, seed + motions)
    pairs = [arms(trial, k) for k in seeds]
    frames, broken = round(motions * LASTS * FPS), sum(len(one.broken) for one in pairs)
    unnamed, changed, still, frozen = (
        sum(getattr(one, name) for one in pairs)
        for name in ("unnamed", "changed", "still", "frozen")
    )
    click.echo(f"two leader arms: {frames} frames, {changed} changed, {unnamed} without a name")
    click.echo(f"  {still} at rest though asked to move, {frozen} of them frozen; {broken} broken")
    bad = broken + unnamed + frozen
    points = [point(k) for k in seeds]
    sums = {name: sum(getattr(one, name) for one in points) for name in vars(Followed())}
    still, frozen, beyond = sums["still"], sums["frozen"], sums["beyond"]
    click.echo(f"a leader's point: {sums['ticks']} ticks, {beyond} beyond a limit")
    click.echo(f"  {still} at rest though it is elsewhere, {frozen} of them frozen")
    raise SystemExit(bool(bad or frozen or beyond))


if __name__ == "__main__":
    main()
