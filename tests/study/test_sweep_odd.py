"""Studies whose rows are not what one hoped for, and folders with little in them."""

from __future__ import annotations

import json
import re
import shutil
import sqlite3
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from command_line import typed
from plate_study import HERE, STUDY, own_metric, plate_in, table_of, written

from coopqp.assessment import assess
from coopqp.execution.controller_run import run
from coopqp.scenario.loader import load
from coopqp.study.sweep import read_study, sweep
from coopqp.study.sweep.results import HEAD, Journal, head_of

pytest.importorskip("pyarrow.parquet")

GOAL = "tasks.slide.goal: {box: [[0.30, -0.05, 0.0], [0.40, 0.10, 0.0]]}"
MASS = "object.mass: {log: [0.1, 2.0]}"


def study_in(folder: Path, *changes: tuple[str, str]) -> Path:
    """The study with some of its text replaced."""
    text = STUDY
    for before, after in changes:
        assert before in text
        text = text.replace(before, after)
    return written(folder, text)


def test_where_no_row_is_done_the_table_says_why(plate: Path) -> None:
    path = study_in(plate, (MASS, "dt: {range: [0.02, 0.03]}"))
    result = typed("sweep", path, "--out", plate / "out", "--jobs", "1")
    assert result.exit_code == 0, result.output
    assert "kappa: found 100.0; needs at most 1/dt" in result.stdout
    assert {row["state"] for row in table_of(plate / "out")} == {"invalid"}
    assert typed("sweep", plate / "out", "--table", "--json").exit_code == 0


def test_a_journal_with_only_its_head_has_a_table(plate: Path) -> None:
    sweep(read_study(plate / "study.yaml"), plate / "out", engine=HERE)
    changed(plate / "out", "DELETE FROM records WHERE id >= 0")
    result = typed("sweep", plate / "out", "--table")
    assert result.exit_code == 0, result.output
    assert "0 of 16 rows are there yet" in result.stdout


@pytest.mark.parametrize(
    ("key", "values", "labels"),
    [
        ("grasp", ["null", "rigid"], ["left out", "rigid"]),
        ("kappa", ["null", *(str(k) for k in range(3))], ["0", "1", "2", "left out"]),
        ("on_infeasible", ["hold", "scale"], ["hold", "scale"]),
    ],
)
def test_null_has_a_bin_of_its_own(
    plate: Path, key: str, values: list[str], labels: list[str]
) -> None:
    from coopqp.report.sweep.page import Binned
    from coopqp.study.sweep.results import Columns

    path = study_in(plate, (MASS, f"{key}: {{choice: [{', '.join(values)}]}}"))
    study = read_study(path)
    sweep(study, plate / "out", engine=HERE)
    binned = Binned(study, Columns.of(plate / "out"))
    (axis,) = (axis for axis in binned.axes if axis.name == key)
    assert sorted(axis.labels) == sorted(labels)
    for row, code in zip(table_of(plate / "out"), axis.code, strict=True):
        value = row[key]
        assert axis.labels[code] == (
            "left out" if value is None else f"{value:.4g}" if key == "kappa" else value
        )
    assert sum(map(sum, next(iter(binned.maps()))["all"])) == len(axis.code)
    list(binned.flows())


def test_many_numbers_and_null_are_in_bins_with_labels() -> None:
    from coopqp.report.sweep.page import BINS, _axis

    class Found:
        def __init__(self) -> None:
            self.kinds = {"kappa": "double"}

        def numbers(self, name: str) -> np.ndarray:
            return values

    values = np.append(np.linspace(0.0, 32.0, 33), np.nan)
    axis = _axis(Found(), "kappa", None, BINS)  # type: ignore[arg-type]
    assert axis is not None
    assert axis.count == BINS + 1
    assert axis.labels[0] == "0 to 2"
    assert axis.labels[-1] == "left out"
    assert np.bincount(axis.code).tolist() == [2] * (BINS - 1) + [3, 1]


def test_a_loop_that_opens_is_why_a_run_does_not_succeed(plate: Path) -> None:
    """Goals are reached, and no limit is broken."""
    trace = run(load("planar_pair"), controller="qp")
    assert assess(trace).succeeds
    assert not assess(trace).broken
    opened = replace(trace, loop_position=trace.loop_position + 1.2e-4)
    assert assess(opened).reached
    assert not assess(opened).succeeds
    assert assess(opened).broken == ("loop",)


@pytest.mark.parametrize(("duration", "named"), [(0.08, True), (3.0, False)])
def test_speeds_that_hold_a_run_up_are_named(plate: Path, duration: float, named: bool) -> None:
    """It ends on its way, with joints as fast as they can; with more time it arrives."""
    text = (plate / "plate.yaml").read_text(encoding="utf-8")
    for before, after in (
        ("\nduration: 0.1", f"\nduration: {duration}"),
        ("duration: 0.1}", "duration: 0.05}"),
        ("gain: 5.0", "gain: 20.0"),
        ("goal: [0.36, 0.10, 0.0]", "goal: [0.46, 0.24, 0.0]"),
    ):
        assert before in text
        text = text.replace(before, after)
    (plate / "fast.yaml").write_text(text, encoding="utf-8")
    scenario = load(plate / "fast.yaml")
    trace = run(scenario, controller="qp")
    assert assess(trace).succeeds is not named
    model = scenario.robot_model.model
    full = (np.abs(trace.v) > 0.9999 * model.velocityLimit).mean(axis=0) > 0.25
    fast = {f"speed of {joint}" for joint, at in zip(trace.joints, full, strict=True) if at}
    found = {name for name in assess(trace).blocked_by if name.startswith("speed")}
    assert found == (fast if named else set())
    assert fast or not named
    law = run(scenario, controller="pseudoinverse")
    assert not [name for name in assess(law).blocked_by if name.startswith("speed")]


# Folders


@pytest.fixture(scope="module")
def kept(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a study, and its results in out."""
    folder = plate_in(tmp_path_factory.mktemp("kept"))
    sweep(read_study(folder / "study.yaml"), folder / "out", engine=HERE)
    return folder


def changed(out: Path, statement: str, *values: object) -> Path:
    """The folder, with its journal changed behind coopqp's back."""
    with closing(sqlite3.connect(out / "journal.sqlite3")) as database, database:
        database.execute(statement, values)
    return out


def copied(kept: Path, folder: Path, statement: str = "SELECT 1", *values: object) -> Path:
    """A copy of the results, with its journal changed."""
    return changed(Path(shutil.copytree(kept / "out", folder / "out")), statement, *values)


def test_a_digit_that_changes_on_the_disk_is_done_again(kept: Path, tmp_path: Path) -> None:
    out = copied(kept, tmp_path, "UPDATE records SET said = '{}' WHERE id = 6")
    content = (out / "journal.sqlite3").read_bytes()
    for variant in (2, 4):
        digit = re.search(rb'"variant":%d,[^{]*{.*?0\.\d{6}(\d)' % variant, content)
        assert digit
        k, other = digit.start(1), b"1" if digit[1] != b"1" else b"2"
        content = content[:k] + other + content[k + 1 :]
    (out / "journal.sqlite3").write_bytes(content)
    looked = typed("sweep", out, "--table")
    assert looked.exit_code == 0
    assert "3 records of the journal are damaged" in looked.stderr
    assert "10 of 16 rows are there yet" in looked.stdout
    again = typed("sweep", kept / "study.yaml", "--out", out, "--jobs", "1")
    assert again.exit_code == 0
    words = "3 records of the journal are damaged; what stood there has been done again"
    assert words in again.stderr
    assert table_of(out) == table_of(kept / "out")
    assert "damaged" not in typed("sweep", out, "--table").stderr


def refused(*words: object) -> str:
    """What a command says that ends with exit code 2 and one error."""
    result = typed(*words)
    assert result.exit_code == 2, result.output
    assert result.stderr.count("error: ") == 1
    return result.stderr


def test_a_damaged_head_is_told_and_nothing_is_lost(kept: Path, tmp_path: Path) -> None:
    head = "UPDATE records SET said = replace(said, 'sobol: 8', 'sobol: 4') WHERE id = -1"
    outs = [copied(kept, tmp_path / str(k), *words) for k, words in enumerate(((head,), (), ()))]
    whole = (kept / "out" / "journal.sqlite3").read_bytes()
    (outs[1] / "journal.sqlite3").write_bytes(b"no head" + whole[7:])
    (outs[2] / "journal.sqlite3").write_bytes(b"")
    for out in outs:
        before = (out / "journal.sqlite3").read_bytes()
        said = refused("sweep", kept / "study.yaml", "--out", out)
        assert "damaged" in said
        assert re.search("move (the folder|it) away", said)
        assert (out / "journal.sqlite3").read_bytes() == before
        assert refused("sweep", out, "--table")


def test_pages_that_are_garbage_are_told(kept: Path, tmp_path: Path) -> None:
    """Whatever part of the file a disk has lost."""
    whole = (kept / "out" / "journal.sqlite3").read_bytes()
    for k, lost in enumerate(range(4096, len(whole), 4096)):
        out = copied(kept, tmp_path / str(k))
        (out / "journal.sqlite3").write_bytes(whole[:lost] + b"?" * 4096 + whole[lost + 4096 :])
        for words in ((out, "--table"), (kept / "study.yaml", "--out", out, "--jobs", "1")):
            result = typed("sweep", *words)
            told = result.stderr.count("damaged") + result.stderr.count("cannot be read")
            assert result.exit_code in (0, 2)
            assert told == 1, result.output
            assert "Traceback" not in result.output


def test_an_older_form_is_refused_in_words(kept: Path, tmp_path: Path) -> None:
    other = copied(kept, tmp_path / "other", "PRAGMA user_version = 2")
    older = copied(kept, tmp_path / "older")
    (older / "journal.sqlite3").rename(older / "journal.jsonl")
    told = ((other, "another coopqp (form 2, this one has 3)"), (older, "an older coopqp"))
    for out, whose in told:
        for words in (("sweep", out, "--table"), ("sweep", kept / "study.yaml", "--out", out)):
            said = refused(*words)
            assert f"was written by {whose}" in said
            assert "use that one, or give another --out" in said


def test_records_of_no_variant_are_refused(kept: Path, tmp_path: Path) -> None:
    for k, wrong in enumerate(({"variant": 9999, "rows": [{}, {}]}, {"variant": 1, "rows": []})):
        out = copied(kept, tmp_path / str(k))
        with Journal.opened(out / "journal.sqlite3", {}) as journal:
            journal.append([(wrong["variant"], wrong)])
        for words in (("sweep", out, "--table"), ("sweep", kept / "study.yaml", "--out", out)):
            assert "holds a record that is none of this study's" in refused(*words)


def test_a_journal_that_is_a_folder_is_refused(kept: Path, tmp_path: Path) -> None:
    (tmp_path / "journal.sqlite3").mkdir()
    for words in (
        ("sweep", tmp_path, "--table"),
        ("sweep", kept / "study.yaml", "--out", tmp_path),
    ):
        assert "is a folder, needs a file" in refused(*words)


def test_studies_and_comparisons_have_folders_of_their_own(kept: Path, tmp_path: Path) -> None:
    assert typed("sweep", kept / "out", "--table").exit_code == 0
    page = (kept / "out" / "report.html").read_bytes()
    said = refused("compare", kept / "plate.yaml", "--out", kept / "out")
    assert "holds a study" in said
    assert (kept / "out" / "report.html").read_bytes() == page
    compared = tmp_path / "compared"
    assert typed("compare", kept / "plate.yaml", "--out", compared).exit_code == 0
    said = refused("sweep", kept / "study.yaml", "--out", compared)
    assert "holds a comparison (metrics.json)" in said
    assert not (compared / "journal.sqlite3").exists()


def test_what_differs_is_named_by_its_key(kept: Path, tmp_path: Path) -> None:
    shutil.copytree(kept, tmp_path / "kept")
    study_in(tmp_path / "kept", ("seed: 1", "seed: 2"))
    said = refused("sweep", tmp_path / "kept" / "study.yaml", "--out", tmp_path / "kept" / "out")
    assert ": the study file (samples.seed) differs; " in said
    assert "scipy" not in said


def test_options_that_contradict_each_other_are_refused(kept: Path, tmp_path: Path) -> None:
    study, out = kept / "study.yaml", kept / "out"
    for words, told in (
        ((study, "--out", tmp_path / "x", "--scheduler", ""), "--scheduler"),
        ((study, "--out", tmp_path / "x", "--jobs", "5000"), "--jobs: found 5000; needs at most"),
        ((out, "--table", "--show", "1"), "ask one at a time"),
        ((out, "--shard", "1/2"), "--shard and --scheduler need a study file"),
        ((study, "--out", study / "x", "--jobs", "1"), "cannot be made"),
    ):
        result = typed("sweep", *words)
        assert result.exit_code == 2
        assert told in result.stderr
    assert not (tmp_path / "x").exists()


def test_validate_knows_studies(kept: Path, tmp_path: Path) -> None:
    result = typed("validate", kept / "plate.yaml", kept / "study.yaml")
    assert result.exit_code == 0, result.output
    assert f"{kept / 'study.yaml'}: ok" in result.stdout
    shutil.copy(kept / "plate.yaml", tmp_path)
    wrong = study_in(tmp_path, ("log: [0.1, 2.0]", "choice: [1.0, heavy]"))
    assert f'{wrong}:4: vary.object.mass: found "heavy"; needs a number' in refused(
        "validate", wrong
    )


def test_reasons_that_only_differ_in_numbers_are_one(plate: Path) -> None:
    path = study_in(plate, (MASS, "dt: {range: [0.02, 0.03]}"))
    result = typed("sweep", path, "--out", plate / "out", "--jobs", "1", "--json")
    (reason,) = json.loads(result.stdout)["reasons"].items()
    assert reason[0].startswith("such as ")
    assert "kappa: found 100.0" in reason[0]
    assert reason[1] == 16


def test_what_plugins_print_does_not_stand_in_the_json(
    plate: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    measures = 'print("measured"); os.system("echo below"); return trace.ticks'
    own_metric(plate / "loud", "talks", measures, 'print("imported")')
    path = study_in(plate, ("[loop_error_max]", "[talks]"), ("sobol: 8", "sobol: 2"))
    options = ("--out", plate / "out", "--plugins", plate / "loud", "--jobs", "1")
    done = typed("sweep", path, "--json", *options)
    assert json.loads(done.stdout)["rows"] == 4
    assert "imported" in done.stderr
    assert "measured" in done.stderr
    below = capfd.readouterr()
    assert "below" in below.err
    assert "below" not in below.out


def test_a_study_file_is_no_folder(kept: Path) -> None:
    for option in (("--table",), ("--show", "1")):
        assert "is a file; --table and --show need the folder of a study" in refused(
            "sweep", kept / "study.yaml", *option
        )


def test_opening_a_study_runs_none_of_its_code(plate: Path) -> None:
    """Somebody's folder names plug-ins that leave a mark when they are read."""
    for name in ("own", "theirs"):
        mark = 'Path(__file__).with_suffix(".mark").touch()'
        own_metric(plate / name, "thrice", "return 3 * trace.ticks", mark)
    path, out = study_in(plate, ("[loop_error_max]", "[thrice]")), plate / "out"
    assert (
        typed("sweep", path, "--out", out, "--jobs", "1", "--plugins", plate / "own").exit_code == 0
    )
    assert (plate / "own" / "metrics" / "thrice.mark").exists()
    head = {**head_of(out / "journal.sqlite3"), "folders": [[], [str(plate / "theirs")]]}
    with Journal.opened(out / "journal.sqlite3", {}) as journal:
        journal.append([(HEAD, head)])
    assert typed("sweep", out, "--table").exit_code == 0
    assert typed("sweep", out, "--watch").exit_code == 0
    told = refused("sweep", out, "--show", "1")
    assert f"add --plugins {plate / 'theirs'}" in told
    assert not (plate / "theirs" / "metrics" / "thrice.mark").exists()
    shown = typed("sweep", out, "--show", "1", "--plugins", plate / "own")
    assert shown.exit_code == 0
    assert "warning" not in shown.stderr
