"""How near robots come that are driven into themselves, each other and things at random.

    python benchmarks/collisions.py [GOALS] [POSES]

prints what docs/limits.md says of self_collision and obstacles, in about half an hour with the
default 500 goals and 1,000 poses a robot:

- distances at random poses, against pinocchio's own reading of the files and coal alone;
- the nearest that bodies came at any tick of any run, less what the limits keep free. "free" are
  arms that hold nothing, driven at full speed straight to random joint values; "holding" are runs
  of the QP controller with random goals for the object, most of them unreachable. Of each run the
  deepest tick is measured again by coal alone.
"""

from __future__ import annotations

import itertools
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import coal
import numpy as np
import pinocchio as pin
import qpsolvers

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from collision_robots import CASES, Case, Oracle, bodies_of_rows

from coopqp.base.spec import Array, Pose
from coopqp.controller import ControlProblem
from coopqp.controllers import QPController
from coopqp.execution.rollout import drive
from coopqp.limit import Limit, LimitRows
from coopqp.limits import JointPosition, JointVelocity, Obstacle, Obstacles, SelfCollision
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.profile import Profile
from coopqp.model.state import State
from coopqp.plant import Disturbance
from coopqp.plants import Kinematic
from coopqp.solvers import Daqp
from coopqp.tasks import JointCentering
from coopqp.tasks import Pose as PoseTask

DT, TICKS = 0.01, 100
GAINS = {10.0: 1, 50.0: 5}  # 1/s; one of so many goals
PULL = 5.0  # 1/s, of free arms towards their goal
REACH, TURN = 0.5, 1.5  # of the object's goals: standard deviations [m, rad]

#: In reach of the arms of each robot, clear of where they start.
THINGS = {
    "two UR5": {
        "post": Obstacle(cylinder={"radius": 0.05, "length": 1.2}, position=(0.5, 0.55, 0.4)),  # type: ignore[arg-type]
        "ball": Obstacle(sphere=0.08, position=(0.5, -0.5, 0.6)),
        "table": Obstacle(box=(0.4, 0.5, 0.05), position=(0.5, 0.0, -0.1)),
    },
    "Baxter": {
        "post": Obstacle(cylinder={"radius": 0.05, "length": 1.5}, position=(0.9, -0.6, 0.2)),  # type: ignore[arg-type]
        "ball": Obstacle(sphere=0.1, position=(0.7, 0.0, 0.6)),
        "table": Obstacle(box=(0.6, 1.2, 0.05), position=(0.8, 0.0, -0.35)),
    },
    "PR2": {
        "post": Obstacle(cylinder={"radius": 0.05, "length": 1.5}, position=(0.6, -0.75, 0.8)),  # type: ignore[arg-type]
        "ball": Obstacle(sphere=0.1, position=(0.75, 0.0, 1.2)),
        "table": Obstacle(box=(0.5, 1.0, 0.05), position=(0.75, 0.0, 0.45)),
    },
}


def limits_of(name: str, gain: float, *, holding: bool) -> tuple[SelfCollision, Obstacles]:
    """The two limits of a robot; arms that hold nothing have no object to watch."""
    ignore = CASES[name].ignore if holding else (*CASES[name].ignore, ("object", "*"))
    things = THINGS[name]
    parts = CASES[name].robot.build().collision_shapes
    bodies = None if holding else tuple(dict.fromkeys(part.frame for part in parts))
    return (
        SelfCollision(gain=gain, ignore=ignore),
        Obstacles(gain=gain, shapes=things, bodies=bodies),
    )


def solids(name: str) -> dict[str, tuple[coal.CollisionGeometry, pin.SE3]]:
    """The things for coal, made by hand."""
    found = {}
    for thing, it in THINGS[name].items():
        if it.box:
            geometry = coal.Box(*it.box)
        elif it.sphere:
            geometry = coal.Sphere(it.sphere)
        else:
            assert it.cylinder is not None
            geometry = coal.Cylinder(it.cylinder.radius, it.cylinder.length)
        found[thing] = (geometry, pin.SE3(np.eye(3), np.array(it.position)))
    return found


@dataclass
class Found:
    """What a series of runs came to.

    Attributes:
        margin: distance less what is kept free, least of each run [m].
        by_coal: the same by coal alone, at that tick.
        stuck: ticks whose QP had no answer.
    """

    margin: list[float]
    by_coal: list[float]
    stuck: int = 0

    @property
    def row(self) -> str:
        """For the table."""
        reached = sum(margin < 1e-3 for margin in self.margin)
        return (
            f"{reached:4d} of {len(self.margin)} reached a limit   "
            f"nearest {1e3 * min(self.margin):7.3f} mm   "
            f"by coal {1e3 * min(self.by_coal):7.3f} mm   "
            f"ticks without answer {self.stuck}"
        )


class Drive:
    """Arms that hold nothing on their way to joint values, one QP a tick.

    Args:
        chain: whose arms; its loops are left out.
        limits: rows and bounds.
    """

    def __init__(self, chain: ClosedChain, limits: Sequence[Limit]) -> None:
        self.chain, self.stuck = chain, 0
        self._tighten = [
            limit.bind(chain, DT) for limit in (JointPosition(), JointVelocity(), *limits)
        ]
        n = chain.n
        ends = np.cumsum([0, 0, 0, *(len(limit.rows(chain)) for limit in limits)]).tolist()
        self._lb, self._ub, self._h = np.zeros(n), np.zeros(n), np.zeros(ends[-1])
        self._G = np.zeros((ends[-1], n))
        self._rows = [
            LimitRows(self._lb, self._ub, self._G[a:b], self._h[a:b])
            for a, b in itertools.pairwise(ends)
        ]

    def run(self, goal: Array, ticks: int) -> Array:
        """Configurations, shape (ticks + 1, n)."""
        state, q = State(self.chain), [self.chain.q_start]
        for _ in range(ticks):
            state.update()
            self._lb[:], self._ub[:] = -np.inf, np.inf
            for tighten, rows in zip(self._tighten, self._rows, strict=True):
                tighten(state, rows)
            near = np.abs(self._G).sum(axis=1) > 0.0
            v = qpsolvers.solve_qp(
                np.eye(self.chain.n), PULL * (state.q - goal), self._G[near], self._h[near],
                lb=self._lb, ub=self._ub, solver="daqp",
            )  # fmt: skip
            if v is None:
                v, self.stuck = np.zeros(self.chain.n), self.stuck + 1
            state.advance(v, DT)
            q.append(state.q.copy())
        return np.array(q)


def nearest(
    name: str, chain: ClosedChain, limits: Sequence[Limit], oracle: Oracle, q: Array
) -> tuple[float, float]:
    """Least margin in a run, and the same at that tick by coal alone [m]."""
    v = np.zeros((len(q) - 1, chain.n))
    margins = [np.column_stack(list(k.margins(chain, q, v, DT).values())) for k in limits]
    tick = int(np.argmin(np.minimum(*(margin.min(axis=1) for margin in margins)))) + 1
    oracle.place(q[tick])
    by_coal = min(
        oracle.distance(*pair) - limit.distance  # type: ignore[attr-defined]
        for limit in limits
        for pair in bodies_of_rows(limit, chain)
    )
    return min(float(margin.min()) for margin in margins), by_coal


def free(name: str, goals: int, gain: float, ticks: int = TICKS) -> Found:
    """Arms that hold nothing."""
    chain, rng = CASES[name].chain(), np.random.default_rng(1)
    limits = limits_of(name, gain, holding=False)
    oracle, arms = Oracle(CASES[name], chain, solids(name)), Drive(chain, limits)
    found = Found([], [])
    for goal in chain.sample(rng, goals):
        margin, by_coal = nearest(name, chain, limits, oracle, arms.run(goal, ticks))
        found.margin.append(margin)
        found.by_coal.append(by_coal)
    found.stuck = arms.stuck
    return found


def problem(case: Case, chain: ClosedChain, goal: Pose, limits: Sequence[Limit]) -> ControlProblem:
    """The object is to go to a pose within a second."""
    task = PoseTask(goal=goal, profile=Profile(duration=1.0))
    return ControlProblem(
        chain=chain,
        tasks=(task,),
        secondary=(JointCentering(gain=0.5),),
        limits=(JointPosition(), JointVelocity(), *limits),
        dt=DT,
        solver=Daqp(),
    )


def goals_of(chain: ClosedChain, count: int) -> list[Pose]:
    """Random poses of the object round its start."""
    rng, p = np.random.default_rng(2), chain.start_position
    return [
        Pose(
            position=tuple((p + rng.normal(0.0, REACH, 3)).tolist()),
            rpy=tuple(rng.normal(0.0, TURN, 3).tolist()),
        )
        for _ in range(count)
    ]


def holding(name: str, goals: int, gain: float, ticks: int = TICKS) -> Found:
    """Arms that hold an object, under the QP controller."""
    chain = CASES[name].chain()
    limits = limits_of(name, gain, holding=True)
    oracle, found = Oracle(CASES[name], chain, solids(name)), Found([], [])
    for goal in goals_of(chain, goals):
        asked = problem(CASES[name], chain, goal, limits)
        law = QPController().build(asked)
        plant, state, q = Kinematic().build(asked, 0, Disturbance()), law.start(), [chain.q_start]
        for _ in drive(law, plant, state, ticks):
            found.stuck += not law.command.status.usable
            q.append(state.q.copy())
        margin, by_coal = nearest(name, chain, limits, oracle, np.array(q))
        found.margin.append(margin)
        found.by_coal.append(by_coal)
    return found


def poses(name: str, count: int) -> str:
    """Largest difference of a distance from coal's at random poses."""
    case = CASES[name]
    chain = case.chain()
    limit = SelfCollision(distance=0.0, ignore=case.ignore)
    pairs, oracle = bodies_of_rows(limit, chain), Oracle(case, chain)
    worst, touching = 0.0, 0
    for q in chain.sample(np.random.default_rng(0), count):
        path, still = np.vstack([q, q]), np.zeros((1, chain.n))
        d = np.array([m[0] for m in limit.margins(chain, path, still, DT).values()])
        oracle.place(q)
        by_coal = np.array([oracle.distance(*pair) for pair in pairs])
        worst, touching = max(worst, float(np.abs(d - by_coal).max())), touching + (d < 0.0).sum()
    share = 100.0 * touching / (count * len(pairs))
    return (
        f"{len(pairs):4d} pairs, {count} poses: off by {1e6 * worst:.2f} um ({share:.1f} % touch)"
    )


def main(goals: int, count: int) -> None:
    """Print the tables."""
    for name in CASES:
        print(f"{name:8s} {poses(name, count)}", flush=True)
    for runs in (free, holding):
        for gain, share in GAINS.items():
            for name in CASES:
                found = runs(name, max(1, goals // share), gain)
                print(f"{runs.__name__:8s} gain {gain:2g} {name:8s} {found.row}", flush=True)


if __name__ == "__main__":
    main(*(int(word) for word in (*sys.argv[1:], *("500", "1000")[len(sys.argv) - 1 :])))
