"""Which arms hold the object how: robots and starts of the shipped scenarios, built once a process.

An arrangement is a scenario's closed chain, firm or with passive joints in the hands. Those whose
robots are not installed are left out, so the same seed draws the same on equal installations.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import cache, partial

import numpy as np

from coopqp.base.errors import MissingDependencyError
from coopqp.grasp import Grasp
from coopqp.grasps import Revolute, Rigid, Spherical
from coopqp.model.closed_chain import ClosedChain
from coopqp.robots.example_robot import robots
from coopqp.scenario.catalog import Catalog
from coopqp.scenario.loader import load
from coopqp.scenario.scenario import Scenario

#: Scenario of each robot.
OWN = {"nao_t14": "point_on_point", "planar_pair": "planar_pair", "yeo_4_5": "yeo_4_5"}
INSTALLED = {
    "two_pandas": "two_pandas", "baxter": "baxter_tray", "tiago": "tiago_torso",
    "three_ur": "three_ur", "panda_free": "two_pandas",
}  # fmt: skip
#: In this one the second arm does not hold the object, so that it can move relative to it.
RELEASED = {"panda_free": ("right/arm",)}
#: The planar pair's hinges are normal to its plane; a ball would take the plate out of it.
PLANAR = "planar_pair"
#: What each hand may be; "one" is the first hand alone.
GRASPS = ("rigid", "rigid", "revolute", "revolute one", "spherical one")
HINGE_POINT = (0.0, 0.0, -0.05)  # of the grasp in the shipped scenarios [m]


@cache
def names() -> tuple[str, ...]:
    """The arrangements that can be built here."""
    try:
        robots()
    except MissingDependencyError:
        return tuple(OWN)
    return (*OWN, *INSTALLED)


def grasps_of(name: str) -> tuple[str, ...]:
    """How the object may be held in an arrangement."""
    if name == "yeo_4_5":
        return ("its own",)
    if name in RELEASED:
        return ("rigid",)
    return tuple(g for g in GRASPS if name != PLANAR or not g.startswith("spherical"))


@cache
def chain(name: str, grasp: str) -> ClosedChain:
    """The closed chain of an arrangement, at its scenario's start."""
    own = _scenario({**OWN, **INSTALLED}[name])
    held = own if grasp == "its own" else _held(own, grasp)
    if name not in RELEASED:
        return held.chain
    return held.chain.handed_over(held.chain.q_start, RELEASED[name])


_scenario = cache(partial(load, catalog=Catalog()))


def _held(scenario: Scenario, grasp: str) -> Scenario:
    """The scenario with passive joints in the hands, and with its robot as it is built."""
    kind, _, only = grasp.partition(" ")
    first, *others = (arm.name for arm in scenario.robot_model.arms)
    kinds = {first: kind, **dict.fromkeys(others, "rigid" if only else kind)}
    held = replace(scenario, grasps={arm: _grasp(k, scenario, arm) for arm, k in kinds.items()})
    vars(held)["robot_model"] = scenario.robot_model
    return held


def _grasp(kind: str, scenario: Scenario, arm: str) -> Grasp:
    own = scenario.grasps[arm] if isinstance(scenario.grasps, Mapping) else scenario.grasps
    pose = own.object_in_hand
    if kind == "revolute" and scenario.name == PLANAR:
        return Revolute(object_in_hand=pose, axis=(0.0, 0.0, 1.0), lower=-1.0, upper=1.0)
    if kind == "revolute":
        return Revolute(object_in_hand=pose, point=HINGE_POINT)
    if kind == "spherical":
        return Spherical(object_in_hand=pose, cone=float(np.radians(60.0)))
    return Rigid(object_in_hand=pose)
