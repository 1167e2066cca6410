"""Between messages of ROS and an online loop: its robot, its inputs and its diagnostics.

Messages are any objects with the fields of ROS's own, those of rclpy or of rosbags alike. They are
put into a queue by whoever receives them, in whatever thread, and read by the loop's next tick.
"""

import math
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Annotated, Any, Literal

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from pydantic import Field

from coopqp.base.errors import InvalidValueError, require_known, short
from coopqp.base.qp import Row
from coopqp.base.spec import Array, NonNegative, Positive, spec
from coopqp.base.wording import raised
from coopqp.model.closed_chain import AXES, ClosedChain
from coopqp.model.notes import Why, note_of
from coopqp.online.loop import OnlineLoop
from coopqp.online.phases import OBJECT_POSE, Gripper
from coopqp.recordings.messages import AT, BROKEN, NS, Remark, level_of
from coopqp.scenario.scenario import Scenario
from coopqp.signal import POSE as KIND_OF_POSE
from coopqp.signal import Kind
from coopqp.solver import STANDS, Status, written

JOINT_STATE = "sensor_msgs/msg/JointState"
POSE = "geometry_msgs/msg/PoseStamped"
TWIST = "geometry_msgs/msg/TwistStamped"
Commanded = Literal["velocity", "position", "trajectory"]
QUEUE_SIZE = 1000  # messages that wait for a tick at most; older ones are dropped


@spec
class RosSettings:
    """Parameters of the node."""

    controllers: Annotated[list[str], Field(min_length=1)]
    """Of ros2_control; each is sent its joints' commands."""
    command: Commanded = "velocity"
    """Velocities or positions on /NAME/commands, or a point each tick on /NAME/joint_trajectory."""
    law: str = "qp"
    """The scenario's controller that decides."""
    reference: Literal["commanded", "measured"] = "commanded"
    """As :class:`coopqp.OnlineLoop` has it, and so the next one."""
    grasp: Literal["as_held", "as_written"] = "as_held"
    """Whether the object is held as the hands are at the first tick."""
    joint_states: str = "/joint_states"
    """Topic of the measured joint positions."""
    frame: str = "world"
    """The scenario's world in ROS; targets in another frame are refused."""
    object_frame: str = ""
    """The object's frame on /tf, as commanded; not published if empty."""
    silent_after: Positive = 0.1
    """How long joint states may fail to come before the robot counts as silent [s]."""
    patience: Positive = 0.25
    """How long after that the loop stops [s]."""
    position_gain: NonNegative = 1.0
    """Gain on each joint's distance from its commanded position, of velocity commands [1/s]."""
    diagnostics_every: Positive = 0.1
    """Time between two messages on /diagnostics [s]."""
    out: str = ""
    """Folder for the session; none if empty."""


def ros_name(joint: str) -> str:
    """What ROS calls a joint; of several robots in one scenario ``left/joint1`` is left_joint1."""
    return joint.replace("/", "_")


@dataclass(frozen=True)
class Joints:
    """The robot's joints without the grasps' passive ones, and which controller moves them."""

    names: tuple[str, ...]  # in ROS, in the loop's order
    orders: Mapping[str, Sequence[str]]  # each controller's joints, in its order
    ordered: Mapping[str, NDArray[np.intp]]  # their indices in q


def joints_of(
    chain: ClosedChain, controllers: Sequence[str], orders: Mapping[str, Sequence[str]]
) -> Joints:
    """Which controller of ros2_control moves which joint; without an order a single one moves all.

    CoopqpError: a joint is unknown, moved twice or not at all, or an order is missing.
    """
    own = np.setdiff1d(np.arange(chain.n), chain.passive)
    index = {ros_name(chain.joint_names[i]): int(i) for i in own}
    named: dict[str, Sequence[str]] = {}
    moved: list[str] = []
    for name in controllers:
        given = orders.get(name) or (list(index) if len(controllers) == 1 else [])
        if not given:
            words = "several controllers need each their joints, in their order"
            raise InvalidValueError(f"{name}.joints: {words}")
        require_known("joint", given, index, f"{name}.joints: ")
        for joint in given:
            if joint in moved:
                raise InvalidValueError(f"{name}.joints: '{joint}' is there twice")
            moved.append(joint)
        named[name] = given
    if left := [joint for joint in index if joint not in moved]:
        raise InvalidValueError(f"joints: no controller moves {', '.join(left)}")
    ordered = {name: np.array([index[x] for x in given]) for name, given in named.items()}
    return Joints(tuple(index), named, ordered)


def kinds_of(scenario: Scenario) -> dict[str, Kind]:
    """Of the inputs that messages can give, the object's place among them where it may stand."""
    kinds = {name: kind for name, kind in scenario.followed().items() if name in scenario.inputs}
    return kinds | ({OBJECT_POSE: KIND_OF_POSE} if scenario.stands else {})


def message_of(kind: Kind) -> str:
    """The type of message that an input takes."""
    return JOINT_STATE if kind.each else TWIST if kind.velocity else POSE


def value_of(kind: Kind, message: Any, frame: str) -> list[float]:
    """The value of an input in a message of the type :func:`message_of`.

    Of a pose a point takes the position, a rotation and a direction (its z axis) the orientation.
    InvalidValueError: it is in another frame than ``frame`` or none, or lacks a joint.
    """
    if kind.each:
        names = _names(message)
        values = dict(zip(names, message.position, strict=True))
        if missing := [name for name in map(ros_name, kind.columns) if name not in values]:
            has = ", ".join(names) or "none"
            raise InvalidValueError(f"has no position of {', '.join(missing)}; has {has}")
        return [float(values[ros_name(name)]) for name in kind.columns]
    given = str(message.header.frame_id)
    if given not in ("", frame):
        raise InvalidValueError(f"is in frame '{given}', needs '{frame}'; transform it before")
    if kind.velocity:
        parts = (message.twist.linear, message.twist.angular)
        twist = dict(zip(AXES, (c for v in parts for c in (v.x, v.y, v.z)), strict=True))
        return [float(twist[axis]) for axis in kind.columns]
    p, q = message.pose.position, message.pose.orientation
    place, turned = [p.x, p.y, p.z], [q.x, q.y, q.z, q.w]
    return [float(x) for x in (place if kind.numbers else []) + (turned if kind.turns else [])]


def _names(message: Any) -> list[str]:
    """Joints of a sensor_msgs/JointState, each once, with a position each."""
    names, positions = list(message.name), len(message.position)
    if len(names) != positions:
        raise InvalidValueError(f"{len(names)} names and {positions} positions in a message")
    if len(set(names)) < len(names):
        twice = next(name for i, name in enumerate(names) if name in names[:i])
        raise InvalidValueError(f"'{short(str(twice))}' is twice in a message")
    return names


class Clocks:
    """Converts stamps of ROS's clock [ns] to times of the loop's clock [s].

    ROS stamps by the system's clock, which can be set, or by a simulator's; the loop's never goes
    back. Two readings of the one around a reading of the other bound the offset between them. It is
    kept as long as it is within these bounds, so that times keep their order and distances, and
    follows a clock that was set.
    """

    def __init__(self, stamping: Callable[[], int], own: Callable[[], float]) -> None:
        self._stamping, self._own, self._offset = stamping, own, -math.inf
        self.compare()

    def compare(self) -> None:
        before, there, after = self._own(), self._stamping() / NS, self._own()
        self._offset = min(max(self._offset, before - there), after - there)

    def own(self, stamp: Any) -> float | None:
        """A header's stamp by the loop's clock [s]; None for time zero, which is no stamp."""
        ns = int(stamp.sec) * NS + int(stamp.nanosec)
        return ns / NS + self._offset if ns else None


class JointStates:
    """Measured joint positions from messages that may each have some of the joints.

    ``wrong`` says what was wrong with the last message; it is empty if nothing was.
    """

    def __init__(self, names: Sequence[str], silent_after: float) -> None:
        self._silent_after = silent_after
        self._index = {name: i for i, name in enumerate(names)}
        self._q = np.full(len(names), np.nan)
        self._sent = np.full(len(names), -np.inf)
        self._new = np.zeros(len(names), bool)
        self.wrong = ""

    def take(self, message: Any, sent: float | None, now: float) -> None:
        """Read a sensor_msgs/JointState that came now [s]; stamped later, it was sent now.

        InvalidValueError: it has not one position for each name, or a name twice.
        """
        sent = now if sent is None else min(sent, now)
        names, positions = _names(message), np.asarray(message.position, float)
        self.wrong = ""
        if now - sent > self._silent_after:
            clocks = "are the clocks of both machines in step?"
            self.wrong = f"stamped {now - sent:.3g} s before they came; {clocks}"
            return
        for name, position in zip(names, positions, strict=True):
            i = self._index.get(name)
            if i is None:
                continue
            if sent < self._sent[i]:
                self.wrong = f"{name} is older than the last, by {self._sent[i] - sent:.3g} s"
                continue
            self._q[i], self._sent[i], self._new[i] = position, sent, True

    def read(self) -> Array | None:
        """All joints, shape (n,), once each of them has come anew."""
        if not self._new.all():
            return None
        self._new[:] = False
        return self._q.copy()

    def silence(self, now: float) -> str:
        """Which joints have not come for too long, as a sentence; empty if none."""
        age = now - self._sent
        late = np.isinf(age) if np.isinf(age).any() else age > self._silent_after
        names = [name for name, i in self._index.items() if late[i]]
        if not names:
            return ""
        since = "" if np.isinf(age).any() else f" for {age.max():.3g} s"
        more = f" and {len(names) - 3} more" if len(names) > 3 else ""
        return f"nothing has come{since} of {', '.join(names[:3])}{more}"


class Bridge:
    """A robot and inputs for :func:`coopqp.real_time`, made of messages.

    ``kinds`` are by input; ``transport`` carries messages, as :class:`coopqp.ros.node.Topics`.
    """

    def __init__(
        self,
        loop: OnlineLoop,
        joints: Joints,
        kinds: Mapping[str, Kind],
        settings: RosSettings,
        transport: Any,
    ) -> None:
        self._loop, self._joints, self._kinds = loop, joints, kinds
        self._settings, self._transport = settings, transport
        self._clocks = Clocks(transport.now, lambda: loop.now)
        self._states = JointStates(joints.names, settings.silent_after)
        self._queue: deque[tuple[str, Any, float]] = deque(maxlen=QUEUE_SIZE)
        self._arrived: dict[str, tuple[list[float], float]] = {}
        self._refused: dict[str, str] = {}
        self._distance, self._is_new = np.zeros(loop.problem.chain.n), False
        self._causes: dict[Status, None] = {}
        self._note: tuple[str | Why, ...] = ()
        self._reported_at = -np.inf

    def take(self, name: str, message: Any) -> None:
        """Queue a message for an input, or joint states if the name is empty; from any thread."""
        self._queue.append((name, message, self._loop.now))

    def read(self) -> Array | None:
        """Measured joint positions, if all of them have come since the last call."""
        if self._queue:
            self._clocks.compare()
        for _ in range(len(self._queue)):  # what comes meanwhile waits: a flood stops no tick
            name, message, came = self._queue.popleft()
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
        q = self._states.read()
        self._is_new = q is not None
        return q

    def inputs(self) -> Mapping[str, tuple[list[float], float]]:
        """What has arrived since the last call, as a tick of the loop takes it."""
        arrived, self._arrived = self._arrived, {}
        return arrived

    @property
    def object_pose(self) -> list[float] | None:
        """Where the object was seen, if it was, before the loop began."""
        return self._arrived[OBJECT_POSE][0] if OBJECT_POSE in self._arrived else None

    def write(self, q: Array, v: Array) -> None:
        """Send commands to the controllers, and diagnostics when they are due."""
        settings, state, command = self._settings, self._loop.state, self._loop.command
        velocity = self._with_position_gain(v) if settings.command == "velocity" else v
        for name, indices in self._joints.ordered.items():
            self._transport.command(name, q[indices].tolist(), velocity[indices].tolist())
        if settings.object_frame:
            self._transport.place(state.p_WO.tolist(), pin.Quaternion(state.R_WO).coeffs().tolist())
        self._causes |= dict.fromkeys(command.causes)
        self._note = command.messages or self._note
        if self._loop.now - self._reported_at >= settings.diagnostics_every:
            self.say()

    def grip(self, grippers: Mapping[str, Gripper]) -> None:
        for arm, gripper in grippers.items():
            self._transport.grip(arm, gripper == "close")

    def say(self, why: str = "") -> None:
        """Send diagnostics now; ``why`` the loop has ended or could not begin, else empty."""
        loop, self._reported_at = self._loop, self._loop.now
        silence = self._states.silence(self._reported_at) or self._states.wrong
        refused = self._refused.pop("", "")
        remarks = [self._loop_remark(why), *(_limits(loop) if loop.begun else ())]
        self._causes, self._note = {}, ()
        words = "; ".join(filter(None, (silence, refused)))
        remarks.append(Remark("joint states", 2 if silence else int(bool(refused)), words, {}))
        stale = loop.state.inputs.stale
        for name in self._kinds:
            words = self._refused.pop(name, "") or ("is stale" if name in stale else "")
            remarks.append(Remark(f"input {name}", int(bool(words)), words, {}))
        self._transport.diagnose(remarks)

    def _loop_remark(self, why: str) -> Remark:
        """All statuses and the last note of the ticks since the last diagnostics."""
        loop, causes = self._loop, list(self._causes)
        if len(causes) > 1:
            causes = [cause for cause in causes if cause is not Status.OPTIMAL]
        levels = [2 if cause in STANDS else level_of(cause) for cause in causes]
        stopped = why or loop.stopped
        texts = [*(cause.value for cause in causes), note_of(self._note), stopped]
        texts = [x for i, x in enumerate(texts) if not any(x in other for other in texts[i + 1 :])]
        values = {
            "status": written(causes) if causes else "",
            "law": loop.controller,
            "phase": loop.phase.name,
            "t [s]": f"{loop.state.t:.3f}",
            "ticks": str(loop.ticks),
            "late": str(loop.watch.late),
            "longest [ms]": f"{1e3 * loop.watch.longest:.2f}",
        }
        words = "; ".join(filter(None, texts)) or "waits for the robot"
        return Remark("loop", 2 if stopped else max(levels, default=0), words, values)

    def _with_position_gain(self, v: Array) -> Array:
        """With ``position_gain`` times the distance to the commanded positions, unless at rest."""
        loop = self._loop
        if not v.any() or STANDS.intersection(loop.command.causes):
            return v
        if self._is_new:
            np.subtract(loop.state.q, loop.measured, self._distance)
        max_v = loop.problem.chain.velocity
        return np.clip(v + self._settings.position_gain * self._distance, -max_v, max_v)


def _limits(loop: OnlineLoop) -> Iterator[Remark]:
    """Each limit: at which of its rows the last command is, and the smallest margin."""
    kept, problem = loop.history.last(2), loop.problem
    q, v = np.vstack([kept.q, loop.setpoint]), kept.v
    for limit in problem.limits:
        margins: dict[str, dict[Row, float]] = {}
        with suppress(Exception):  # a tick that met the same error names it
            for row, margin in limit.margins(problem.chain, q, v, problem.dt).items():
                if margin.size:
                    margins.setdefault(row.owner, {})[row] = float(margin[-1])
        yield from (_limit(owner, own) for owner, own in margins.items())


def _limit(owner: str, margins: Mapping[Row, float]) -> Remark:
    reached = {row: m < BROKEN for row, m in margins.items() if m <= AT}
    texts = [f"{'beyond' if broken else 'at'} {row.label}" for row, broken in reached.items()]
    units = dict.fromkeys(row.unit for row in margins)
    nearest = {u: min((r for r in margins if r.unit == u), key=margins.__getitem__) for u in units}
    values = {f"left [{unit}]": f"{margins[row]:.4g}" for unit, row in nearest.items()}
    values |= {f"nearest [{unit}]": row.label for unit, row in nearest.items()}
    level = max((1 + broken for broken in reached.values()), default=0)
    return Remark(f"limit {owner}", level, "; ".join(texts), values)
