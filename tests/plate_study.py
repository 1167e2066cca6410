"""A small study of the planar pair, which tests of studies share."""

from __future__ import annotations

from pathlib import Path

from coopqp.scenario.loader import shipped
from coopqp.study.engine import Engine

HERE = Engine(jobs=1)
STUDY = """scenario: plate.yaml
vary:
  tasks.slide.goal: {box: [[0.30, -0.05, 0.0], [0.40, 0.10, 0.0]]}
  object.mass: {log: [0.1, 2.0]}
  controllers: {choice: [qp, pseudoinverse]}
samples: {sobol: 8, seed: 1}
metrics: [loop_error_max]
"""
METRIC = '''"""A metric of one's own."""
import os
from pathlib import Path

from coopqp import Metric, Trace, spec

{first}


@spec
class {name}(Metric):
    """Of the ticks."""

    def measure(self, trace: Trace) -> int:
        {measures}
'''
SHORT = (("duration: 3.0", "duration: 0.1"), ("duration: 2.0", "duration: 0.1"))


def plate_in(folder: Path) -> Path:
    """The folder, with a study of eight variants of ten ticks in it."""
    text = shipped()["planar_pair"].read_text(encoding="utf-8")
    for before, after in SHORT:
        text = text.replace(before, after)
    (folder / "plate.yaml").write_text(text, encoding="utf-8")
    written(folder, STUDY)
    return folder


def written(folder: Path, text: str) -> Path:
    path = folder / "study.yaml"
    path.write_text(text, encoding="utf-8")
    return path


def own_metric(folder: Path, name: str, measures: str, *first: str) -> Path:
    """A folder of plug-ins with a metric of one's own; first are lines that run when it is read."""
    metrics = folder / "metrics"
    metrics.mkdir(parents=True)
    lines = "\n".join(first)
    text = METRIC.format(name=name.capitalize(), measures=measures, first=lines)
    (metrics / f"{name}.py").write_text(text, encoding="utf-8")
    return folder


def table_of(folder: Path) -> list[dict[str, object]]:
    import pyarrow.parquet as pq

    rows: list[dict[str, object]] = pq.read_table(folder / "results.parquet").to_pylist()
    return rows
