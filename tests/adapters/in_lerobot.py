"""LeRobot's real classes with coopqp's plug-in, on simulated buses; prints what it has checked.

Run by tests/adapters/test_lerobot.py in the environment that benchmarks/lerobot_env.sh makes.
"""

from __future__ import annotations

import json
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from lerobot.processor import RobotProcessorPipeline
from lerobot.processor.converters import (
    robot_action_observation_to_transition,
    transition_to_robot_action,
)
from lerobot.robots.so_follower import SOFollowerConfig
from lerobot.robots.utils import make_robot_from_config
from lerobot.teleoperators.so_leader.config_so_leader import SOLeaderConfig
from lerobot.teleoperators.utils import make_teleoperator_from_config
from lerobot.utils.import_utils import register_third_party_plugins
from lerobot_robot_coopqp import (
    CoopqpBiSOFollowerConfig,
    CoopqpBiSOLeaderConfig,
    CoopqpFilterStep,
    Filter,
)

import coopqp
from adapters.servos import Servos
from coopqp.adapters.dataset import audit
from coopqp.adapters.motors import ARMS, GRIPPERS, KEYS, SIDES
from coopqp.execution.comparison import compare
from coopqp.recordings import export, read
from coopqp.report import files

FPS, DT = 30.0, 1.0 / 30.0
MOTORS = [key.removesuffix(".pos").partition("_")[2] for key in KEYS[:6]]
START = np.degrees(coopqp.load("two_so101").chain.q_start)


def calibration() -> dict[str, dict[str, int]]:
    """Ranges of an arm that was swept with care; the gripper's from closed to open."""
    half = {"shoulder_pan": 1250, "shoulder_lift": 1130, "elbow_flex": 1100, "wrist_flex": 1080}
    found = {}
    for i, motor in enumerate(MOTORS):
        ends = 0, 4095
        if motor in half:
            ends = 2047 - half[motor], 2047 + half[motor]
        if motor == "gripper":
            ends = 2000, 3300
        found[motor] = {"id": i + 1, "drive_mode": 0, "homing_offset": 0,
                        "range_min": ends[0], "range_max": ends[1]}  # fmt: skip
    return found


def calibrated(folder: Path, arm: Any) -> dict[str, Any]:
    """Two arms of a kind with calibration files, as configurations of pairs have them."""
    for side in SIDES:
        (folder / f"pair_{side}.json").write_text(json.dumps(calibration()))
    return {
        "id": "pair",
        "calibration_dir": folder,
        "left_arm_config": arm,
        "right_arm_config": arm,
    }


def simulate(bus: Any, degrees: np.ndarray, grip: float, load: np.ndarray) -> Servos:
    """Put motors on a real FeetechMotorsBus whose port is never opened."""
    read = calibration()
    middle = np.array([0.5 * (read[m]["range_min"] + read[m]["range_max"]) for m in MOTORS])
    counts = np.append(degrees * 4095 / 360, 0.0) + middle
    counts[5] = 2000 + 13.0 * grip
    servos = Servos(counts, load)
    bus.opened = False

    def connect(*_: Any, **__: Any) -> None:
        bus.opened = True

    def sync_read(name: str, *_: Any, **__: Any) -> dict[str, float]:
        assert name == "Present_Position"
        ids = dict(zip(range(1, 7), servos.read().astype(int).tolist(), strict=True))
        said = bus._normalize(ids)
        return {motor: said[bus.motors[motor].id] for motor in bus.motors}

    def sync_write(name: str, values: dict[str, float], **_: Any) -> None:
        assert name == "Goal_Position"
        raw = bus._unnormalize({bus.motors[motor].id: x for motor, x in values.items()})
        goal = servos.goal.copy()
        for k, motor in enumerate(MOTORS):
            if bus.motors[motor].id in raw:
                goal[k] = raw[bus.motors[motor].id]
        servos.write(goal)

    bus.connect, bus.sync_read, bus.sync_write = connect, sync_read, sync_write
    bus.disconnect = lambda *_: setattr(bus, "opened", False)
    bus.configure_motors = bus.write = lambda *_, **__: None
    bus.disable_torque = bus.enable_torque = lambda *_, **__: None
    type(bus).is_connected = property(lambda self: self.opened)
    type(bus).is_calibrated = property(lambda self: True)
    return servos


def robot(folder: Path) -> tuple[Any, list[Servos]]:
    """The follower as command lines make it, at the scenario's start, grippers open."""
    both = calibrated(folder, SOFollowerConfig(port="none"))
    made = make_robot_from_config(CoopqpBiSOFollowerConfig(**both))
    load = np.array([0.0, 0.4, 0.3, 0.1, 0.0, 0.0])
    servos = [
        simulate(side.bus, START[5 * k : 5 * k + 5], 80.0, load)
        for k, side in enumerate((made.left_arm, made.right_arm))
    ]
    made.connect()
    return made, servos


def action(degrees: np.ndarray, grip: float) -> dict[str, float]:
    row = np.full(12, grip)
    row[ARMS] = degrees
    return dict(zip(KEYS, row.tolist(), strict=True))


def checks_robot(folder: Path) -> str:
    """Wild actions through the real robot: what is sent keeps ranges and speeds."""
    made, servos = robot(folder)
    rng, sent, asked = np.random.default_rng(1), [], None
    for k in range(120):
        if k % 20 == 0:
            asked = rng.uniform(-150.0, 150.0, 10)
        grip = 80.0 if k < 60 else 10.0
        out = made.send_action(action(asked, grip))
        sent.append([out[key] for key in KEYS])
        for each in servos:
            each.step(DT)
    q = np.radians(np.array(sent)[:, ARMS])
    assert np.abs(np.diff(q, axis=0)).max() <= 4.7 / FPS + 1e-6
    half = np.radians(np.array([1250, 1130, 1100, 1080]) * 360 / 4095)
    for arm in (q[:, :4], q[:, 5:9]):
        assert (np.abs(arm) <= half + 1e-6).all()
    seen = made.get_observation()
    off = max(abs(seen[key] - out[key]) for key in np.array(KEYS)[ARMS])
    assert off < 20.0, off
    made.disconnect()
    return f"robot: 120 actions, largest error of the servos at the end {off:.1f} degrees"


def checks_step(folder: Path) -> str:
    """The step in a pipeline, saved and read back; a sound action stays as it is."""

    def piped(steps: list[Any]) -> Any:
        return RobotProcessorPipeline(
            steps=steps, name="coopqp", to_transition=robot_action_observation_to_transition,
            to_output=transition_to_robot_action,
        )  # fmt: skip

    first = piped([CoopqpFilterStep(filter=Filter(fps=50.0))])
    first.save_pretrained(str(folder / "saved"))
    again = RobotProcessorPipeline.from_pretrained(
        str(folder / "saved"), config_filename="coopqp.json",
        to_transition=robot_action_observation_to_transition, to_output=transition_to_robot_action,
    )  # fmt: skip
    assert again.steps[0].filter == Filter(fps=50.0)
    here = action(START, 80.0)
    near = action(START + 1.0, 80.0)
    assert again((near, here)) == near
    far = again((action(START + 90.0, 80.0), near))
    went = max(abs(far[key] - near[key]) for key in np.array(KEYS)[ARMS])
    assert went <= np.degrees(4.7 / 50.0) + 1e-6
    return "step: saved, read back, keeps speeds"


def checks_leaders(folder: Path) -> str:
    """Two leaders of which one opens the loop: their common part moves on."""
    both = calibrated(folder, SOLeaderConfig(port="none"))
    made = make_teleoperator_from_config(CoopqpBiSOLeaderConfig(**both))
    none = np.zeros(6)
    servos = [
        simulate(side.bus, START[5 * k : 5 * k + 5], 80.0, none)
        for k, side in enumerate((made.left_arm, made.right_arm))
    ]
    made.connect()
    middle = np.array([2047.0, 2047.0, 2047.0, 2047.0, 2047.5])
    q, sent = START.copy(), []
    for k in range(90):
        grip = 80.0 if k < 10 else max(80.0 - 4.0 * (k - 10), 10.0)
        q[1] = START[1] + 0.1 * max(0, k - 40)
        for i, each in enumerate(servos):  # hands move leaders at once
            each.joint[:5] = q[5 * i : 5 * i + 5] * 4095 / 360 + middle
            each.joint[5] = 2000 + 13.0 * grip
        sent.append(list(made.get_action().values()))
    sent = np.array(sent)
    assert (sent[-1, GRIPPERS] <= 30.0).all()
    moved = np.abs(sent[-1] - sent[40])[ARMS]
    assert 0.1 < moved[1] < 4.9, moved
    assert moved[5:].max() > 0.1, moved
    return f"leaders: one went by 4.9 degrees, both hands by {np.round(moved, 1).tolist()}"


def checks_dataset(folder: Path) -> str:
    """A dataset that LeRobot itself has written is audited; one jump is found."""
    feature = {"dtype": "float32", "shape": (12,), "names": list(KEYS)}
    made = LeRobotDataset.create(
        "me/pair", 30, {"action": feature, "observation.state": feature},
        root=folder / "set", use_videos=False,
    )  # fmt: skip
    for episode in range(2):
        for k in range(40):
            row = np.full(12, 80.0, np.float32)
            row[ARMS] = START + (30.0 if episode and k >= 20 else 0.0) * (np.arange(10) == 1)
            made.add_frame({"action": row, "observation.state": row, "task": "lift the bar"})
        made.save_episode()
    made.finalize()
    found = list(audit(folder / "set", coopqp.load("two_so101")))
    assert [len(each.broken) for each in found] == [0, 1], [str(each) for each in found]
    return f"dataset: {found[1].broken[0]}"


def checks_export(folder: Path) -> str:
    """A run that coopqp has exported is a dataset for LeRobot itself, texts and chunks too."""
    scenario = coopqp.load("two_so101")
    done = compare(scenario, controllers=["qp"])
    files.write(done, folder)
    export(read(folder / "trace.csv"), scenario, "lerobot", "qp", folder / "set")
    chunk = {"action": [0.0, 1.0 / 100]}
    found = LeRobotDataset("me/run", root=folder / "set", delta_timestamps=chunk)
    assert (len(found), found.fps, found.num_episodes) == (450, 100, 1)
    assert found[7]["task"] == scenario.description
    assert found[7]["action"].shape == (2, 12)
    told = found[7]["action"][0].numpy()
    assert abs(np.radians(told[ARMS]) - done.traces["qp"].q[8]).max() < 1e-6
    assert found.meta.stats["action"]["mean"].shape == (12,)
    return f"export: {len(found)} frames, {found[7]['task'][:15]} ..."


def main() -> None:
    register_third_party_plugins()
    for check in (checks_robot, checks_step, checks_leaders, checks_dataset, checks_export):
        with tempfile.TemporaryDirectory() as folder:
            sys.stdout.write(check(Path(folder)) + "\n")


if __name__ == "__main__":
    main()
