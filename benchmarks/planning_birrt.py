"""The shelves beside the planner of those who published them, its inverse kinematics compiled.

    python benchmarks/planning_birrt.py --data shelves.json --scene CLONE --drake PYTHON

CLONE is a checkout of cohnt/constrained-bimanual-planning-example (Cohn et al., ICRA 2024): its
IK-BiRRT and shortcuts run as they are, with Drake's collision checker, in a Python that has drake,
networkx, scipy and tqdm. The follower's joints come from planning_birrt.cpp, which is compared with
the checkout's Python first; as published, grippers do not count there, and they do for coopqp,
which also looks at its path a second time. Six ordered pairs, in turns, CPU seconds.
"""

from __future__ import annotations

import argparse
import itertools
import json
import os
import re
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

GRASP, BASE = np.array([0.0, 0.0, 0.6]), np.array([0.0, 0.765, 0.0])
GC, TURN = np.array([1.0, 1.0, -1.0]), np.deg2rad(180 - 2 * 68.0)
ELBOWS = {"bottom": 1.45, "middle": 1.45, "top": 2.41}  # the follower's, [rad]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    for name in ("data", "scene", "drake"):
        parser.add_argument(f"--{name}", type=Path, required=True)
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--out", type=Path, default=Path("out/planning"))
    asked = parser.parse_args()
    from planning import load_scene

    from coopqp.planning.closed_space import Budget
    from coopqp.planning.plan import Planner

    asked.out.mkdir(parents=True, exist_ok=True)
    data = json.loads(asked.data.read_text())
    named = {name: np.array(c["q"]) for name, c in data["configurations"].items()}
    scene = load_scene(data, asked.scene, asked.out, named["bottom"], named["top"])
    theirs = subprocess.Popen(
        [asked.drake, __file__, "--worker", asked.scene.resolve()],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True,
    )  # fmt: skip
    assert theirs.stdin
    assert theirs.stdout
    print("largest difference of the joints, compiled and not:", theirs.stdout.readline().strip())
    rows: dict[str, list[tuple[float, float]]] = {"IK-BiRRT": [], "coopqp": []}
    for seed, (a, b) in itertools.product(range(asked.seeds), itertools.permutations(named, 2)):
        ends = [[*named[end][:7], ELBOWS[end]] for end in (a, b)]
        theirs.stdin.write(json.dumps([seed, *ends]) + "\n")
        theirs.stdin.flush()
        rows["IK-BiRRT"].append(tuple(json.loads(theirs.stdout.readline())))
        begun = time.process_time()
        problem = scene.problem(chain=scene.chain.moved(named[a]))
        found = Planner(problem, scene.duration).path(Budget(seed=seed), goals=named[b])
        spent = time.process_time() - begun
        rows["coopqp"].append((spent, found.length if found.success else np.nan))
    for name, row in rows.items():
        spent, length = np.array(row).T
        half, p95 = np.percentile(spent, [50, 95])
        solved = np.isfinite(length)
        print(
            f"{name}: solved {solved.sum()} of {len(row)}, CPU {half:.3f} / {p95:.3f} s, "
            f"length {np.median(length[solved]):.2f} rad"
        )
    old, new = (np.array(row)[:, 0] for row in rows.values())
    print(f"IK-BiRRT takes {np.median(old) / np.median(new):.1f} times as long in the median")


class Follower:
    """Both arms' joints from the leader's and the follower's elbow angle, (8,)."""

    def __init__(self) -> None:
        import ctypes

        text = Path(__file__).with_suffix(".cpp")
        built = Path(tempfile.mkdtemp()) / "follower.so"
        how = ["c++", "-std=c++17", "-O2", "-shared", "-fPIC"]
        subprocess.run([*how, text, "-o", built], check=True)
        self._follow = ctypes.CDLL(str(built)).follow
        self._follow.argtypes = [ctypes.c_void_p] * 7
        c, s = np.cos(TURN), np.sin(TURN)
        self.turn = np.diag([-1.0, 1.0, -1.0]) @ [[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]
        self._lead, self.q, self.cosines = np.zeros(8), np.zeros(14), np.zeros(4)
        given = (self._lead, self.turn, GRASP, BASE, GC, self.q[7:], self.cosines)
        self._at = [array.ctypes.data for array in given]

    def __call__(self, lead: np.ndarray) -> np.ndarray:
        self._lead[:] = lead
        self.q[:7] = lead[:7]
        self._follow(*self._at)
        return self.q


def worker(clone: Path) -> None:
    """Answer each line [seed, start, goal] with [CPU s, length]; with the checkout's modules."""
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # what their modules print
    sys.path.insert(0, str(clone))
    from src.iiwa_analytic_ik import Analytic_IK_7DoF, iiwa_limits_lower, iiwa_limits_upper
    from src.rrt import BiRRT, RRTOptions
    from src.shortcut import shortcut

    follower, rng = Follower(), np.random.default_rng(0)
    lower = np.append(iiwa_limits_lower, 0.0)
    upper = np.append(iiwa_limits_upper, 2.0 * np.pi)
    leads = rng.uniform(lower, upper, (200, 8))
    print(_apart(follower, Analytic_IK_7DoF(), leads), file=answers, flush=True)
    free = _free(clone)

    def valid(lead: np.ndarray) -> bool:
        q = follower(lead)
        if (np.abs(follower.cosines) > 1.0).any() or (np.abs(q[[8, 10, 12]]) < 1e-2).any():
            return False
        return bool((q[7:] >= lower[:7]).all() and (q[7:] <= upper[:7]).all() and free(q))

    for line in sys.stdin:
        seed, *ends = json.loads(line)
        np.random.seed(seed)  # noqa: NPY002 - theirs draws from it
        options = RRTOptions(0.2, 1e-2, 1e4, 1e6, 0.01, timeout=60.0)  # their notebook's
        begun = time.process_time()
        planner = BiRRT(lambda: np.random.uniform(lower, upper), valid)  # noqa: NPY002
        path = planner.plan(*map(np.array, ends), options)
        length = float("nan")
        if path:
            path = shortcut(path, valid, check_size=1e-2)
            spent = time.process_time() - begun
            legs, shares = itertools.pairwise(path), np.linspace(0.0, 1.0, 50)
            q = np.array([follower(a + x * (b - a)).copy() for a, b in legs for x in shares])
            length = float(np.linalg.norm(np.diff(q, axis=0), axis=1).sum())
        else:
            spent = time.process_time() - begun
        print(json.dumps([spent, length]), file=answers, flush=True)


def _apart(follower: Follower, theirs: Any, leads: np.ndarray) -> float:
    """The largest difference from the checkout's own, where these arms reach [rad]."""
    from pydrake.all import RigidTransform

    worst = 0.0
    for lead in leads:
        X = theirs.FK(lead[:7])
        there = np.eye(4)
        there[:3, :3] = X[:3, :3] @ follower.turn
        there[:3, 3] = X[:3, 3] + X[:3, :3] @ GRASP - BASE
        q = follower(lead)[7:].copy()
        if (np.abs(follower.cosines) < 1.0 - 1e-3).all():
            apart = np.abs(q - theirs.IK(RigidTransform(there), GC, lead[7]))
            worst = max(worst, float(apart.max()))
    return worst


def _free(clone: Path) -> Any:
    """Drake's check of a configuration, with the arms as robots, as published."""
    from pydrake.all import (
        CollisionCheckerParams,
        LoadModelDirectives,
        Parser,
        ProcessModelDirectives,
        RobotDiagramBuilder,
        SceneGraphCollisionChecker,
    )

    root = Path(tempfile.mkdtemp())
    for path in (clone / "models").rglob(
        "*"
    ):  # without what is drawn, which is not in the checkout
        to = root / path.relative_to(clone)
        if path.is_file():
            to.parent.mkdir(parents=True, exist_ok=True)
            if path.suffix in (".urdf", ".sdf"):
                to.write_text(re.sub(r"<visual.*?</visual>", "", path.read_text(), flags=re.DOTALL))
            else:
                to.symlink_to(path)
    builder = RobotDiagramBuilder(time_step=0.0)
    plant = builder.plant()
    parser = Parser(plant)
    parser.package_map().Add("bimanual", str(root))
    shelves = LoadModelDirectives(str(root / "models/old_shelves.dmd.yaml"))
    ProcessModelDirectives(shelves, parser)
    params = CollisionCheckerParams()
    arms = [plant.GetModelInstanceByName(f"iiwa_{side}") for side in ("left", "right")]
    params.robot_model_instances = arms
    plant.Finalize()
    params.model = builder.Build()
    params.edge_step_size = 0.01
    return SceneGraphCollisionChecker(params).CheckConfigCollisionFree


if __name__ == "__main__":
    if "--worker" in sys.argv:
        worker(Path(sys.argv[2]))
    else:
        main()
