"""Whether a folder is a study's own: refuse others before anything is written into it."""

from __future__ import annotations

from pathlib import Path

from coopqp.errors import CoopqpError
from coopqp.study.sweep.identity import differences
from coopqp.study.sweep.journal import PATTERN, head_of, journals
from coopqp.study.sweep.results import NAME

#: Files that only a comparison's folder has.
COMPARISONS = ("metrics.json", "trace.csv")
AWAY = "give another --out, or move the folder away"


def check_folder(folder: Path, identity: dict[str, str]) -> None:
    """Refuse what is not the folder of this study.

    Args:
        folder: in which its results are to be; need not exist.
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
        if different := differences(head["identity"], identity):
            words = f"'{folder}' belongs to another study ('{head.get('name')}'), or an older one"
            raise CoopqpError(
                f"{words}: {', '.join(different)} differ{'' if len(different) > 1 else 's'}; {AWAY}"
            )
