"""A plant whose sensors and motors have faults: what is commanded and measured passes through here.

The plant itself is sound. It has a state of its own, which goes on as the motors do; the state of
the controller goes on as it commands, and reads what the faulty sensors say. Of x, which was x_0
when the fault began:

    reversed   -x + 2 x_0 of encoders; -x of speeds, torques and forces
    stuck      x_0 of encoders, torques and forces; 0 of speeds

Where there are several, the next one has what the one before has left.
"""

from collections.abc import Sequence

import numpy as np

from coopqp.base.errors import InvalidValueError, UnknownNameError
from coopqp.base.spec import Array
from coopqp.controller import Command, ControlProblem
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.state import State
from coopqp.plant import Fault, PlantModel


class Injected:
    """A fault of one chain's robot.

    Attributes:
        fault, at: what is wrong, and with which numbers of all joints, or of all hands' wrenches.
        of: what passes through it, "encoder", "motor" or "force"; else "reading".
        place: its keys in a scenario.

    Raises:
        CoopqpError: there is no such joint, motor or arm.
    """

    def __init__(self, index: int, fault: Fault, chain: ClosedChain) -> None:
        self.fault, self.place = fault, ("disturbance", "faults", index)
        of, _, kind = fault.kind.partition("_")
        self.of = of.rstrip("s")
        self._before: Array | None = None
        if fault.arm:
            i = self._index("arm", "arm", fault.arm, [arm.name for arm in chain.robot.arms])
            self.at = np.arange(6 * i, 6 * i + 6)
        elif fault.kind == "encoders_in_degrees":
            self.at = np.flatnonzero(np.array(chain.joint_units) == "rad")
        else:
            key = "joint" if fault.joint else "joints"
            names = fault.joints or ((fault.joint,) if fault.joint else ())
            found = [self._index(key, "joint", name, chain.joint_names) for name in names]
            self.at = np.array(found, int)
        if self.of == "motor" and set(self.at) & set(chain.passive):
            raise InvalidValueError(f"{fault.kind}: a passive joint has no motor").at(*self.place)
        if len(set(self.at)) < len(self.at):
            raise InvalidValueError(f"{fault.kind} needs two joints").at(*self.place, "joints")
        by, about = fault.by or 0.0, 2.0 * (self.of == "encoder")
        slopes = {"reversed": -1.0, "stuck": 0.0, "dead": 0.0, "scaled": by}
        self._slope = {**slopes, "in_degrees": np.rad2deg(1.0)}.get(kind, 1.0)
        self._memory = {"reversed": about, "stuck": 1.0}.get(kind, 0.0)
        self._offset = by if kind == "offset_jump" else 0.0
        self._source = self.at[::-1] if kind == "swapped" else self.at

    def _index(self, key: str, kind: str, name: str, known: Sequence[str]) -> int:
        if name not in known:
            raise UnknownNameError(kind, name, known).at(*self.place, key)
        return known.index(name)

    def alter(self, x: Array, t: float, *, is_rate: bool = False) -> None:
        """Write what becomes of sound numbers at time t [s]; rates have no memory."""
        if not self.fault.acts(t):
            self._before = None
            return
        found = self._slope * x[self._source]
        if not is_rate:
            if self._before is None:
                self._before = x[self.at].copy()
            found += self._memory * self._before + self._offset
        x[self.at] = found


class FaultyPlant(PlantModel):
    """Wraps a plant, which is sound and at its start.

    Where readings are lost, ``q_measured`` is NaN, ``measured`` stays what was read last, and so do
    q and v after a torque command. InvalidValueError: a fault of a force sensor, where there are
    none.
    """

    def __init__(
        self, plant: PlantModel, problem: ControlProblem, faults: Sequence[Injected]
    ) -> None:
        super().__init__()
        self._plant, self._faults, self.signals = plant, faults, plant.signals
        self._dt, self._chain, self._ticks = problem.dt, problem.chain, 0
        self._own = State(problem.chain, plant.measured)
        self._hand_wrench, self._lost = plant.hand_wrench, False
        for fault in faults:
            if fault.of == "force" and self._hand_wrench is None:
                words = "this plant has no force sensors; use plant: rigid_body, quasi_static"
                raise InvalidValueError(f"{fault.fault.kind}: {words} or mujoco").at(*fault.place)
        self.measured: Array = self._own.q.copy()
        self._read(self._own.q)

    @property
    def hand_wrench(self) -> Array | None:
        return None if self._hand_wrench is None else self._hand_wrench.copy()

    def step(self, state: State, command: Command) -> None:
        own, torques = self._own, command.tau is not None
        own.t = state.t
        self._plant.step(own, self._carried_out(command))
        self._ticks += 1
        self.lost = self._plant.lost
        self._read(own.q if torques or own.q_measured is None else own.q_measured)
        state.hand_wrench = self.hand_wrench
        if not torques:
            state.advance(command.v, self._dt)
            silent = np.full(len(own.q), np.nan)
            state.q_measured = silent if self._lost else self.measured.copy()
            return
        state.t += self._dt
        if not self._lost:
            state.q[:], state.v[:], state.q_measured = self.measured, own.v, None
            for fault in self._faults:
                if fault.of == "encoder":
                    fault.alter(state.v, self._t, is_rate=True)

    def truth(self, state: State) -> State:
        true = self._plant.truth(self._own)
        if true is self._own:
            true.update()
        return true

    def resume(self, before: PlantModel) -> None:
        assert isinstance(before, FaultyPlant)
        self._plant.resume(before._plant)
        self._own = State(self._chain, before._own.q)
        self._own.v[:] = before._own.v
        self._faults, self._ticks, self._lost = before._faults, before._ticks, before._lost
        self.measured, self._hand_wrench = before.measured, before._hand_wrench

    @property
    def _t(self) -> float:
        """Time since the run began [s]."""
        return self._ticks * self._dt

    def _carried_out(self, command: Command) -> Command:
        done = command.copy()
        for fault in self._faults:
            if fault.of == "motor":
                x, is_rate = (done.v, True) if done.tau is None else (done.tau, False)
                fault.alter(x, self._t, is_rate=is_rate)
        return done

    def _read(self, q: Array) -> None:
        """Write what the sensors say of joints that are at q and of the hands' forces."""
        read, self._hand_wrench = q.copy(), self._plant.hand_wrench
        for fault in self._faults:
            if fault.of == "encoder":
                fault.alter(read, self._t)
            elif fault.of == "force" and self._hand_wrench is not None:
                fault.alter(self._hand_wrench, self._t)
        self._lost = any(f.of == "reading" and f.fault.acts(self._t) for f in self._faults)
        if not self._lost:
            self.measured = read
