"""LeRobot's datasets (v3.0): which recorded frames break limits, self-collision or the loop."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from coopqp.adapters.chunk_filter import Change, ChunkFilter
from coopqp.adapters.motors import KEYS, MotorUnits
from coopqp.base.errors import InvalidValueError, MissingDependencyError, UnreadableFileError
from coopqp.base.spec import Array
from coopqp.base.wording import counted
from coopqp.scenario.scenario import Scenario

#: Changes of an episode that its text shows.
SHOWN = 3


@dataclass(frozen=True)
class AuditedEpisode:
    """What one episode of so many frames breaks."""

    episode: int
    frames: int
    broken: tuple[Change, ...]

    def __str__(self) -> str:
        count = len({change.frame for change in self.broken})
        text = f"episode {self.episode}: {count} of {counted(self.frames, 'frame')} broken"
        if not count:
            return text
        kinds = Counter(change.limit for change in self.broken)
        by_kind = ", ".join(f"{limit} {number}" for limit, number in sorted(kinds.items()))
        return "\n  ".join([f"{text}: {by_kind}", *map(str, self.broken[:SHOWN])])


def audit(
    folder: Path,
    scenario: Scenario,
    units: MotorUnits | None = None,
    *,
    column: str = "action",
    **settings: Any,
) -> Iterator[AuditedEpisode]:
    """Look at every episode of a dataset of two arms, at the dataset's own rate.

    Args:
        folder: of the dataset, with meta/info.json.
        scenario: with the robot.
        units: of the motors.
        column: "action" or "observation.state".
        settings: as for :class:`ChunkFilter`, but fps.

    Raises:
        CoopqpError: pyarrow is missing; the folder is no such dataset.
    """
    fps, at = _described(folder, column)
    chunks = ChunkFilter(scenario, units, fps=fps, **settings)
    for episode, rows in _episodes(folder, column):
        yield AuditedEpisode(episode, len(rows), tuple(chunks.audit(rows[:, at])))


def _described(folder: Path, column: str) -> tuple[float, list[int]]:
    """Frames a second, and where in a row each key is."""
    file = folder / "meta" / "info.json"
    try:
        info = json.loads(file.read_text(encoding="utf-8"))
        fps, feature = float(info["fps"]), info["features"][column]
        names = list(feature["names"])
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise UnreadableFileError(file, f"is no dataset v3.0 with {column}: {error!r}") from None
    if missing := [key for key in KEYS if key not in names]:
        raise InvalidValueError(f"{file}: {column} has no {', '.join(missing)}")
    return fps, [names.index(key) for key in KEYS]


def _episodes(folder: Path, column: str) -> Iterator[tuple[int, Array]]:
    try:
        import pyarrow.parquet as parquet
    except ImportError:
        raise MissingDependencyError("datasets", "studies") from None
    wanted = ["episode_index", "frame_index", column]
    kept: dict[int, list[tuple[int, list[float]]]] = {}
    for file in sorted((folder / "data").glob("*/*.parquet")):
        try:
            rows = parquet.read_table(file, columns=wanted).to_pydict()
        except (OSError, ValueError, KeyError) as error:
            raise UnreadableFileError(file, str(error)) from None
        for episode, frame, row in zip(*(rows[key] for key in wanted), strict=True):
            kept.setdefault(episode, []).append((frame, row))
    for episode in sorted(kept):
        yield episode, np.array([row for _, row in sorted(kept[episode])], float)
