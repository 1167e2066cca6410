"""LeRobot's datasets (v3.0): which recorded frames break limits, self-collision or the loop."""

import json
from collections import Counter
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np

from coopqp.adapters.chunk_filter import Change, ChunkFilter
from coopqp.adapters.motors import ARMS, KEYS, MotorUnits
from coopqp.base.errors import InvalidValueError, UnreadableFileError, needs
from coopqp.base.spec import Array
from coopqp.base.wording import counted, message_of
from coopqp.scenario.scenario import Scenario

SHOWN = 3  # changes of an episode that its text shows


@dataclass(frozen=True)
class AuditedEpisode:
    """What one episode of so many frames breaks; ``radians`` if its angles look like that."""

    episode: int
    frames: int
    broken: tuple[Change, ...]
    radians: bool = False

    def __str__(self) -> str:
        count = len({change.frame for change in self.broken})
        text = f"episode {self.episode}: {count} of {counted(self.frames, 'frame')} broken"
        text += "; no joint is farther than 3.2 degrees from 0: are these radians?" * self.radians
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
    fps, at, count = _described(folder, column)
    chunks = ChunkFilter(scenario, units, fps=fps, **settings)
    for episode, numbers, rows in _episodes(folder, column, count):
        given = rows[:, at]
        farthest = np.abs(np.nan_to_num(given[:, ARMS])).max(initial=0.0)
        radians = chunks.units.use_degrees and bool(0.0 < farthest < 3.2)
        broken = (replace(x, frame=numbers[x.frame]) for x in chunks.audit(given))
        yield AuditedEpisode(episode, len(rows), tuple(broken), radians)


def _described(folder: Path, column: str) -> tuple[float, list[int], int]:
    """Frames a second, where in a row each key is, and how many numbers a row has."""
    file = folder / "meta" / "info.json"
    try:
        info = json.loads(file.read_text(encoding="utf-8"))
        fps, feature = float(info["fps"]), info["features"][column]
        names = list(feature["names"])
        if not 0.0 < fps < np.inf:
            raise ValueError(f"fps is {fps:g}")
    except (OSError, ValueError, KeyError, TypeError) as error:
        kind = f"{type(error).__name__} ({message_of(error)})"
        why = "there is no such file" if isinstance(error, OSError) else kind
        raise UnreadableFileError(file, f"is no dataset v3.0 with {column}: {why}") from None
    if missing := [key for key in KEYS if key not in names]:
        raise InvalidValueError(f"{file}: {column} has no {', '.join(missing)}")
    return fps, [names.index(key) for key in KEYS], len(names)


def _episodes(folder: Path, column: str, count: int) -> Iterator[tuple[int, list[int], Array]]:
    """Of each episode its number, those of its frames, and its rows, (frames, count)."""
    with needs("datasets", "studies"):
        import pyarrow.parquet as parquet
    wanted = ["episode_index", "frame_index", column]
    kept: dict[int, list[tuple[int, Array]]] = {}
    for file in sorted((folder / "data").glob("*/*.parquet")):
        try:
            rows = parquet.read_table(file, columns=wanted).to_pydict()
        except (OSError, ValueError, KeyError) as error:
            words = f"needs columns {', '.join(wanted)}: {message_of(error)}"
            raise UnreadableFileError(file, words) from None
        for k, (episode, frame, row) in enumerate(zip(*(rows[key] for key in wanted), strict=True)):
            if not (isinstance(episode, int) and isinstance(frame, int)):
                words = f"row {k}: episode_index and frame_index need whole numbers"
                raise UnreadableFileError(file, words)
            place = f"{file}: frame {frame} of episode {episode}"
            kept.setdefault(episode, []).append((frame, _numbers(row, count, place)))
    if not kept:
        raise UnreadableFileError(folder / "data", "has no frames in */*.parquet")
    for episode in sorted(kept):
        frames, found = zip(*sorted(kept[episode], key=itemgetter(0)), strict=True)
        yield episode, list(frames), np.array(found)


def _numbers(row: Any, count: int, place: str) -> Array:
    """Numbers of a frame, NaN where there is none."""
    with suppress(TypeError, ValueError):
        found = np.array(row, float)
        if found.shape == (count,):
            return found
    raise UnreadableFileError(place, f"needs {count} numbers")
