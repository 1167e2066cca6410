"""Whether a folder is a study's own: refuse others before anything is written into it."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from coopqp.errors import CoopqpError
from coopqp.scenario.yaml import parsed
from coopqp.study.sweep.identity import PARTS, differences
from coopqp.study.sweep.journal import PATTERN, head_of, journals
from coopqp.study.sweep.results import NAME
from coopqp.study.sweep.study import Study
from coopqp.wording import dotted

#: Files that only a comparison's folder has.
COMPARISONS = ("metrics.json", "trace.csv")
MOST_KEYS = 4  # that are named
AWAY = "give another --out, or move the folder away"


def check_folder(folder: Path, study: Study, identity: dict[str, str]) -> None:
    """Refuse what is not the folder of this study.

    Args:
        folder: in which its results are to be; need not exist.
        study: whose.
        identity: of the study.

    Raises:
        CoopqpError: it is a file, or holds a comparison, results without their journal, or another
            study, saying what differs.
    """
    if folder.exists() and not folder.is_dir():
        raise CoopqpError(f"'{folder}' is not a folder")
    found = journals(folder)
    for name in COMPARISONS if not found else ():
        if (folder / name).exists():
            raise CoopqpError(f"'{folder}' holds a comparison ({name}); {AWAY}")
    if not found and (folder / NAME).exists():
        torn = any(folder.glob(PATTERN))
        why = "the head of its journal is damaged" if torn else "its journal is not there"
        raise CoopqpError(f"'{folder}' has {NAME}, but {why}; {AWAY}")
    for path in found:
        head = head_of(path) or {}
        if different := list(_different(head, study, identity)):
            words = f"'{folder}' belongs to another study ('{head.get('name')}'), or an older one"
            raise CoopqpError(
                f"{words}: {', '.join(different)} differ{'' if len(different) > 1 else 's'}; {AWAY}"
            )


def _different(head: dict[str, Any], study: Study, identity: dict[str, str]) -> Iterator[str]:
    """What is not the same, with its keys; the points follow from the study."""
    texts = {"study": (study.file.path, study.file.text), "scenario": study.scenario_text}
    parts = differences(head["identity"], identity)
    for part in parts:
        if part == "points" and "study" in parts:
            continue
        keys: list[str] = []
        if part in texts:
            before = parsed(Path(head[part][0]), head[part][1]).data
            keys = list(_keys(before, parsed(*texts[part]).data))
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
