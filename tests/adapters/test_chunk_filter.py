"""Chunks for two SO-101: what is sound stays as it is, what is not keeps all limits after it."""

from __future__ import annotations

import numpy as np
import pytest
from scenario_files import LOADABLE

from adapters import leaders
from adapters.adversarial import FRAMES, KINDS, Trial, draw
from adapters.so101_oracle import START
from coopqp.adapters.chunk_filter import ChunkFilter
from coopqp.adapters.motors import ARMS, KEYS, MotorUnits
from coopqp.base.errors import CoopqpError, InvalidValueError
from coopqp.base.spec import Array
from coopqp.kernel import native
from coopqp.kernel.free_space import Told
from coopqp.scenario.loader import load

pytestmark = [
    pytest.mark.skipif(native.module() is None, reason="the kernel is not built"),
    pytest.mark.skipif("two_so101" not in LOADABLE, reason="needs example-robot-data"),
]


@pytest.fixture(scope="module")
def trial() -> Trial:
    return Trial()


@pytest.fixture
def chunks(trial: Trial) -> ChunkFilter:
    trial.filter.reset()
    return trial.filter


def frames(joints: Array, grips: float = 80.0) -> Array:
    """Actions from joints (N, 10) [rad]."""
    chunk = np.full((len(joints), len(KEYS)), grips)
    chunk[:, ARMS] = np.degrees(joints)
    return chunk


def waving(size: float = 0.1) -> Array:
    t = np.arange(FRAMES)[:, None] / 30.0
    return START + size * np.sin(t + np.arange(10))


def carried(trial: Trial) -> Array:
    """Joints with which both hands carry something, closed by the oracle's own Newton steps."""
    taken, q, found = trial.oracle.in_each_other(START), START.copy(), []
    for k in range(FRAMES):
        q[[0, 5]] = START[[0, 5]]
        q[1] = START[1] + 0.002 * k
        for _ in range(20):
            q[2:] -= np.linalg.lstsq(*_opening(trial, q, taken), rcond=None)[0]
        found.append(q.copy())
    return np.array(found)


def _opening(trial: Trial, q: Array, taken: object) -> tuple[Array, Array]:
    """Slope by differences and value of how far q opens the loop, of joints 2 to 9."""

    def error(q: Array) -> Array:
        import pinocchio as pin

        return np.asarray(pin.log6(taken.actInv(trial.oracle.in_each_other(q))).vector)  # type: ignore[attr-defined]

    at, J = error(q), np.zeros((6, 8))
    for j in range(8):
        step = np.zeros(10)
        step[2 + j] = 1e-6
        J[:, j] = (error(q + step) - at) / 1e-6
    return J, at


@pytest.mark.parametrize("seed", range(2 * len(KINDS)))
def test_adversarial_chunks_keep_all_limits_and_move_on(trial: Trial, seed: int) -> None:
    judged = trial.one(seed)
    assert judged.broken == []
    assert judged.unnamed == judged.frozen == 0


@pytest.mark.parametrize("kind", ["jumps", "still", "out of range", "holes"])
@pytest.mark.parametrize("grips", [10.0, 80.0])
def test_leaders_frame_by_frame_are_filtered_as_a_chunk_is(
    chunks: ChunkFilter, kind: str, grips: float
) -> None:
    asked = frames(draw(np.random.default_rng(1), START, kind), grips)
    start = frames(START[None], grips)[0]
    whole = chunks.filter_chunk(asked, start)
    chunks.reset()
    one_by_one = [chunks.filter_chunk(row[None], start if k == 0 else None).actions[0]
                  for k, row in enumerate(asked)]  # fmt: skip
    np.testing.assert_allclose(one_by_one, whole.actions, rtol=0.0, atol=1e-6)


def test_sound_chunks_come_back_as_they_are(chunks: ChunkFilter) -> None:
    chunk = frames(waving())
    found = chunks.filter_chunk(chunk, chunk[0])
    assert np.array_equal(found.actions, chunk)
    assert not found.changed.any()
    assert found.changes == ()


def test_what_both_hands_carry_comes_back_as_it_is(trial: Trial, chunks: ChunkFilter) -> None:
    chunk = frames(carried(trial), 10.0)
    assert np.abs(np.diff(chunk, axis=0)).max() > 0.1
    found = chunks.filter_chunk(chunk, chunk[0])
    assert found.holding.all()
    assert np.array_equal(found.actions, chunk)


def test_one_arm_that_moves_alone_opens_the_loop_and_that_is_said(chunks: ChunkFilter) -> None:
    q = np.tile(START, (20, 1))
    q[:, 1] += np.linspace(0.0, 0.3, 20)
    found = chunks.filter_chunk(frames(q, 10.0), frames(START[None], 10.0)[0])
    assert {change.limit for change in found.changes} >= {"loop"}
    *_, last = (change for change in found.changes if change.limit == "loop")
    assert last.frame == 19
    assert last.names == ("left/arm", "right/arm")
    assert last.by > 0.01


def test_nearest_frame_is_the_clipped_one_where_nothing_else_is_in_the_way(
    chunks: ChunkFilter,
) -> None:
    q = np.tile(START, (3, 1))
    q[:, 0] = [0.1, 1.0, 1.0]
    found = chunks.filter_chunk(frames(q), frames(START[None])[0])
    step = 4.7 / 30.0
    assert found.q[:, 0] == pytest.approx([0.1, 0.1 + step, 0.1 + 2 * step])
    assert [(c.frame, c.limit, c.names) for c in found.changes] == [
        (1, "joint_velocity", ("left_shoulder_pan.pos",)),
        (2, "joint_velocity", ("left_shoulder_pan.pos",)),
    ]


@pytest.mark.parametrize("grips", [10.0, 80.0])
def test_arms_in_each_other_come_out(chunks: ChunkFilter, grips: float) -> None:
    q = START.copy()
    rng, inside = np.random.default_rng(3), Told.INSIDE
    while not (chunks._space.measure(q)[:, 0] == inside).any():
        q = rng.normal(START, 0.8).clip(chunks.lower, chunks.upper)
    found = chunks.filter_chunk(frames(np.tile(START, (3, 1)), grips), frames(q[None], grips)[0])
    assert np.abs(np.diff(found.q, axis=0, prepend=q[None])).max(axis=1).min() > 1e-3


def test_squeeze_is_kept_up_to_what_is_allowed(trial: Trial) -> None:
    def wide(q: Array) -> float:
        left, right = (X.translation for X in trial.oracle.placed_hands(q))
        return float(np.linalg.norm(left - right))

    slope = np.array([wide(START + 1e-6 * row) - wide(START) for row in np.eye(10)]) / 1e-6
    slope[5:] = 0.0  # of the left arm alone
    way = -np.linspace(0.0, 0.008, 10)[:, None] * slope / (slope @ slope)
    chunks = ChunkFilter(load("two_so101"), squeeze=0.004)
    found = chunks.filter_chunk(frames(START + way, 10.0), frames(START[None], 10.0)[0])
    closer = [wide(START) - wide(q) for q in (START + way[-1], found.q[-1])]
    assert closer[0] > 0.006
    assert 0.003 < closer[1] < 0.005


def test_dicts_come_back_as_dicts_and_what_they_leave_out_stays(chunks: ChunkFilter) -> None:
    start = dict(zip(KEYS, frames(START[None])[0].tolist(), strict=True))
    found = chunks.filter_chunk([{"left_elbow_flex.pos": start["left_elbow_flex.pos"] + 1}], start)
    (action,) = found.actions
    assert action == {**start, "left_elbow_flex.pos": start["left_elbow_flex.pos"] + 1}


def test_calibration_bounds_joints_and_gives_shares_a_meaning() -> None:
    motors = {j: {"range_min": 1024, "range_max": 3071, "drive_mode": 0} for j in (
        "shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll")}  # fmt: skip
    both = {"left": motors, "right": motors}
    units = MotorUnits(use_degrees=False, calibration=both, signs={"left_shoulder_lift": -1},
                       offsets_deg={"right_elbow_flex": 2.0})  # fmt: skip
    half = np.radians(0.5 * (3071 - 1024) * 360 / 4095)
    q = units.joints(np.full((1, 12), 50.0))[0]
    assert q[[0, 1]] == pytest.approx([0.5 * half, -0.5 * half])
    assert q[7] == pytest.approx(0.5 * half + np.radians(2.0))
    assert units.motors(q[None])[0] == pytest.approx(50.0)
    bounded = units.bounded(load("two_so101").chain)
    assert bounded.upper[0] == pytest.approx(half)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"signs": {"left_gripper": -1}}, "unknown motor 'left_gripper'"),
        ({"use_degrees": False}, "needs both arms' calibration"),
        ({"calibration": {"left": {}}}, "calibration.left.shoulder_pan: needs range_min"),
    ],
)
def test_units_that_cannot_be_are_refused(given: dict[str, object], words: str) -> None:
    with pytest.raises(CoopqpError, match=words):
        MotorUnits(**given)  # type: ignore[arg-type]


def test_chunks_that_are_none_are_refused(chunks: ChunkFilter) -> None:
    with pytest.raises(InvalidValueError, match="start: where the arms are is needed"):
        chunks.filter_chunk(frames(waving()))
    with pytest.raises(InvalidValueError, match=r"found shape \(3, 10\), needs \(N, 12\)"):
        chunks.filter_chunk(np.zeros((3, 10)), np.zeros(12))
    with pytest.raises(InvalidValueError, match=r"start: found shape \(5,\), needs \(12,\)"):
        chunks.filter_chunk(np.zeros((3, 12)), np.zeros(5))
    with pytest.raises(InvalidValueError, match=r"found joints .*, as in the scenario two_so101"):
        ChunkFilter(load("point_on_point"))


def test_a_start_begins_anew_and_a_refused_chunk_changes_nothing(chunks: ChunkFilter) -> None:
    there = frames(START[None], 10.0)
    elsewhere = there + 8.0 * np.eye(len(KEYS))[0]
    chunks.filter_chunk(there, there[0])
    with pytest.raises(InvalidValueError, match="found a text"):
        chunks.filter_chunk("garbage", elsewhere[0])
    assert not chunks.filter_chunk(there).changed.any()
    assert not chunks.filter_chunk(np.repeat(elsewhere, 3, axis=0), elsewhere[0]).changed.any()


STILL = dict.fromkeys(KEYS, 0.0)


@pytest.mark.parametrize(
    ("chunk", "start", "words"),
    [
        ([STILL], STILL | {KEYS[1]: 1e7}, "start: left_shoulder_lift.pos is more than 25.1 rad"),
        ([STILL], [1e300] * 12, "start: left_shoulder_pan.pos is more than"),
        ([STILL], "abc", "start: found a text"),
        ([STILL], [[1.0], 2.0], "start: found lists of different lengths"),
        (([0.0] * 12 for _ in range(2)), STILL, "chunk: found generator"),
        (STILL, STILL, "chunk: found dict"),
        ([STILL, [0.0] * 12], STILL, "chunk: found a list among dicts"),
        ([{KEYS[0]: "1"}], STILL, "chunk: found a text"),
        ([{KEYS[0]: [1.0, 2.0]}], STILL, r"chunk: left_shoulder_pan.pos: found shape \(2,\)"),
        ([{"shoulder.pos": 1.0}], STILL, "chunk: knows none of shoulder.pos; needs keys as left_"),
        (
            [STILL | {"left_elbow.pos": 1.0}],
            STILL,
            "chunk: unknown motor 'left_elbow.pos'; did you mean 'left_elbow_flex.pos'",
        ),
    ],
)
def test_what_is_no_chunk_is_refused(
    chunks: ChunkFilter, chunk: object, start: object, words: str
) -> None:
    with pytest.raises(InvalidValueError, match=words):
        chunks.filter_chunk(chunk, start)
    assert not chunks.begun


@pytest.mark.full
@pytest.mark.parametrize("seed", [0, 1])
def test_leaders_that_jump_and_freeze_are_followed_without_a_frozen_frame(
    trial: Trial, seed: int
) -> None:
    """``python -m tests.adapters.leaders`` follows a hundred."""
    judged = leaders.arms(trial, seed)
    assert not judged.broken
    assert not judged.unnamed
    assert not judged.frozen


def test_the_object_follows_a_point_that_jumps_without_a_frozen_tick() -> None:
    followed = leaders.point(0)
    assert not followed.beyond
    assert not followed.frozen
