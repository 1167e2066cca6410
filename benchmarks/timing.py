"""The fastest motions along random closed paths: python benchmarks/timing.py [--paths 5].

Five paths each on NAO, two Pandas, Baxter and two SO-101, from seeds, none chosen: four way-points
0.6 rad apart. The wrench between the hands is free (without a box, so that sets can be compared),
or follows the motors' weights (least sum of (tau / tau_max)^2, the weighted pseudoinverse), or is
zero (equal sharing). All three keep the same rows on the same grid, before limits are divided by
what is exceeded between places. Then the whole call, with the default box: share of the time with
an active limit, largest use of any limit at ten times the resolution by rows made there, closure at
1,000 random places, and CPU time. With --toppra PYTHON, an interpreter that has toppra, its timing
of the weighted sharing's rows stands beside ours. With --follow, torque_qp follows five of them in
MuJoCo, and the PID one, as ``reference: {plan: timed.csv}`` has it, with the mass as told and 20 %
off. Limits in space are left out, since random paths do not know them.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import median

import numpy as np

from coopqp.base.spec import Array
from coopqp.base.table import csv_text
from coopqp.controller import Controller
from coopqp.controllers import PassiveGraspPid, TorqueQp
from coopqp.execution.controller_run import run
from coopqp.grasp import SAFETY
from coopqp.limits import SelfCollision
from coopqp.planning.closed_path import Loops
from coopqp.planning.forward_backward_pass import Passes, Share, Stuck
from coopqp.planning.path_constraints import RowMaker, Rows
from coopqp.planning.time_along import TimedPath, time_along
from coopqp.plant import Disturbance
from coopqp.plants import Mujoco
from coopqp.scenario.loader import load
from coopqp.scenario.planned import PlanReference, following
from coopqp.scenario.scenario import Scenario
from coopqp.trace import Trace

sys.path.append(str(Path(__file__).resolve().parents[1] / "tests"))
from random_ways import random_way

#: Scenarios, and the share of the torque that is planned with: with all of it speeds bind alone.
ROBOTS = {"point_on_point": 1.0, "two_pandas": 0.4, "baxter_tray": 1.0, "two_so101": 0.15}
#: Scenarios, shares of the torque and seeds that are followed, and by whom.
FOLLOWED = (
    ("point_on_point", 0.8, 0, TorqueQp()), ("point_on_point", 0.8, 1, TorqueQp()),
    ("two_pandas", 0.4, 0, TorqueQp()), ("two_pandas", 0.4, 1, TorqueQp()),
    ("two_so101", 0.15, 0, TorqueQp()), ("passive_grasp_pose", 0.8, 0, TorqueQp()),
    ("passive_grasp_pose", 0.8, 0, PassiveGraspPid()),
)  # fmt: skip
#: Control period and the time after the path's end [s].
DT, REST = 0.002, 0.5
#: As good as no box [N].
UNBOUND = 1e4
FINER = 10
TOPPRA = Path(__file__).with_name("timing_toppra.py")


@dataclass(frozen=True)
class Result:
    """One path; durations [s] are NaN where a sharing has none."""

    robot: str
    seed: int
    free: float
    weighted: float
    equal: float
    toppra: float
    whole: TimedPath
    exceeded: float
    gap: float
    seconds: float


def seconds(rows: Rows) -> float:
    """Duration of one pair of passes; NaN where there is none."""
    try:
        found = Passes(rows, np.ones(rows.R[2].shape), np.ones(len(rows.s))).profile()
    except Stuck:
        return np.nan
    return float(found.t[-1])


def shared(rows: Rows, weighted: bool) -> Rows:
    """The rows with the wrench that a fixed sharing has: a linear function of u, x and rest."""
    nothing = rows.Rl[:, :, :0]
    if not weighted:
        return replace(rows, Rl=nothing)
    size = rows.maker.size
    motors = np.flatnonzero((rows.maker.kinds == "torque") & (size > 0.0))
    R = rows.Rl[:, motors] / size[motors, None]
    to_wrench = -np.linalg.pinv(R)
    made = []
    for part in rows.R:
        scaled = part[:, motors] / size[motors]
        lam = (to_wrench @ scaled[:, :, None])[..., 0]
        made.append(part + (rows.Rl @ lam[:, :, None])[..., 0])
    return replace(rows, R=np.array(made), Rl=nothing)


def exceeded(found: TimedPath) -> float:
    """Largest use of a limit at the finer places, by rows that are made there."""
    part, way = np.linspace(0.0, 1.0, FINER + 1), found.profile
    s = (way.s[:-1, None] + np.diff(way.s)[:, None] * part).ravel()
    rows, u = found.maker.at(s), np.repeat(way.u, len(part))
    x = np.maximum((1.0 - part) * way.x[:-1, None] + part * way.x[1:, None], 0.0).ravel()
    speed = np.abs(rows.rates) * np.sqrt(x)[:, None] / found.maker.speeds
    share = Share(rows)
    force = max(share.of(i, u[i], x[i])[0] for i in range(len(s)))
    quick = found.maker.kinds == "acceleration"
    a = np.abs(rows.values(u, x)[:, quick]) / found.maker.size[quick]
    return float(max(speed.max(), force, a.max(initial=0.0)))


def by_toppra(rows: Rows, python: str) -> float:
    """Duration by toppra with the same rows."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "rows.npz"
        lo, up = rows.lo_up(np.ones(rows.R[2].shape))
        np.savez(file, s=rows.s, a=rows.R[0], b=rows.R[1], lo=lo, up=up, x_max=rows.x_max)
        done = subprocess.run(
            [python, str(TOPPRA), str(file)], check=True, capture_output=True, text=True
        )
        return float(done.stdout.split()[-1])


def measured(robot: str, torque: float, seed: int, python: str) -> Result:
    scenario = load(robot)
    way = random_way(scenario.chain, seed)
    whole = time_along(way, scenario, torque=torque)
    begun = time.process_time()
    time_along(way, scenario, torque=torque)
    took = time.process_time() - begun
    bounds = replace(whole.maker.bounds, wrench=np.full(6, UNBOUND))
    maker = RowMaker(whole.path, bounds)
    rows = maker.at(whole.profile.s)
    free = seconds(rows)
    weighted = shared(rows, weighted=True)
    places = np.random.default_rng(seed).uniform(0.0, whole.path.length, 1000)
    gaps = Loops(scenario.chain).errors(whole.path.spline(places))
    return Result(
        robot, seed, free, seconds(weighted),
        seconds(shared(rows, weighted=False)),
        by_toppra(weighted, python) if python else np.nan,
        whole, exceeded(whole), float(gaps[:, 0].max()), took,
    )  # fmt: skip


def tracked(
    scenario: Scenario, found: TimedPath, disturbance: Disturbance, law: Controller
) -> tuple[Trace, Array]:
    """A law's run along a timed path in MuJoCo, and the largest joint error by tick of the way."""
    limits = tuple(limit for limit in scenario.limits if not isinstance(limit, SelfCollision))
    other = scenario.changed(
        secondary=(), plant=Mujoco(), dt=DT, kappa=100.0, limits=limits, duration=DT,
        controllers={law.name: law}, disturbance=disturbance,
    )  # fmt: skip
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "timed.csv"
        file.write_text(csv_text(found.table(DT)), encoding="utf-8")
        led = following(other, PlanReference(plan=file, late=REST)).held_by(law.name)
    led = led.changed(phases=led.phases[:1])
    trace = run(led, controller=law.name, timed=False)
    ticks = led.schedule[0].ticks(DT)
    planned = [found.path.spline(found.where(k * DT)[0]) for k in range(ticks)]
    return trace, np.abs(trace.measured[:ticks] - np.array(planned)).max(axis=1)


def followed(rise: float) -> Iterator[str]:
    """What laws make of timed paths in MuJoCo, and of one with a box between pads."""
    for robot, torque, seed, law in FOLLOWED:
        scenario = load(robot)
        way = random_way(scenario.chain, seed)
        found = time_along(way, scenario, torque=torque, rise=rise)
        moments = [found.at(float(t)) for t in np.linspace(0.0, found.duration, 50)]
        planned = max(np.abs(now.internal[:, :3]).max() for now in moments)
        for mass in (1.0, 1.2, 0.8):
            trace, off = tracked(scenario, found, Disturbance(object_mass=mass), law)
            motors = np.setdiff1d(np.arange(scenario.chain.n), scenario.chain.passive)
            tau = np.abs(trace.signals["tau"])[: len(off), motors]
            used = (tau / scenario.chain.model.effortLimit[motors]).max(axis=1)
            force = np.abs(trace.signals["internal_wrench"][: len(off)]).reshape(-1, 6)[:, :3].max()
            yield (
                f"{law.name} {robot} {seed}, {mass:g} of the mass, {found.duration:.3f} s: error "
                f"{1e3 * off.max():.1f} mrad, at the end {1e3 * off[-1]:.2f}; motors up to "
                f"{100.0 * used.max():.0f} %, {100.0 * np.quantile(used, 0.95):.0f} in 95 % of the "
                f"time (planned {100.0 * torque:.0f}), internal force "
                f"{force:.1f} N (planned {planned:.1f}); {len(trace.failures)} failures"
            )
    scenario = load("press_and_lift")
    way = random_way(scenario.chain, 1, count=3, step=0.4)
    for safety in (SAFETY, 1.0):
        found = time_along(way, scenario, safety=safety, rise=rise)
        for friction in (1.0, 0.7, 0.6):
            law = TorqueQp(safety=safety)
            trace, _ = tracked(scenario, found, Disturbance(friction=friction), law)
            slip = np.nanmax(trace.signals["slip"])
            end = trace.failures[0].note if trace.failures else "not lost by the end"
            yield (
                f"press_and_lift, safety {safety:g}, {friction:g} of the friction, "
                f"{found.duration:.3f} s: slips by {1e3 * slip:.1f} mm; {end}"
            )


def lines(results: list[Result]) -> Iterator[str]:
    names = "path", "free", "weighted", "toppra", "/weighted", "/equal", "call", "active", "at 10x"
    yield f"{names[0]:17}" + "".join(f"{name:>10}" for name in (*names[1:], "gap [mm]", "CPU [ms]"))
    for r in results:
        active = 1.0 - r.whole.shares.get("nothing", 0.0)
        yield (
            f"{r.robot + ' ' + str(r.seed):17}{r.free:10.4f}{r.weighted:10.4f}{r.toppra:10.4f}"
            f"{r.free / r.weighted:10.4f}{r.free / r.equal:10.4f}{r.whole.duration:10.4f}"
            f"{active:10.3f}{r.exceeded:10.5f}{1e3 * r.gap:10.1e}{1e3 * r.seconds:10.0f}"
        )
    for robot in dict.fromkeys(r.robot for r in results):
        own = [r for r in results if r.robot == robot]
        kinds: dict[str, float] = {}
        for r in own:
            for name, share in r.whole.shares.items():
                kind = name.partition(" ")[0]
                kinds[kind] = kinds.get(kind, 0.0) + share / len(own)
        binds = ", ".join(f"{kind} {100.0 * share:.0f} %" for kind, share in kinds.items())
        yield f"{robot}: CPU {1e3 * median(r.seconds for r in own):.0f} ms; of the time {binds}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--paths", type=int, default=5, help="a robot")
    parser.add_argument("--toppra", default="", help="interpreter that has toppra")
    parser.add_argument("--follow", action="store_true", help="in MuJoCo instead")
    parser.add_argument("--rise", type=float, default=0.0, help="of accelerations [s], to follow")
    options = parser.parse_args()
    if options.follow:
        print("\n".join(followed(options.rise)))
        return
    results = [
        measured(robot, torque, seed, options.toppra)
        for robot, torque in ROBOTS.items()
        for seed in range(options.paths)
    ]
    print("\n".join(lines(results)))


if __name__ == "__main__":
    main()
