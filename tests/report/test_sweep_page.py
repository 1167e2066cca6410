"""The page of a study: what it counts, and that it stays small."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest

from coopqp.report.sweep import table
from coopqp.report.sweep.page import BINS, Binned, bins_for, worst_error, worst_rows, write
from coopqp.study.sweep import Study, read_study
from coopqp.study.sweep.results import Columns
from coopqp.study.sweep.summary import summarize

pa = pytest.importorskip("pyarrow")
STUDY = """scenario: planar_pair
vary:
  tasks.slide.gain: {range: [1.0, 9.0]}
  object.mass: {log: [0.1, 10.0]}
  on_infeasible: {choice: [scale, hold]}
  controllers: {choice: [qp, pseudoinverse]}
samples: {random: 3000, seed: 1}
"""


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> Study:
    path = tmp_path_factory.mktemp("study") / "study.yaml"
    path.write_text(STUDY, encoding="utf-8")
    return read_study(path)


@pytest.fixture(scope="module")
def columns(study: Study, tmp_path_factory: pytest.TempPathFactory) -> Columns:
    """Made-up results: heavy objects are missed, and nothing is done where the gain is below 2."""
    from pyarrow import parquet as pq

    rows = []
    for k in range(study.points.count):
        gain, mass, mode = study.variant(k).values
        for i, controller in enumerate(study.controllers):
            done = gain >= 2.0
            good = mass < (5.0, 1.0)[i]
            rows.append(
                {
                    "row": 2 * k + i, "variant": k, "controller": controller,
                    "state": "done" if done else "invalid", "reason": "" if done else "too low",
                    "tasks.slide.gain": gain, "object.mass": mass, "on_infeasible": mode,
                    "success": good if done else None, "reached": good if done else None,
                    "blocked_by": "" if good or not done else "left_1, left_2",
                    "broken": "" if done else None,
                    "task_error.slide": mass / (i + 1) if done else None,
                    "limit_margin_min": 0.1 * gain if done else None,
                }
            )  # fmt: skip
    path = tmp_path_factory.mktemp("results") / "results.parquet"
    pq.write_table(pa.Table.from_pylist(rows), path)
    return Columns(path)


def test_maps_count_every_row_once_and_where_it_is(study: Study, columns: Columns) -> None:
    binned = Binned(study, columns)
    assert [axis.name for axis in binned.axes] == list(study.columns)
    gain, mass = (columns.numbers(name) for name in study.columns[:2])
    own = (np.array(columns.codes("controller")[0]) == 0) & (gain >= 2.0)
    (found,) = (m for m in binned.maps() if (m["x"], m["y"]) == (0, 1))
    edges = np.linspace(1.0, 9.0, BINS + 1)
    powers = np.linspace(-1.0, 1.0, BINS + 1)
    for key, chosen in (("all", own), ("good", own & (mass < 5.0))):
        counted, *_ = np.histogram2d(gain[chosen], np.log10(mass[chosen]), [edges, powers])
        np.testing.assert_array_equal(np.reshape(found[key][0], (BINS, BINS)), counted)


@pytest.mark.parametrize("variants", [1, 128, 256, 600, 1000, 3000, 100_000])
def test_a_cell_has_rows_enough_for_a_share(variants: int) -> None:
    count = bins_for(variants)
    assert count % 4 == 0  # where ticks are
    assert 4 <= count <= BINS
    assert count == 4 or variants / count**2 >= 8


def test_bands_are_quantiles_of_what_is_in_the_bin(study: Study, columns: Columns) -> None:
    binned = Binned(study, columns)
    error = columns.numbers("task_error.slide")
    bands = binned.bands(error)
    axis = binned.axes[2]
    assert axis.labels == ("scale", "hold") or axis.labels == ("hold", "scale")
    for controller in (0, 1):
        for b in (0, 1):
            chosen = (axis.code == b) & (binned.controller == controller) & binned.done
            expected = np.quantile(error[chosen], [0.05, 0.25, 0.5, 0.75, 0.95])
            np.testing.assert_allclose(bands[2][controller][b], expected, rtol=1e-4)
    assert bands[0][0][0] is None  # the lowest gains, where nothing is done


def test_ribbons_have_all_rows_that_are_done(study: Study, columns: Columns) -> None:
    binned = Binned(study, columns)
    done = int(binned.done.sum())
    good = int((binned.success > 0.0).sum())
    for flow in binned.flows():
        assert sum(count for _, _, count, _ in flow) == done
        assert sum(count for _, _, _, count in flow) == good


def test_controllers_are_compared_on_the_same_variants(columns: Columns, study: Study) -> None:
    summary = summarize(columns, exact=False)
    (pair,) = summary.pairs
    gain, mass = (columns.numbers(name)[::2] for name in study.columns[:2])
    mass = mass[gain >= 2.0]
    assert (pair.controller, pair.reference) == ("pseudoinverse", "qp")
    found, only_qp = pair.success, int(((mass >= 1.0) & (mass < 5.0)).sum())
    assert (found.both, found.only_one) == ((mass < 1.0).sum(), 0)
    assert (found.only_reference, found.neither) == (only_qp, (mass >= 5.0).sum())
    assert found.difference.value == pytest.approx(-only_qp / len(mass))
    assert found.difference.high < 0.0
    error = pair.numbers["task_error.slide"]  # the second ends at half the distance
    assert error.value == pytest.approx(np.median(-0.5 * mass))
    assert error.low < error.value < error.high < 0.0
    assert error.p < 1e-9
    same = pair.numbers["limit_margin_min"]
    assert (same.value, same.low, same.high, same.p) == (0.0, 0.0, 0.0, 1.0)
    shown = table.paired(summary)
    assert shown is not None
    assert "p < 1e-4" in table.points(found.difference, exact=False)


def test_the_worst_rows_end_farthest(study: Study, columns: Columns) -> None:
    binned, error = Binned(study, columns), worst_error(columns)
    mass = columns.numbers("object.mass")
    own = np.flatnonzero(binned.done & (binned.controller == 0))
    expected = own[np.argsort(-mass[own])][:10]
    assert worst_rows(binned, error, 0) == expected.tolist()


def test_the_table_counts_limits_and_reasons(columns: Columns) -> None:
    summary = summarize(columns, exact=False)
    gain, mass = (columns.numbers(name)[::2] for name in ("tasks.slide.gain", "object.mass"))
    line = summary.lines[0]
    heavy = int(((gain >= 2.0) & (mass >= 5.0)).sum())
    assert line.blocked_by == {"left_1": heavy, "left_2": heavy}
    assert line.states == {"done": int((gain >= 2.0).sum()), "invalid": int((gain < 2.0).sum())}
    assert summary.reasons == {"too low": 2 * int((gain < 2.0).sum())}
    assert list(table.sentences(summary)) == [f"{2 * int((gain < 2.0).sum()):,} rows: too low"]


def test_the_page_is_small_and_links_what_is_there(
    study: Study, columns: Columns, tmp_path: Path
) -> None:
    page = write(study, columns, summarize(columns, exact=False), tmp_path)
    text = page.read_text(encoding="utf-8")
    assert len(text) < 200_000  # six thousand rows
    links = re.findall(r'href="([^"]+)"', text)
    assert len(links) == 20
    assert all((tmp_path / link).is_file() for link in links)
    data = re.search(r"<script>const study = (.*?);</script>", text)
    assert data
    assert json.loads(data.group(1))["controllers"] == ["qp", "pseudoinverse"]
    assert "http://" not in text.replace("http://www.w3.org/2000/svg", "")
