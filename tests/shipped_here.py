"""The shipped scenarios that can be loaded with what is installed."""

from __future__ import annotations

from importlib import metadata

from coopqp.scenario.loader import shipped


def _installed(package: str) -> bool:
    try:
        metadata.distribution(package)
    except metadata.PackageNotFoundError:
        return False
    return True


HAS_ROBOTS = _installed("example-robot-data")

#: Names of the scenarios whose robots are there.
LOADABLE = [
    name
    for name, path in shipped().items()
    if HAS_ROBOTS or "example_robot:" not in path.read_text(encoding="utf-8")
]
