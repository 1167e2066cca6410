"""Closed configurations inside the position limits: where they are, and ways between them.

Searches are the kernel's (``core/manifold.hpp``, ``core/way.hpp``), joint limits those of every
limit that bounds q. A tree grows in charts: n - rank joints lead and the others follow by Newton
steps. Who can follow is said by the loops' Jacobian J_c at closed configurations: a chart is as
good as the mean logarithm of the smallest singular value of its followers' columns.
"""

import itertools
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from pydantic import Field

from coopqp.base.errors import CoopqpError
from coopqp.base.rank import matrix_rank
from coopqp.base.spec import UNLIMITED, Array, NonNegative, Positive, spec
from coopqp.controller import ControlProblem
from coopqp.kernel import native
from coopqp.kernel.flat import Group, Levels, flat_distances, flat_model, kept_rows
from coopqp.limit import DistanceBounds, Program
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.state import State
from coopqp.planning.closed_path import Loops, lengths, on_lines
from coopqp.planning.linking import ClosedLine, closed_line
from coopqp.study.explanation.goal import PositionLimits
from coopqp.task import Programs, Task, TaskStack

LARGE = 1e300  # stands for no limit

#: Newton steps of a configuration that is far off the manifold.
STEPS = 60

#: Configurations at which charts are judged, how many of each leader are used, sets looked at.
POSES, EACH, MAX_SETS = 30, 2, 200
#: Followers are dependent below this singular value [m/rad, 1]; where a chart has this share of
#: such poses, the chart in which no joint leads is used too.
DEPENDENT, MANY = 0.02, 0.4

#: What a loop may be open by between the points of a path [m, rad], and a joint beyond its limit.
OPEN, BEYOND = 1e-5, 1e-9

Wait = Callable[[], None]


@spec
class Budget:
    """What a search may cost, and how fine it looks."""

    seconds: NonNegative = 10.0
    """Wall time [s]."""
    seed: int = 0
    """Of samples and shortcuts."""
    step: Positive = 0.1
    """Between two looks at what is in the way, in trees [rad, m]."""
    fine: Positive = 0.02
    """The same on a path [rad, m]."""
    reach: Positive = 1.5
    """Of a branch [rad, m]."""
    max_projections: Annotated[int, Field(ge=1)] = 20000
    """Projections after which trees begin anew, of other random numbers."""
    shortcuts: Annotated[int, Field(ge=0)] = 160
    """Tries to make a path shorter."""


class ClosedSpace:
    """Closed configurations of a problem inside its position limits, with some tasks held.

    Args:
        problem: whose limits count.
        tasks: held at time t [s].
        threads: that bring configurations to the manifold; their number changes no result.

    Attributes:
        bounds: the position limits.
        lower, upper: of the joints, shape (n,) [rad, m].
        programs: of the limits, as the kernel has them, and ``distances``, those of bodies.
        others: whether limits in space that are no distances are kept at q; None without any.

    Raises:
        CoopqpError: the kernel is not built, or cannot do such joints or tasks.
    """

    def __init__(
        self, problem: ControlProblem, tasks: Sequence[Task] = (), t: float = 0.0, threads: int = 1
    ) -> None:
        chain = self.chain = problem.chain
        found, model = native.module(), chain.once(flat_model)
        if found is None or model is None:
            why = native.MISSING if found is None else "a joint is neither a hinge nor a slide"
            raise CoopqpError(f"ways are searched for by the compiled kernel: {why}")
        tasks = tuple(task.at_goal() for task in tasks)  # the kernel has not every profile
        self._tasks, self._t = tasks, t
        programs = self.programs = [limit.program(chain, problem.dt) for limit in problem.limits]
        bounds = self.bounds = PositionLimits(problem, programs)
        bounds.lower = np.maximum(bounds.lower, chain.lower)  # verdicts look at ranges in any case
        bounds.upper = np.minimum(bounds.upper, chain.upper)
        self.lower, self.upper = np.maximum(bounds.lower, -LARGE), np.minimum(bounds.upper, LARGE)
        self.distances = [program for program in programs if isinstance(program, DistanceBounds)]
        self.others = _others(problem, programs)
        levels = Levels([Group((), hard=tasks)], Programs(State(chain)))
        if not levels.compiled or levels.arriving or levels.followed:
            raise CoopqpError("\n".join(filter(None, (_unfit(chain, task) for task in tasks))))
        flat = {
            "model": model,
            "kept": kept_rows(chain),
            "rank": float(chain.loops.rank),
            "distances": [flat_distances(chain, bounds) for bounds in self.distances],
            "levels": levels.flat,
            "primitives": levels.primitives,
            "t": float(t),
            "lower": self.lower,
            "upper": self.upper,
        }
        self._engines = [found.Planner(flat) for _ in range(threads)]
        self._map: Any = ThreadPoolExecutor(threads).map if threads > 1 else map

    def sample(self, rng: np.random.Generator, count: int) -> Array:
        """Random configurations inside the joint limits, loops not closed, shape (count, n)."""
        return np.asarray(rng.uniform(*self._sampled(), (count, self.chain.n)), float)

    def project(self, q: Array, steps: int = STEPS) -> NDArray[np.bool_]:
        """Bring each row of q (N, n) to the manifold, in place; whether each is there."""
        closed = np.zeros(len(q), np.uint8)
        ends = np.linspace(0, len(q), len(self._engines) + 1).astype(int).tolist()

        def bring(engine: Any, first: int, end: int) -> None:
            engine.project(q[first:end], closed[first:end], steps)

        list(self._map(bring, self._engines, ends, ends[1:]))
        return closed.view(np.bool_)

    def is_free(self, q: Array) -> NDArray[np.bool_]:
        """Whether each row of q (N, n) keeps the limits in space."""
        free = np.zeros(len(q), np.bool_)
        self._engines[0].is_free(np.ascontiguousarray(q, float), free.view(np.uint8))
        if self.others:
            free &= np.array([self.others(row) for row in q], bool)
        return free

    def way(self, starts: Array, goals: Array, budget: Budget, wait: Wait = lambda: None) -> Array:
        """A path, shape (K, n), from one of the starts to one of the goals, (k, n), all closed.

        ``wait`` is called ten times a second and ends the search by raising.
        """
        low, high = self._sampled()
        sizes = ("step", "fine", "seconds", "shortcuts")
        made = self._engines[0].find(
            {
                **{name: float(getattr(budget, name)) for name in sizes},
                "range": budget.reach,
                "most": float(budget.max_projections),
                "seed": int(budget.seed) % 2**64,  # the kernel's word; any number is a seed
                "low": low,
                "high": high,
                "charts": self.charts.astype(float).ravel(),
                "starts": np.ascontiguousarray(starts, float).ravel(),
                "goals": np.ascontiguousarray(goals, float).ravel(),
            },
            self.others,
            wait,
        )
        return np.frombuffer(made["path"]).reshape(-1, self.chain.n).copy()

    @cached_property
    def line(self) -> ClosedLine | None:
        """The closed line of two arms, which free motions never lead through itself, if proven."""
        found = closed_line(self.chain, self.programs)
        return found if found and found.proven else None

    @cached_property
    def charts(self) -> NDArray[np.bool_]:
        """Which joints lead in each chart, shape (c, n); none in one where all go."""
        q = self.sample(np.random.default_rng(0), POSES)
        q = q[self.project(q)]
        chain, tasks = self.chain, self._tasks
        J = _jacobians(chain, tasks, self._t, q if len(q) else chain.q_start[None])
        return _charts(chain, J)

    def _sampled(self) -> tuple[Array, Array]:
        q = self.chain.q_start
        low = np.where(self.lower > -LARGE, self.lower, q - UNLIMITED)
        return low, np.where(self.upper < LARGE, self.upper, q + UNLIMITED)


def _unfit(chain: ClosedChain, task: Task) -> str:
    """Why a task has no manifold that the kernel knows; empty where it has one."""
    levels = Levels([Group((), hard=(task,))], Programs(State(chain)))
    if not levels.compiled:
        return f"tasks: {task.name}: its rows are Python's, which no search knows; leave it out"
    if levels.arriving or levels.followed:
        return f"tasks: {task.name}: its goal moves by a signal or an input; needs a fixed goal"
    return ""


def _jacobians(chain: ClosedChain, tasks: Sequence[Task], t: float, q: Array) -> Array:
    """Rows of the closed loops and of the tasks at each row of q, shape (N, rows, n)."""
    state = State(chain)
    stack = TaskStack(tasks, State(chain))
    found = []
    for row in q:
        state.q[:], state.t = row, t
        state.update()
        stack.update(state)
        found.append(np.vstack([state.J_rel[: chain.loops.closed], stack.J]))
    return np.array(found)


def _charts(chain: ClosedChain, J: Array) -> NDArray[np.bool_]:
    """The best charts in which all arms but one follow, as far as their joints do."""
    rank = int(np.median([matrix_rank(rows, 1e-6) for rows in J])) if J.shape[1] else 0
    charts, worst = [], 0.0
    for leader in chain.arms[: chain.holding]:
        own = [chain.joint_names.index(joint) for joint in chain.robot.arm_joints(leader)]
        sets = filter(None, _followers(chain.n, own, rank))
        worth = {follow: float(np.log(_least(J, follow) + 1e-4).mean()) for follow in sets}
        for follow in sorted(worth, key=lambda one: -worth[one])[:EACH]:
            charts.append(np.isin(np.arange(chain.n), follow, invert=True))
            worst = max(worst, float((_least(J, follow) < DEPENDENT).mean()))
    if worst > MANY or not charts:
        charts.append(np.zeros(chain.n, bool))
    return np.array(charts)


def _followers(n: int, leading: Sequence[int], rank: int) -> Iterator[tuple[int, ...]]:
    """Sets of joints that can follow: of the other arms first, at most so many."""
    others = [j for j in range(n) if j not in leading]
    if len(others) >= rank:
        yield from itertools.islice(itertools.combinations(others, rank), MAX_SETS)
        return
    for more in itertools.islice(itertools.combinations(leading, rank - len(others)), MAX_SETS):
        yield (*others, *more)


def _least(J: Array, follow: Sequence[int]) -> Array:
    """The smallest singular value of the followers' columns at each pose, shape (N,)."""
    return np.asarray(np.linalg.svd(J[:, :, list(follow)], compute_uv=False)[:, -1], float)


@dataclass(frozen=True)
class Verification:
    """What a second look at a path has shown."""

    points: int  # that were looked at
    open: float  # largest loop error [m, rad]
    beyond: float  # how far a joint is outside its limits, at most [rad, m]
    hits: int  # points at which a limit in space is not kept

    @property
    def good(self) -> bool:
        return self.open <= OPEN and self.beyond <= BEYOND and not self.hits

    @property
    def message(self) -> str:
        """What is wrong; empty where nothing is."""
        wrong = [f"{self.hits} of {self.points} points break a limit in space"] * bool(self.hits)
        if self.open > OPEN:
            wrong.append(f"a loop is open by {1e3 * self.open:.3g} mm or mrad")
        if self.beyond > BEYOND:
            wrong.append(f"a joint is {self.beyond:.3g} outside its limits")
        return ", ".join(wrong)


class Verifier:
    """A second look at paths in a space, by pinocchio and coal: nothing of the kernel is used.

    Between its points a path is the straight line in joint space.
    """

    def __init__(self, space: ClosedSpace) -> None:
        chain = self._chain = space.chain
        self._loops, self._bounds, self._others = Loops(chain), space.bounds, space.others
        self._data, margins = chain.model.createData(), list[float]()
        geometry = pin.GeometryModel()
        for bounds in space.distances:
            first = geometry.ngeoms
            for joint, convex in bounds.bodies:
                convex.geometry.computeLocalAABB()
                at = f"{geometry.ngeoms}", joint, convex.placement, convex.geometry
                geometry.addGeometryObject(pin.GeometryObject(*at))
            for a, b in (first + bounds.pairs).tolist():
                geometry.addCollisionPair(pin.CollisionPair(a, b))
            margins += [bounds.distance] * len(bounds.pairs)
        placed = pin.GeometryData(geometry)
        for i, margin in enumerate(margins):
            request = placed.collisionRequests[i]
            request.security_margin, request.num_max_contacts = margin, 1
            placed.collisionRequests[i] = request
        # It asks all boxes, which for a robot's few bodies is less than keeping a tree of them.
        kind = pin.BroadPhaseManager_NaiveCollisionManager
        self._manager = kind(chain.model, geometry, placed)
        self._referred_to = geometry, placed  # kept, since the manager does not

    def look(self, q: Array, every: float) -> Verification:
        """Look at a path q, shape (K, n), each so many radians or metres."""
        points, bounds = along(q, every), self._bounds
        hits = sum(not self.free(row) for row in points)
        opened = self._loops.errors(points).max(initial=0.0)
        beyond = np.maximum(points - bounds.upper, bounds.lower - points).max(initial=0.0)
        return Verification(len(points), float(opened), float(beyond), hits)

    def free(self, q: Array) -> bool:
        """Whether the limits in space are kept at q."""
        if pin.computeCollisions(self._chain.model, self._data, self._manager, q, True):
            return False
        return self._others is None or self._others(q)


def _others(
    problem: ControlProblem, programs: Sequence[Program | None]
) -> Callable[[Array], bool] | None:
    """Whether limits in space that are no distances are kept; None where there are none."""
    chain, state = problem.chain, State(problem.chain)
    left = [
        clearance
        for limit, program in zip(problem.limits, programs, strict=True)
        if not isinstance(program, DistanceBounds) and (clearance := limit.clearance(chain))
    ]

    def kept(q: Array) -> bool:
        state.q[:] = q
        state.update()
        return all(bool((clearance(state) >= 0.0).all()) for clearance in left)

    return kept if left else None


def along(q: Array, every: float) -> Array:
    """Points on the straight lines between rows of q at equal distances, both ends included."""
    s = lengths(q)
    if len(q) < 2 or s[-1] == 0.0:
        return q[:1].copy()
    return on_lines(np.linspace(0.0, s[-1], int(np.ceil(s[-1] / every)) + 1), s, q)
