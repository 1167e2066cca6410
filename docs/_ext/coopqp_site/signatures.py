"""Signatures as pages show them: with types, without what only the reader of files has to know."""

from __future__ import annotations

import inspect
import re
from enum import Enum

ANNOTATED = re.compile(r"~?\b(\w+\.)*Annotated\[")
WIDTH = 100


def signature(name: str, value: type | object) -> str:
    """A function or class as it is called; no more than its name where it says nothing of that."""
    made = inspect.isclass(value)
    head = f"{'class' if made else 'def'} {name}"
    if made and (issubclass(value, Enum) or not _is_made(value)):
        return head
    asked = inspect.signature(value)
    arguments = list(asked.parameters.values())
    shown = [_argument(argument) for argument in arguments]
    named = [k for k, argument in enumerate(arguments) if argument.kind is argument.KEYWORD_ONLY]
    if named:
        shown.insert(named[0], "*")
    if made and not shown:
        return head
    gives = "" if made else f" -> {_type(asked.return_annotation)}"
    line = f"{head}({', '.join(shown)}){gives}"
    if len(line) <= WIDTH:
        return line
    return "\n".join([f"{head}(", *(f"    {words}," for words in shown), f"){gives}"])


def _is_made(cls: type) -> bool:
    """Whether a class of coopqp says how to make one: no protocol does, nor what Python has."""
    if getattr(cls, "_is_protocol", False):
        return False
    ours = (base for base in cls.__mro__ if base.__module__.startswith("coopqp"))
    return any("__init__" in vars(base) for base in ours)


def _argument(given: inspect.Parameter) -> str:
    """An argument with its type and default."""
    words = f"{given.name}: {_type(given.annotation)}"
    if given.default is given.empty:
        return words
    default = repr(given.default)
    return f"{words} = {'...' if default.startswith('<') else default}"


def _type(annotation: object) -> str:
    """An annotation as it is written."""
    return without_notes(annotation if isinstance(annotation, str) else repr(annotation))


def without_notes(signature: str) -> str:
    """X for Annotated[X, ...]."""
    while found := ANNOTATED.search(signature):
        depth, comma = 1, 0
        for i in range(found.end(), len(signature)):
            depth += (signature[i] in "[(") - (signature[i] in "])")
            if depth == 1 and signature[i] == "," and not comma:
                comma = i
            if not depth:
                break
        inside = signature[found.end() : comma or i]
        signature = signature[: found.start()] + inside + signature[i + 1 :]
    return signature
