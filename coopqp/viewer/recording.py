"""What was sent while a scenario was played, as a scenario that ``coopqp compare`` replays.

OUT/scenario.yaml is the scenario with an input for everything that can be dragged,
OUT/inputs/NAME.csv what has arrived at it, tick by tick: t, sent and the columns of its kind.
"""

import tempfile
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from coopqp.base.errors import CoopqpError, InvalidValueError
from coopqp.recordings.sent import FOLDER, Sent, fed, file_name
from coopqp.report.files import write_one
from coopqp.scenario.input import Arrival
from coopqp.scenario.scenario import MOST_KEPT, Scenario
from coopqp.scenario.yaml import as_yaml, parsed
from coopqp.signal import Kind
from coopqp.viewer.steering import KAPPA, SteeredField, dialled_field, input_limits

FILE = "scenario.yaml"


def check_folder(folder: Path) -> None:
    """Raise a CoopqpError for a folder that has a session or cannot be written to."""
    try:
        if (folder / FILE).exists() or (folder / FOLDER).exists():
            raise CoopqpError(f"--record: '{folder}' holds a session already; name another folder")
        there = next(path for path in (folder, *folder.absolute().parents) if path.exists())
        with tempfile.TemporaryDirectory(dir=there) as trial:
            (Path(trial) / folder.name).mkdir(exist_ok=True)
    except (OSError, ValueError) as error:
        why = f"{getattr(error, 'strerror', None) or error}; name another folder"
        raise CoopqpError(f"--record: cannot write to '{folder}': {why}") from error


class Recording:
    """What is recorded so far: ticks of each phase; the note says why it has ended."""

    def __init__(
        self,
        scenario: Scenario,
        steered: Sequence[SteeredField],
        controllers: Sequence[str],
        dials: Mapping[str, float],
    ) -> None:
        self._scenario, self._steered, self._names = scenario, steered, controllers
        self._dials = dict(dials)
        self.ticks, self.note = [0], ""
        self._sent: dict[str, Sent] = {}
        joints = len(scenario.robot_model.joint_names)
        self._max_ticks = MOST_KEPT // (joints * max(1, len(controllers)))

    @property
    def seconds(self) -> float:
        return sum(self.ticks) * self._scenario.dt

    def add(
        self, phase: int, since: float, t: float, sent: Iterable[Arrival], kinds: Mapping[str, Kind]
    ) -> None:
        if self.note:
            return
        if sum(self.ticks) >= self._max_ticks:
            self.note = f"is full after {self.seconds:.0f} s"
            return
        while len(self.ticks) <= phase:
            self.ticks.append(0)
        self.ticks[phase] += 1
        for name, value, when in sent:
            kept = self._sent.setdefault(name, Sent(kinds[name]))
            kept.add(since + t, since + when, value)

    def end(self, why: str) -> None:
        """Record no more; what there is can be saved."""
        self.note = self.note or why

    def save(self, folder: Path) -> Path:
        """Write it; raise a CoopqpError where that is not possible, or nothing is recorded."""
        if sum(self.ticks) <= 1:  # the first is decided before anybody looks
            raise InvalidValueError("nothing has been played yet, so nothing is recorded")
        try:
            (folder / FOLDER).mkdir(parents=True, exist_ok=True)
        except OSError as error:
            reason = error.strerror or str(error)
            raise CoopqpError(f"cannot write the recording to '{folder}': {reason}") from error
        names: dict[str, str] = {}
        for name, sent in self._sent.items():
            names[name] = file_name(name, names.values())
            write_one(folder / FOLDER / names[name], sent.header + sent.lines())
        played = f"{self._scenario.name}, played for {self.seconds:.3f} s"
        text = f"# {played}; coopqp compare replays it.\n{as_yaml(self._data(names, folder))}"
        write_one(folder / FILE, text)
        return folder / FILE

    def _data(self, names: Mapping[str, str], folder: Path) -> dict[str, Any]:
        """The scenario file as a mapping, with what was played."""
        scenario = self._scenario
        data = dict(parsed(Path(scenario.name), scenario.source).data)
        if scenario.folder is not None:
            data["folder"] = str(scenario.folder)
        phases = self._phases(data)
        secondary = [_spelled(slot) for slot in data.get("secondary", [])]
        self._turn(data, phases, secondary)
        if secondary:
            data["secondary"] = secondary
        inputs = dict(data.get("inputs") or {})
        for field in self._steered:
            if field.start and field.phase < len(phases):
                _follow(phases[field.phase]["tasks"][field.task], field)
                inputs.setdefault(field.name, input_limits(scenario))
        base = Path() if scenario.folder is None else folder.resolve()
        paths = {name: str(base / FOLDER / file) for name, file in names.items()}
        if inputs:
            data["inputs"] = fed(inputs, paths)
        own = list(scenario.controllers)
        given = data.get("controllers") or own
        data["controllers"] = [given[own.index(n)] if n in own else n for n in self._names]
        return data

    def _phases(self, data: dict[str, Any]) -> list[dict[str, Any]]:
        """Put the phases that were played into the mapping, with their durations."""
        given_phases, phases = data.get("phases", [data]), []
        played = zip(given_phases, self._scenario.schedule, self.ticks, strict=False)
        for given, phase, ticks in played:
            end = max((task.end for task in phase.tasks), default=0.0)
            tasks = [*map(_spelled, given["tasks"])]
            phases.append(given | {"duration": max(ticks * self._scenario.dt, end), "tasks": tasks})
        data |= {"phases": phases} if "phases" in data else phases[0]
        return phases

    def _turn(
        self, data: dict[str, Any], phases: list[dict[str, Any]], secondary: list[dict[str, Any]]
    ) -> None:
        for key, value in self._dials.items():
            if key == KAPPA:
                data[KAPPA] = value
                continue
            kind, phase, number, field = dialled_field(key)
            if kind == "tasks" and phase >= len(phases):
                continue
            slots = phases[phase]["tasks"] if kind == "tasks" else secondary
            (fields,) = slots[number].values()
            fields[field] = round(value) if field == "priority" else value


def _spelled(slot: Any) -> dict[str, Any]:
    """A plug-in's entry as one name with its fields."""
    if isinstance(slot, str):
        return {slot: {}}
    ((name, fields),) = slot.items()
    return {name: dict(fields or {})}


def _follow(slot: dict[str, Any], field: SteeredField) -> None:
    (fields,) = slot.values()
    if field.kind.turns and not field.kind.numbers and not field.kind.axis:
        fields.pop("rpy", None)
        fields.pop("rpy_deg", None)
    fields[field.field] = {"input": {"name": field.name, "start": list(field.start or ())}}
