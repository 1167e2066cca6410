"""Write the velocities of a folder of scenarios with their first task made hard or scaled.

``python velocities.py OUT.npz FOLDER TICKS [ERROR_DAMPING]``, for :mod:`tests.qp_law.same_as`,
which runs it once for each checkout. It must run on both, so it uses only what both have.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

from coopqp.controller import ControlProblem
from coopqp.controllers import QPController
from coopqp.scenario.loader import load
from coopqp.solver import Status

MODES, ENGINES = ("as it is", "hard", "scaled"), ("python", "auto")


def changed(problem: ControlProblem, mode: str) -> ControlProblem | None:
    """The problem with its first task in another mode; None where that asks for a force."""
    if mode == "as it is":
        return problem
    first, *others = problem.tasks
    if first.of_forces or first.impedance is not None:
        return None
    changed_first = replace(first, mode=mode)  # type: ignore[arg-type]
    return replace(problem, tasks=(changed_first, *others))


def drive(
    file: Path, mode: str, engine: str, most: int, changes: dict[str, float]
) -> tuple[np.ndarray, np.ndarray] | None:
    """Velocities and which ticks are OPTIMAL, until a tick is not; None where there is no QP."""
    scenario = load(file)
    laws = [kind for kind in scenario.controllers.values() if isinstance(kind, QPController)]
    if not laws:
        return None
    problem = changed(scenario.problem(), mode)
    if problem is None:
        return None
    law = replace(laws[0], engine=engine, **changes).build(problem)  # type: ignore[arg-type]
    made = law.run(law.start(), min(scenario.schedule[0].ticks(scenario.dt), most))
    return made.v, np.array([causes == (Status.OPTIMAL,) for causes in made.causes])


def main(out: str, folder: str, most: str, *error_damping: str) -> None:
    found, changes = {}, dict(zip(("error_damping",), map(float, error_damping), strict=False))
    for file in sorted(Path(folder).glob("*.yaml")):
        for mode in MODES:
            for engine in ENGINES:
                run = f"{file.stem}|{mode}|{engine}"
                try:
                    ran = drive(file, mode, engine, int(most), changes)
                except Exception as error:  # noqa: BLE001 - told, and compared by who asks
                    found[f"{run}|raised"] = np.array(str(error))
                    continue
                if ran is not None:
                    found[f"{run}|v"], found[f"{run}|optimal"] = ran
    np.savez(Path(out), **found)  # type: ignore[arg-type]


if __name__ == "__main__":
    main(*sys.argv[1:])
