"""From a study file to a study, or to all that is wrong with it, before anything runs."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel

from coopqp.checked import taken_names
from coopqp.errors import CoopqpError, Fault, InvalidValueError, ScenarioError, unknown_name
from coopqp.reading import absolute
from coopqp.scenario.catalog import Catalog
from coopqp.scenario.form import check, file_model
from coopqp.scenario.loader import find
from coopqp.scenario.yaml import YamlFile, parsed, read_yaml
from coopqp.study.sweep import points as sampling
from coopqp.study.sweep import space
from coopqp.study.sweep.path import located, put
from coopqp.study.sweep.points import MOST, Points
from coopqp.study.sweep.study import CONTROLLERS, SEED, Study, Varied
from coopqp.wording import Location, dotted, shown

T = TypeVar("T")

KEYS = {
    "scenario": "Path of a scenario's file, from the study's folder, or the name of a shipped one.",
    "vary": "What is varied over what: a path in the scenario, and values to take there.",
    "samples": "Which points are looked at: a way to sample and how many, and a seed (0).",
    "metrics": "Names of metrics that are measured, beside those that the page needs.",
}
GRID = "grid"
#: Measured in every study, because its page shows them.
ALWAYS = ("reached", "task_error", "limit_margin_min", "limit_violation_max")
MOST_TRIED = 1000  # values of a key that are checked before anything runs


def read_study(path: Path, catalog: Catalog | None = None) -> Study:
    """Read and check a study file.

    Args:
        path: of a YAML file.
        catalog: what its scenario can name; shipped and installed plug-ins when omitted.

    Raises:
        ScenarioError: with every fault, its line and its likely fix.
    """
    return _Reader(read_yaml(path), catalog or Catalog()).study(None)


def study_text(path: Path, text: str, scenario: tuple[Path, str], catalog: Catalog) -> Study:
    """The same from texts that were kept of a study that has been read before.

    What its scenario names is not looked up, so that the plug-ins need not be there.

    Args:
        path: of the study's file.
        text: what it held.
        scenario: path and text of its scenario.
        catalog: what the scenario can name, for who runs it.

    Raises:
        ScenarioError: as :func:`read_study`.
    """
    return _Reader(parsed(path, text), catalog, kept=True).study(parsed(*scenario))


class _Reader:
    """Collects the faults of a study's file.

    Args:
        file: read.
        catalog: what its scenario can name.
        kept: whether it has been read before, with all that it names.
    """

    def __init__(self, file: YamlFile, catalog: Catalog, *, kept: bool = False) -> None:
        self._file, self._catalog, self._kept = file, catalog, kept
        self._faults: list[Fault] = []
        self._notes: list[str] = []
        self._defaults = _defaults(file_model(catalog))

    def study(self, scenario: YamlFile | None) -> Study:
        data = self._file.data
        for key in data:
            if key not in KEYS:
                self._fault([key], unknown_name("key", key, KEYS))
        missing = [key for key in ("scenario", "vary", "samples") if key not in data]
        for key in missing:
            self._fault([], f"needs the key '{key}'")
        seed = self._seed()
        metrics = self._metrics()
        scenario = scenario or self._scenario()
        vary = self._variations()
        if scenario is None or missing:
            self._end()
        assert scenario
        base = scenario.changed(copy.deepcopy(scenario.data))
        controllers = self._controllers(vary, base)
        varied = self._located(vary, base)
        self._contradictions(varied)
        self._end()
        if not self._kept:
            self._tried(varied, scenario, base)
        points, varied = self._points(varied, seed)
        self._end()
        named = tuple(_names(base, controllers, self._catalog))
        notes = tuple(self._notes)
        return Study(
            file=self._file,
            scenario=base,
            scenario_text=(absolute(scenario.path), scenario.text),
            catalog=self._catalog,
            varied=varied,
            controllers=named,
            points=points,
            metrics=metrics,
            seed=seed,
            notes=notes,
        )

    def _fault(self, location: Location, message: str, inside: Location = ()) -> None:
        self._faults.append(Fault(self._file.place(location, inside), message))

    def _end(self) -> None:
        if self._faults:
            raise ScenarioError(list(dict.fromkeys(self._faults)))

    def _told(self, location: Location, build: Callable[[], T]) -> T | None:
        """What is built; its error becomes a fault."""
        try:
            return build()
        except InvalidValueError as error:
            self._fault(location, str(error), error.keys)
            return None

    def _seed(self) -> int:
        samples = self._file.data.get("samples")
        seed = samples.get(SEED, 0) if isinstance(samples, dict) else 0
        if not isinstance(seed, int) or isinstance(seed, bool) or seed < 0:
            self._fault(["samples", SEED], f"found {shown(seed)}; needs a whole number, at least 0")
            return 0
        return seed

    def _metrics(self) -> tuple[str, ...]:
        given = self._file.data.get("metrics", [])
        known = self._catalog.entries("metrics")
        if not isinstance(given, list):
            self._fault(["metrics"], "needs a list of names")
            return ()
        for i, name in enumerate(given):
            if name not in known and not self._kept:
                self._fault(["metrics", i], unknown_name("metric", str(name), known))
        return tuple(dict.fromkeys((*ALWAYS, *map(str, given))))

    def _scenario(self) -> YamlFile | None:
        """The file of the study's scenario; beside the study, or shipped."""
        given = self._file.data.get("scenario")
        if "scenario" not in self._file.data:
            return None
        if not isinstance(given, str) or not given:
            self._fault(["scenario"], "needs the path of a scenario, or the name of a shipped one")
            return None
        beside = self._file.path.parent / given
        try:
            found = read_yaml(beside if beside.exists() else find(given))
            if "vary" in found.data and "robot" not in found.data:
                self._fault(["scenario"], f"'{given}' is a study; needs a scenario")
                return None
            return found
        except ScenarioError as error:
            for fault in error.faults:
                self._fault(["scenario"], str(fault))
        return None

    def _variations(self) -> dict[str, space.Variation]:
        given = self._file.data.get("vary")
        if "vary" not in self._file.data:
            return {}
        if not isinstance(given, dict) or not given:
            self._fault(["vary"], "is empty; needs a path of the scenario: what to vary it over")
            return {}
        found = {}
        for path, value in given.items():
            if not path:
                self._fault(["vary"], "'' is no path; needs one such as tasks.reach.goal", [path])
                continue
            variation = self._told(["vary", path], lambda value=value: space.read(value))  # type: ignore[misc]
            if variation is not None:
                found[path] = variation
        return found

    def _located(self, vary: dict[str, space.Variation], base: YamlFile) -> tuple[Varied, ...]:
        found = []
        for path, over in vary.items():
            if path == CONTROLLERS:
                continue
            place = self._told(
                ["vary", path], lambda path=path: located(base.data, path, self._defaults)  # type: ignore[misc]
            )  # fmt: skip
            if place is not None:
                found.append(Varied(path, place, over))
        return tuple(found)

    def _contradictions(self, varied: Sequence[Varied]) -> None:
        """Keys that are varied twice."""
        for i, one in enumerate(varied):
            for other in varied[:i]:
                shorter = min(len(one.location), len(other.location))
                if one.location[:shorter] == other.location[:shorter]:
                    words = f"is the same as '{other.path}', or in it; vary one of them"
                    self._fault(["vary", one.path], words)

    def _controllers(self, vary: dict[str, space.Variation], base: YamlFile) -> list[Any]:
        """What is written into the scenario; each variant is run under all of them."""
        over = vary.get(CONTROLLERS)
        if over is None:
            return []
        if not isinstance(over, space.Listed) or over.numbers:
            self._fault(["vary", CONTROLLERS], "needs choice: [...], names of controllers")
            return []
        chosen = list(over.values)
        if not self._kept:
            self._check_controllers(chosen, base)
        base.data[CONTROLLERS] = chosen
        return chosen

    def _check_controllers(self, chosen: list[Any], base: YamlFile) -> None:
        place = ["vary", CONTROLLERS]
        known = len(self._faults)
        for i, one in enumerate(chosen):
            for fault in self._wrong(base.changed({**base.data, CONTROLLERS: [one]})):
                if f": {CONTROLLERS}" in fault.place:
                    self._fault(place, fault.message, ["choice", i])
        if len(self._faults) == known:
            names = list(_names(base, chosen, self._catalog))
            for i, taken in taken_names(names):
                words = f"{taken}; give this one another, such as {{{names[i]}: {{name: other}}}}"
                self._fault(place, words, ["choice", i])

    def _tried(self, varied: Sequence[Varied], scenario: YamlFile, base: YamlFile) -> None:
        """See whether each key takes its values, each alone, and the scenario one of all keys.

        Of numbers between two a few are tried, and one that is taken is enough.
        """
        known = [fault.message for fault in self._wrong(scenario)]
        data = base.data
        for one in varied:
            alone = {**copy.deepcopy(scenario.data), CONTROLLERS: base.data.get(CONTROLLERS)}
            if alone[CONTROLLERS] is None:
                del alone[CONTROLLERS]
            located(alone, one.path, self._defaults)
            taken, words, before = [], [], len(self._faults)
            for i, value in enumerate(one.over.tried()[:MOST_TRIED]):
                tried = scenario.changed(put(alone, one.location, value))
                new = [fault for fault in self._wrong(tried) if fault.message not in known]
                words += [fault.message for fault in new]
                if not new:
                    taken.append(value)
                elif isinstance(one.over, space.Listed):
                    self._own_faults(one, i, new)
            if taken:
                data = put(data, one.location, taken[0])
            elif len(self._faults) == before:
                self._fault(["vary", one.path], words[0])
        self._end()
        self._faults += self._wrong(base.changed(data))

    def _own_faults(self, one: Varied, index: int, faults: Sequence[Fault]) -> None:
        """Those of a listed value itself; what contradicts other keys may go with others."""
        kind = next(iter(self._file.data["vary"][one.path]))
        for fault in faults:
            _, found, inside = fault.place.partition(f": {dotted(one.location)}")
            if found and inside[:1] in ("", ".", "["):
                words = f"{inside.lstrip('.')}: {fault.message}" if inside else fault.message
                self._fault(["vary", one.path], words, [kind, index])

    def _wrong(self, file: YamlFile) -> list[Fault]:
        """What is wrong with the form of a scenario."""
        try:
            with file.lines():
                check(file, self._catalog)
        except ScenarioError as error:
            return list(error.faults)
        except CoopqpError as error:
            return [Fault(file.place([]), str(error))]
        return []

    def _points(self, varied: tuple[Varied, ...], seed: int) -> tuple[Points, tuple[Varied, ...]]:
        """The points, and what is varied over them: on a grid everything has levels."""
        given = self._file.data["samples"]
        if not isinstance(given, str | dict):
            words = f"found {shown(given)}; needs a way to sample, such as sobol: 1024, or grid"
            self._fault(["samples"], words)
            return sampling.grid(()), varied
        named = given if isinstance(given, dict) else {given: None}
        methods = (GRID, *sampling.METHODS)
        asked = [key for key in named if key != SEED]
        if len(asked) != 1 or asked[0] not in methods:
            unknown = [str(key) for key in asked if key not in methods]
            words = f"found {len(asked)}; needs one of {', '.join(methods)}, such as sobol: 1024"
            words = unknown_name("way to sample", unknown[0], methods) if unknown else words
            self._fault(["samples"], words, unknown[:1])
            return sampling.grid(()), varied
        method, count = asked[0], named[asked[0]]
        if method == GRID and count is None:
            count = 0
        elif not isinstance(count, int) or isinstance(count, bool) or not 1 <= count <= MOST:
            words = f"found {shown(count)}; needs a whole number of 1 to {MOST:,}"
            self._fault(["samples", method], words)
            return sampling.grid(()), varied
        if method == GRID:
            return self._grid(varied, count)
        if method == "sobol" and count & (count - 1):
            even = 1 << round(math.log2(count))
            place = self._file.place(["samples", method])
            words = f"{count} is no power of two; {even} points would fill the space more evenly"
            self._notes.append(f"{place}: {words}")
        dimensions = sum(one.over.dimensions for one in varied)
        return sampling.drawn(method, count, dimensions, seed), varied

    def _grid(
        self, varied: tuple[Varied, ...], count: int
    ) -> tuple[Points, tuple[Varied, ...]]:  # fmt: skip
        levels: list[int] = []
        found: list[Varied] = []
        for one in varied:
            own = one.over.levels(count)
            if not all(own):
                normal = isinstance(one.over, space.Normal)
                cure = "values: [...]" if normal else "levels, or say samples: {grid: LEVELS}"
                self._fault(["vary", one.path], f"has no levels for a grid; give it {cure}")
            levels += own
            over = one.over.gridded(own) if isinstance(one.over, space.Box) else one.over
            found.append(Varied(one.path, one.location, over))
        if math.prod(levels) > MOST:
            words = f"the grid has {math.prod(levels):,} points; needs at most {MOST:,}"
            self._fault(["samples"], words)
            return sampling.grid(()), varied
        return sampling.grid(levels), tuple(found)


def _defaults(model: type[BaseModel]) -> dict[str, Any]:
    """What the keys are that a scenario leaves out, as far as a file could say it."""
    fields = model.model_fields.items()
    return {key: f.default for key, f in fields if isinstance(f.default, str | list | dict)}


def _names(base: YamlFile, chosen: Sequence[Any], catalog: Catalog) -> Iterator[str]:
    """Names of the controllers that each variant is run under."""
    listed = chosen or base.data.get(CONTROLLERS) or _defaults(file_model(catalog))[CONTROLLERS]
    for slot in listed:
        kind, fields = next(iter(slot.items())) if isinstance(slot, dict) else (slot, None)
        yield str((fields or {}).get("name") or kind)
