"""Between messages of ROS and a loop: its robot, its inputs, and who is told what becomes of it.

Messages are any objects with the fields of ROS's own, those of rclpy or of rosbags alike. They are
put into a box by whoever receives them, in whatever thread, and read by the loop's next tick.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from typing import Any, Protocol

import numpy as np

from coopqp.base.errors import InvalidValueError
from coopqp.base.spec import Array
from coopqp.base.wording import raised
from coopqp.online.loop import OnlineLoop
from coopqp.recordings.messages import Remark
from coopqp.ros.clocks import Clocks
from coopqp.ros.diagnosis import HALTS, Diagnosis
from coopqp.ros.joint_states import JointStates
from coopqp.ros.settings import Joints, RosSettings
from coopqp.ros.targets import value_of
from coopqp.signal import Kind

#: Messages that wait for a tick at most; older ones are dropped.
BOX = 1000


class Transport(Protocol):
    """Carries messages."""

    def now(self) -> int:
        """By the clock of stamps [ns]."""

    def command(self, controller: str, velocities: list[float]) -> None:
        """Send velocities of joints [rad/s, m/s], in the order of the controller."""

    def diagnose(self, remarks: Sequence[Remark]) -> None:
        """Send what is to be said."""


class Bridge:
    """A robot and inputs for :func:`coopqp.real_time`, made of messages.

    Args:
        loop: whose robot this is.
        joints: who moves them.
        kinds: of the inputs, by name.
        settings: of the node.
        transport: carries what is said.
    """

    def __init__(
        self,
        loop: OnlineLoop,
        joints: Joints,
        kinds: Mapping[str, Kind],
        settings: RosSettings,
        transport: Transport,
    ) -> None:
        self._loop, self._joints, self._kinds = loop, joints, kinds
        self._settings, self._transport = settings, transport
        self._clocks = Clocks(transport.now, lambda: loop.now)
        self._states = JointStates(joints.names, settings.silent_after)
        self._diagnosis = Diagnosis(loop)
        self._box: deque[tuple[str, Any, float]] = deque(maxlen=BOX)
        self._arrived: dict[str, tuple[list[float], float]] = {}
        self._refused: dict[str, str] = {}
        self._off, self._is_new = np.zeros(loop.problem.chain.n), False
        self._said_at = -np.inf

    def take_joint_state(self, message: Any) -> None:
        """Joint states have come; from any thread."""
        self._box.append(("", message, self._loop.now))

    def take_target(self, name: str, message: Any) -> None:
        """A target has come; from any thread.

        Args:
            name: of the input.
            message: as :func:`coopqp.ros.targets.message_of` says.
        """
        self._box.append((name, message, self._loop.now))

    def read(self) -> Array | None:
        """Where the joints are, if all of them have been told of since it was last asked."""
        if self._box:
            self._clocks.compare()
        while self._box:
            name, message, came = self._box.popleft()
            try:
                sent = self._clocks.own(message.header.stamp)
                if name:
                    value = value_of(self._kinds[name], message, self._settings.frame)
                    self._arrived[name] = value, came if sent is None else sent
                else:
                    self._states.take(message, sent, came)
            except InvalidValueError as error:
                self._refused[name] = str(error)
            except Exception as error:  # noqa: BLE001 - anything can arrive
                self._refused[name] = raised(error)
        found = self._states.read()
        self._is_new = found is not None
        return found

    def inputs(self) -> Mapping[str, tuple[list[float], float]]:
        """What has arrived since it was last asked, as a tick of the loop takes it."""
        arrived, self._arrived = self._arrived, {}
        return arrived

    def write(self, q: Array, v: Array) -> None:
        """Send velocities to the controllers, and now and then what is to be said."""
        velocity = self._held(v)
        for name, places in self._joints.ordered.items():
            self._transport.command(name, velocity[places].tolist())
        self._diagnosis.tick()
        if self._loop.now - self._said_at >= self._settings.diagnostics_every:
            self.say()

    def say(self, why: str = "") -> None:
        """Send what is to be said now.

        Args:
            why: the loop has ended, or could not begin; empty while it goes on.
        """
        self._said_at = self._loop.now
        silence = self._states.silence(self._said_at) or self._states.wrong
        silence = silence or self._refused.pop("", "")
        remarks = self._diagnosis.remarks(why)
        remarks.append(Remark("joint states", 2 if silence else 0, silence, {}))
        stale = self._loop.state.inputs.stale
        for name in self._kinds:
            words = self._refused.pop(name, "") or ("is stale" if name in stale else "")
            remarks.append(Remark(f"input {name}", int(bool(words)), words, {}))
        self._transport.diagnose(remarks)

    def _held(self, v: Array) -> Array:
        """The velocities, and what brings each joint to where it was commanded to be by now.

        Velocities alone would let every joint drift away by what it does not follow exactly. How
        far it is off is known when it says where it is. Where all shall stand still, or nobody
        knows where the joints are, the velocities are left as they are.
        """
        loop, gain = self._loop, self._settings.position_gain
        if not v.any() or HALTS.intersection(loop.command.causes):
            return v
        if self._is_new:
            np.subtract(loop.state.q, loop.measured, self._off)
        most = loop.problem.chain.velocity
        return np.clip(v + gain * self._off, -most, most)
