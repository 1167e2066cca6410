"""YAML files with the line of every value, so that an error can name its place."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.constructor import DuplicateKeyError
from ruamel.yaml.error import MarkedYAMLError, YAMLError

from coopqp.errors import Fault, ScenarioError
from coopqp.wording import Location, dotted


@dataclass(frozen=True)
class YamlFile:
    """A mapping read from a file.

    Attributes:
        path: of the file, as given.
        data: plain dicts, lists, strings, numbers, booleans and None.
    """

    path: Path
    data: dict[str, Any]
    _marked: Any

    def place(self, location: Location) -> str:
        """``file:line: key.path`` of a value, or of the nearest mapping that holds it."""
        node: Any = self._marked
        line = 1
        for key in location:
            try:
                lines: Any = node.lc
                position = lines.item(key) if isinstance(node, list) else lines.key(key)
                node = node[key]
            except (KeyError, IndexError, TypeError, AttributeError):
                break
            line = position[0] + 1
        where = f"{self.path}:{line}"
        return f"{where}: {dotted(location)}" if location else where


def read_yaml(path: Path) -> YamlFile:
    """Read a YAML mapping.

    Raises:
        ScenarioError: no such file, not text, not YAML, a key given twice, empty, not a mapping.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise _refused(path, f"cannot be read: {error.strerror}") from None
    except UnicodeDecodeError:
        raise _refused(path, "is not a text file in UTF-8") from None
    try:
        marked = YAML(typ="rt").load(text)
    except DuplicateKeyError as error:
        key = str(error.problem).partition('"')[2].partition('"')[0]
        raise _refused(_marked_place(path, error), f"key '{key}' is given twice") from None
    except MarkedYAMLError as error:
        what = " ".join(str(error.problem or error.context).split())
        raise _refused(_marked_place(path, error), f"not YAML: {what}") from None
    except YAMLError as error:
        raise _refused(path, f"not YAML: {' '.join(str(error).split())}") from None
    if marked is None:
        raise _refused(path, "the file is empty")
    if not isinstance(marked, dict):
        raise _refused(
            f"{path}:1", "needs a mapping of keys such as 'robot:', found something else"
        )
    return YamlFile(path, _plain(marked), marked)


def _refused(place: object, message: str) -> ScenarioError:
    return ScenarioError([Fault(str(place), message)])


def _marked_place(path: Path, error: MarkedYAMLError) -> str:
    mark = error.problem_mark or error.context_mark
    return f"{path}:{mark.line + 1}" if mark else str(path)


def _plain(value: Any) -> Any:
    """Without the reader's own types."""
    if isinstance(value, dict):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, list):
        return [_plain(v) for v in value]
    for kind in (bool, int, float, str):
        if isinstance(value, kind):
            return kind(value)
    return None if value is None else str(value)
