"""A path of closed configurations from a scenario's start to where its tasks are met."""

from __future__ import annotations

import itertools
import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike

from coopqp.base.errors import CoopqpError, InvalidValueError, require_known, under
from coopqp.base.spec import Array
from coopqp.base.wording import counted
from coopqp.controller import ControlProblem
from coopqp.planning.closed_path import lengths
from coopqp.planning.closed_space import Budget, ClosedSpace, Verification, Verifier
from coopqp.planning.reach import (
    MAX_TRIES,
    PROVEN,
    Goals,
    Progress,
    explained,
    need_a_place,
    no_way,
    reasons,
    too_far,
)
from coopqp.planning.timing import Clock, timed
from coopqp.scenario.planned import PHASE
from coopqp.scenario.scenario import Scenario, needs_scenario
from coopqp.signal import POSE, quaternion_of
from coopqp.study.explanation.goal import Goal, placed
from coopqp.study.explanation.words import RunExplanation, size
from coopqp.task import Task

#: Largest distance of a path's points: straight lines between them open loops by less than 0.01 mm.
CLOSE = 0.005
#: Distance at which a path is looked at a second time, a tenth of a tree's step.
VERIFIED = 0.01
#: Goal configurations that are searched for; to the nearest to the start every other search goes.
GOALS, NEAREST = 48, 12
#: How often others are looked for after a search without a way (:meth:`Goals.look`).
MORE = 8
#: Goals nearer to a joint's limit are planned to where there are not enough others [rad, m].
OFF = 0.05
#: How often a phase is planned anew where no way leads on from where it ended.
AGAIN = 3
#: How long a path may be timed where the search has left less [s].
TIMING = 1.0
#: How long an explanation looks for a way round [s].
TRIED = 2.0
#: How far a start moves when its loops are closed exactly [rad, m].
FAR = 1e-3
#: Loops and tasks that a start is off by less, are closed and met there [m, rad].
MET = 1e-6


@dataclass(frozen=True, kw_only=True)
class Plan:
    """A way round."""

    success: bool  #: Whether there is a path; without one the arrays have no rows.
    sentence: str  #: In words.
    joints: tuple[str, ...]  #: Names of the n joints.
    q: Array  #: The path's points, closed and at most ``CLOSE`` apart, shape (K, n) [rad, m].
    t: Array  #: Times of a rollout's ticks, shape (T,) [s].
    timed: Array  #: Where the joints are then, shape (T, n) [rad, m].
    object: Array  #: Where the object is then: place, and quaternion x, y, z, w, shape (T, 7).
    verification: Verification | None = None  #: The second look; None without a path.
    #: Wall time of goals, search and second look [s].
    seconds: dict[str, float] = field(default_factory=dict)
    #: Number of the phase that each tick leads to, shape (T,); empty without phases.
    phase: Array = field(default_factory=lambda: np.zeros(0))
    proven: bool = False  #: Whether it is proven that there is no path.

    @property
    def length(self) -> float:
        """Of the path [rad, m]."""
        return float(lengths(self.q)[-1]) if len(self.q) else 0.0

    @property
    def columns(self) -> dict[str, Array]:
        """The path tick by tick, as ``way-points: {file: ...}`` names its columns."""
        names = ("t", *self.joints, *POSE.columns)
        rows = np.column_stack([self.t, self.timed, self.object])
        phases = {PHASE: self.phase} if len(self.phase) else {}
        return dict(zip(names, rows.T, strict=True)) | phases


def plan(
    scenario: Scenario,
    *,
    goals: ArrayLike | None = None,
    keep: Sequence[str] = (),
    budget: Budget | float = 10.0,
    progress: Progress = lambda share: None,
) -> Plan:
    """Find a path of closed configurations that keeps all limits.

    Args:
        scenario: whose phases are planned one after the other, each from where the one before ends,
            with the arms that hold the object then.
        goals: closed configurations of the first phase, shape (k, n), which is planned for alone;
            those that meet the tasks when omitted.
        keep: names of tasks met at the start that stay so all the way; in phases, where they are.
        budget: what it may cost, or the seconds that it may take with the scenario's seed.
        progress: called with the share of the time that is gone.

    Raises:
        CoopqpError: the start is no closed configuration inside the limits, a task to keep is not
            met there or does not exist, or the kernel is not built.
    """
    needs_scenario(scenario)
    if not isinstance(budget, Budget):
        budget = Budget(seconds=budget, seed=scenario.seed)
    if isinstance(keep, str):
        raise InvalidValueError(f"keep: found {keep!r}; needs a list of names")
    problem, t = scenario.problem(), scenario.schedule[0].duration
    if scenario.phases and goals is None:
        return _joined(scenario, _through(scenario, keep, budget, progress))
    if goals is None:
        need_a_place(problem)
    return Planner(problem, t, keep).plan(budget, goals, progress)


def _through(
    scenario: Scenario, keep: Sequence[str], budget: Budget, progress: Progress
) -> list[Plan]:
    """A plan for each phase; the last is that of a phase to which none was found.

    Where the one after it has none, a phase is planned again, to goals of other random numbers.
    """
    begun, count = time.perf_counter(), len(scenario.phases)
    made: list[Plan] = []
    chains, again, best = [scenario.chain], [0] * count, list[Plan]()
    unknown = set(keep) - {task.name for phase in scenario.phases for task in phase.tasks}
    while len(made) < count:
        k, left = len(made), budget.seconds - (time.perf_counter() - begun)
        phase = scenario.phases[k]
        names = [x for x in keep if x in unknown or x in [task.name for task in phase.tasks]]
        with under("phases", k):
            planner = Planner(scenario.problem(phase, chains[k]), phase.duration, names)
            now = replace(budget, seconds=max(left, 1e-3), seed=budget.seed + again[k])
            found = planner.plan(now, progress=progress)
        if found.success:
            made.append(found)
            if len(made) < count:
                released = scenario.phases[k + 1].released
                chains = [*chains[: k + 1], chains[k].handed_over(found.q[-1], released)]
            continue
        best = max([*made, found], best, key=len)
        if not k or left <= 0.0 or again[k - 1] >= AGAIN:
            return best
        again[k - 1 :] = [again[k - 1] + 1] + [0] * (count - k)
        made.pop()
    return made


def _joined(scenario: Scenario, parts: Sequence[Plan]) -> Plan:
    """The plans of phases one after the other; none where one has none."""
    last, names = parts[-1], [phase.name for phase in scenario.phases]
    keys = dict.fromkeys(key for part in parts for key in part.seconds)
    took = {key: sum(part.seconds.get(key, 0.0) for part in parts) for key in keys}
    named = zip(names, parts, strict=False)
    sentences = [f"phase '{name}': {part.sentence}" for name, part in named]
    if not last.success:
        return replace(last, sentence=sentences[-1], seconds=took)
    ends = np.cumsum([0.0, *(part.t[-1] + scenario.dt for part in parts)])
    return replace(
        last, sentence="\n".join(sentences), seconds=took,
        q=np.concatenate([part.q for part in parts]),
        t=np.concatenate([part.t + end for part, end in zip(parts, ends, strict=False)]),
        timed=np.concatenate([part.timed for part in parts]),
        object=np.concatenate([part.object for part in parts]),
        phase=np.repeat(np.arange(1.0, len(parts) + 1.0), [len(part.t) for part in parts]),
    )  # fmt: skip


def way_round(
    scenario: Scenario, found: RunExplanation, named: str, seconds: float = TRIED
) -> RunExplanation:
    """The explanation of a blocked run, and whether a plan from the start leads to its goal.

    Tried so long, where limits are in the way or a configuration is known at the goal, and a run
    may follow a plan; a search without success is told only of goals with such a configuration.
    ``named`` is what the command line calls the scenario.
    """
    followed = any(phase.leads for phase in scenario.phases)
    if followed or not (found.elsewhere or found.kind == "limits"):
        return found
    command = f"coopqp plan {named}"
    try:
        way = plan(scenario, budget=Budget(seconds=seconds, seed=scenario.seed))
    except CoopqpError as error:
        words = f"; {command} cannot help: {error}" if found.elsewhere else ""
        return replace(found, sentence=found.sentence + words)
    if not (way.success or found.elsewhere):
        return found
    took = f"{sum(way.seconds.values()):.2g} s, {way.length:.3g} rad"
    words = f"{command}: {f'a way round was found in {took}' if way.success else way.sentence}"
    return replace(found, sentence=f"{found.sentence}; {words}", way_round=way.success)


class Planner:
    """Plans in one problem, whose tasks are met at t [s]; ``keep`` as in :func:`plan`."""

    def __init__(self, problem: ControlProblem, t: float, keep: Sequence[str] = ()) -> None:
        self.problem, self.chain, self._t = problem, problem.chain, t
        tasks = {task.name: task for task in placed(problem.tasks, problem.chain)} if keep else {}
        require_known("task with a place", keep, tasks, "keep: ")
        kept = tuple(tasks[name] for name in keep)
        self.space = ClosedSpace(problem, kept, t)
        self.verifier = Verifier(self.space)
        self._looked: Goals | None = None
        self._check_start(kept)

    def _check_start(self, kept: Sequence[Task]) -> None:
        q, space = self.chain.q_start, self.space
        outside = np.maximum(space.bounds.lower - q, q - space.bounds.upper)
        if outside.max(initial=0.0) > 0.0:
            joint = self.chain.joint_names[int(outside.argmax())]
            raise InvalidValueError(
                f"start: {joint} is {outside.max():.3g} outside its limits; ways begin inside"
            ).at("start")
        if kept and (missed := Goal(self.chain, kept, self._t).missed(q)):
            part, error = missed[0]
            raise InvalidValueError(
                f"keep: {part.name} is {size(error, part.part.unit)} off at the start; "
                "what is kept has to be met there"
            )
        if self._off(q[None])[0] > FAR:
            raise InvalidValueError("start: the loops are not closed there").at("start")
        if not space.is_free(q[None])[0]:
            clearance = space.bounds.at(q)
            row = space.bounds.rows[int(clearance.argmin())]
            raise InvalidValueError(
                f"start: {row.label} is {-1e3 * clearance.min():.2f} mm less than its limit keeps; "
                "move the start, or let the limit keep less"
            ).at("start")

    def plan(
        self, budget: Budget, goals: ArrayLike | None = None, progress: Progress = lambda x: None
    ) -> Plan:
        """As :func:`plan`."""
        begun = time.perf_counter()
        found = self.path(budget, goals, progress)
        if not found.success:
            return found
        left = max(budget.seconds - (time.perf_counter() - begun), TIMING)
        try:
            return self._timed(found, left)
        except TimeoutError as error:
            return self._nothing(f"{found.sentence}; {error}", found.seconds)

    def path(
        self, budget: Budget, goals: ArrayLike | None = None, progress: Progress = lambda x: None
    ) -> Plan:
        """The same without times, which have no rows then."""
        begun = time.perf_counter()
        took: dict[str, float] = {}
        ends, why = self._goals(budget, goals, begun)
        took["goals"] = time.perf_counter() - begun
        if not len(ends):
            return self._nothing(why, took)
        start, look = self.chain.q_start[None].copy(), None
        self.space.project(start)

        def wait() -> None:
            progress(min((time.perf_counter() - begun) / budget.seconds, 1.0))

        for turn in itertools.count():
            wait()
            at = time.perf_counter()
            if (left := budget.seconds - (at - begun)) <= 0.0:
                break
            near = ends if goals is not None or turn % 2 else ends[:NEAREST]
            # Some trees grow long, others meet early.
            count = budget.max_projections << min(turn // 2, 16)
            now = replace(budget, seconds=left, seed=budget.seed + turn, max_projections=count)
            q = self._close(self.space.way(start, near, now, wait))
            took["search"] = took.get("search", 0.0) + time.perf_counter() - at
            if not len(q):
                ends = self._more(ends)
                continue
            at = time.perf_counter()
            look = self.verifier.look(q, VERIFIED)
            took["verify"] = took.get("verify", 0.0) + time.perf_counter() - at
            if look.good:
                return self._found(q, look, len(near), took)
            # What the finer look has found, the next search looks for as finely.
            budget = replace(budget, fine=0.5 * budget.fine)
        more = f"; the last path failed the second look: {look.message}" if look else ""
        tried = f"not found in {time.perf_counter() - begun:.1f} s"
        to = f"no path to any of {counted(len(ends), 'goal configuration')}"
        return self._nothing(f"{tried}: {to}; that proves nothing, more time may do{more}", took)

    def _goals(self, budget: Budget, given: ArrayLike | None, begun: float) -> tuple[Array, str]:
        """Goal configurations in the order of :meth:`_ordered`, or why there are none."""
        n = self.chain.n
        if given is not None:
            q = self._given(np.atleast_2d(np.array(given, float)))
            none = no_way(self.space, q)
            ways = np.array([not why for why in none], bool)
            return q[ways], f"{PROVEN}: no motion leads there: {reasons(none)}"
        if proof := too_far(self.problem, self._t):
            return np.zeros((0, n)), proof
        goals, why = Goals(self.problem, self._t, budget.seed), ""
        self._looked = goals
        while len(goals.solutions) < GOALS and goals.tried < MAX_TRIES:
            goals.look()
            if (gone := time.perf_counter() - begun) > 0.5 * budget.seconds:
                why = f"not found in {gone:.1f} s: no goal configuration from {goals.tried} starts"
                why += "; that proves nothing, more time may do"
                break
            if goals.solutions and goals.tried >= MAX_TRIES // 4:
                break
        if not goals.solutions and not goals.cut_off:
            why = why or explained(goals)
        if goals.solutions:
            return self._ordered(goals), "no goal configuration keeps the tasks that are to be kept"
        if goals.cut_off:
            them = f"all {len(goals.cut_off)} goal configurations from {goals.tried} starts"
            why = f"not found: {them} are where no motion leads: {goals.why}"
        return np.zeros((0, n)), why

    def _more(self, ends: Array) -> Array:
        """Look for further goals: those that are known may be where no way from here leads."""
        if not self._looked:
            return ends
        for _ in range(MORE):
            self._looked.look()
        return self._ordered(self._looked)

    def _ordered(self, goals: Goals) -> Array:
        """Those that keep what is to be kept, the nearest that are off the joints' limits first."""
        found = np.array(goals.solutions)
        found = found[self._off(found) < MET]  # which keep what is to be kept
        away = np.linalg.norm(found - self.chain.q_start, axis=1)
        bounds = self.space.bounds
        margin = np.minimum(found - bounds.lower, bounds.upper - found).min(axis=1, initial=OFF)
        return np.asarray(found[np.lexsort((away, margin < OFF))], float)

    def _off(self, q: Array) -> Array:
        """How far each row is from the manifold of what is kept; infinite where no step leads."""
        near = q.copy()
        return np.where(self.space.project(near), np.abs(near - q).max(axis=1), np.inf)

    def _given(self, q: Array) -> Array:
        if q.ndim != 2 or q.shape[1] != self.chain.n or not np.isfinite(q).all():
            raise InvalidValueError(
                f"goals: found shape {q.shape}, needs finite numbers, (k, {self.chain.n})"
            )
        good = (self._off(q) < MET) & self.space.is_free(q)
        if not good.all():
            raise InvalidValueError(
                f"goals[{int(np.argmin(good))}]: is open, outside a limit, or in something"
            )
        self.space.project(q)
        return q

    def _close(self, q: Array) -> Array:
        """The path with points so near to each other that the loops stay closed between them."""
        while len(q) > 1:
            (far,) = np.nonzero(np.linalg.norm(np.diff(q, axis=0), axis=1) > CLOSE)
            if not len(far):
                break
            middle = 0.5 * (q[far] + q[far + 1])
            if not self.space.project(middle).all():
                return q[:0]
            q = np.insert(q, far + 1, middle, axis=0)
        return q

    def _found(self, q: Array, look: Verification, goals: int, took: dict[str, float]) -> Plan:
        sentence = (
            f"found in {sum(took.values()):.2g} s: {lengths(q)[-1]:.3g} rad to one of "
            f"{counted(goals, 'goal configuration')}; {look.points} points verified, loops closed "
            f"within {1e3 * look.open:.1g} mm"
        )
        return replace(self._nothing(sentence, took), success=True, q=q, verification=look)

    def _timed(self, found: Plan, seconds: float) -> Plan:
        clock = Clock(seconds)
        t, ticks = timed(self.problem, found.q, self._allowed, clock)
        if len(t) < 2:  # the start is a goal: a file of it is read back as others
            t, ticks = np.array([0.0, self.problem.dt]), np.repeat(ticks, 2, axis=0)
        poses = (self.chain.object_pose(q) for rows in clock.parts(ticks) for q in rows)
        at = np.array([[*X.translation, *quaternion_of(X.rotation)] for X in poses])
        lasts = f"{found.sentence}; it lasts {t[-1]:.3g} s"
        return replace(found, sentence=lasts, t=t, timed=ticks, object=at)

    def _allowed(self, q: Array) -> Array | None:
        """Rows near the path on the manifold; None where one is not, or something is in the way."""
        near = q.copy()
        return near if self.space.project(near).all() and self.space.is_free(near).all() else None

    def _nothing(self, why: str, took: dict[str, float]) -> Plan:
        n = self.chain.n
        return Plan(
            success=False, sentence=why, joints=self.chain.joint_names, q=np.zeros((0, n)),
            t=np.zeros(0), timed=np.zeros((0, n)), object=np.zeros((0, 7)), seconds=took,
            proven=why.startswith(PROVEN),
        )  # fmt: skip
