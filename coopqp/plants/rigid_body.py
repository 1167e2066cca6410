"""The closed chain as rigid bodies under joint servos with torque limits.

Integrates the direct dynamic model with the classical Runge-Kutta method at a step that divides
the control period, and projects q and v back on the closed loops after every step.
"""

import numpy as np

from coopqp.base.spec import Array, Positive, spec
from coopqp.closed_loop.dynamics import ClosedLoopDynamics, Friction
from coopqp.closed_loop.grasp_matrix import moved
from coopqp.closed_loop.hands import in_axes, into_contacts, points
from coopqp.controller import ControlProblem
from coopqp.model.closed_chain import ClosedChain
from coopqp.plant import Disturbance, Plant, PlantModel
from coopqp.plants import _dynamic

#: Newton steps on the loops after a small slip.
SLIP_STEPS = 3
#: How far a motor's full torque presses a joint into its stop [rad].
STOP_ANGLE = 0.005
#: Largest natural frequency of a stop times the integration step; Runge-Kutta diverges above 1.4.
STABLE = 0.5


@spec
class RigidBody(Plant):
    """Rigid bodies with joint servos and torque limits, integrated with the loops closed."""

    time_step: Positive = 0.001
    """Integration step; must divide the control period [s]."""
    servo: _dynamic.Servo = _dynamic.Servo()
    """How the joints follow velocity commands."""
    friction: Friction = Friction()
    """In every joint."""
    end_stops: bool = True
    """Whether joints stop at their position limits: full torque presses them in by 5 mrad."""

    def build(self, problem: ControlProblem, seed: int, disturbance: Disturbance) -> PlantModel:
        return RigidBodyModel(problem, self, seed, disturbance)


class RigidBodyModel(_dynamic.DynamicModel):
    """The rigid bodies.

    Attributes:
        signals: also ``cut_wrench`` (6 L,), lambda where all arms but the first are cut off, and
            those of :class:`HandSignals`.

    Hands that press hold the object as if they were fastened, until friction cannot bear it: then
    it is lost, and the run ends.
    """

    def __init__(
        self, problem: ControlProblem, settings: RigidBody, seed: int, disturbance: Disturbance
    ) -> None:
        servo = _dynamic.ServoLaw(problem.chain, settings.servo)
        super().__init__(problem, servo, settings.time_step, seed, disturbance)
        chain, self._settings = problem.chain, settings
        self._open()
        # The trace tells of the arms in the robot's order, whoever holds the object.
        self._order = [chain.arms.index(arm) for arm in chain.robot.arms]
        self.signals["cut_wrench"] = np.zeros(6 * (len(self._order) - 1))
        self.signals |= self.hand_signals.signals

    def attach(self, before: PlantModel) -> None:
        """Hands that attach while they move stop without a bounce."""
        assert isinstance(before, RigidBodyModel)
        true = self.true
        self._open()
        # The object comes with the speed of an arm that has held it.
        carrier = next(iter(before.true.chain.hold.holders), true.chain.arms[0].name)
        shares = [float(arm.name == carrier) for arm in true.chain.arms]
        impact = ClosedLoopDynamics(
            true.chain, shares=shares, mass_scale=self.disturbance.object_mass
        )
        impact.update(true.q, true.v)
        true.v[:] = impact.impact(true.v)

    def grip(self) -> None:
        """The arms yield at once to close the loops as they are now."""
        self.true.close_loops(SLIP_STEPS)
        self._open()

    def _open(self) -> None:
        chain, mass_scale = self.true.chain, self.disturbance.object_mass
        # Where planar arms leave it open who carries the weight, each carries its share.
        self._dynamics = ClosedLoopDynamics(
            chain, shares=chain.alpha, friction=self._settings.friction, mass_scale=mass_scale
        )
        self._stops = EndStops(chain, self.h) if self._settings.end_stops else None
        self._updated = b""  # the state that the dynamics are up to date with

    def integrate(self) -> None:
        """One Runge-Kutta step, then a projection on the closed loops."""
        h, true = self.h, self.true
        q, v, t = true.q, true.v, true.t
        self._follow(q, v)
        if self._stops:
            self._stops.update(self._dynamics)
        a1 = self._acceleration(q, v, t)
        v2 = v + 0.5 * h * a1
        a2 = self._acceleration(q + 0.5 * h * v, v2, t)
        v3 = v + 0.5 * h * a2
        a3 = self._acceleration(q + 0.5 * h * v2, v3, t)
        v4 = v + h * a3
        a4 = self._acceleration(q + h * v3, v4, t)
        q += h / 6.0 * (v + 2.0 * v2 + 2.0 * v3 + v4)
        v += h / 6.0 * (a1 + 2.0 * a2 + 2.0 * a3 + a4)
        true.t += h
        true.update()
        true.close_loops()

    def energy(self) -> tuple[float, float]:
        """Kinetic and potential energy; updates the wrench signals as well."""
        true, dynamics = self.true, self._dynamics
        a = self._acceleration(true.q, true.v, true.t)
        wrenches = dynamics.object_wrenches(a, self._wrench, self.disturbance.wrench(true.t))
        cut = self.signals["cut_wrench"]
        cut[:] = -wrenches.by_arm[1:].ravel()[: len(cut)]
        self._write_hand_signals(wrenches.by_arm)
        self.signals["internal_wrench"][:] = wrenches.internal[self._order].ravel()
        return dynamics.kinetic_energy(true.q, true.v), dynamics.potential_energy(true.q)

    def _write_hand_signals(self, by_arm: Array) -> None:
        """Write the hands' signals; the object is lost where friction cannot bear it."""
        true, signals = self.true, self.hand_signals
        at = points(signals.hands, true.p_WO, true.R_WO)
        wrenches = [moved(h, true.p_WO, p) for h, p in zip(by_arm, at, strict=False)]
        turned = into_contacts(signals.hands, true.R_WO)
        signals.write(np.array(wrenches), at, np.array(list(map(in_axes, wrenches, turned))))
        if signals.pressing:
            signals.bear()
            self.lost = signals.lost

    def _follow(self, q: Array, v: Array) -> None:
        """Bring the dynamics up to date, unless they are, as after the last period's end."""
        state = q.tobytes() + v.tobytes()
        if state != self._updated:
            self._dynamics.update(q, v)
            self._updated = state

    def _acceleration(self, q: Array, v: Array, t: float) -> Array:
        self._follow(q, v)
        dynamics = self._dynamics
        tau = self.servo.torque(q, v)
        if self._stops:
            tau = tau + self._stops.torque(q, v)
        push = self.disturbance.wrench(t)
        result = dynamics.direct(tau if push is None else tau + dynamics.J_object.T @ push)
        self._wrench = result.wrench
        return result.a.copy()


class EndStops:
    """Joint end stops: stiff, damped springs that only push back.

        tau = -k (q - upper) - d v,   k = effort / STOP_ANGLE,   d = 2 sqrt(k W_jj)

    with 1/W_jj the inertia at the joint, the loops closed, so that a joint comes to rest there
    without a bounce. A light joint's spring is softer where the integration step h [s] requires it.
    A joint of the chain that starts beyond a limit has its stop there.
    """

    def __init__(self, chain: ClosedChain, h: float) -> None:
        self._lower = np.minimum(chain.lower, chain.q_start)
        self._upper = np.maximum(chain.upper, chain.q_start)
        effort = _dynamic.full_effort(chain)
        # A passive joint's stop is a part of the hand: as firm as the weakest motor's.
        weakest = effort[effort > 0.0].min(initial=_dynamic.UNLIMITED_EFFORT)
        self._firm = np.where(effort > 0.0, effort, weakest) / STOP_ANGLE
        self._k, self._d = self._firm, np.zeros(chain.n)
        self._max_square = (STABLE / h) ** 2  # of the natural frequency
        self._terms: tuple[Array, Array] | None = None
        self._nothing = np.zeros(chain.n)

    def update(self, dynamics: ClosedLoopDynamics) -> None:
        # Kept until a joint is at its stop, which few are: the inertia takes a decomposition.
        self._terms = dynamics.A.copy(), dynamics.J.copy()

    def torque(self, q: Array, v: Array) -> Array:
        """Torques of the stops on the joints, shape (n,) [N m]; not to be written to."""
        if not (np.count_nonzero(q > self._upper) or np.count_nonzero(q < self._lower)):
            return self._nothing
        if self._terms:
            W = _dynamic.inertia_seen(*self._terms)
            self._k = np.minimum(self._firm, W * self._max_square)
            self._d, self._terms = 2.0 * np.sqrt(self._k * W), None
        above, below = q - self._upper, self._lower - q
        push = np.where(below > 0.0, np.maximum(self._k * below - self._d * v, 0.0), 0.0)
        push -= np.where(above > 0.0, np.maximum(self._k * above + self._d * v, 0.0), 0.0)
        return push
