"""The bodies of a robot and what it holds, and which of them can meet.

Neighbours touch by design and are no pair: bodies of one joint or of joints that follow each other,
hands that hold one object firmly, and the object with the hands and what is before them. Neither
are bodies of one robot that touch by construction: those that do so in nearly all of some random
configurations, or, one carrying the other, where all joints are at zero.
"""

import bisect
import fnmatch
import itertools
from collections.abc import Collection, Iterator, Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np
import pinocchio as pin

from coopqp.base.errors import InvalidValueError, UnknownNameError
from coopqp.base.spec import Array
from coopqp.limits._distances import (
    Body,
    Distances,
    Pair,
    of_capsule,
    of_meshes,
    of_shape,
    outermost,
)
from coopqp.model.closed_chain import ClosedChain
from coopqp.robot import Convex, RobotModel, Shape

OBJECT = "object"

#: Random configurations that are looked at, and the share of them in which bodies that touch by
#: construction do.
SAMPLES, SHARE = 100, 0.95

#: Reach of a joint without limits in them [rad or m].
UNLIMITED = np.pi


class _Tree:
    """Which bodies follow which."""

    def __init__(self, robot: RobotModel, model: pin.Model, bodies: Collection[Body]) -> None:
        self._model, self._occupied = model, {body.joint for body in bodies}
        ways = [robot.arm_joints(arm) for arm in robot.arms]
        # What several arms share, such as a waist, belongs to none.
        self._arm_of = {
            joint: i
            for i, way in enumerate(ways)
            for joint in way
            if sum(joint in other for other in ways) == 1
        }

        frames = list(model.frames)
        self._root_ids = [i for i, f in enumerate(frames) if i and f.parentFrame == 0]
        self._roots = [frames[i].name for i in self._root_ids]

    def neighbours(self, a: Body, b: Body) -> bool:
        if a.joint == b.joint:
            return True
        if not (a.link or b.link) and self._one_arm(a, b):
            return True  # capsules are too coarse for an arm against itself
        one, other = (a, b) if a.joint < b.joint else (b, a)
        return self.before(other.joint) == one.joint and (
            one.joint > 0 or self.root(one) in ("", self.root(other))
        )

    def carries(self, a: Body, b: Body) -> bool:
        supports = self._model.supports
        return a.joint in list(supports[b.joint]) or b.joint in list(supports[a.joint])

    def before(self, joint: int) -> int:
        """The nearest joint before it that carries bodies; 0 if none does."""
        before = [j for j in self._model.supports[joint] if j != joint and j in self._occupied]
        return max(before, default=0)

    def root(self, body: Body) -> str:
        """Name of the first link of the robot that it belongs to; empty for capsules."""
        if not body.link:
            return ""
        # Of a robot the first frame alone follows the world's; pinocchio forgets the frame before
        # a locked joint, but keeps a robot's frames together.
        at = self._model.getFrameId(body.link)
        return str(self._roots[bisect.bisect(self._root_ids, at) - 1])

    def hands(self, chain: ClosedChain) -> set[int]:
        """Joints whose bodies may touch the object: hands, what follows and what is before them.

        Not of arms that neither hold it nor are about to.
        """
        model, found = self._model, set[int]()
        for arm in (arm for arm in chain.robot.arms if arm.name not in chain.hold.away):
            tip = model.frames[model.getFrameId(arm.tip)].parentJoint
            found |= {j for j in range(model.njoints) if tip in model.supports[j]}
            hand = tip if tip in self._occupied else self.before(tip)
            found |= {hand, self.before(hand)} - {0}
        return found

    def _one_arm(self, a: Body, b: Body) -> bool:
        arms = {self._arm_of.get(self._model.names[body.joint]) for body in (a, b)}
        return len(arms) == 1 and None not in arms


def robot_bodies(robot: RobotModel, model: pin.Model) -> tuple[list[Body], list[str]]:
    """The robot's bodies, from capsules or shapes, and a sentence for each part that cannot be one.

    Meshes of one link are one body: robots drawn in CAD have one for every screw.
    """
    bodies = [
        Body(c.name, model.getJointId(c.joint) if c.joint else 0, of_capsule(c))
        for c in robot.capsules
    ]
    faults = [*robot.unseen]
    for link in dict.fromkeys(shape.frame for shape in robot.collision_shapes):
        frame = model.frames[model.getFrameId(link)]
        shapes = [
            replace(shape, placement=frame.placement * shape.placement)
            for shape in robot.collision_shapes
            if shape.frame == link
        ]
        for i, part in enumerate(_parts(shapes, faults)):
            name = f"{link}[{i + 1}]" if i else link
            bodies.append(Body(name, frame.parentJoint, part, link))
    return bodies, faults


def _parts(shapes: Sequence[Shape], faults: list[str]) -> Iterator[Convex]:
    """The convex bodies of a link; its meshes are one."""
    meshes = []
    for shape in shapes:
        try:
            if shape.kind == "mesh":
                outermost(shape)
                meshes.append(shape)
            else:
                yield of_shape(shape)
        except InvalidValueError as error:
            faults.append(f"{shape.frame}: {error}")
    try:
        if meshes:
            yield of_meshes(meshes)
    except InvalidValueError as error:
        faults.append(f"{meshes[0].frame}: {error}")


def held_body(chain: ClosedChain) -> Body:
    """The object's box, as carried by the first arm."""
    frame = chain.model.frames[chain.frames[0]]
    size = tuple(float(edge) for edge in chain.held.size)
    box = Shape(frame=frame.name, placement=frame.placement, kind="box", size=size)
    return Body(OBJECT, frame.parentJoint, of_shape(box))


def bodies_of(chain: ClosedChain) -> tuple[list[Body], list[str]]:
    """The robot's bodies (InvalidValueError: none) and the object, and what cannot be watched."""
    bodies, faults = chain.once(_of_the_robot)
    if not bodies:
        why = f": {faults[0]}" if faults else ""
        raise InvalidValueError(
            f"robot {chain.robot.name} has no collision geometry{why}; leave this limit out, "
            "use a file with it, or add capsules to RobotModel.capsules"
        )
    return [*bodies, held_body(chain)], faults


def _of_the_robot(chain: ClosedChain) -> tuple[list[Body], list[str]]:
    return robot_bodies(chain.robot, chain.model)


def unseen(kind: str, chain: ClosedChain) -> tuple[str, ...]:
    """What of the robot a limit of this kind does not watch, one sentence each."""
    return tuple(f"{kind} does not see {fault}" for fault in bodies_of(chain)[1])


def named_bodies(
    where: str, name: str, bodies: Sequence[Body], faults: Sequence[str]
) -> list[Body]:
    """Those of a link, or of this very name, or else that a pattern fits; errors where none is."""
    found = [body for body in bodies if name in (body.name, body.link)]
    found = found or [body for body in bodies if fnmatch.fnmatchcase(body.name, name)]
    for fault in faults if not found else ():
        if fault.startswith(f"{name}: "):
            raise InvalidValueError(f"{where}nothing of {fault}")
    if not found:
        raise UnknownNameError("body", name, [body.name for body in bodies], where)
    return found


def pairs_that_can_meet(chain: ClosedChain) -> list[Pair]:
    """All pairs of :func:`bodies_of` but neighbours and those that touch by construction."""
    (*bodies, held), _ = bodies_of(chain)
    tree, pairs = chain.once(_apart)
    firm = {chain.model.frames[i].parentJoint for i in chain.frames[: chain.holding]}
    touching = tree.hands(chain) | {held.joint}
    found = [(a, b) for a, b in pairs if not {a.joint, b.joint} <= firm]
    return found + [(held, body) for body in bodies if body.joint not in touching]


def _apart(chain: ClosedChain) -> tuple[_Tree, list[Pair]]:
    """Pairs of the robot's bodies that are no neighbours and do not touch by construction."""
    bodies, _ = chain.once(_of_the_robot)
    tree, joined = _Tree(chain.robot, chain.model, bodies), by_construction(chain.robot)
    return tree, [
        (a, b) if a.joint else (b, a)  # the base comes second
        for a, b in itertools.combinations(bodies, 2)
        if not tree.neighbours(a, b) and frozenset((a.name, b.name)) not in joined
    ]


@lru_cache(maxsize=16)
def by_construction(robot: RobotModel) -> frozenset[frozenset[str]]:
    """Names of the pairs of one robot's bodies that touch by construction."""
    model, data = robot.model, robot.model.createData()
    bodies, _ = robot_bodies(robot, model)
    tree = _Tree(robot, model, bodies)
    pairs = [
        (a, b)
        for a, b in itertools.combinations(bodies, 2)
        if tree.root(a) == tree.root(b) and not tree.neighbours(a, b)
    ]
    found, touches = Distances(pairs), np.zeros(len(pairs), int)
    zero, *samples = _configurations(model)
    for q in samples:
        pin.updateGeometryPlacements(model, data, found.geometry, found.placed, q)
        found.update(0.0)
        touches += found.d < 0.0
    pin.updateGeometryPlacements(model, data, found.geometry, found.placed, zero)
    found.update(0.0)
    at_zero = [d < 0.0 and tree.carries(*pair) for d, pair in zip(found.d, pairs, strict=True)]
    left_out = np.flatnonzero((touches >= SHARE * SAMPLES) | np.array(at_zero, bool)).tolist()
    return frozenset(frozenset(body.name for body in pairs[i]) for i in left_out)


def _configurations(model: pin.Model) -> Array:
    """All joints at zero, or at their limit nearest to it, then random ones."""
    lower, upper = np.array(model.lowerPositionLimit), np.array(model.upperPositionLimit)
    zero = np.clip(0.0, lower, upper)
    lower = np.where(np.isfinite(lower), lower, -UNLIMITED)
    upper = np.where(np.isfinite(upper), upper, UNLIMITED)
    samples = np.random.default_rng(0).uniform(lower, upper, (SAMPLES, len(lower)))
    return np.vstack([zero, samples])
