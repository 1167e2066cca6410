"""Which push and which friction lose the box of press_and_lift, and what cones cost a tick.

python benchmarks/forces.py              # the tables of docs/forces.md, some minutes
python benchmarks/forces.py --baselines  # formulas without and with a fixed squeeze, some minutes
python benchmarks/forces.py --speed      # the ratio alone
"""

from __future__ import annotations

import argparse
import itertools
from dataclasses import replace

import numpy as np

import coopqp
from coopqp.controller import Controller
from coopqp.controllers import PassiveGraspPid, TorqueQp, WrenchSplit
from coopqp.execution.rollout import rollout
from coopqp.grasps import Rigid
from coopqp.metrics.friction_margin import FrictionMargin
from coopqp.metrics.held import Held
from coopqp.metrics.slip_distance import SlipDistance
from coopqp.model.closed_chain import ClosedChain
from coopqp.plant import Disturbance, Push
from coopqp.plants import RigidBody
from coopqp.scenario.scenario import Scenario
from coopqp.trace import Trace

DOWN = (0.0, 0.0, -1.0)
PUSHES = (10.0, 15.0, 20.0, 25.0, 30.0, 35.0, 40.0)  # [N]
FRICTIONS = (0.9, 0.8, 0.7, 0.6, 0.5)  # times the modelled one
#: Equal shares of force and torque, virtual bodies of almost no inertia, the pseudoinverse.
SPLITS = ("walker", "virtual_inertia", "minimum_norm")
SQUEEZES = (0.0, 22.0, 25.0, 30.0, 41.6)  # [N]
TICKS = 300


def ran(scenario: Scenario, newtons: float, friction: float) -> Trace:
    push = Push(force=tuple(newtons * x for x in DOWN), start=3.5, duration=1.0)
    disturbed = Disturbance(push=push if newtons else None, friction=friction)
    return coopqp.run(replace(scenario, disturbance=disturbed), controller="torque_qp")


def line(what: str, trace: Trace) -> str:
    held, slip = Held().measure(trace), SlipDistance().measure(trace)
    margin = FrictionMargin().measure(trace)
    assert held is not None
    assert slip is not None
    lost = "held" if held["held"] else f"lost at {held['lost_at']:.2f} s"
    unused = "-" if margin is None else f"{max(0.0, 100 * margin):.0f}"  # none: it never pressed
    return f"| {what} | {lost} | {unused} | {1e3 * slip:.2f} |"


def tables() -> None:
    scenario = coopqp.load("press_and_lift")
    print("| push down [N] | | friction unused [%] | slip [mm] |\n|---|---|---|---|")
    for newtons in PUSHES:
        print(line(f"{newtons:g}", ran(scenario, newtons, 1.0)))
    print("\n| friction over the modelled | | friction unused [%] | slip [mm] |\n|---|---|---|---|")
    for friction in FRICTIONS:
        print(line(f"{friction:g}", ran(scenario, 10.0, friction)))


def baselines() -> None:
    """Formulas that know no friction, and the PID, beside the QP: in the story of the scenario."""
    scenario = coopqp.load("press_and_lift")
    print("| law | squeeze [N] | | friction unused [%] | slip [mm] |\n|---|---|---|---|---|")
    print(line("torque_qp | its own", coopqp.run(scenario, controller="torque_qp")))
    print(line("passive_grasp_pid | none", beside(scenario, PassiveGraspPid(level="kinematic"))))
    for split, squeeze in itertools.product(SPLITS, SQUEEZES):
        trace = beside(scenario, WrenchSplit(split=split, squeeze=squeeze))
        print(line(f"{split} | {squeeze:g}", trace))


def beside(scenario: Scenario, settings: Controller) -> Trace:
    return coopqp.run(replace(scenario, controllers={"beside": settings}), controller="beside")


def tick(chain: ClosedChain, scenario: Scenario) -> float:
    """Median time of a tick on rigid bodies [us]."""
    problem = scenario.problem(chain=chain)
    law, plant = TorqueQp().build(problem), RigidBody().build(problem, 0, Disturbance())
    trace = rollout(law, plant, TICKS, controller="torque_qp", solver="daqp")
    return float(np.median(trace.tick_us))


def speed() -> None:
    scenario = coopqp.load("press_and_lift")
    pads = scenario.chain
    firm = ClosedChain(replace(pads.hold, grasps={name: Rigid() for name in pads.grasps}))
    times = np.array([(tick(pads, scenario), tick(firm, scenario)) for _ in range(5)])
    ratio = np.median(times[:, 0] / times[:, 1])
    print(f"a tick of torque_qp with pads takes {ratio:.2f} times one with firm grasps")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--speed", action="store_true")
    parser.add_argument("--baselines", action="store_true")
    asked = parser.parse_args()
    if asked.baselines:
        baselines()
        return
    if not asked.speed:
        tables()
    speed()


if __name__ == "__main__":
    main()
