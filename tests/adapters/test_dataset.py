"""Recorded episodes of two SO-101: frames that break limits are found, with the right names."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from scenario_files import LOADABLE

from adapters.so101_oracle import START
from coopqp.adapters.dataset import audit
from coopqp.adapters.motors import ARMS, GRIPPERS, KEYS
from coopqp.base.errors import CoopqpError
from coopqp.base.spec import Array
from coopqp.cli import main
from coopqp.execution.comparison import compare
from coopqp.kernel import native
from coopqp.recordings import export, read
from coopqp.report import files
from coopqp.scenario.loader import load

pa = pytest.importorskip("pyarrow")
pytestmark = [
    pytest.mark.skipif(native.module() is None, reason="the kernel is not built"),
    pytest.mark.skipif("two_so101" not in LOADABLE, reason="needs example-robot-data"),
]


def written(folder: Path, *episodes: Array, fps: int = 30, **others: object) -> Path:
    """A dataset as LeRobot writes it, as far as an audit reads it, with other columns."""
    import pyarrow.parquet

    info = {"codebase_version": "v3.0", "fps": fps, "features": {
        "action": {"dtype": "float32", "shape": [12], "names": list(KEYS)}}}  # fmt: skip
    data = folder / "data" / "chunk-000"
    data.mkdir(parents=True)
    (folder / "meta").mkdir()
    (folder / "meta" / "info.json").write_text(json.dumps(info))
    columns = {
        "action": pa.array([row.tolist() for each in episodes for row in each],
                           pa.list_(pa.float32(), 12)),
        "episode_index": [k for k, each in enumerate(episodes) for _ in each],
        "frame_index": [k for each in episodes for k in range(len(each))],
    } | others  # fmt: skip
    pyarrow.parquet.write_table(pa.table(columns), data / "file-000.parquet")
    return folder


def episode(grips: float) -> Array:
    rows = np.full((50, len(KEYS)), grips)
    t = np.arange(50)[:, None] / 30.0
    rows[:, ARMS] = np.degrees(START) + 3.0 * np.sin(t) * (np.arange(10) == 1)
    return rows


def test_each_broken_frame_is_found_and_no_other(tmp_path: Path) -> None:
    sound, fast, low = episode(80.0), episode(80.0), episode(80.0)
    fast[20:, 1] += 30.0
    low[10, 2] = 98.0  # of 96.8 degrees
    found = list(audit(written(tmp_path, sound, fast, low), load("two_so101")))
    assert [len(each.broken) for each in found[:2]] == [0, 1]
    (jump,) = found[1].broken
    assert (jump.frame, jump.limit, jump.names) == (
        20, "joint_velocity", ("left_shoulder_lift.pos",),
    )  # fmt: skip
    assert {(c.frame, c.limit) for c in found[2].broken} >= {(10, "joint_position")}
    assert {c.frame for c in found[2].broken} <= {10, 11}


def test_frames_are_named_by_their_recorded_numbers(tmp_path: Path) -> None:
    cut = episode(80.0)
    cut[20, 2] = 98.0  # of 96.8 degrees
    (found,) = audit(
        written(tmp_path, cut, frame_index=[100 + k for k in range(50)]), load("two_so101")
    )
    assert 120 in {change.frame for change in found.broken} <= {120, 121}
    assert "frame 120: " in str(found)


def test_hands_that_part_are_found_while_both_hold(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = written(tmp_path, episode(10.0))
    (found,) = audit(folder, load("two_so101"))
    assert {change.limit for change in found.broken} == {"loop"}
    with pytest.raises(SystemExit):
        main(["audit", str(folder)])
    said = capsys.readouterr().out
    assert "episode 0: 48 of 50 frames broken: loop 48\n  frame 2: loop" in said


def test_a_sound_run_exported_as_a_dataset_is_found_sound(tmp_path: Path) -> None:
    import pyarrow.parquet as pq

    scenario, folder = load("two_so101"), tmp_path / "qp.lerobot"
    done = compare(scenario, controllers=["qp"])
    files.write(done, tmp_path)
    export(read(tmp_path / "trace.csv"), scenario, "lerobot", "qp", folder)
    assert [(len(e.broken), e.frames) for e in audit(folder, scenario)] == [(0, 450)]
    info = json.loads((folder / "meta" / "info.json").read_text())
    table = pq.read_table(folder / info["data_path"].format(chunk_index=0, file_index=0))
    assert table.column_names == list(info["features"])
    assert info["features"]["action"] == {"dtype": "float32", "shape": [12], "names": list(KEYS)}
    action, state = (np.array(table[key].to_pylist()) for key in ("action", "observation.state"))
    q = done.traces["qp"].q
    np.testing.assert_allclose(np.radians(state[:, ARMS]), q[:-1], atol=1e-6)
    np.testing.assert_allclose(np.radians(action[:, ARMS]), q[1:], atol=1e-6)
    assert not action[:, GRIPPERS].any()
    for key in ("frame_index", "index"):
        assert table[key].to_pylist() == list(range(450))
    assert table["timestamp"].to_pylist() == pytest.approx(np.arange(450) / info["fps"], abs=1e-4)
    tasks = pq.read_table(folder / "meta" / "tasks.parquet")
    assert tasks.to_pylist() == [{"task_index": 0, "task": scenario.description}]
    assert json.loads(tasks.schema.metadata[b"pandas"])["index_columns"] == ["task"]
    (episode,) = pq.read_table(folder / "meta" / "episodes").to_pylist()
    assert (episode["length"], episode["dataset_to_index"]) == (450, 450)
    assert episode["stats/action/max"] == pytest.approx(action.max(axis=0))


def test_a_folder_that_is_none_is_refused(tmp_path: Path) -> None:
    with pytest.raises(CoopqpError, match=r"info\.json: is no dataset v3\.0 with action"):
        list(audit(tmp_path, load("two_so101")))


def test_rows_that_are_not_finite_or_huge_are_named_and_no_other(tmp_path: Path) -> None:
    missing, first, huge = episode(80.0), episode(80.0), episode(10.0)
    missing[5:7], first[0], huge[5] = np.nan, np.nan, 1e30
    found = list(audit(written(tmp_path, missing, first, huge, fps=5), load("two_so101")))
    assert [{(c.frame, c.limit) for c in each.broken} for each in found[:2]] == [
        {(5, "not_finite"), (6, "not_finite")}, {(0, "not_finite")},
    ]  # fmt: skip
    assert {(5, "joint_position"), (6, "joint_velocity")} <= {
        (c.frame, c.limit) for c in found[2].broken
    }


def test_grippers_without_a_number_or_out_of_their_range_are_named(tmp_path: Path) -> None:
    missing, far, sound = episode(80.0), episode(80.0), episode(100.0)
    missing[3, 5], far[4, 11], far[5, 11] = np.nan, 1e9, -np.inf
    found = list(audit(written(tmp_path, missing, far, sound, fps=3), load("two_so101")))
    assert [[(c.frame, c.limit, c.names) for c in each.broken] for each in found] == [
        [(3, "not_finite", ("left_gripper.pos",))],
        [(4, "joint_position", ("right_gripper.pos",)), (5, "not_finite", ("right_gripper.pos",)),
         (5, "joint_position", ("right_gripper.pos",))],
        [],
    ]  # fmt: skip


def test_angles_that_look_like_radians_are_asked_about(tmp_path: Path) -> None:
    turned = episode(80.0)
    turned[:, ARMS] = np.radians(turned[:, ARMS])
    found = list(audit(written(tmp_path, turned, episode(80.0)), load("two_so101")))
    assert [each.radians for each in found] == [True, False]
    assert "no joint is farther than 3.2 degrees from 0: are these radians?" in str(found[0])


@pytest.mark.parametrize("fps", [0, -30, float("nan")])
def test_a_rate_that_is_none_is_refused_with_the_file(tmp_path: Path, fps: int) -> None:
    with pytest.raises(CoopqpError, match=r"info\.json: is no dataset v3\.0 .*fps is"):
        list(audit(written(tmp_path, episode(80.0), fps=fps), load("two_so101")))


def test_a_missing_column_is_told_with_those_that_are_needed(tmp_path: Path) -> None:
    import pyarrow.parquet as pq

    folder = written(tmp_path, episode(80.0))
    file = next(folder.glob("data/*/*.parquet"))
    pq.write_table(pq.read_table(file, columns=["action", "frame_index"]), file)
    with pytest.raises(CoopqpError, match="needs columns episode_index, frame_index, action: "):
        list(audit(folder, load("two_so101")))


ROW = [0.0] * 12


@pytest.mark.parametrize(
    ("others", "words"),
    [
        ({"action": [ROW, ROW[:6]]}, "frame 1 of episode 0: needs 12 numbers"),
        ({"action": [ROW, None]}, "frame 1 of episode 0: needs 12 numbers"),
        ({"action": ["abc", "abc"]}, "frame 0 of episode 0: needs 12 numbers"),
        ({"action": [["a"] * 12] * 2}, "frame 0 of episode 0: needs 12 numbers"),
        ({"action": [1.0, 1.0]}, "frame 0 of episode 0: needs 12 numbers"),
        ({"action": [ROW] * 2, "episode_index": [0, None]}, "row 1: episode_index and frame_index"),
        ({"action": [], "episode_index": [], "frame_index": []}, "data: has no frames"),
    ],
)
def test_damaged_data_end_in_one_message(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], others: dict[str, object], words: str
) -> None:
    folder = written(tmp_path, episode(80.0)[:2], **others)  # type: ignore[arg-type]
    with pytest.raises(SystemExit) as ended:
        main(["audit", str(folder)])
    assert ended.value.code == 2
    assert words in capsys.readouterr().err
