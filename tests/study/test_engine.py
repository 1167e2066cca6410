"""Many items on workers, some of which die."""

from __future__ import annotations

import gc
import pickle
import time
from pathlib import Path

import pytest
from work_that_dies import refuses, square

from coopqp.base.errors import (
    CoopqpError,
    Fault,
    InvalidValueError,
    MissingDependencyError,
    ScenarioError,
    UnknownNameError,
)
from coopqp.study.engine import Engine, Lost, Share


@pytest.fixture
def marks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Where items leave a mark, for workers that are started from now on."""
    from joblib.externals.loky import get_reusable_executor

    monkeypatch.setenv("COOPQP_TEST_MARKS", str(tmp_path))
    get_reusable_executor().shutdown(wait=True, kill_workers=True)
    return tmp_path


def test_a_worker_that_dies_takes_no_more_than_its_item(marks: Path) -> None:
    items = [*range(1, 20), -1, -7, *range(20, 30)]
    found = dict(Engine(jobs=2).results(square, items))
    assert isinstance(found.pop(-1), Lost)
    assert found == {item: item * item for item in items if item != -1}


def test_what_work_raises_comes_out_as_it_was() -> None:
    with pytest.raises(MissingDependencyError, match=r"^solver 'x' needs: pip .*coopqp\[extra\]'$"):
        list(Engine(jobs=2).results(refuses, range(9)))


@pytest.mark.parametrize(
    "error",
    [
        UnknownNameError("solver", "dapq", ["daqp"]),
        MissingDependencyError("this", "extra"),
        ScenarioError([Fault("a.yaml:3: dt", "needs a number")]),
        InvalidValueError("wrong").at("tasks", 0),
    ],
)
def test_errors_go_from_process_to_process(error: CoopqpError) -> None:
    again = pickle.loads(pickle.dumps(error))
    assert type(again) is type(error)
    assert str(again) == str(error)
    assert vars(again) == vars(error)


def test_shares_are_all_there_is_and_nothing_twice() -> None:
    shares = [Share.read(f"{i}/3").taken(range(10)) for i in (1, 2, 3)]
    assert sorted(item for share in shares for item in share) == list(range(10))


@pytest.mark.parametrize("text", ["0/3", "4/3", "2", "a/b", "", "1/0"])
def test_no_share(text: str) -> None:
    with pytest.raises(InvalidValueError, match=r"--shard: found '.*', needs I/N"):
        Share.read(text)


def test_a_scheduler_that_does_not_answer_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("distributed")
    monkeypatch.setattr("coopqp.study.engine.PATIENCE", 0.5)
    unraised: list[object] = []
    monkeypatch.setattr("sys.unraisablehook", unraised.append)
    begun = time.monotonic()
    for address in ("tcp://127.0.0.1:9", "nonsense"):
        with pytest.raises(CoopqpError, match=f"no Dask scheduler answers at '{address}'"):
            list(Engine(scheduler=address).results(square, range(3)))
        gc.collect()  # what the client has begun is not waited for
    assert time.monotonic() - begun < 10.0
    assert not unraised
