"""Scenario files: the shipped ones that can be loaded here, one in phases, and how to cut them."""

from __future__ import annotations

from dataclasses import replace
from importlib import metadata
from pathlib import Path

import pytest

from coopqp.scenario.loader import load, shipped
from coopqp.scenario.scenario import Scenario


def _installed(package: str) -> bool:
    try:
        metadata.distribution(package)
    except metadata.PackageNotFoundError:
        return False
    return True


HAS_ROBOTS = _installed("example-robot-data")
needs_robots = pytest.mark.skipif(not HAS_ROBOTS, reason="needs coopqp[robots]")

#: Names of the scenarios whose robots are there.
LOADABLE = [
    name
    for name, path in shipped().items()
    if HAS_ROBOTS or "example_robot:" not in path.read_text(encoding="utf-8")
]

#: The text of the simplest scenario.
GOOD = shipped()["point_on_point"].read_text(encoding="utf-8")

HEAD = """\
robot: nao_t14
grasp: {rigid: {}}
object: {size: [0.08, 0.19, 0.08], mass: 0.2}
start:
  right: [0.7, -0.2, 1.2, 0.9, 0.1]
  left: [0.7, 0.2, -1.2, -0.9, -0.1]
"""
#: Both carry; the left hand lets go and moves away; both carry again, held otherwise.
PHASES = """\
phases:
  - name: carry
    duration: 0.6
    tasks:
      - point_on_point: {name: reach, goal: [0.17, 0.01, 0.06], gain: 5, profile: {duration: 0.4}}
  - name: alone
    duration: 0.6
    released: [left]
    tasks:
      - point_on_point: {name: stay, goal: [0.17, 0.01, 0.06], gain: 5, profile: {duration: 0.1}}
      - posture: {name: away, goal: {left: [0.5, 0.5, -1.0, -0.7, 0.1]}, gain: 5,
                  tolerance: 0.01, profile: {duration: 0.4}}
  - name: again
    duration: 0.5
    tasks:
      - point_on_point: {name: up, goal: [0.17, 0.01, 0.07], gain: 5, profile: {duration: 0.3}}
"""
TAIL = "controllers: [qp]\ndt: 0.01\nkappa: 100\n"
NO_DRIFT = TAIL.replace("kappa: 100", "kappa: 0")


def write(folder: Path, text: str) -> Path:
    """The text as a scenario file."""
    path = folder / "scenario.yaml"
    path.write_text(text, encoding="utf-8")
    return path


def phased(folder: Path, text: str = HEAD + PHASES + TAIL) -> Scenario:
    """The scenario in phases, or another one, loaded from its file."""
    return load(write(folder, text))


def cut(scenario: Scenario, ticks: int) -> Scenario:
    """The same scenario, every phase cut to a few ticks."""
    short = ticks * scenario.dt
    phases = tuple(replace(phase, duration=short) for phase in scenario.phases)
    return replace(scenario, duration=short, phases=phases)


#: NAO's hands stand away from a box, take hold of it, lift it and let go.
TAKES_HOLD = """\
robot: nao_t14
grasp: {rigid: {}}
object: {size: [0.08, 0.19, 0.08], mass: 0.2, pose: {position: [0.16, 0.0, 0.05]}}
start:
  right: [0.7, -0.2, 1.2, 0.9, 0.1]
  left: [0.7, 0.2, -1.2, -0.9, -0.1]
phases:
  - name: take
    duration: 0.4
    released: [left, right]
    tasks:
      - posture: {name: in, goal: {left: [0.72, 0.22, -1.2, -0.9, -0.1]}, gain: 5,
                  tolerance: 0.01, profile: {duration: 0.2}}
  - name: lift
    duration: 0.5
    tasks:
      - point_on_point: {name: up, goal: [0.16, 0.0, 0.07], gain: 5, profile: {duration: 0.3}}
  - name: leave
    duration: 0.4
    released: [left, right]
    tasks:
      - relative_motion: {name: back, arm: right, goal: {position: [0.0, -0.02, 0.0]}, gain: 5,
                          tolerance: 0.2, tolerance_angle: 0.2, profile: {duration: 0.2}}
controllers: [qp, pseudoinverse]
dt: 0.01
kappa: 100
"""
