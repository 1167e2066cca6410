"""Run what of a study is not there yet, in a folder of its own; the study from its folder alone.

What makes two folders the same study is a hash of each part that results follow from.
"""

import inspect
import json
import math
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import lru_cache, partial
from hashlib import sha256
from pathlib import Path
from shlex import quote
from typing import Any

import numpy as np

import coopqp
from coopqp.assessment import assess
from coopqp.base.errors import CoopqpError, InternalError
from coopqp.base.reading import absolute
from coopqp.base.wording import dotted, raised
from coopqp.execution.controller_run import run
from coopqp.metric import Metric, measured
from coopqp.scenario.catalog import COLLECTIONS, Catalog
from coopqp.scenario.checks import Known
from coopqp.scenario.loader import load_file
from coopqp.scenario.scenario import Scenario
from coopqp.scenario.yaml import YamlFile, as_read, as_yaml, files_in, has_files, parsed
from coopqp.study.engine import Engine, Lost
from coopqp.study.sweep import results
from coopqp.study.sweep.reader import study_text
from coopqp.study.sweep.study import (
    CONTROLLERS,
    DONE,
    FAILED,
    INVALID,
    Row,
    Study,
    Variant,
    changed,
)
from coopqp.trace import Trace

HERE = Engine()
EVERY = 0.1  # s between what is written to the journal, at least


@dataclass
class Progress:
    """How far a sweep is: so many variants of this share were there before, and are done."""

    total: int
    before: int
    done: int
    states: Counter[str] = field(default_factory=Counter)  # of the rows since it began
    damaged: int = 0  # records that were not as they were written: what they said is done again
    begun: float = field(default_factory=time.monotonic)

    @property
    def rate(self) -> float:
        """Variants a second since it began; 0 before the first."""
        return (self.done - self.before) / max(time.monotonic() - self.begun, 1e-3)

    @property
    def left(self) -> float:
        """Time that the others will take [s]; infinite before the first."""
        return (self.total - self.done) / self.rate if self.rate else float("inf")


def sweep(
    study: Study,
    folder: Path,
    *,
    engine: Engine = HERE,
    progress: Callable[[Progress], None] | None = None,
) -> Progress:
    """Run the variants that are not in the folder yet; at the end write ``results.parquet``.

    Killed at any moment, it goes on from there when called again; the file is the same in the end.
    The folder is made if it does not exist; ``progress`` is called when something was written.
    """
    results.needs_arrow()
    head = _head_for(study)
    _check_folder(folder, head)
    job = job_of(study)
    with results.Journal.opened(results.path_of(folder, engine.share), head) as journal:
        mine = engine.share.taken(range(study.points.count))
        index = results.Index(folder, study)
        missing = index.missing(mine)
        there = len(mine) - len(missing)
        state = Progress(len(mine), there, there, damaged=index.damaged)
        found: dict[int, list[Row]] = {}
        variants = map(study.variant, missing.tolist())
        work, written = partial(run_variant, job=job), -math.inf

        def write() -> None:
            journal.append((index, {"variant": index, "rows": x}) for index, x in found.items())
            state.done += len(found)
            state.states.update(row["state"] for rows in found.values() for row in rows)
            found.clear()
            if progress:
                progress(state)

        try:
            for variant, rows in engine.results(work, variants, len(missing)):
                lost = isinstance(rows, Lost)
                found[variant.index] = _without(job, FAILED, rows.reason) if lost else rows
                if time.monotonic() - written > EVERY:
                    write()
                    written = time.monotonic()
        finally:
            if found:
                write()
    results.compact(study, folder)
    return state


@dataclass(frozen=True)
class Job:
    """What a worker must know: the scenario's file, for faults, its data as JSON, and so on."""

    file: tuple[Path, str]
    data: str
    places: tuple[tuple[Any, ...], ...]
    controllers: tuple[str, ...]
    metrics: tuple[str, ...]
    folders: tuple[tuple[Path, ...], ...]


def job_of(study: Study) -> Job:
    """What the workers of a study must know."""
    data, own = json.dumps(study.scenario.data), study.catalog.folders
    return Job(study.scenario_text, data, study.locations, study.controllers, study.metrics, own)


@lru_cache(maxsize=2)
def _prepared(job: Job) -> tuple[YamlFile, Mapping[str, Any], Catalog, Known]:
    return parsed(*job.file), json.loads(job.data), Catalog(*job.folders), Known()


def run_variant(variant: Variant, *, job: Job) -> list[Row]:
    """What the engine has a worker do."""
    file, data, catalog, known = _prepared(job)
    try:
        own = file.changed(changed(data, job.places, variant))
        scenario = load_file(own, catalog, known)
    except CoopqpError as error:
        return _without(job, INVALID, str(error))
    except Exception as error:  # noqa: BLE001 - one variant is not to end a study
        return _without(job, FAILED, raised(error))
    with np.errstate(all="ignore"):  # laws that run away leave the range of numbers
        return [_row(job, scenario, name) for name in job.controllers]


def _row(job: Job, scenario: Scenario, controller: str) -> Row:
    try:
        entries = scenario.catalog.entries("metrics")
        metrics = {name: entries[name].cls() for name in job.metrics}
        timed = any(metric.timed for metric in metrics.values())
        return row_of(run(scenario, controller=controller, timed=timed), metrics)
    except CoopqpError as error:
        state = FAILED if isinstance(error, InternalError) else INVALID
        return _without(job, state, str(error))[0]


def row_of(trace: Trace, metrics: Mapping[str, Metric]) -> Row:
    """What a study keeps of a run."""
    found = assess(trace)
    values, faults = measured(metrics, trace)
    row: Row = {"state": DONE, "reason": "; ".join(faults), "success": found.succeeds}
    row |= {"blocked_by": ", ".join(found.blocked_by), "broken": ", ".join(found.broken)}
    for name, value in values.items():
        row |= _flat(name, value)
    return row


def _without(job: Job, state: str, reason: str) -> list[Row]:
    row = {"state": state, "reason": "; ".join(reason.splitlines())}
    return [row for _ in job.controllers]


def _flat(name: str, value: Any) -> Row:
    """Numbers by name; None for what is not finite, for which JSON has no word."""
    if isinstance(value, dict):
        parts = (_flat(f"{name}.{key}", inside) for key, inside in value.items())
        return {key: inside for part in parts for key, inside in part.items()}
    if isinstance(value, list | tuple):
        return {name: json.dumps(value)}
    if isinstance(value, float) and not math.isfinite(value):
        return {name: None}
    return {name: value}


#: Modules of shipped plug-ins; their files count as the version.
SHIPPED = tuple(f"coopqp.{kind}." for kind in COLLECTIONS)
#: What each part is called where it differs.
PARTS = {
    "study": "the study file",
    "scenario": "the scenario",
    "files": "a file that the scenario names",
    "plugins": "the plug-ins",
    "points": "the points drawn, by another version of scipy or numpy",
    "version": "coopqp itself",
}


def _head_for(study: Study) -> dict[str, Any]:
    """What a journal says of its study, with a hash of each part that results follow from."""
    data, folder = study.scenario.data, study.scenario.folder
    named = files_in([data, study.file.data])
    paths = {absolute(folder / name) for name in named if isinstance(name, str)}
    code = _hash(*_of_files(Path(coopqp.__file__).parent.rglob("*.py")))  # versions in development
    identity = {
        "study": _hash(json.dumps(study.file.data, sort_keys=True)),
        "scenario": _hash(study.scenario.path.stem, json.dumps(data, sort_keys=True)),
        "files": _hash(*_of_files(paths)),
        "plugins": _plugins_hash(study),
        "points": study.points.digest,
        "version": f"{coopqp.__version__} ({code})",
    }
    return {
        "name": study.name,
        "identity": identity,
        "study": [str(study.file.path), study.file.text],
        "scenario": list(map(str, study.scenario_text)),
        "folders": [[str(one) for one in kind] for kind in study.catalog.folders],
    }


def _plugins_hash(study: Study) -> str:
    """Of the plug-ins that are not shipped, and of files beside them."""
    classes = [e.cls for kind in COLLECTIONS for e in study.catalog.entries(kind).values()]
    own = (cls for cls in classes if not cls.__module__.startswith(SHIPPED))
    folders = {absolute(Path(inspect.getfile(cls))).parent for cls in own}
    return _hash(*_of_files(file for folder in folders for file in folder.glob("*.py")))


def _hash(*texts: str) -> str:
    found = sha256()
    for text in texts:
        found.update(text.encode())
        found.update(b"\0")
    return found.hexdigest()[:16]


def _of_files(paths: Iterable[Path]) -> Iterator[str]:
    for path in sorted(paths):
        try:
            yield f"{path.name} {sha256(path.read_bytes()).hexdigest()}"
        except OSError:
            yield f"{path.name} -"


#: Files that only a comparison's folder has.
COMPARISONS = ("metrics.json", "trace.csv")
MOST_KEYS = 4  # that are named
AWAY = "give another --out, or move the folder away"


def _check_folder(folder: Path, own: dict[str, Any]) -> None:
    """Refuse what is not the folder of the study with this head, saying what differs."""
    if folder.exists() and not folder.is_dir():
        raise CoopqpError(f"'{folder}' is not a folder")
    found = results.journals(folder)
    for name in COMPARISONS if not found else ():
        if (folder / name).exists():
            raise CoopqpError(f"'{folder}' holds a comparison ({name}); {AWAY}")
    if not found and (folder / results.NAME).exists():
        torn = any(folder.glob(results.PATTERN))
        why = "the head of its journal is damaged" if torn else "its journal is not there"
        raise CoopqpError(f"'{folder}' has {results.NAME}, but {why}; {AWAY}")
    for head in found.values():
        if different := list(_different(head, own)):
            words = f"'{folder}' belongs to another study ('{head.get('name')}'), or an older one"
            differ = "differ" if len(different) > 1 else "differs"
            raise CoopqpError(f"{words}: {', '.join(different)} {differ}; {AWAY}")


def _different(head: dict[str, Any], own: dict[str, Any]) -> Iterator[str]:
    """What is not the same, with its keys; the points follow from the study."""
    one, other = head["identity"], own["identity"]
    parts = [part for part in PARTS if one.get(part) != other.get(part)]
    for part in parts:
        if part == "points" and "study" in parts:
            continue
        keys: list[str] = []
        if part in ("study", "scenario"):
            before, now = (parsed(Path(x[part][0]), x[part][1]).data for x in (head, own))
            keys = list(_keys(before, now))
        more = f" and {len(keys) - MOST_KEYS} more" if len(keys) > MOST_KEYS else ""
        told = f" ({', '.join(keys[:MOST_KEYS])}{more})" if keys else ""
        yield f"{PARTS[part]}{told}"


def _keys(one: Any, other: Any, place: tuple[str | int, ...] = ()) -> Iterator[str]:
    """Places at which two files say something else."""
    if isinstance(one, dict) and isinstance(other, dict):
        for key in {**one, **other}:
            yield from _keys(one.get(key), other.get(key), (*place, key))
    elif one != other:
        yield dotted(place)


def kept_study(folder: Path, catalog: Catalog | None = None) -> Study:
    """The study whose results a folder holds.

    No plug-ins are looked for where it was run: who opens a folder runs none of its code. Who runs
    it gives a catalogue of what its scenario can name; shipped and installed plug-ins when omitted.
    """
    head = _head(folder)
    path, text = head["scenario"]
    own, words = head["study"]
    study = study_text(Path(own), words, (Path(path), text), catalog or Catalog())
    if head["identity"]["points"] != study.points.digest:
        words = "other points are drawn here than where it was run, by another scipy or numpy"
        raise CoopqpError(f"'{folder}': {words}; use that one's")
    return study


def check_plugins(folder: Path, study: Study) -> list[str]:
    """Refuse to run a row without any plug-ins where the study was run with some; else warnings."""
    head = _head(folder)
    named = [
        f"{option} {quote(path)}"
        for option, paths in zip(("--tasks", "--plugins"), head["folders"], strict=True)
        for path in paths
    ]
    if named and not any(study.catalog.folders):
        words = "was run with plug-ins, and opening a folder never runs code by itself"
        raise CoopqpError(f"'{folder}' {words}; if you trust them, add {' '.join(named)}")
    if head["identity"]["plugins"] != _plugins_hash(study):
        return ["the plug-ins are not those that the study was run with"]
    return []


def _head(folder: Path) -> dict[str, Any]:
    if folder.is_file():
        raise CoopqpError(f"'{folder}' is a file; --table and --show need the folder of a study")
    if not folder.is_dir():
        raise CoopqpError(f"'{folder}' is neither a study file nor the folder of a study")
    found = results.journals(folder)
    if not found:
        words = "holds no study: needs a journal, as 'coopqp sweep' writes it"
        raise CoopqpError(f"'{folder}' {words}")
    return next(iter(found.values()))


def scenario_of_row(study: Study, row: int) -> tuple[str, str]:
    """A scenario file for one row, and the name of its controller."""
    if not 0 <= row < study.rows:
        raise CoopqpError(f"--show: found {row}; the study has rows 0 to {study.rows - 1}")
    number, k = divmod(row, len(study.controllers))
    variant = study.variant(number)
    data = changed(study.scenario.data, study.locations, variant)
    controllers = data.get(CONTROLLERS)
    if controllers:
        data = {**data, CONTROLLERS: [controllers[k]]}
    if has_files(data):
        data = {**data, "folder": str(absolute(study.scenario.changed(data).folder))}
    columns = zip(study.columns, study.parts(variant), strict=True)
    values = ", ".join(f"{name} {value}" for name, value in columns)
    head = f"# Row {row} of the study {study.name}, variant {number}: {values}\n"
    return head + as_read(as_yaml(data), data), study.controllers[k]
