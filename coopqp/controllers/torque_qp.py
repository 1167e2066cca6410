"""The QP at torque level: accelerations, torques and loop wrenches as variables.

    minimise    sum_i w_i |J_i a + drift_i + 2 g_i e_dot_i + g_i^2 e_i + integral g_i^3 int w_i|^2
              + sum_j w_j |C_j h - wanted_j|^2                     internal wrenches asked for
              + damping |a + v/damping_time|^2 + effort |tau|^2 + grip |h_int|^2
    subject to  A a + H = S' tau - sum_i J_i' h_i                  dynamics of the arms   (hard)
                G h = M a_o + b                                    of the object          (hard)
                J_c a = -Jdot_c v - 2 kappa J_c v - kappa^2 e      loop acceleration      (hard)
                |tau| <= effort limits                             motors                 (hard)
                lb <= v + a dt <= ub,  G (v + a dt) <= h          the scenario's limits  (hard)
                h_i in its cone, friction over safety, at both ends of the tick (``program``)

h are the wrenches of the hands on the object, and h_int their internal part that no task asks for
(``hand_wrenches``). Hard tasks are equalities, and soft tasks of a later priority act in the null
space of the earlier ones (``program``). Between hands that press, friction and not the model
decides their relative pose: kappa^2 e is left out there.

g_i is the task's gain, w_i the deviation of the error from its reference model (``margins``), so
that a step of the reference does not overshoot. While a motor is at its limit the integral is held.
Gains and integrals that oscillate with commands one tick late are refused. lb, ub, G, h are the
scenario's limits on the next velocity, but a joint near its stop must slow down in time:
v + a dt <= (upper - q)/brake_time. A velocity beyond a limit recovers with the largest
acceleration.
"""

from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import Field

from coopqp.base.errors import InvalidValueError
from coopqp.base.qp import QP
from coopqp.base.rank import least_squares
from coopqp.base.spec import Array, NonNegative, Positive, spec
from coopqp.closed_loop.dynamics import ClosedLoopDynamics
from coopqp.closed_loop.hands import WrenchStack
from coopqp.controller import Command, Controller, ControlProblem, Features, Law
from coopqp.grasp import SAFETY
from coopqp.model.state import State
from coopqp.qp_law.bounds import Bounds
from coopqp.solver import Solution, Status
from coopqp.torque_law import hand_wrenches, margins, task_dynamics
from coopqp.torque_law.program import Costs, HeldTorques, Layout, programs

#: Ticks in which a motion may die out, or a joint brake, at the fastest.
MIN_TICKS = 4


@spec
class TorqueQp(Controller):
    """QP at torque level: dynamics and loops hard, motor, joint and acceleration limits hard."""

    uses_solver: ClassVar[bool] = True
    supports: ClassVar[Features] = frozenset({"limits", "modes", "priorities", "forces"})

    integral: NonNegative = 0.3
    """Weight of the integral over gain cubed; refused where it oscillates, from 0.8 on or less."""
    damping: Positive = 1e-5
    """Cost of squared accelerations that do not brake [s4/rad2]."""
    damping_time: Positive = 0.05
    """Motion that no task asks for dies out in this time [s]."""
    effort: Positive = 1e-5
    """Cost of squared motor torques [1/(N m)2]; decides how redundant motors share."""
    grip: Positive = 1e-4
    """Cost of squared internal wrenches that no task asks for, torques over 10 cm [1/N2]."""
    split: Literal["virtual_inertia", "walker"] = "virtual_inertia"
    """What counts as internal: virtual_inertia spares the hands torques, walker shares them too."""
    shares: dict[str, NonNegative] | Literal["weights", "motors"] = "weights"
    """Share of the load by arm, with sum 1; weights: as in the object's pose; motors: as they have
    left."""
    safety: Annotated[float, Field(ge=1.0, le=10.0)] = SAFETY
    """Friction of hands that press is counted on over this."""
    external_wrench: Literal["unknown", "observed", "measured"] = "unknown"
    """Of the surroundings on the object: observed from joints and torques, by the generalised
    momentum, or measured by sensors in the hands. Hands then bear it, and impedances feel it."""
    observer_gain: Positive = 50.0
    """One over the time in which a push is followed [1/s]; at most 1/dt."""
    brake_time: Positive = 0.05
    """A joint may move towards its stop at most at the distance over this time [s]."""
    acceleration: Positive = 500.0
    """Largest joint acceleration [rad/s2]."""

    def __post_init__(self) -> None:
        if self.external_wrench == "unknown" and self.observer_gain != TorqueQp.observer_gain:
            raise ValueError(
                f"observer_gain: found {self.observer_gain:g}, but nothing is observed; add "
                "external_wrench: observed or measured, or leave it out"
            )

    @property
    def commands_torques(self) -> bool:
        return True

    def build(self, problem: ControlProblem) -> Law:
        """Refuse tasks that the motors cannot decide, gains and integrals that oscillate."""
        name = self.name
        for task in problem.tasks:
            if task.mode == "scaled":
                raise InvalidValueError(
                    f"{name}: task '{task.name}' is scaled; accelerations are soft or hard"
                )
        task_dynamics.require_motor_freedom(problem, name, free=True)
        margins.require_damped_models(problem, name)
        hand_wrenches.require_forces(problem, self.safety, name)
        knows = self.external_wrench != "unknown"
        task_dynamics.require_impedances(
            problem, task_dynamics.TaskDynamics(problem), name, knows_wrench=knows
        )
        self._require_times(problem.dt)
        self._require_damped_integral(problem)
        return TorqueQpLaw(problem, self)

    def observer(
        self, dynamics: ClosedLoopDynamics, dt: float
    ) -> hand_wrenches.MomentumObserver | hand_wrenches.HandSensors | None:
        """The estimator of the external wrench, for a control period [s]; None where unknown."""
        if self.external_wrench == "unknown":
            return None
        if self.external_wrench == "measured":
            return hand_wrenches.HandSensors(dynamics, gain=self.observer_gain, dt=dt)
        try:
            return hand_wrenches.MomentumObserver(dynamics, gain=self.observer_gain, dt=dt)
        except InvalidValueError as error:
            raise InvalidValueError(f"{self.name}: observer_{error}") from None

    def _require_times(self, dt: float) -> None:
        """What dies out or brakes within a tick or two overshoots, and passes the stop."""
        for key in ("damping_time", "brake_time"):
            found = getattr(self, key)
            if found < MIN_TICKS * dt:
                raise InvalidValueError(
                    f"{self.name}.{key}: found {found:g} s, needs at least {MIN_TICKS} ticks, "
                    f"{MIN_TICKS * dt:g} s"
                )

    def _require_damped_integral(self, problem: ControlProblem) -> None:
        dt = problem.dt
        for task in problem.tasks:

            def holds(integral: float, gain: float = task.gain) -> bool:
                return margins.damped(margins.row_loop(gain, integral, dt))

            if not holds(self.integral):
                raise InvalidValueError(
                    f"{self.name}.integral: found {self.integral:g}, needs at most "
                    f"{margins.largest(holds, self.integral):g} at gain {task.gain:g} 1/s (task "
                    f"{task.name}) and dt {1e3 * dt:g} ms; more oscillates, so lower it"
                )


class TorqueQpLaw(Law):
    """The QPs of one problem; memory: those of ReferenceModel, HeldTorques and the observer.

    There is one of ``programs`` a level of priority, and ``wrenches`` has rows of tasks on hands'.
    """

    def __init__(self, problem: ControlProblem, settings: TorqueQp) -> None:
        super().__init__(problem, torques=True, gives_way=True)
        self.settings = settings
        self._level = level = task_dynamics.TaskDynamics(problem)
        chain, dynamics = problem.chain, level.dynamics
        start = State(chain)
        self._bounds = Bounds(problem.limits, start, problem.dt, settings.brake_time)
        self.hands = hand_wrenches.HandWrenches(
            chain, safety=settings.safety, split=settings.split, shares=settings.shares
        )
        self.wrenches = WrenchStack(problem.wrenches, start)
        costs = Costs(settings.damping, settings.damping_time, settings.effort, settings.grip)
        self.layout = Layout(level, self.hands, self.wrenches, self._bounds, costs)
        self.programs = programs(problem, self.layout)
        self._has_hard = bool(level.tasks.hard.any() or self.wrenches.hard.any())
        self._wrench: Array | None = None
        self._effort = chain.model.effortLimit[dynamics.actuated]
        self._impedances = task_dynamics.Impedances(problem, level)
        self._followed = self._impedances.others
        self._model = margins.ReferenceModel(level.gains[self._followed], problem.dt)
        self._integral_gains = settings.integral * level.gains[self._followed]
        self._estimator = settings.observer(dynamics, problem.dt)
        self._held_torques = HeldTorques(self.hands, self.layout, dynamics)
        sizes = self._model.memory_sizes | self._held_torques.memory_sizes
        self.memory_sizes = sizes | (self._estimator.memory_sizes if self._estimator else {})

    @property
    def qp(self) -> QP:
        return self.programs[0].qp

    @property
    def solution(self) -> Solution:
        return self.programs[0].solution

    def decide(self, state: State) -> Command:
        """Assemble, solve, verify; without a usable solution the motors hold and brake."""
        command = self.command
        self.assemble(state)
        x, causes = self._solved(state)
        command.say(*causes)
        if self._estimator and self._estimator.fault:  # the hands' wrenches were not measured
            command.add(Status.FORCE_NOT_MEASURED, self._estimator.fault)
        assert command.tau is not None
        command.tau[:] = 0.0
        self._held_torques.remember(state, self.qp, x)
        if x is not None:
            tau = x[self.layout.tau]
            command.tau[self._level.dynamics.actuated] = tau
            integrate = bool((np.abs(tau) < self._effort).all())
            followed = self._followed
            self._model.update(state.memory, self._level.tasks.e[followed])
            self._model.advance(state.memory, self._level.e_dot[followed], integrate=integrate)
        else:
            command.tau[:] = self._level.holding(state, self.settings.damping_time)
        self._remember(state)
        return command

    def assemble(self, state: State) -> None:
        """Evaluate tasks, dynamics, hands and limits at a state, and fill the first level's QP."""
        self._level.update(state)
        self._impedances.update()
        self.hands.update(state, self._level.dynamics)
        self.wrenches.update(state)
        self._bounds.update(state)
        known = self._estimator
        self._wrench = known.update(state) if known else self._impedances.guess()
        self._fill(0, state, None)
        self._held_torques.foresee(state, self.qp)

    def _fill(self, number: int, state: State, before: Array | None, soften: bool = False) -> None:
        self.programs[number].assemble(
            state, self._wanted(state), self._limits(state), self._loops(state), before,
            soften=soften, wrench=self._wrench,
        )  # fmt: skip

    def _solved(self, state: State) -> tuple[Array | None, tuple[Status, ...]]:
        """The solution with all constraints; else hard tasks softened; else cones violated."""
        x, status = self._solve_levels(state)
        if x is not None or status is not Status.INFEASIBLE:
            return x, (status,)
        relaxed: tuple[Status, ...] = ()
        if self._has_hard:
            x, status = self._solve_levels(state, soften=True)
            relaxed = (Status.TASKS_RELAXED,)
        if x is None and self.hands.pressing:
            x, status = self._solve_levels(state, soften=True, keep=False)
            relaxed = (*relaxed, Status.CONTACT_GIVEN_UP)
        return (x, relaxed) if x is not None else (None, (status,))

    def _solve_levels(
        self, state: State, *, soften: bool = False, keep: bool = True
    ) -> tuple[Array | None, Status]:
        """The solution of the last level that has one, and the status of the first."""
        x, first = None, Status.OPTIMAL
        for i, program in enumerate(self.programs):
            program.keep_cones(keep=keep)
            if i or soften:
                self._fill(i, state, x, soften)
            status = program.solve()
            if i == 0:
                first = status
            if not status.usable:
                break
            x = program.solution.v
        return x, first

    def _wanted(self, state: State) -> Array:
        """J a that the rows of all tasks ask for."""
        level, gains, given = self._level, self._level.gains, self._impedances
        held = level.tasks.e.copy()
        held[self._followed] += self._integral_gains * state.memory["integral"]
        wanted = -gains * (2.0 * level.e_dot + gains * held)
        if len(given.rows) and self._wrench is not None:
            wanted[given.rows] = given.accelerations(self._wrench, self._correction(state))
        return np.asarray(wanted - level.drift, float)

    def _loops(self, state: State) -> Array:
        """J_c a with which open loops close."""
        return np.asarray(-self._level.dynamics.drift - self._correction(state), float)

    def _correction(self, state: State) -> Array:
        return self.hands.loop_correction(state, self._level.dynamics, self.problem)

    def _limits(self, state: State) -> tuple[Array, Array, Array, Array]:
        """The limits on v + a dt as bounds and rows on a."""
        bounds, v = self._bounds, state.v
        dt, max_a = self.problem.dt, self.settings.acceleration
        upper = np.clip((bounds.ub - v) / dt, -max_a, max_a)
        lower = np.clip((bounds.lb - v) / dt, -max_a, max_a)
        # No row asks for more than the joints' acceleration can give.
        upper_rows = (bounds.h - bounds.G.dot(v)) / dt
        upper_rows = np.maximum(upper_rows, -max_a * np.abs(bounds.G).sum(axis=1))
        return np.minimum(lower, upper), upper, bounds.G, upper_rows

    def learned(self, state: State) -> Array:
        """Accelerations of the joints that the integral adds, by wrong masses and pushes, (n,)."""
        level, followed = self._level, self._followed
        wanted, g = np.zeros_like(level.gains), level.gains[followed]
        wanted[followed] = -(g**2) * self._integral_gains * state.memory["integral"]
        X, J = level.inverse_inertia(), level.tasks.J
        return np.asarray(X @ J.T @ least_squares(J @ X @ J.T, wanted))

    def hold_still(self, state: State) -> None:
        assert self.command.tau is not None
        self._held_torques.remember(state, self.qp, None)
        self.command.tau[:] = self._level.holding(state, self.settings.damping_time)
        self._remember(state)

    def _remember(self, state: State) -> None:
        """Keep what the motors do until the next tick, for the observer."""
        if isinstance(self._estimator, hand_wrenches.MomentumObserver):
            state.memory["observer.tau"][:] = self.command.tau
