"""What the command ``explain`` prints, for people or for machines."""

from __future__ import annotations

from dataclasses import asdict

from coopqp.report import strict_json
from coopqp.study.explanation import RunExplanation, explain
from coopqp.study.tick_record import TickRecord


def run_text(found: RunExplanation, name: str, *, as_json: bool) -> str:
    """Why a run missed its goal."""
    if as_json:
        return strict_json.text(found.as_json())
    of = f", phase {found.phase}" if found.phase else ""
    return f"{name}, {found.controller}{of}:\n{found.sentence}."


def tick_text(record: TickRecord, *, as_json: bool) -> str:
    """Why a tick fell short."""
    found = explain(record)
    if as_json:
        return strict_json.text({"tick": record.tick, "status": record.status, **asdict(found)})
    said = f"{found.sentence[0].upper()}{found.sentence[1:]}."
    return f"{record.scenario}, {record.controller}, tick {record.tick} ({record.status}):\n{said}"
