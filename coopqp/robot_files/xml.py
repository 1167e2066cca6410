"""What reading robots from URDF and MJCF files has in common."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Sequence
from pathlib import Path

from coopqp.errors import InvalidValueError


def read_xml(path: Path, root: str, kind: str) -> ET.Element:
    """Read an XML file of a robot.

    Args:
        path: of the file.
        root: name of its outermost element.
        kind: of file, for messages.

    Raises:
        InvalidValueError: no such file, or no such kind of file.
    """
    try:
        tree = ET.parse(path)
    except OSError as error:
        raise InvalidValueError(f"{path}: cannot be read: {error.strerror}") from None
    except (ET.ParseError, UnicodeError, ValueError) as error:
        raise InvalidValueError(f"{path}: is not a {kind} file: {error}") from None
    element = tree.getroot()
    if element.tag != root:
        raise InvalidValueError(
            f"{path}: is not a {kind} file: starts with <{element.tag}>, needs <{root}>"
        )
    return element


def numbers_of(text: str | None, default: str) -> tuple[float, ...]:
    """The numbers of an attribute."""
    return tuple(float(word) for word in (text or default).split())


def missing_meshes(name: str, missing: Sequence[str], count: int) -> tuple[str, ...]:
    """The warning about meshes that were not found, if there are any."""
    if not missing:
        return ()
    shown = ", ".join(missing[:2]) + (", ..." if len(missing) > 2 else "")
    return (
        f"{name}: {len(missing)} of {count} meshes cannot be found ({shown}); "
        "links left without geometry are drawn as capsules",
    )


def pinocchio_says(error: Exception) -> str:
    """What went wrong, without pinocchio's line numbers."""
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    told = [
        line for line in lines if not line.startswith(("From file:", "in function:", "at line:"))
    ]
    return " ".join(told).removeprefix("message: ") or type(error).__name__
