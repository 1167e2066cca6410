"""The control loop: state, tick, plant, trace. The only place with a clock."""

import time
from collections.abc import Callable, Iterable, Iterator

import numpy as np

from coopqp.assessment.limits import audit
from coopqp.base.spec import Array
from coopqp.base.wording import raised
from coopqp.controller import NO_FEATURES, Command, Features, Law
from coopqp.execution.instants import Instants, rows_of
from coopqp.model.state import State
from coopqp.plant import PlantModel
from coopqp.scenario.input import Feed
from coopqp.solver import Status, written
from coopqp.trace import Failure, TickBatch, Trace, no_input

#: Joints that are beyond these are nowhere [rad or m], [rad/s or m/s].
FARTHEST, FASTEST = 1e8, 1e12


class GuardedPlant(PlantModel):
    """Wraps a plant; where it raises or leaves all numbers, everything stays where it was.

    ``broken`` is the failure, empty so far; ``why`` that as a status.
    """

    def __init__(self, plant: PlantModel) -> None:
        super().__init__()
        self._plant, self.broken, self.why = plant, "", Status.PLANT_FAILED
        self.signals, self.measured = plant.signals, plant.measured
        self.ideal = plant.ideal
        self._true: State | None = None  # what is true, where that is not the state itself

    def step(self, state: State, command: Command) -> None:
        if self.broken:
            return
        if self._plant.lost:  # where it was lost everything stays
            self.broken = f"the object is lost: {self._plant.lost}"
            self.why = Status.OBJECT_LOST
            return
        true = self.truth(state)
        states = [state] if true is state else [state, true]
        before = [(each, each.t, each.q.copy(), each.q_measured) for each in states]
        why = ""
        try:
            with np.errstate(all="ignore"):  # what overflows is found below
                self._plant.step(state, command)
                self.measured = self._plant.measured
                self._true = None
                true = self.truth(state)
                if not (_bounded(state) and (true is state or _bounded(true))):
                    why = "its joints run away"
        except KeyboardInterrupt:
            raise
        except BaseException as error:  # noqa: BLE001 - a plant may be the user's, or blow up
            why = raised(error)
        if why:
            self.broken = f"the plant: {why}"
            for each, t, q, measured in before:
                each.t, each.q[:], each.v[:], each.q_measured = t, q, 0.0, measured
                each.update()
            self._true = states[-1]
            for signal in self.signals.values():
                signal[:] = 0.0

    def truth(self, state: State) -> State:
        """As the plant says after its last step that did not fail."""
        if self._true is None:
            self._true = self._plant.truth(state)
        return self._true

    def resume(self, before: PlantModel) -> None:
        self._plant.resume(before)


def _bounded(state: State) -> bool:
    q, v = state.q, state.v
    return bool(q.dot(q) < FARTHEST**2 and v.dot(v) < FASTEST**2)


def settled(q: Array, v: Array) -> bool:
    """Whether joints stayed within bounds at all instants, shapes (T, n) [rad, m; rad/s, m/s]."""
    far, fast = (np.einsum("ti,ti->t", x, x) for x in (q, v))
    return bool((far < FARTHEST**2).all() and (fast < FASTEST**2).all())


Progress = Callable[[int], None]
"""Called now and then with the number of ticks done."""

PROGRESS_EVERY = 50  # ticks
OPTIMAL = (Status.OPTIMAL,)
#: What of a trace a recorder has under the same name, what its ticks have, and its instants.
RECORDED = "t", "commanded", "measured", "loop_offset", "rows_us", "tick_us", "signals", "inputs"
TICKS = "q", "v", "memory", "scale", "compiled"
INSTANTS = "position", "rotation", "task_error", "goal_error", "e", "rate", "points"


def rollout(
    law: Law,
    plant: PlantModel,
    ticks: int,
    *,
    controller: str,
    solver: str | None,
    supports: Features = NO_FEATURES,
    progress: Progress | None = None,
    state: State | None = None,
    feed: Feed | None = None,
    timed: bool = True,
) -> Trace:
    """Run a law on a plant at its start, for so many ticks; name, solver and supports are noted.

    Without timing and on a plant without errors, all ticks are computed at once, with the same bits
    (:meth:`coopqp.controller.Law.run`). ``progress`` is called every few ticks. The run begins in
    ``state``, which is of the law's own start, and is written up to the end; at rest where the
    plant's sensors say when omitted. Nothing arrives at inputs without a ``feed``.
    """
    if state is None:
        state = law.start(q_measured=plant.measured, hand_wrench=plant.hand_wrench)
    guarded = GuardedPlant(plant)
    recorder = _Recorder(law, guarded, state, ticks, alone=feed is None)
    if timed or not recorder.run(state):
        for k, (command, us) in enumerate(drive(law, guarded, state, ticks, feed)):
            recorder.instant(k, state)
            recorder.tick(k, command, us, state)
            if progress and k % PROGRESS_EVERY == 0:
                progress(k)
        recorder.instant(ticks, state)
    if progress:
        progress(ticks)
    return recorder.trace(controller, solver, supports)


def drive(
    law: Law,
    plant: PlantModel,
    state: State,
    ticks: int | Iterable[object],
    feed: Feed | None = None,
) -> Iterator[tuple[Command, float]]:
    """The control loop: take inputs, decide, send the command, step the plant.

    The plant is where the state is, which is written; after the last step its kinematics are up to
    date. There are so many ticks, or as many as there are items. Yielded are the command and how
    long the tick took [us], before the plant carries it out.
    """
    guarded = plant if isinstance(plant, GuardedPlant) else GuardedPlant(plant)
    for _ in range(ticks) if isinstance(ticks, int) else ticks:
        if feed:
            feed.step(state)
        before = time.perf_counter_ns()
        broken = guarded.broken
        command = law.refuse(guarded.why, broken) if broken else law.tick(state)
        yield command, 1e-3 * (time.perf_counter_ns() - before)
        guarded.step(state, command)
        if guarded.broken:
            state.t += law.problem.dt
    if feed:
        feed.step(state)
    state.update()


class _Recorder:
    """Arrays for one run, filled tick by tick, or by many ticks at once."""

    def __init__(
        self, law: Law, plant: PlantModel, start: State, ticks: int, *, alone: bool
    ) -> None:
        problem = law.problem
        n = problem.chain.n
        self._law, self._plant, self._inputs_at_end = law, plant, start.inputs
        alone &= law.force_control is None and not start.inputs
        self.instants = Instants(problem, plant, start, ticks, alone=alone)
        self._offset = start.loop_offset[: len(start.closed_error)].copy()
        self.batch = TickBatch.empty(ticks, n, sum(law.memory_sizes.values()))
        self.t, self.loop_offset = np.zeros(ticks + 1), np.zeros((ticks, len(start.loop_offset)))
        self.commanded, self.measured = np.zeros((ticks, n)), np.full((ticks, n), np.nan)
        self._remembered, self._v_before = start.memory.numbers.copy(), start.v.copy()
        self.tick_us, self.rows_us = np.full((2, ticks), np.nan)
        self.inputs = {n: no_input(c.kind, ticks) for n, c in start.inputs.items()}
        self.signals = {
            name: np.zeros((ticks, *signal.shape)) for name, signal in plant.signals.items()
        }

    def run(self, state: State) -> bool:
        """Compute and record all ticks at once; False where not possible, or joints run away."""
        if not self.instants.at_end:
            return False
        law, t, corrected = self._law, state.t, state.corrected
        q, v, remembered = state.q.copy(), state.v.copy(), state.memory.numbers.copy()
        with np.errstate(all="ignore"):  # what overflows is found below
            batch = law.run(state, len(self.batch.v))
            if not settled(batch.q[1:], batch.v):
                state.t, state.q[:], state.v[:] = t, q, v
                state.memory.numbers[:], state.corrected = remembered, corrected
                state.update()
                return False
        self.t[0], self.t[1:] = t, law.problem.dt
        np.add.accumulate(self.t, out=self.t)  # as tick by tick, to the last digit
        self.batch, self.commanded = batch, batch.q[:-1]
        self.loop_offset[:, : len(self._offset)] = self._offset
        return True

    def instant(self, k: int, state: State) -> None:
        """Record the state before tick k, which is the result of tick k - 1."""
        true = self._plant.truth(state)
        true.inputs = state.inputs
        if k:
            if self._law.command.tau is not None:
                self.batch.v[k - 1] = true.v
            for name, signal in self._plant.signals.items():
                self.signals[name][k - 1] = signal
        self._inputs_at_end = state.inputs
        self.t[k], self.batch.q[k] = state.t, true.q
        self.instants.keep(k, true)

    def tick(self, k: int, command: Command, us: float, state: State) -> None:
        """Record what the law decided in tick k, and from what."""
        closed, batch = len(state.closed_error), self.batch
        self.commanded[k], self.loop_offset[k, :closed] = state.q, state.loop_offset[:closed]
        measured = state.q if command.tau is not None else state.q_measured
        if measured is not None:
            self.measured[k] = measured
        batch.memory[k], self._remembered = self._remembered, state.memory.numbers.copy()
        batch.v[k], self.tick_us[k], batch.scale[k] = command.v, us, command.scale
        batch.compiled[k], self.rows_us[k] = self._law.compiled, self._law.rows_us
        for name, kept in self.inputs.items():
            followed = state.inputs[name]
            kept.value[k], kept.rate[k] = followed.value, followed.rate
            if name in state.inputs.arrived:
                kept.sent[k], kept.arrived[k] = state.inputs.arrived[name]
        if command.causes != OPTIMAL:
            batch.causes[k], batch.notes[k] = command.causes, command.remark

    def trace(self, controller: str, solver: str | None, supports: Features) -> Trace:
        problem, instants, batch = self._law.problem, self.instants, self.batch
        chain, q, v = problem.chain, batch.q, batch.v
        instants.follow(self.t, q, v, self._offset)
        status, failures = [Status.OPTIMAL.name] * len(v), list[Failure]()
        for k, causes in enumerate(batch.causes):
            if causes == OPTIMAL:
                continue
            first, status[k] = causes[0], written(causes)
            if not first.usable:
                failures.append(Failure(k, first.value, batch.notes.get(k, "")))
        return Trace(
            controller=controller,
            solver=solver,
            engine=self._law.engine,
            dt=problem.dt,
            kappa=problem.kappa,
            joints=chain.joint_names,
            units=chain.joint_units,
            lower=chain.lower,
            upper=chain.upper,
            velocity=chain.velocity,
            effort=chain.model.effortLimit.copy(),
            tasks=tuple(info for info, _ in instants.parts),
            manipulability=instants.directional_manipulability(
                self.t[-1], q[[0, -1]], v[-1:].sum(axis=0), self._inputs_at_end
            ),
            loop_position=instants.loop[:, 0],
            loop_orientation=instants.loop[:, 1],
            task_rows=rows_of((*problem.tasks, *problem.wrenches), chain),
            status=tuple(status),
            rows_in_python=self._law.rows_in_python,
            supports=supports,
            failures=tuple(failures),
            **vars(audit(problem.limits, chain, q, v, problem.dt, self._v_before)),
            **{name: getattr(self, name) for name in RECORDED},
            **{name: getattr(batch, name) for name in TICKS},
            **{name: getattr(instants, name) for name in INSTANTS},
        )
