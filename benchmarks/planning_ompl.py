"""OMPL's Atlas and Projected spaces on the shelves, with the closure and the bodies of coopqp.

    python benchmarks/planning_ompl.py --data shelves.json --scene CLONE [--seeds 10]

Needs ompl 2.0.1 beside coopqp, best in an environment of its own. Both spaces get the kept rows of
``ClosedChain.loop_error`` and ``loop_jacobian`` and what ``ClosedSpace.is_free`` says, the compiled
check of the planner; RRT-Connect searches. What a path costs is what ends it: no shortcut, no
second look. Each named pair is asked once a seed; a space that is not done after --seconds of CPU
time has failed. OMPL seeds its random numbers once a process, so that each pair runs in its own.
"""

from __future__ import annotations

import argparse
import itertools
import json
import multiprocessing
import time
from pathlib import Path
from typing import Any

import numpy as np
from planning import load_scene

from coopqp.planning.closed_space import ClosedSpace

#: Steps and the atlas, each the best of nine and eight settings on two seeds in four seconds.
SETTINGS: dict[str, dict[str, float]] = {
    "Atlas": {
        "delta": 0.1, "lambda": 2.0, "epsilon": 0.2, "rho": 1.0, "alpha": 0.39, "range": 1.5,
    },
    "Projected": {"delta": 0.3, "lambda": 5.0, "range": 3.0},
}  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, required=True, help="shelves.json")
    parser.add_argument("--scene", type=Path, required=True, help="the checkout with the meshes")
    parser.add_argument("--out", type=Path, default=Path("out/planning"))
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--seconds", type=float, default=8.0)
    parser.add_argument("--spaces", nargs="*", default=("Atlas", "Projected"))
    parser.add_argument("--set", nargs="*", default=(), metavar="NAME=VALUE", help="settings")
    asked = parser.parse_args()
    asked.out.mkdir(parents=True, exist_ok=True)
    for kind in asked.spaces:
        pairs = (given.partition("=") for given in asked.set)
        SETTINGS[kind].update((name, float(x)) for name, _, x in pairs)
    data = json.loads(asked.data.read_text())
    named = {name: np.array(c["q"]) for name, c in data["configurations"].items()}
    scene = load_scene(data, asked.scene, asked.out, named["bottom"], named["top"])
    for kind in asked.spaces:
        found = []
        for seed, (a, b) in itertools.product(
            range(1, asked.seeds + 1), itertools.permutations(named, 2)
        ):
            pipe, end = multiprocessing.Pipe()
            job = multiprocessing.Process(
                target=_solve, args=(end, scene, kind, named[a], named[b], seed, asked.seconds)
            )
            job.start()
            end.close()
            try:
                found.append(pipe.recv())
            except EOFError:
                found.append((False, np.nan, np.nan, 0, np.nan))
            job.join()
            solved, cpu, length, checks, opened = found[-1]
            print(
                f"  {kind} {a}->{b} {seed}: {'solved' if solved else 'not'}, {cpu:.2f} CPU s, "
                f"{length:.1f} rad, {checks} checks, loops open by {1e3 * opened:.2g} mm",
                flush=True,
            )
        good = [row for row in found if row[0]]
        half, p95 = np.percentile([row[1] for row in good or [(0, np.nan)]], [50, 95])
        print(f"{kind}: {len(good)} of {len(found)}, {half:.2f} / {p95:.2f} CPU s", flush=True)


def _solve(  # noqa: C901 - what OMPL asks for
    end: Any, scene: Any, kind: str, start: Any, goal: Any, seed: int, seconds: float
) -> None:
    from ompl import base as ob
    from ompl import geometric as og
    from ompl import util

    settings = SETTINGS[kind]
    util.RNG.setSeed(seed)
    util.setLogLevel(util.LogLevel.LOG_NONE)
    problem = scene.problem(chain=scene.chain.moved(start))
    chain, checks = problem.chain, 0
    closed = ClosedSpace(problem)
    kept = list(chain.loops.kept)

    class Closure(ob.Constraint):
        def __init__(self) -> None:
            super().__init__(chain.n, len(kept), 1e-6)

        def function(self, x: Any, out: Any) -> None:
            out[:] = chain.loop_error(np.array(x))[kept]

        def jacobian(self, x: Any, out: Any) -> None:
            out[:] = chain.loop_jacobian(np.array(x))[kept]

        def project(self, x: Any) -> bool:
            row = np.array(x)[None]
            found = bool(closed.project(row)[0])
            x[:] = row[0]
            return found

    ambient, bounds = ob.RealVectorStateSpace(chain.n), ob.RealVectorBounds(chain.n)
    for j in range(chain.n):
        bounds.setLow(j, float(closed.lower[j]))
        bounds.setHigh(j, float(closed.upper[j]))
    ambient.setBounds(bounds)
    space = getattr(ob, f"{kind}StateSpace")(ambient, Closure())
    information = ob.ConstrainedSpaceInformation(space)
    setup = og.SimpleSetup(information)
    space.setDelta(settings["delta"])
    space.setLambda(settings["lambda"])
    if kind == "Atlas":
        space.setEpsilon(settings["epsilon"])
        space.setRho(settings["rho"])
        space.setAlpha(settings["alpha"])

    def free(state: Any) -> bool:
        nonlocal checks
        checks += 1
        return bool(closed.is_free(_numbers(state, chain.n)[None])[0])

    setup.setStateValidityChecker(free)
    ends = []
    for q in (start, goal):
        state = space.allocState()
        state.copy(q.tolist())
        if kind == "Atlas":
            space.anchorChart(state)
        ends.append(state)
    setup.setStartAndGoalStates(*ends)
    planner = og.RRTConnect(information)
    planner.setRange(settings["range"])
    setup.setPlanner(planner)
    begun = time.process_time()
    late = ob.PlannerTerminationCondition(lambda: time.process_time() - begun > seconds)
    solved = bool(setup.solve(late)) and setup.haveExactSolutionPath()
    cpu, length, opened = time.process_time() - begun, np.nan, np.nan
    if solved:
        path = setup.getSolutionPath()
        path.interpolate()
        length = path.length()
        q = np.array([_numbers(state, chain.n) for state in path.getStates()])
        middle = 0.5 * (q[1:] + q[:-1])
        opened = max(np.abs(chain.loop_error(row)).max() for row in middle)
    end.send((solved, cpu, length, checks, opened))


def _numbers(state: Any, n: int) -> Any:
    return np.array([state[j] for j in range(n)])


if __name__ == "__main__":
    main()
