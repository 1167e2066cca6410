"""Whether a recorded run is one of the scenario that lies beside it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from coopqp.checked import Array
from coopqp.disturbance import Disturbance
from coopqp.plants import Kinematic
from coopqp.scenario.scenario import Scenario
from coopqp.study.explanation.goal import parts_of

#: What times may be off by, as a share of a tick, and joints that do as told [rad, m].
OF_A_TICK, ROUNDING = 0.01, 1e-9


def strange_tick(
    scenario: Scenario, t: Sequence[float], q: Array, v: Array
) -> tuple[int, str] | None:
    """The first tick that no run of the scenario can have had, and why; None if there is none.

    Where joints do exactly as told, q + v dt has to be the next q; servos and masses allow more.

    Args:
        scenario: as the controller holds it.
        t: of each instant, shape (T + 1,) [s].
        q: shape (T + 1, n) [rad, m].
        v: shape (T, n) [rad/s, m/s].
    """
    dt = scenario.dt
    off = np.abs(np.array(t) - dt * np.arange(len(t))) > OF_A_TICK * dt
    if off.any():
        k = int(off.argmax())
        return k, f"t: found {t[k]:g}, needs {k * dt:g} at a dt of {dt:g} s"
    if not isinstance(scenario.plant, Kinematic) or scenario.disturbance != Disturbance():
        return None
    told = np.vstack([scenario.chain.q_start, q[:-1] + dt * v])
    moved = np.abs(q - told) > ROUNDING * np.maximum(1.0, np.abs(q))
    moved[[first + 1 for first in scenario.first_ticks[1:]]] = False  # hands may have let go
    moved[1:][(q[1:] == q[:-1]).all(axis=1)] = False  # the plant broke down
    if not moved.any():
        return None
    k = int(moved.any(axis=1).argmax())
    joint = int(moved[k].argmax())
    name = scenario.chain.joint_names[joint]
    return k, f"q[{name}]: found {q[k, joint]:g}, but it was moved to {told[k, joint]:g}"


def units_of_parts(scenario: Scenario) -> dict[str, str]:
    """The unit of each part of each task, by its name in a trace."""
    return {
        f"{phase.name}.{part.name}" if scenario.phases else part.name: part.part.unit
        for phase in scenario.schedule
        for part in parts_of(phase.tasks, scenario.chain)
    }
