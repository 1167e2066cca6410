"""The node, with rclpy: topics around a bridge, and the loop."""

import importlib
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from functools import partial
from typing import Any

from coopqp.base.errors import CoopqpError, InvalidValueError, MissingDependencyError
from coopqp.online.loop import OnlineLoop
from coopqp.online.real_time import Ended, real_time
from coopqp.recordings.messages import NS, Remark
from coopqp.ros.bridge import (
    JOINT_STATE,
    Bridge,
    Joints,
    RosSettings,
    joints_of,
    kinds_of,
    message_of,
    ros_name,
)
from coopqp.scenario.scenario import Scenario

NAME = "coopqp"
NUMBERS, DIAGNOSTICS = "std_msgs/msg/Float64MultiArray", "diagnostic_msgs/msg/DiagnosticArray"
CLOSED = "std_msgs/msg/Bool"
POINT = "trajectory_msgs/msg/JointTrajectoryPoint"
TRAJECTORY, TRANSFORMS = "trajectory_msgs/msg/JointTrajectory", "tf2_msgs/msg/TFMessage"
FAREWELL = 1.0  # for the last messages to be received [s]
WAITING = 0.1  # between checks for the first joint states [s]
SLOWEST = 0.2  # of the machine's time that a period of simulated time may take [s]


class Topics:
    """The node's publishers and subscriptions; ``simulated`` if its time is that of /clock."""

    def __init__(self, node: Any, settings: RosSettings, joints: Joints, dt: float) -> None:
        self._node, self._settings, self._joints, self._dt = node, settings, joints, dt
        self.simulated = bool(node.get_parameter("use_sim_time").value)
        trajectories = settings.command == "trajectory"
        kind, topic = (TRAJECTORY, "joint_trajectory") if trajectories else (NUMBERS, "commands")
        publisher, message = node.create_publisher, _type(kind)
        self._commands = {x: publisher(message, f"/{x}/{topic}", 1) for x in settings.controllers}
        self._diagnostics = node.create_publisher(_type(DIAGNOSTICS), "/diagnostics", 10)
        self._grippers: dict[str, Any] = {}
        places = settings.object_frame
        self._tf = node.create_publisher(_type(TRANSFORMS), "/tf", 10) if places else None

    def subscribe(self, kind: str, topic: str, take: Any) -> None:
        """Subscribe; lost messages are not sent again. CoopqpError: no topic can be called so."""
        from rclpy.qos import qos_profile_sensor_data

        try:
            self._node.create_subscription(_type(kind), topic, take, qos_profile_sensor_data)
        except Exception as error:  # noqa: BLE001 - each of rclpy's layers has its own
            words = " ".join(str(error).split())
            raise CoopqpError(f"topic '{topic}': {words}") from None

    def now(self) -> int:
        """By the clock of stamps [ns]."""
        return int(self._node.get_clock().now().nanoseconds)

    def command(self, controller: str, q: list[float], v: list[float]) -> None:
        """Send positions at the end of the period [rad, m], or velocities until then."""
        if self._settings.command == "trajectory":
            # A header without a stamp: the point is to be reached a period after it has come.
            point = _type(POINT)(positions=q, velocities=v)
            after = point.time_from_start
            after.sec, after.nanosec = divmod(round(self._dt * NS), NS)
            message = _type(TRAJECTORY)(joint_names=self._joints.orders[controller], points=[point])
        else:
            message = _type(NUMBERS)(data=v if self._settings.command == "velocity" else q)
        self._commands[controller].publish(message)

    def grip(self, arm: str, closed: bool) -> None:
        """Send whether a gripper shall be closed, on a topic that keeps its last message."""
        from rclpy.qos import DurabilityPolicy, QoSProfile

        if arm not in self._grippers:
            kept = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
            topic = f"~/grippers/{ros_name(arm)}"
            self._grippers[arm] = self._node.create_publisher(_type(CLOSED), topic, kept)
        self._grippers[arm].publish(_type(CLOSED)(data=closed))

    def place(self, position: list[float], quaternion: list[float]) -> None:
        """Send the object's position in the world [m] and its orientation (x, y, z, w)."""
        transform = _type("geometry_msgs/msg/TransformStamped")()
        transform.header.stamp = self._node.get_clock().now().to_msg()
        transform.header.frame_id = self._settings.frame
        transform.child_frame_id = self._settings.object_frame
        for axis, x in zip("xyz", position, strict=True):
            setattr(transform.transform.translation, axis, x)
        for axis, x in zip("xyzw", quaternion, strict=True):
            setattr(transform.transform.rotation, axis, x)
        assert self._tf is not None  # the bridge asks for it where there is a frame
        self._tf.publish(_type(TRANSFORMS)(transforms=[transform]))

    def diagnose(self, remarks: Sequence[Remark]) -> None:
        array = _type(DIAGNOSTICS)(status=[_status(remark) for remark in remarks])
        array.header.stamp = self._node.get_clock().now().to_msg()
        self._diagnostics.publish(array)

    def wait(self) -> None:
        """Wait until what was published has been received, but not long."""
        from rclpy.duration import Duration

        for publisher in (*self._commands.values(), self._diagnostics):
            publisher.wait_for_all_acked(Duration(seconds=FAREWELL))


def run_node(scenario: Scenario, arguments: Sequence[str] = ()) -> Ended:
    """Run a node until Ctrl-C, SIGTERM, or the robot has been silent for too long.

    The arguments are ROS's own, such as ``--ros-args --params-file params.yaml``.

    Raises:
        MissingDependencyError: there is no rclpy.
        CoopqpError: a parameter is wrong, the loop cannot begin where the robot is, or the record
            could not be written.
    """
    with _node(arguments) as node:
        settings, orders = _parameters(node)
        given = ("reference", "grasp", "silent_after", "patience")
        options: dict[str, Any] = {key: getattr(settings, key) for key in given}
        joints = joints_of(scenario.chain, settings.controllers, orders)
        kinds = kinds_of(scenario)
        topics = Topics(node, settings, joints, scenario.dt)
        if topics.simulated:
            options["clock"] = lambda: 1e-9 * topics.now()
        loop = OnlineLoop(scenario, settings.law, out=settings.out or None, **options)
        if loop.by_torques:
            words = "commands torques; ros2_control is sent velocities or positions, such as qp's"
            raise InvalidValueError(f"law: '{settings.law}' {words}")
        bridge = Bridge(loop, joints, kinds, settings, topics)
        topics.subscribe(JOINT_STATE, settings.joint_states, partial(bridge.take, ""))
        for name, kind in kinds.items():
            topics.subscribe(message_of(kind), f"~/inputs/{name}", partial(bridge.take, name))
        with _received(node):
            return _run(loop, bridge, topics)


def _run(loop: OnlineLoop, bridge: Bridge, topics: Topics) -> Ended:
    """Wait for the robot and run the loop; at the end say why it has ended."""
    why = "the node was cut off"
    try:
        with loop:  # so that Ctrl-C and SIGTERM end the waiting, too
            ended = _when_measured(loop, bridge, topics)
        why = str(ended)
        return ended
    except CoopqpError as error:
        why = str(error)
        raise
    finally:
        with suppress(Exception):  # there is nobody left to tell
            bridge.say(why)
            topics.wait()


def _when_measured(loop: OnlineLoop, bridge: Bridge, topics: Topics) -> Ended:
    while loop.running:
        q = bridge.read()
        if q is not None and topics.now():  # simulated time is zero until it has come
            loop.begin(q, bridge.object_pose)
            slowest = SLOWEST if topics.simulated else None
            return real_time(loop, bridge, inputs=bridge.inputs, slowest=slowest)
        bridge.say()
        time.sleep(WAITING)
    return Ended(loop.stopped, 0, 0, 0.0, -1)


@contextmanager
def _node(arguments: Sequence[str]) -> Iterator[Any]:
    try:
        import rclpy
        from rclpy.signals import SignalHandlerOptions
    except ImportError:
        words = "rclpy; source the setup.bash of a ROS 2 whose Python this is (docs/ros.md)"
        raise MissingDependencyError("'coopqp ros'", instructions=words) from None
    # Its own handlers would cut the node off before the robot is commanded to stop.
    try:
        rclpy.init(args=list(arguments), signal_handler_options=SignalHandlerOptions.NO)
    except Exception as error:  # noqa: BLE001 - each of its layers has its own
        raise CoopqpError(f"ROS: {' '.join(str(error).split())}") from None
    try:
        node = rclpy.create_node(NAME)
        try:
            yield node
        finally:
            node.destroy_node()
    finally:
        rclpy.try_shutdown()


@contextmanager
def _received(node: Any) -> Iterator[None]:
    from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor

    executor = SingleThreadedExecutor()
    executor.add_node(node)

    def spin() -> None:
        with suppress(ExternalShutdownException):
            executor.spin()

    thread = threading.Thread(target=spin, daemon=True)
    thread.start()
    try:
        yield
    finally:
        executor.shutdown()
        thread.join(FAREWELL)


def _parameters(node: Any) -> tuple[RosSettings, Mapping[str, list[str]]]:
    names = RosSettings.__dataclass_fields__
    given = {name: value for name in names if (value := _parameter(node, name)) is not None}
    if "controllers" not in given:
        words = "name those of ros2_control, as -p controllers:=[arm_velocity_controller]"
        raise InvalidValueError(f"controllers: {words}")
    settings = RosSettings(**given)
    orders = {name: _parameter(node, f"{name}.joints") for name in settings.controllers}
    return settings, {name: order for name, order in orders.items() if order}


def _parameter(node: Any, name: str) -> Any:
    free = _type("rcl_interfaces/msg/ParameterDescriptor")(dynamic_typing=True, read_only=True)
    value = node.declare_parameter(name, None, free).value
    return list(value) if isinstance(value, list | tuple) else value


def _type(name: str) -> Any:
    """The class of a message, by its name in ROS."""
    package, _, kind = name.split("/")
    return getattr(importlib.import_module(f"{package}.msg"), kind)


def _status(remark: Remark) -> Any:
    pair = _type("diagnostic_msgs/msg/KeyValue")
    return _type("diagnostic_msgs/msg/DiagnosticStatus")(
        level=bytes([remark.level]),
        name=f"{NAME}: {remark.about}",
        message=remark.message,
        values=[pair(key=key, value=value) for key, value in remark.values.items()],
    )
