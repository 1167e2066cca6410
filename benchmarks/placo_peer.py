"""The same job by PlaCo, in an environment of its own (placo_env.sh): it pins another pinocchio.

python placo_peer.py JOBS.json

For each line on standard input, the name of a job and a pause before each tick [s], it runs one
motion and answers with the median of its ticks [us] and how far from the last target it ends [m].
It ends with its input.
"""

import json
import sys
from collections.abc import Callable
from pathlib import Path
from statistics import median
from time import perf_counter_ns, sleep
from typing import Any

import numpy as np
import placo


def prepared(job: dict[str, Any]) -> Callable[[float], tuple[float, float]]:
    """The motion of a job."""
    robot = placo.RobotWrapper("arms", placo.Flags.ignore_collisions, job["urdf"])
    targets = np.array(job["targets"])

    def motion(pause: float) -> tuple[float, float]:
        robot.reset()
        for name, q in zip(job["joints"], job["q"], strict=True):
            robot.set_joint(name, q)
        robot.update_kinematics()
        solver = placo.KinematicsSolver(robot)
        solver.dt = job["dt"]
        solver.mask_fbase(True)
        solver.enable_joint_limits(True)
        solver.enable_velocity_limits(True)
        start = robot.get_T_world_frame("object0")
        reach = solver.add_position_task("object0", start[:3, 3])
        reach.configure("reach", "soft", 1.0)
        for i in range(1, job["arms"]):
            apart = robot.get_T_a_b("object0", f"object{i}")
            loop = solver.add_relative_frame_task("object0", f"object{i}", apart)
            loop.configure(f"loop{i}", "hard", 1.0, 1.0)
        solver.add_regularization_task(1e-6)

        def step(k: int) -> None:
            reach.target_world = targets[k]
            solver.solve(True)
            robot.update_kinematics()

        times = []
        for k in range(len(targets)):
            if pause:
                sleep(pause)
            before = perf_counter_ns()
            step(k)
            times.append(perf_counter_ns() - before)
        end = robot.get_T_world_frame("object0")[:3, 3]
        return 1e-3 * median(times), float(np.linalg.norm(end - targets[-1]))

    return motion


def main() -> None:
    """Answer until there is no more."""
    jobs = json.loads(Path(sys.argv[1]).read_text(encoding="utf-8"))
    motions = {job["name"]: prepared(job) for job in jobs}
    for line in sys.stdin:
        name, pause = line.rsplit(maxsplit=1)
        us, missed = motions[name](float(pause))
        print("placo", us, missed, flush=True)


if __name__ == "__main__":
    main()
