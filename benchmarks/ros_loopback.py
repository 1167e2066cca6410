"""The node of ROS 2 for real, on this machine: what happens when a robot is killed, or the node.

    python benchmarks/ros_loopback.py [robot|node [SECONDS [PERIOD [PARAMETER:=VALUE ...]]]]

needs rclpy. Three processes: ``coopqp ros`` on the scenario of examples/teleoperation; a robot
whose joints follow velocities with a delay of 20 ms and say 100 times a second where they are; and
this one, which sends targets 60 times a second and listens. Last it kills the robot (SIGKILL), or
ends the node (SIGTERM), while the arms move. With ``command:=position`` or ``trajectory`` joints
follow positions; with ``use_sim_time:=true`` the robot is a simulation at half of real time, whose
/clock is that of all.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped
from rclpy.node import Node
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from trajectory_msgs.msg import JointTrajectory

import coopqp

SCENARIO = Path(__file__).parents[1] / "examples" / "teleoperation" / "nao.yaml"
ARMS = ("left", "right")
SIMULATED = "simulated-robot"  # first argument of the process that is the robot
RUN = "from coopqp.cli import main; main()"
LAG, SLOWER = 0.02, 0.5  # of the joints [s]; a simulation's time over the machine's
GOALS = ([0.15, 0.0, 0.05], [0.17, 0.02, 0.06], [0.15, -0.02, 0.07])
OUTSIDE = [0.18, 0.04, 0.03]  # the corner of what the scenario lets an input ask for


def joints(arm: str) -> list[str]:
    """Of an arm, in the order that its controller wants: from the hand to the shoulder."""
    names = coopqp.load(SCENARIO).chain.joint_names
    return [name for name in reversed(names) if name.startswith(arm[0].upper())]


def topic(arm: str, parameters: list[str]) -> tuple[type, str]:
    """Of a controller's commands."""
    if "command:=trajectory" in parameters:
        return JointTrajectory, f"/{arm}_controller/joint_trajectory"
    return Float64MultiArray, f"/{arm}_controller/commands"


def by_velocity(parameters: list[str]) -> bool:
    """Whether commands are velocities [rad/s]; else positions, of which steps are printed [rad]."""
    return not {"command:=position", "command:=trajectory"} & set(parameters)


def numbers(message: Any) -> list[float]:
    """What a controller is commanded: velocities, or positions."""
    return list(message.points[0].positions if hasattr(message, "points") else message.data)


class Robot:
    """Joints that follow velocities, or positions, with a delay.

    Args:
        node: of ROS.
        parameters: of coopqp's node.
    """

    def __init__(self, node: Node, parameters: list[str]) -> None:
        self.node = node
        chain = coopqp.load(SCENARIO).chain
        self.names, self.q = list(chain.joint_names), chain.q_start.copy()
        self.wanted, self.v = np.zeros((2, chain.n))
        self.by_velocity = by_velocity(parameters)
        if not self.by_velocity:
            self.wanted[:] = self.q
        self.out = node.create_publisher(JointState, "/joint_states", 10)
        for arm in ARMS:
            places = [self.names.index(name) for name in joints(arm)]
            node.create_subscription(*topic(arm, parameters), self._taker(places), 1)
        self.at, self.t = time.monotonic(), 100.0
        self.clock = None
        if "use_sim_time:=true" in parameters:
            self.clock = node.create_publisher(Clock, "/clock", 10)
        node.create_timer(0.01, self.step)

    def _taker(self, places: list[int]) -> Callable[[Any], None]:
        def take(message: Any) -> None:
            self.wanted[places] = numbers(message)

        return take

    def step(self) -> None:
        """Move on and say where the joints are."""
        now = time.monotonic()
        elapsed, self.at = now - self.at, now
        message = JointState(name=self.names)
        if self.clock is not None:
            elapsed *= SLOWER
            self.t += elapsed
            sec, nanosec = divmod(round(1e9 * self.t), 10**9)
            message.header.stamp.sec, message.header.stamp.nanosec = sec, nanosec
            said = Clock()
            said.clock.sec, said.clock.nanosec = sec, nanosec
            self.clock.publish(said)
        else:
            message.header.stamp = self.node.get_clock().now().to_msg()
        share = 1.0 - np.exp(-elapsed / LAG)
        if self.by_velocity:
            self.v += share * (self.wanted - self.v)
            self.q += elapsed * self.v
        else:
            self.q += share * (self.wanted - self.q)
        message.position = self.q.tolist()
        self.out.publish(message)


class Listener:
    """Sends targets and keeps what it hears.

    Args:
        node: of ROS.
        parameters: of coopqp's node.
    """

    def __init__(self, node: Node, parameters: list[str]) -> None:
        self.node, self.goal = node, GOALS[0]
        self.stamped = "use_sim_time:=true" not in parameters
        self.commands: list[tuple[float, str, list[float]]] = []
        self.said: list[tuple[float, list[Any]]] = []
        self.states: list[tuple[float, list[float]]] = []
        self.out = node.create_publisher(PoseStamped, "/coopqp/inputs/target", 1)
        for arm in ARMS:
            node.create_subscription(*topic(arm, parameters), self._keeper(arm), 1)
        node.create_subscription(DiagnosticArray, "/diagnostics", self._hear, 10)
        node.create_subscription(JointState, "/joint_states", self._see, 10)
        node.create_timer(1.0 / 60.0, self.send)

    def _keeper(self, arm: str) -> Callable[[Any], None]:
        return lambda m: self.commands.append((time.monotonic(), arm, numbers(m)))

    def _hear(self, message: Any) -> None:
        self.said.append((time.monotonic(), list(message.status)))

    def _see(self, message: Any) -> None:
        self.states.append((time.monotonic(), list(message.position)))

    def send(self) -> None:
        """The target, stamped now; not stamped where time is simulated."""
        message = PoseStamped()
        message.header.frame_id = "world"
        if self.stamped:
            message.header.stamp = self.node.get_clock().now().to_msg()
        p = message.pose.position
        p.x, p.y, p.z = self.goal
        self.out.publish(message)

    def listen(self, seconds: float, until: Callable[[], bool] = lambda: False) -> bool:
        """Spin; whether it came to what was waited for."""
        end = time.monotonic() + seconds
        while time.monotonic() < end and not until():
            rclpy.spin_once(self.node, timeout_sec=0.01)
        return until()


def node(scenario: Path, parameters: list[str]) -> subprocess.Popen[str]:
    """``coopqp ros``."""
    orders = [f"{arm}_controller.joints:=[{', '.join(joints(arm))}]" for arm in ARMS]
    given = ["controllers:=[left_controller, right_controller]", "patience:=1.0", *orders]
    given += parameters
    words = [word for one in given for word in ("-p", one)]
    command = [sys.executable, "-c", RUN, "ros", str(scenario), "--ros-args", *words]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)


def main(victim: str, seconds: float, scenario: Path, parameters: list[str]) -> None:
    """Move, kill, listen, and print what came of it."""
    heard = Listener(rclpy.create_node("listener"), parameters)
    started, chain = node(scenario, parameters), coopqp.load(SCENARIO).chain
    waits = heard.listen(30.0, lambda: bool(heard.said))
    print(f"before the robot speaks: {worst(heard) if waits else 'nothing was heard'}")
    robot = subprocess.Popen([sys.executable, __file__, SIMULATED, *parameters])
    try:
        print(f"commands come: {heard.listen(30.0, lambda: bool(heard.commands))}")
        for heard.goal in (*GOALS, OUTSIDE):
            heard.listen(seconds / 4)
            X = chain.object_pose(np.array(heard.states[-1][1]))
            apart = 1e3 * np.linalg.norm(X.translation - heard.goal)
            print(f"goal {heard.goal}: the object is {apart:.2f} mm off; {worst(heard)}")
        rates(heard)
        heard.goal = GOALS[0]
        heard.listen(0.3)  # on the way
        killed = time.monotonic()
        robot.kill() if victim == "robot" else started.terminate()
        heard.listen(40.0, lambda: started.poll() is not None)
        heard.listen(0.5)
    finally:
        robot.kill()
        robot.wait()
        started.terminate()
    for arm in ARMS:
        times, values = zip(*((t, v) for t, who, v in heard.commands if who == arm), strict=True)
        moved = np.abs(
            values if by_velocity(parameters) else np.diff(values, axis=0, prepend=values[:1])
        )
        moving, after = moved.max(axis=1) > 1e-9, np.array(times) > killed
        last = 1e3 * (max(np.array(times)[moving & after], default=killed) - killed)
        print(
            f"{arm}: {moved[~after][-1].max():.4f} before; the last command that moves {last:.0f} "
            f"ms after the kill, {np.sum(after & ~moving)} after it that do not"
        )
    for t, status in heard.said:
        bad = [f"{s.name}: {s.message}" for s in status if s.level == b"\x02"]
        if t > killed and bad:
            print(f"{1e3 * (t - killed):6.0f} ms after the kill: {' | '.join(bad)}")
    print(f"the node: {started.communicate(timeout=5.0)[0].strip()} (exit code {started.poll()})")


def worst(heard: Listener) -> str:
    """What the last diagnostics say beyond that all is well."""
    _, status = heard.said[-1]
    return " | ".join(f"{s.name}: {s.message}" for s in status if s.level != b"\x00") or "all well"


def rates(heard: Listener) -> None:
    """How often what came, and the time between commands."""
    for what, times in (
        ("states", [t for t, _ in heard.states]),
        ("commands to an arm", [t for t, who, _ in heard.commands if who == "left"]),
        ("diagnostics", [t for t, _ in heard.said]),
    ):
        gaps = 1e3 * np.diff(times)
        rate = len(gaps) / (times[-1] - times[0])
        p50, p99 = np.percentile(gaps, (50, 99))
        print(f"{what}: {len(times)}, {rate:.1f} a second; gaps {p50:.1f} ms, p99 {p99:.1f} ms")


if __name__ == "__main__":
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    os.environ.setdefault("ROS_DOMAIN_ID", str(os.getpid() % 100))
    rclpy.init()
    if sys.argv[1:2] == [SIMULATED]:
        rclpy.spin(Robot(rclpy.create_node("robot"), sys.argv[2:]).node)
    else:
        words = sys.argv[1:]
        seconds = float(words[1]) if words[1:] else 12.0
        text = SCENARIO.read_text(encoding="utf-8")
        with tempfile.TemporaryDirectory() as folder:
            scenario = Path(folder) / "nao.yaml"
            period = float(words[2]) if words[2:] else 0.01
            scenario.write_text(text.replace("dt: 0.002", f"dt: {period}"), encoding="utf-8")
            main(words[0] if words else "robot", seconds, scenario, words[3:])
        rclpy.shutdown()
