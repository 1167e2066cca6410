"""Studies that are killed, cut or shared lose nothing."""

from __future__ import annotations

import os
import random
import resource
import shutil
import signal
import sqlite3
import sys
import time
from pathlib import Path

import pytest
from command_line import typed
from forking import forked
from plate_study import HERE, STUDY, own_metric, plate_in, table_of, written

from coopqp.base.errors import CoopqpError
from coopqp.scenario.catalog import Catalog
from coopqp.study.engine import Engine, Share
from coopqp.study.sweep import Progress, Study, kept_study, read_study, sweep
from coopqp.study.sweep.results import Journal, path_of, records

pytest.importorskip("pyarrow.parquet")


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Study:
    """The study of 24 variants, whose results when nothing happens to it are beside it."""
    folder = plate_in(tmp_path_factory.mktemp("kept"))
    study = read_study(written(folder, STUDY.replace("sobol: 8", "random: 24")))
    sweep(study, folder / "whole", engine=HERE)
    return study


@pytest.fixture(scope="module")
def undisturbed(whole: Study) -> Path:
    """The folder with these results."""
    return whole.file.path.parent / "whole"


def test_wherever_a_batch_was_half_written_the_results_are_the_same(
    whole: Study, undisturbed: Path, tmp_path: Path
) -> None:
    """Whole records up to somewhere, and a part of the next batch as a kill leaves it."""
    rng, out = random.Random(17), tmp_path / "out"
    for _ in range(3):
        shutil.copytree(undisturbed, out)
        os.waitpid(forked(lambda: half_written(out, rng.randrange(24))), 0)
        assert (out / "journal.sqlite3-journal").stat().st_size
        sweep(whole, out, engine=HERE)
        assert not (out / "journal.sqlite3-journal").exists()
        assert table_of(out) == table_of(undisturbed)
        shutil.rmtree(out)


def half_written(folder: Path, first: int) -> None:
    """Remove the records from some variant on, and be killed amidst writing garbage for them."""
    path = folder / "journal.sqlite3"
    with sqlite3.connect(path) as database:
        database.execute("DELETE FROM records WHERE id >= ?", (first,))
    database.execute("PRAGMA cache_size = 1")  # so that it is in the file before it is whole
    rows = [(first + k, "garbage" * 1000, 0) for k in range(20)]
    database.executemany("INSERT OR REPLACE INTO records VALUES (?, ?, ?)", rows)
    assert b"garbage" in path.read_bytes()
    os.kill(os.getpid(), signal.SIGKILL)


def test_a_client_is_killed_five_times(whole: Study, undisturbed: Path, tmp_path: Path) -> None:
    """Ten times: python -m benchmarks.studies --kills 10."""
    rng, out, killed = random.Random(4), tmp_path / "out", 0
    while killed < 5:
        child = forked(lambda: sweep(whole, out, engine=HERE))
        time.sleep(rng.uniform(0.03, 0.2))
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
        killed += 1
    sweep(whole, out, engine=HERE)
    assert table_of(out) == table_of(undisturbed)


@pytest.mark.skipif(sys.platform != "linux", reason="looks for the workers in /proc")
def test_a_worker_is_killed(whole: Study, undisturbed: Path, tmp_path: Path) -> None:
    """Ten times: python -m benchmarks.studies --kills 10."""
    rng, out, left = random.Random(4), tmp_path / "out", [5]

    def kill(state: Progress) -> None:
        if left and state.done >= left[0]:
            left.pop(0)
            os.kill(rng.choice(workers()), signal.SIGKILL)

    sweep(whole, out, engine=Engine(jobs=2), progress=kill)
    assert not left
    assert table_of(out) == table_of(undisturbed)


def workers() -> list[int]:
    """Loky's processes that work for this one."""
    found = []
    for child in Path(f"/proc/{os.getpid()}/task/{os.getpid()}/children").read_text().split():
        command = Path(f"/proc/{child}/cmdline")
        if command.exists() and b"LokyProcess" in command.read_bytes():
            found.append(int(child))
    return found


def test_a_full_disk_stops_with_what_is_there(
    whole: Study, undisturbed: Path, tmp_path: Path
) -> None:
    """Files may have 24 kB; then the command goes on where it was."""

    def limited() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (24_000, 24_000))
        result = typed("sweep", whole.file.path, "--out", tmp_path / "out", "--jobs", "1")
        (tmp_path / "said").write_text(f"{result.exit_code} {result.stderr}", encoding="utf-8")

    os.waitpid(forked(limited), 0)
    said = (tmp_path / "said").read_text(encoding="utf-8")
    assert said.startswith("2 error: cannot write")
    assert said.endswith("; what was done is kept, and the same command goes on from there\n")
    kept = dict(records(tmp_path / "out" / "journal.sqlite3"))
    assert 0 < len(kept) < 24
    sweep(whole, tmp_path / "out", engine=HERE)
    assert dict(records(tmp_path / "out" / "journal.sqlite3")).items() > kept.items()
    assert table_of(tmp_path / "out") == table_of(undisturbed)


def test_two_commands_do_not_write_to_one_journal(whole: Study, undisturbed: Path) -> None:
    with (
        Journal.opened(path_of(undisturbed, Share()), {}),
        pytest.raises(CoopqpError, match="another process is at work on it"),
    ):
        sweep(whole, undisturbed, engine=HERE)


def test_plugins_of_a_users_own_are_part_of_a_study(plate: Path) -> None:
    own_metric(plate / "plugins", "twice", "return 2 * trace.ticks")
    catalog = Catalog((), (plate / "plugins",))
    study = read_study(written(plate, STUDY.replace("[loop_error_max]", "[twice]")), catalog)
    sweep(study, plate / "out", engine=HERE)
    assert {row["twice"] for row in table_of(plate / "out")} == {20}
    assert kept_study(plate / "out").metrics[-1] == "twice"
    (plate / "plugins" / "metrics" / "_helper.py").write_text("x = 1\n", encoding="utf-8")
    with pytest.raises(CoopqpError, match="the plug-ins differs"):
        sweep(study, plate / "out", engine=HERE)
