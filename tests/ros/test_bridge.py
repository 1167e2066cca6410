"""A robot and a leader that are messages: what the node makes of them, without any ROS."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from online_loops import Told, follows
from ros_messages import JOINT_STATE, STORE, joint_state, pose
from scenario_files import TAKES_HOLD, phased

import coopqp
from coopqp import CoopqpError, OnlineLoop, Status, UnknownNameError
from coopqp.recordings.messages import Remark
from coopqp.ros.bridge import Bridge, RosSettings, joints_of, kinds_of
from coopqp.scenario.scenario import Scenario

NEAR = [0.15, 0.0, 0.06]
EPOCH = 1_790_000_000_000_000_000  # ROS's clock is years ahead of the loop's [ns]


class World:
    """A robot, a leader and the wires between them and a bridge.

    Args:
        scenario: that the loop runs.
        every: a joint state comes every so many ticks.
        share: of a velocity that the joints really have.
        settings: of the node.
    """

    def __init__(
        self, scenario: Scenario, *, every: int = 1, share: float = 1.0, **settings: Any
    ) -> None:
        self.clock, self.behind = Told(), 0
        self.every, self.share, self.ticks, self.silent = every, share, 0, False
        self.sent: dict[str, list[float]] = {}
        self.positions: dict[str, list[float]] = {}
        self.object: list[float] = []
        self.gripped: list[tuple[str, bool]] = []
        self.said: list[Sequence[Remark]] = []
        given = RosSettings(**{"controllers": ["left", "right"], **settings})
        chain = self.chain = scenario.chain
        self.orders = {
            arm: [name for name in reversed(chain.joint_names) if name[0] == arm[0].upper()]
            for arm in ("left", "right")
        }
        silence = {"silent_after": given.silent_after, "patience": given.patience}
        self.loop = OnlineLoop(scenario, clock=self.clock, **silence)
        joints = joints_of(chain, given.controllers, self.orders)
        self.bridge = Bridge(self.loop, joints, kinds_of(scenario), given, self)
        self.names, self.q = list(chain.joint_names), chain.q_start.copy()
        self.state: Callable[[], Any] = self.told

    def now(self) -> int:
        """By ROS's clock [ns]."""
        return EPOCH + round(1e9 * self.clock.t) - self.behind

    def command(self, controller: str, q: list[float], v: list[float]) -> None:
        """What a controller is sent."""
        self.positions[controller], self.sent[controller] = q, v

    def grip(self, arm: str, closed: bool) -> None:
        """What a gripper is sent."""
        self.gripped.append((arm, closed))

    def place(self, position: list[float], quaternion: list[float]) -> None:
        """Where the object is."""
        self.object = position + quaternion

    def diagnose(self, remarks: Sequence[Remark]) -> None:
        """What is said."""
        self.said.append(remarks)

    def told(self) -> Any:
        """Where the joints are, stamped now."""
        return joint_state(self.now(), self.names, self.q)

    def go(self, ticks: int, target: Callable[[], Any] | None = None) -> None:
        """Some periods; the target is sent before each tick."""
        for _ in range(ticks):
            if not self.silent and self.ticks % self.every == 0:
                self.bridge.take("", self.state())
            if target is not None:
                self.bridge.take("target", target())
            command = self.loop.tick(self.bridge.read(), self.bridge.inputs())
            self.bridge.write(self.loop.setpoint, command.v)
            for arm, velocities in self.sent.items():
                for name, v in zip(self.orders[arm], velocities, strict=True):
                    self.q[self.names.index(name)] += 0.01 * self.share * v
            self.clock.t += 0.01
            self.ticks += 1

    def near(self) -> Any:
        """A target, stamped now."""
        return pose(self.now(), NEAR, frame="world")

    def words(self, about: str) -> tuple[int, str]:
        """What was said last of something: its level and the words."""
        (found,) = (remark for remark in self.said[-1] if remark.about == about)
        return found.level, found.message


@pytest.fixture
def scenario() -> Scenario:
    return follows()


def test_the_object_is_taken_where_a_camera_sees_it_and_grippers_are_told(tmp_path: Path) -> None:
    world = World(phased(tmp_path, TAKES_HOLD))
    seen = [0.165, 0.002, 0.052]
    world.bridge.take("object_pose", pose(world.now(), seen, frame="world"))
    world.bridge.read()
    assert world.bridge.object_pose is not None
    assert world.bridge.object_pose[:3] == seen
    while world.loop.phase.name == "take":
        world.go(1)
        world.bridge.take("object_pose", pose(world.now(), seen, frame="world"))
        world.bridge.grip(world.loop.command.grippers)
    world.go(1)
    np.testing.assert_allclose(world.loop.problem.chain.start_position, seen, atol=1e-9)
    assert world.gripped[:2] == [("right", False), ("left", False)]
    assert world.gripped[-2:] == [("right", True), ("left", True)]


def test_an_object_that_never_stands_is_not_looked_for(scenario: Scenario) -> None:
    assert "object_pose" not in kinds_of(scenario)


def test_the_object_goes_where_targets_say_and_each_joint_gets_its_velocity(
    scenario: Scenario,
) -> None:
    world = World(scenario, every=4)
    world.go(20, world.near)
    v = dict(zip(world.names, world.loop.command.v.tolist(), strict=True))
    assert np.abs(list(v.values())).max() > 1e-3
    for arm, order in world.orders.items():
        # the arms do exactly as told, so that there is nothing to be made good
        np.testing.assert_allclose(world.sent[arm], [v[name] for name in order], atol=1e-12)
    world.go(280, world.near)
    assert world.loop.command.causes == (Status.OPTIMAL,)
    found = world.chain.object_pose(world.q).translation
    np.testing.assert_allclose(found, NEAR, atol=1e-3)
    np.testing.assert_allclose(found, world.loop.state.p_WO, atol=1e-5)
    assert world.words("loop") == (0, "optimal")
    assert world.words("joint states") == world.words("input target") == (0, "")


def test_a_robot_that_falls_silent_is_told_to_stand_still_and_so_it_is_said(
    scenario: Scenario,
) -> None:
    world = World(scenario)
    world.go(30, world.near)
    assert np.abs(world.loop.command.v).max() > 0.01
    world.silent = True
    world.go(9, world.near)
    assert world.loop.status is Status.OPTIMAL
    world.go(20, world.near)
    assert not np.any([*world.sent.values()])
    assert world.words("joint states")[0] == 2
    assert "nothing has come for 0.2" in world.words("joint states")[1]
    assert world.words("loop") == (2, f"{Status.ROBOT_SILENT.value}; read() gave None")
    world.silent = False
    world.go(20, world.near)
    assert world.loop.status is Status.OPTIMAL
    world.silent = True
    world.go(50, world.near)
    assert world.loop.stopped == "for 0.25 s the robot has not said where it is"
    world.silent = False
    world.go(20, world.near)
    assert world.words("loop")[0] == 2
    assert world.loop.stopped in world.words("loop")[1]
    assert not np.any([*world.sent.values()])


def test_a_joint_that_is_faster_than_it_may_be_in_a_tick_has_not_jumped(
    scenario: Scenario,
) -> None:
    world = World(scenario, every=8)
    world.go(9)
    fast = world.chain.velocity * 0.01 * 8 * 1.2  # as servos that catch up do
    world.q += np.minimum(fast, world.chain.upper - world.q)
    assert (np.minimum(fast, world.chain.upper - world.q) > 0.02).any()
    world.go(8)
    assert Status.MEASURED_JUMPED not in world.loop.command.causes
    world.q += 10.0 * fast
    world.go(1)
    world.ticks = 8
    world.go(1)
    assert world.loop.status is Status.MEASURED_JUMPED
    world.go(3)  # nothing new does not make it believed
    assert world.loop.status is Status.MEASURED_JUMPED


def test_times_are_by_the_clock_of_the_loop_also_when_that_of_the_system_is_set(
    scenario: Scenario,
) -> None:
    world = World(scenario)
    world.go(5, world.near)
    for behind in (0, 3600 * 10**9, -5 * 10**9):
        world.behind = behind
        world.go(2, world.near)
        assert Status.INPUT_REFUSED not in world.loop.command.causes
        t, _ = world.loop.state.inputs.arrived["target"]
        assert t == pytest.approx(world.loop.state.t, abs=1e-6)
    world.go(1, lambda: pose(world.now() - 5 * 10**6, NEAR))
    assert Status.INPUT_REFUSED not in world.loop.command.causes
    t, _ = world.loop.state.inputs.arrived["target"]
    assert t == pytest.approx(world.loop.state.t - 0.005, abs=1e-6)
    for ahead, words in ((10**9, "is from the future"), (-(10**9), "is older than the last")):
        world.go(1, lambda ahead=ahead: pose(world.now() + ahead, NEAR))
        assert Status.INPUT_REFUSED in world.loop.command.causes
        assert words in world.loop.note
    world.go(1, lambda: pose(0, NEAR))  # not stamped: sent when it came
    assert world.loop.status is Status.OPTIMAL
    world.go(40)
    assert world.loop.status is Status.INPUT_STALE
    assert world.words("input target") == (1, "is stale")


BAD_STATES: dict[str, tuple[Callable[[World], Any], str]] = {
    "fewer positions than names": (
        lambda w: joint_state(w.now(), w.names, w.q[:3]),
        "10 names and 3 positions in a message",
    ),
    "a joint twice": (
        lambda w: joint_state(w.now(), [*w.names, w.names[0]], [*w.q, 9.0]),
        "'RShoulderPitch' is twice in a message",
    ),
    "old": (
        lambda w: joint_state(w.now() - 2 * 10**9, w.names, w.q),
        "stamped 2 s before they came; are the clocks of both machines in step?",
    ),
    "older than the last": (
        lambda w: joint_state(EPOCH + 100 * 10**9 + 180 * 10**6, w.names, w.q),
        "is older than the last, by 0.01 s",
    ),
    "other joints": (lambda w: joint_state(w.now(), ["wheel"], [1.0]), "nothing has come for"),
    "no message": (lambda w: "hello", "AttributeError"),
}


@pytest.mark.parametrize("case", BAD_STATES)
def test_joint_states_that_are_none_bring_the_robot_to_rest(scenario: Scenario, case: str) -> None:
    world = World(scenario)
    world.go(20, world.near)
    bad, words = BAD_STATES[case]
    world.state = lambda: bad(world)
    world.go(30, world.near)
    assert not np.any([*world.sent.values()])
    world.bridge.say()
    assert world.words("joint states")[0] == 2
    said = [r.message for told in world.said for r in told if r.about == "joint states"]
    assert any(words in line for line in said)


class Anything:
    """A message with any fields."""

    def __init__(self, **fields: Any) -> None:
        self.__dict__.update(fields)


def _malformed(world: World, rng: np.random.Generator) -> Any:
    """A message that is none, or one of a sound one's fields replaced."""
    junk = [None, "x", b"x", -1, 10**400, np.nan, np.inf, [], [[1.0]], {}, object(), True, 1j]
    sound = [joint_state(world.now(), world.names, world.q), world.near()][rng.integers(2)]
    fields = {**vars(sound)}
    stamp = Anything(sec=junk[rng.integers(len(junk))], nanosec=junk[rng.integers(len(junk))])
    replaced = [*junk, list(world.names), [0.0] * 3, Anything(stamp=stamp, frame_id="world")]
    for name in rng.choice(list(fields), rng.integers(1, 3)):
        fields[name] = replaced[rng.integers(len(replaced))]
    fields.pop("velocity", None)
    return Anything(**fields) if rng.random() < 0.9 else replaced[rng.integers(len(replaced))]


def test_malformed_messages_among_sound_ones_change_nothing(
    scenario: Scenario, rng: np.random.Generator
) -> None:
    world = World(scenario)
    world.go(20, world.near)
    for _ in range(300):
        for name in ("", "target"):
            bad = _malformed(world, rng)
            if name or not hasattr(bad, "pose"):
                world.bridge.take(name, bad)
        world.go(1, world.near)
        assert world.loop.status in (Status.OPTIMAL, Status.INPUT_REFUSED), world.loop.note
        assert np.isfinite([*world.sent.values()]).all()
    assert {r.level for told in world.said for r in told if r.about == "joint states"} == {0, 1}


def test_joints_that_are_no_numbers_are_said_by_the_loop(scenario: Scenario) -> None:
    world = World(scenario)
    world.go(20, world.near)
    world.state = lambda: joint_state(world.now(), world.names, world.q * np.nan)
    world.go(2, world.near)
    assert world.loop.status is Status.NOT_MEASURED
    world.bridge.say()
    level, words = world.words("loop")
    assert level == 2
    assert "no finite number for RShoulderPitch" in words


def test_arms_that_speak_apart_are_one_robot_until_one_of_them_is_silent(
    scenario: Scenario,
) -> None:
    world = World(scenario)

    def of(arm: str) -> Any:
        names = world.orders[arm]
        return joint_state(world.now(), names, [world.q[world.names.index(n)] for n in names])

    def half() -> Any:
        world.bridge.take("", of("left"))
        return of("right")

    world.state = half
    world.go(20, world.near)
    assert world.loop.status is Status.OPTIMAL
    world.state = lambda: of("left")
    world.go(30, world.near)
    assert world.loop.status is Status.ROBOT_SILENT
    level, words = world.words("joint states")
    assert level == 2
    assert all(
        name.startswith("R") for name in words.split(" of ")[1].split(" and ")[0].split(", ")
    )


BAD_TARGETS: dict[str, tuple[Callable[[World], Any], str]] = {
    "another frame": (
        lambda w: pose(w.now(), NEAR, frame="camera"),
        "is in frame 'camera', needs 'world'; transform it before",
    ),
    "no message": (lambda w: 3, "AttributeError"),
}


@pytest.mark.parametrize("case", BAD_TARGETS)
def test_targets_that_cannot_be_read_are_refused_and_said(scenario: Scenario, case: str) -> None:
    world = World(scenario)
    world.go(20, world.near)
    bad, words = BAD_TARGETS[case]
    world.go(30, lambda: bad(world))
    assert world.loop.status is Status.INPUT_STALE
    level, said = world.words("input target")
    assert level == 1
    assert words in said


def test_positions_are_where_velocities_lead_and_the_object_is_where_the_joints_hold_it(
    scenario: Scenario,
) -> None:
    """No gain is added to velocities that are sent beside positions."""
    world = World(scenario, share=0.9, command="position", object_frame="box")
    world.go(50, world.near)
    loop = world.loop
    q = dict(zip(world.names, (loop.state.q + 0.01 * loop.command.v).tolist(), strict=True))
    v = dict(zip(world.names, loop.command.v.tolist(), strict=True))
    for arm, order in world.orders.items():
        np.testing.assert_allclose(world.positions[arm], [q[name] for name in order], atol=1e-12)
        np.testing.assert_allclose(world.sent[arm], [v[name] for name in order], atol=1e-12)
    X = world.chain.object_pose(loop.state.q)
    np.testing.assert_allclose(world.object, pin.SE3ToXYZQUAT(X), atol=1e-6)


@pytest.mark.parametrize("gain", [0.0, 1.0])
def test_joints_that_lag_are_brought_to_where_they_were_commanded(
    scenario: Scenario, gain: float
) -> None:
    world = World(scenario, share=0.9, position_gain=gain)
    world.go(600, world.near)
    off = np.abs(world.q - world.loop.state.q).max()
    assert (off > 5e-3) == (gain == 0.0)
    assert (off < 1e-3) == (gain == 1.0)


def test_the_limits_that_the_joints_are_at_are_named() -> None:
    world = World(coopqp.load("joint_limit_stress"))
    world.go(150)
    world.bridge.say()
    named = {r.about: r.message for r in world.said[-1] if r.about.startswith("limit ")}
    left = {"upper": world.chain.upper, "lower": world.chain.lower}
    at = [
        f"at {name} ({side})"
        for i, name in enumerate(world.names)
        for side, ends in left.items()
        if abs(ends[i] - world.loop.setpoint[i]) < 1e-6
    ]
    assert at
    assert sorted(named["limit position"].split("; ")) == sorted(at)


def test_a_bag_is_as_good_as_a_robot(scenario: Scenario, tmp_path: Path) -> None:
    from rosbags.rosbag2 import Reader, Writer

    world = World(scenario)
    with Writer(tmp_path / "bag", version=8) as writer:
        topic = writer.add_connection("/joint_states", JOINT_STATE, typestore=STORE)
        for k in range(60):
            ns = world.now() + k * 10**7
            message = joint_state(ns, world.names, world.q)
            writer.write(topic, ns, STORE.serialize_cdr(message, JOINT_STATE))
    with Reader(tmp_path / "bag") as reader:
        raw = [data for _, _, data in reader.messages()]
    told = iter(raw)
    world.state = lambda: STORE.deserialize_cdr(next(told), JOINT_STATE)
    world.go(60, lambda: pose(0, world.loop.state.p_WO))
    assert world.loop.status is Status.OPTIMAL
    np.testing.assert_array_equal(world.loop.measured, world.chain.q_start)


WRONG_ORDERS: dict[str, tuple[list[str], dict[str, list[str]], str]] = {
    "unknown": (["a"], {"a": ["RElbowRol"]}, "a.joints: unknown joint 'RElbowRol'; did you mean"),
    "twice": (["a"], {"a": ["RElbowYaw", "RElbowYaw"]}, "a.joints: 'RElbowYaw' is there twice"),
    "left out": (["a"], {"a": ["RElbowYaw"]}, "joints: no controller moves RShoulderPitch, "),
    "no order": (["a", "b"], {}, "a.joints: several controllers need each their joints"),
}


@pytest.mark.parametrize("case", WRONG_ORDERS)
def test_wrong_orders_of_joints_are_refused(scenario: Scenario, case: str) -> None:
    controllers, orders, words = WRONG_ORDERS[case]
    with pytest.raises((CoopqpError, UnknownNameError)) as caught:
        joints_of(scenario.chain, controllers, orders)
    assert words in str(caught.value)


def test_passive_joints_are_neither_heard_nor_commanded() -> None:
    chain = coopqp.load("rigid_vs_passive").held_by("qp").chain
    joints = joints_of(chain, ["all"], {})
    assert len(joints.names) == chain.n - len(chain.passive) == len(joints.ordered["all"])
    assert not set(joints.ordered["all"]) & set(chain.passive)
