"""Arms whose servos sag and hands whose grips yield: statics, with the servos' lag and no masses.

Joint servos are springs K with a first-order lag T, and hand i holds the rigid object by a spring
at its point, k and k (0.03 m)^2, whose rest may creep or slip by s_i. With the spring's extension
d_i and the wrench h_i of the hand on the object,

    K (q_d - q - T q') + feed-forward - weight = sum_i J_i' h_i,    sum_i G_i h_i + w = 0
    h_i = k (d_i - s_i),    s_i' = h_i / c (creep)  or  |f_i| <= limit (slip)

is solved for the end of each control period, linearised at its beginning (implicit Euler). So it is
stable at every period, and a tick costs some 0.3 ms. With e the loop error, S = J_c K^-1 J_c' and C
the compliance of two grips, a pair of arms at rest has the internal force (e - s) / (S + C).
"""

from collections.abc import Mapping
from typing import ClassVar

import numpy as np
import pinocchio as pin

from coopqp.base.spec import Array, NonNegative, Positive, spec
from coopqp.closed_loop.grasp_matrix import grasp_matrix, moved
from coopqp.closed_loop.hands import in_axes, into_contacts, points
from coopqp.controller import Command, ControlProblem
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.loop_observer import GRIP_SIZE, by_joint
from coopqp.model.state import State
from coopqp.plant import Disturbance, Plant, PlantModel
from coopqp.plants._dynamic import DynamicModel, Servo, ServoLaw

#: Damping of joints without a motor, such as hinges [N m s/rad].
PASSIVE_DAMPING = 1e-3
#: A joint that friction holds moves by at most this in a step [rad].
STUCK = 1e-9
#: Iterations of what depends on itself: friction of joints, slip of hands; and when they agree.
ITERATIONS, AGREED = 30, 1e-6
#: A hand that has slipped by more than this has lost the object [m].
LOST = 0.05


@spec
class QuasiStatic(Plant):
    """Servos as springs that sag, grips that yield, creep or slip: statics, fast at any period."""

    takes_torques: ClassVar[bool] = False
    feels: ClassVar[tuple[str, ...]] = ("object_mass", "push", "noise_position", "delay")

    stiffness: Positive | Mapping[str, Positive] | None = None
    """Of the servos, one for all or by joint [N m/rad]; full torque at 0.05 rad if omitted."""
    lag: NonNegative = 0.03
    """Time after which a joint has done 63 % of a step [s]."""
    integral_time: Positive | None = None
    """In which an integral part of the servos removes the sag [s]; none if omitted."""
    joint_friction: NonNegative = 0.0
    """Coulomb friction of every motor's joint [N m]."""
    arms_compensated: NonNegative = 1.0
    """Share of the arms' own weight in the servos' feed-forward."""
    object_compensated: NonNegative = 1.0
    """Share of the object's modelled weight there, split by the arms' weights in the pose."""
    grip: Positive = 1e6
    """Stiffness of each hand's grip [N/m], and (0.03 m)^2 of it about axes [N m/rad]."""
    creep: Positive | None = None
    """Force over speed with which a grip creeps [N s/m], and (0.03 m)^2 of it; none if omitted."""
    slip_force: Positive | None = None
    """Force beyond which a hand slips along the object [N]; none if omitted."""

    def build(self, problem: ControlProblem, seed: int, disturbance: Disturbance) -> PlantModel:
        return QuasiStaticModel(problem, self, seed, disturbance)


class SpringServo(ServoLaw):
    """Servos of the given stiffness, that only take commands: the plant solves for the joints."""

    def __init__(self, chain: ClosedChain, settings: QuasiStatic) -> None:
        super().__init__(chain, Servo())
        self.stiffness = by_joint(chain, settings.stiffness, self.stiffness, "stiffness")
        self.stiffness[chain.passive] = 0.0

    def begin(self, command: Command, q: Array) -> None:
        self._v_d[:] = command.v

    def setpoint(self, h: float) -> Array:
        return np.asarray(self._q_d + h * self._v_d, float)


class QuasiStaticModel(DynamicModel):
    """The springs.

    Attributes:
        signals: ``tau``, the motors' torques with what holds the arms' own weight, without a limit;
            ``slip`` (N,), how far each grip has crept or slipped [m]; those of
            :class:`DynamicModel` and of :class:`HandSignals`.
    """

    def __init__(
        self, problem: ControlProblem, settings: QuasiStatic, seed: int, disturbance: Disturbance
    ) -> None:
        servo = SpringServo(problem.chain, settings)
        super().__init__(problem, servo, problem.dt, seed, disturbance)
        self._settings = settings
        self._order = [arm.name for arm in problem.chain.robot.arms]
        self._crept = np.zeros((len(self._order), 6))
        self._integral = np.zeros(problem.chain.n)
        self._X_WO = self.true.chain.object_pose(self.true.q)
        self.signals["slip"] = np.zeros(len(self._order))
        self.grip()
        self.signals |= {k: v for k, v in self.hand_signals.signals.items() if k != "slip"}

    def truth(self, state: State) -> State:
        """Before noise; the object is where it is between hands that yield."""
        truth = super().truth(state)
        closed = len(truth.closed_error)
        truth.loop_offset[:closed] = truth.loop_error[:closed]
        truth.update_drift()
        truth.p_WO[:], truth.R_WO[:] = self._X_WO.translation, self._X_WO.rotation
        return truth

    def attach(self, before: PlantModel) -> None:
        """Arms that take hold do so without a force."""
        assert isinstance(before, QuasiStaticModel)
        self._X_WO, self._integral = before._X_WO.copy(), before._integral
        self._crept = before._crept.copy()
        self.grip()
        held = before.true.chain.hold.holders
        for i, d in zip(self.hand_signals.at, self._placed()[0], strict=True):
            if self._order[i] not in held:
                self._crept[i] = d

    def grip(self) -> None:
        """Follow the true chain: where its hands' points are on the object."""
        chain = self.true.chain
        self.hand_signals.follow(chain)
        self._hands, self._data = self.hand_signals.hands, chain.model.createData()
        self._moves = np.ones(chain.n, bool)
        self._moves[chain.passive] = False

    def integrate(self) -> None:
        true, servo, h, settings = self.true, self.servo, self.h, self._settings
        assert isinstance(servo, SpringServo)
        d, J = self._placed()
        G = grasp_matrix(self._on_object(), self._X_WO.translation)
        behind = np.where(self._moves, servo.setpoint(h) - true.q, 0.0)
        if settings.integral_time:
            self._integral += h / settings.integral_time * behind
        forward = self._feed_forward(J)
        B_1 = np.where(self._moves, servo.stiffness * (1.0 + settings.lag / h), PASSIVE_DAMPING / h)
        push = servo.stiffness * (behind + self._integral) + forward
        rest = self._crept[self.hand_signals.at]
        step, turn, wrench, slipped = self._solved(J, G, (d - rest).ravel(), B_1, push)
        true.q += step
        true.t += h
        X = self._X_WO
        self._X_WO = pin.SE3(pin.exp3(turn[3:]) @ X.rotation, X.translation + turn[:3])
        self._crept[self.hand_signals.at] += slipped.reshape(-1, 6)
        self._wrench, self._at = wrench.reshape(-1, 6), self._on_object()
        own = pin.computeGeneralizedGravity(true.chain.model, self._data, true.q)
        servo.tau[:] = np.where(self._moves, own + J.T @ wrench, 0.0)
        servo.requested[:] = servo.tau

    def _solved(
        self, J: Array, G: Array, strained: Array, B_1: Array, push: Array
    ) -> tuple[Array, Array, Array, Array]:
        """Joints' step, object's twist, hands' wrenches, and how far the grips give way."""
        h, settings, n = self.h, self._settings, len(strained)
        unit = np.tile(np.repeat([1.0, GRIP_SIZE**-2], 3), len(self._hands))
        creeps = (h / settings.creep if settings.creep else 0.0) * unit
        soft = np.zeros(n + len(B_1))  # compliances of slip, stiffnesses of friction
        A, b = np.zeros((n + 6, n + 6)), np.zeros(n + 6)
        A[n:, :n], A[:n, n:] = G, G.T
        b[n:] = -self._load()
        for _ in range(ITERATIONS):
            slips, B = soft[:n], 1.0 / (B_1 + soft[n:])
            A[:n, :n] = (J * B) @ J.T
            A[range(n), range(n)] += unit / settings.grip + creeps + slips
            b[:n] = strained + J @ (B * push)
            if not n:  # the object stands
                A[:], b[:] = np.eye(6), 0.0
            found = np.asarray(np.linalg.solve(A, b), float)
            wrench, turn = found[:n], found[n:]
            step = B * (push - J.T @ wrench)
            sticks = self._moves * settings.joint_friction / np.maximum(np.abs(step), STUCK)
            before, soft = soft, np.concatenate([self._slipping(wrench, slips), sticks])
            if (np.abs(soft - before) <= AGREED * np.abs(soft)).all():
                break
        return step, turn, wrench, (creeps + soft[:n]) * wrench

    def _slipping(self, wrench: Array, slips: Array) -> Array:
        """Compliance with which hands slip, so that their forces are at the limit [m/N]."""
        max_force, firm = self._settings.slip_force, 1.0 / self._settings.grip
        if max_force is None:
            return slips
        found = np.zeros((len(self._hands), 6))
        sizes = np.linalg.norm(wrench.reshape(-1, 6)[:, :3], axis=1)
        found[:, :3] = np.maximum((slips[::6] + firm) * sizes / max_force - firm, 0.0)[:, None]
        return found.ravel()

    def energy(self) -> tuple[float, float]:
        """No kinetic energy, and the potential one of weight; updates the signals as well."""
        self.true.update()
        X, chain = self._X_WO, self.true.chain
        at_hands = zip(self._wrench, self._at, strict=True)
        by_arm = np.reshape([moved(w, p, X.translation) for w, p in at_hands], (-1, 6))
        turned = into_contacts(self._hands, X.rotation)
        in_contacts = np.array(list(map(in_axes, self._wrench, turned)))
        self.hand_signals.write(self._wrench, self._at, in_contacts)
        self.hand_signals.split(by_arm, chain.alpha)
        slip = self.signals["slip"]
        slip[:] = np.linalg.norm(self._crept[:, :3], axis=1)
        for i in self.hand_signals.at:
            if slip[i] > LOST:
                self.lost = self.lost or f"{self._order[i]} has slipped by {1e3 * slip[i]:.0f} mm"
        held = -self._load()[:3] @ X.translation
        return 0.0, float(pin.computePotentialEnergy(chain.model, self._data, self.true.q) + held)

    def _placed(self) -> tuple[Array, Array]:
        """How far hands' points are from where the object has them, (N, 6), and the Jacobian."""
        chain, data, d, J = self.true.chain, self._data, list[Array](), list[Array]()
        pin.computeJointJacobians(chain.model, data, self.true.q)
        for hand, frame in zip(self._hands, chain.frames, strict=False):
            X = pin.updateFramePlacement(chain.model, data, frame)
            here, there = X * hand.X_OC, self._X_WO * hand.X_OC
            turn = pin.log3(here.rotation @ there.rotation.T)
            d.append(np.concatenate([here.translation - there.translation, turn]))
            J_own = pin.getFrameJacobian(chain.model, data, frame, pin.LOCAL_WORLD_ALIGNED)
            J_own[:3] -= pin.skew(here.translation - X.translation) @ J_own[3:]
            J.append(J_own)
        return np.reshape(d, (-1, 6)), np.reshape(J, (-1, chain.n))

    def _on_object(self) -> Array:
        """The hands' points as the object has them, shape (N, 3)."""
        return points(self._hands, self._X_WO.translation, self._X_WO.rotation)

    def _weight(self, share: float) -> Array:
        """What the weight of that share of the mass does to the object at its origin, (6,)."""
        chain, com = self.true.chain, self._X_WO.rotation @ np.array(self.true.chain.held.com)
        force = share * chain.held.mass * chain.model.gravity.linear
        return moved(np.append(force, np.zeros(3)), com, np.zeros(3))

    def _load(self) -> Array:
        """What weight and pushes do to the object at its origin, shape (6,)."""
        load = self._weight(self.disturbance.object_mass)
        push = self.disturbance.wrench(self.true.t)
        return load if push is None else load + push

    def _feed_forward(self, J: Array) -> Array:
        """Feed-forward less the arms' own weight, shape (n,) [N m]."""
        settings, chain = self._settings, self.true.chain
        own = pin.computeGeneralizedGravity(chain.model, self._data, self.true.q)
        carried, origin = -self._weight(settings.object_compensated), self._X_WO.translation
        at = zip(chain.alpha, self._on_object(), strict=False)
        wrenches = np.ravel([a * moved(carried, origin, p) for a, p in at])
        torque = (settings.arms_compensated - 1.0) * own + J.T @ wrenches
        return np.where(self._moves, torque, 0.0)
