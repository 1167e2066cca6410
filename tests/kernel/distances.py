"""The kernel's distances against coal's: ``python -m tests.kernel.distances --poses 1000``.

Of every shipped robot with bodies all pairs at random poses, as the kernel and as coal measure
them; then adverse cases that are apart: boxes, capsules, balls, cylinders, ellipsoids, hulls and
prisms, 1 nm to 1 m from each other, with faces that are parallel but for 1e-12 to 1e-3 rad. Of
these the nearest points have to lie in the bodies, and the plane between them has to separate the
bodies by the distance, both looked at without what the kernel does. All variants of the kernel have
to give equal bits. Exit code 1 where

- a distance is off by 10 um or more;
- bodies are told to be in each other that are apart, or apart that are deep in each other;
- a distance passes as known that is not, to 1e-7 m.
"""

from __future__ import annotations

import argparse
import itertools
import sys
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any
from unittest.mock import patch

import click
import numpy as np
import pinocchio as pin

sys.path.insert(0, str(Path(__file__).parents[1]))  # what tests share

from variants import variants
from watched_bodies import robots

from coopqp.base.spec import Array
from coopqp.kernel import native
from coopqp.kernel.free_space import FreeSpace, Told
from coopqp.limit import DistanceBounds
from coopqp.limits import SelfCollision
from coopqp.limits._bodies import _hull_of, of_capsule, of_shape
from coopqp.limits._keep_apart import distances_along
from coopqp.model.closed_chain import ClosedChain
from coopqp.robot import Capsule, Convex, Form, Shape

KNOWN = 1e-7  # two bounds of a distance differ by no more where it is known [m], as in apart.hpp
OFF = 1e-5  # from coal's distance [m]
TOUCHES = 5e-6  # what coal calls so deep may be apart [m]
TILTS = (0.0, 1e-12, 1e-9, 1e-6, 1e-3, None)  # of parallel faces [rad]; None: any
AT_ONCE = 500  # adverse cases


def known(found: Array) -> Array:
    """Distances of what a :class:`FreeSpace` has measured; NaN of bodies that are in each other."""
    measured = (found[:, 0] == Told.MEASURED) & (found[:, 2] <= KNOWN)
    return np.where(measured, found[:, 1], np.nan)


@dataclass
class Seen:
    """What distances came to.

    Attributes:
        pairs, inside: how many, and of which the kernel says that they are in each other.
        unknown: told with an error of more than 1e-7 m, which is left to coal.
        off: largest difference from coal, or from what is proved without the kernel [m].
        gap: largest error that the kernel admits, of what is known [m].
        wrong: told inside though apart, apart though inside, or known though it is not.
        differ: whether the variants of the kernel give other bits.
    """

    pairs: int = 0
    inside: int = 0
    unknown: int = 0
    off: float = 0.0
    gap: float = 0.0
    wrong: int = 0
    differ: bool = False

    @property
    def passes(self) -> bool:
        return not (self.wrong or self.differ or self.off >= OFF)

    def add(self, found: Array) -> Array:
        """Count what is told; returns which distances are known."""
        measured = found[:, 0] == Told.MEASURED
        known = measured & (found[:, 2] <= KNOWN)
        self.pairs += len(found)
        self.inside += int((found[:, 0] == Told.INSIDE).sum())
        self.unknown += int((measured & ~known).sum())
        self.gap = max(self.gap, float(found[known, 2].max(initial=0.0)))
        return np.asarray(known)

    def __str__(self) -> str:
        bits = "; VARIANTS DIFFER" if self.differ else ""
        return (
            f"{self.pairs} pairs, {self.inside} in each other, {self.unknown} not known; off by up "
            f"to {self.off:.1e} m, admitted {self.gap:.1e} m; {self.wrong} wrong{bits}"
        )


class All:
    """The same pairs, measured by all variants of the kernel."""

    def __init__(self, chain: ClosedChain, bounds: DistanceBounds) -> None:
        self._spaces = [_made_by(variant, chain, bounds) for variant in variants()]

    def measure(self, q: Array, seen: Seen) -> Array:
        first, *others = (space.measure(q) for space in self._spaces)
        seen.differ |= any(other.tobytes() != first.tobytes() for other in others)
        return first


def _made_by(variant: Any, chain: ClosedChain, bounds: DistanceBounds) -> FreeSpace:
    with patch.object(native, "module", lambda: variant):
        return FreeSpace(chain, [bounds])


def of_robot(chain: ClosedChain, poses: int) -> Seen:
    """All pairs of a robot at random poses, against coal."""
    limit, seen = SelfCollision(), Seen()
    space, pairs = All(chain, limit.program(chain, 0.01)), limit.watched(chain)
    for q in chain.sample(np.random.default_rng(0), poses):
        found, by_coal = (
            space.measure(q, seen),
            distances_along(chain, pairs, q[None])[0],
        )
        known, inside = seen.add(found), found[:, 0] == Told.INSIDE
        seen.off = max(seen.off, float(np.abs(found[:, 1] - by_coal)[known].max(initial=0.0)))
        seen.wrong += int((by_coal[inside] > TOUCHES).sum())
    return seen


@dataclass(frozen=True)
class Placed:
    """A body somewhere in the world."""

    convex: Convex
    X: pin.SE3

    def reach(self, n: Array) -> float:
        """How far it goes along a unit vector, n'x at most."""
        d, convex = self.X.rotation.T @ n, self.convex
        if convex.form is Form.CYLINDER:
            own = convex.half[0] * np.hypot(d[0], d[1]) + convex.half[2] * abs(d[2])
        elif convex.form is Form.ELLIPSOID:
            own = np.linalg.norm(convex.half * d)
        else:
            own = (convex.points @ d).max() + convex.rim
        return float(n @ self.X.translation + own)

    def outside(self, p: Array) -> float:
        """How far a point is out of it, at most [m]."""
        x, convex = self.X.actInv(p), self.convex
        if convex.form is Form.ELLIPSOID:
            return float((np.linalg.norm(x / convex.half) - 1.0) * convex.radius)
        if convex.form is Form.CYLINDER:
            return float(max(np.hypot(x[0], x[1]) - convex.half[0], abs(x[2]) - convex.half[2]))
        if convex.rim:  # ball and capsule
            along = np.clip(x[2], convex.points[0, 2], convex.points[-1, 2])
            return float(np.linalg.norm(x - [0.0, 0.0, along]) - convex.rim)
        if convex.form is Form.BOX:
            return float((np.abs(x) - convex.half).max())
        planes = _planes(convex)
        return float((planes[:, :3] @ x + planes[:, 3]).max())


@cache
def _planes(convex: Convex) -> Array:
    """Of a hull's faces, outward normals and offsets, shape (f, 4)."""
    from scipy.spatial import ConvexHull

    return np.asarray(ConvexHull(convex.points).equations)


def bodies(rng: np.random.Generator) -> Iterator[Convex]:
    """Of each kind in turn, for ever, each of another size."""
    here = pin.SE3.Identity()

    def shape(kind: Any, *size: float) -> Convex:
        return of_shape(Shape(frame="", placement=here, kind=kind, size=size))

    while True:
        yield shape("box", *(0.02 + 0.3 * rng.random(2)), 0.001 + 0.1 * rng.random())
        yield of_capsule(_capsule(0.05, 0.3 * rng.random()))
        yield shape("sphere", 0.1)
        yield _hull(0.1 * _units(rng, int(rng.integers(8, 109))))
        turn = np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False)
        rim = (0.05 + 0.1 * rng.random()) * np.column_stack([np.cos(turn), np.sin(turn)])
        yield _hull(np.array([[*xy, z] for xy, z in itertools.product(rim, (-0.1, 0.1))]))
        yield shape("cylinder", 0.02 + 0.1 * rng.random(), 0.01 + 0.3 * rng.random())
        yield shape("ellipsoid", *(0.02 + 0.2 * rng.random(3)))


def _capsule(radius: float, length: float) -> Capsule:
    return Capsule(
        name="", joint=None, start=(0.0, 0.0, 0.0), end=(0.0, 0.0, length), radius=radius
    )


def _hull(points: Array) -> Convex:
    found = _hull_of(points.tobytes())
    assert found is not None
    return found


def _units(rng: np.random.Generator, count: int) -> Array:
    x = rng.normal(size=(count, 3))
    return np.asarray(x / np.linalg.norm(x, axis=1, keepdims=True))


def _turn(rng: np.random.Generator) -> Array:
    return np.asarray(pin.Quaternion(*rng.normal(size=4)).normalized().toRotationMatrix())


def adverse(cases: int, seed: int = 0) -> Iterator[tuple[float | None, Placed, Placed, float]]:
    """The tilt, two bodies, and a gap that they leave at least [m]."""
    rng = np.random.default_rng(seed)
    pool = list(itertools.islice(bodies(rng), 140))
    for case in range(cases):
        tilt, along_z, aside = TILTS[case % len(TILTS)], case % 2 == 0, case % 3 == 0
        one, other = (pool[int(i)] for i in rng.integers(0, len(pool), 2))
        first = Placed(one, pin.SE3(_turn(rng), np.zeros(3)))
        R = first.X.rotation
        turned = _turn(rng) if tilt is None else R @ pin.exp3(tilt * rng.normal(size=3))
        n = R[:, 2] if along_z else _units(rng, 1)[0]
        gap = 10.0 ** rng.uniform(-9.0, 0.0)
        second = Placed(other, pin.SE3(turned, np.zeros(3)))
        way = first.reach(n) + second.reach(-n) + gap
        side = 0.05 * R[:, 0] if aside else np.zeros(3)
        at = way * n + (side - (side @ n) * n)
        yield tilt, first, Placed(other, pin.SE3(turned, at)), gap


def of_cases(chain: ClosedChain, cases: Iterable[tuple[Any, Placed, Placed, float]]) -> Seen:
    """Adverse cases, as bodies that are fixed to the world of a chain."""
    seen = Seen()
    for batch in _batches(cases):
        solids = [(0, replace(b.convex, placement=b.X)) for _, *pair, _ in batch for b in pair]
        pairs = np.arange(len(solids), dtype=np.int64).reshape(-1, 2)
        still = np.zeros((len(solids), chain.n))
        bounds = DistanceBounds(
            bodies=solids, max_point_speeds=still, pairs=pairs, distance=0.0, gain=1.0, within=0.1
        )
        found = All(chain, bounds).measure(chain.q_start, seen)
        known = seen.add(found)
        for row, is_known, (_, a, b, gap) in zip(found, known, batch, strict=True):
            seen.wrong += row[0] == Told.INSIDE and gap > 1e-12
            if is_known:
                off = _off(a, b, row[1], row[3:6], row[6:9])
                seen.off = max(seen.off, off)
                seen.wrong += off > 2.0 * KNOWN
    return seen


def _off(a: Placed, b: Placed, d: float, p: Array, n: Array) -> float:
    """By how much a distance can be wrong: of points outside, and of planes nearer together [m]."""
    between = -b.reach(-n) - a.reach(n)
    reach = abs(d) + a.convex.rim + b.convex.rim
    tilted = np.sqrt(2.0 * reach * max(d - between, 0.0))  # p + d n is so far beside b's point
    out = max(a.outside(p), b.outside(p + d * n) - tilted)
    return max(d - between, out, abs(float(n @ n) - 1.0))


def _batches(cases: Iterable[Any]) -> Iterator[Sequence[Any]]:
    cases = iter(cases)
    while batch := list(itertools.islice(cases, AT_ONCE)):
        yield batch


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.kernel.distances", description=__doc__)
    parser.add_argument("--poses", type=int, default=1000, help="of each robot")
    parser.add_argument("--cases", type=int, default=240_000, help="adverse ones")
    asked, all_pass = parser.parse_args(), True
    chains = robots()
    for name, chain in chains.items():
        seen = of_robot(chain, asked.poses)
        click.echo(f"{name}: {seen}")
        all_pass &= seen.passes
    seen = of_cases(next(iter(chains.values())), adverse(asked.cases))
    click.echo(f"adverse cases: {seen}")
    return 0 if all_pass and seen.passes else 1


if __name__ == "__main__":
    sys.exit(main())
