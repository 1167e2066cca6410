"""How the suite runs: which tests, which files begin, who shares what, how garbage goes.

In the process that gives the work to others nothing of coopqp but the compiled kernel is imported.
"""

from __future__ import annotations

import gc
import os
import signal
import sys
from collections import Counter, defaultdict
from pathlib import Path
from typing import Any

import pytest

#: Threads of BLAS, which is loaded after this: waiting for each other they take twice the time.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from coopqp.kernel import native

#: Files that take longest, in this order, so that no process is alone with one of them at the end.
LONGEST = (
    "viewer/test_in_a_browser.py",
    "report/test_playback.py",
    "stress/test_wide.py",
    "controllers/test_passive_grasp.py",
    "plants/test_rigid_body.py",
    "controllers/test_impedance.py",
    "assessment/test_levels.py",
    "controllers/test_torque_margins.py",
    "plants/test_pressing_hands.py",
    "study/test_explained_forces.py",
    "metrics/test_reached.py",
    "online/test_real_time.py",
    "viewer/test_play_command.py",
    "recordings/test_every_format.py",
    "random_goals/test_random_goals.py",
    "kernel/test_core.py",
    "plants/test_kinematic_errors.py",
    "study/test_misled_runs.py",
    "controllers/test_promises.py",
    "qp_law/test_continuity.py",
    "study/test_calibration.py",
    "plants/test_phases.py",
    "plants/test_end_stops.py",
    "border/test_reports_are_whole.py",
    "stress/test_masses.py",
    "study/test_repeated_ticks.py",
    "online/test_recording.py",
    "test_gallery.py",
)
#: Files that go to one process, because they share what takes long to make.
TOGETHER = {
    "a report": ("recordings/test_every_format.py", "recordings/test_standard_messages.py"),
    "the site": ("pages/test_api.py", "pages/test_links.py", "pages/test_reference.py"),
    "workers": ("stress/test_wide.py", "study/test_sweep_kept.py", "study/test_engine.py"),
    "shipped scenarios": (
        "report/test_playback.py",
        "test_cli.py",
        "test_contracts.py",
        "test_comparison.py",
        "test_rollout.py",
        "kernel/test_agreement.py",
        "scenario/test_other_robots.py",
        "scenario/test_validate.py",
        "scenario/test_start_solver.py",
        "scenario/test_forces_asked.py",
        "closed_loop/test_holding.py",
        "closed_loop/test_transmission.py",
        "pages/test_blocks.py",
    ),
}


#: Marks of what takes longer than it tells of anything new, and how often each value is met.
MARKS = {
    "full": "a test, or a case, that --all runs",
    "few(n)": "of the cases --all runs all; else so many, from the first to the last",
    "each_value": "of the cases --all runs all; else one of each value of each parameter",
}


def pytest_addoption(parser: pytest.Parser) -> None:
    """Let ``--all`` run what is left out otherwise."""
    parser.addoption("--all", action="store_true", help="all tests in all their cases")


def pytest_configure(config: pytest.Config) -> None:
    """Let Ctrl-C be heard, keep what Python compiles, and have fixtures where tests run.

    A shell's background has commands deaf to Ctrl-C, and so commands under test. And without
    compiled Python, every process that tests start would compile all it imports anew.
    """
    for mark, what in MARKS.items():
        config.addinivalue_line("markers", f"{mark}: {what}")
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    if os.environ.get("COOPQP_KERNEL") == "1" and native.module() is None:
        raise pytest.UsageError(f"COOPQP_KERNEL=1 demands the kernel: {native.MISSING}")
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
    sys.dont_write_bytecode = False
    if config.getoption("dist", "no") == "no":
        gc.disable()  # until all is collected, of which nothing goes
        config.pluginmanager.import_plugin("given")


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Leave out what ``--all`` alone runs, unless it is named; then order files.

    Where several processes share them the longest begin, then those of many tests.
    """
    if not config.getoption("all") and not any("::" in named for named in config.args):
        kept = _kept(items)
        config.hook.pytest_deselected(items=[item for item in items if item not in kept])
        items[:] = [item for item in items if item in kept]
    if not hasattr(config, "workerinput"):
        return
    here = Path(__file__).parent
    tests = Counter(item.path for item in items)
    places = {here / name: k for k, name in enumerate(LONGEST)}
    items.sort(key=lambda item: (places.get(item.path, len(LONGEST)), -tests[item.path]))


def _kept(items: list[pytest.Item]) -> set[pytest.Item]:
    """What runs without ``--all``."""
    cases: dict[str, list[pytest.Item]] = defaultdict(list)
    for item in items:
        if not item.get_closest_marker("full"):
            cases[item.nodeid.partition("[")[0]].append(item)
    return {item for some in cases.values() for item in _chosen(some)}


def _chosen(items: list[pytest.Item]) -> list[pytest.Item]:
    """Cases of a test that its marks leave."""
    marks = {mark.name: mark for mark in items[0].iter_markers()}
    if "few" in marks:
        (count,) = marks["few"].args
        step = (len(items) - 1) / max(1, count - 1)
        return [items[k] for k in sorted({round(step * i) for i in range(count)})]
    return _covering(items) if "each_value" in marks else items


def _covering(items: list[Any]) -> list[pytest.Item]:
    """Cases that have all values of all parameters, evenly used."""
    values = {item: [(k, repr(x)) for k, x in item.callspec.params.items()] for item in items}
    rest, left, used = set(items), set[Any]().union(*values.values()), Counter[Any]()
    kept: list[pytest.Item] = []
    while left:
        in_order = [item for item in items if item in rest]
        kept.append(
            max(
                in_order,
                key=lambda item: _worth(left.intersection(values[item]), values[item], used),
            )
        )
        rest.remove(kept[-1])
        left.difference_update(values[kept[-1]])
        used.update(values[kept[-1]])
    return kept


def _worth(new: set[Any], values: list[Any], used: Counter[Any]) -> tuple[int, int]:
    """How much of a case is new, and how seldom its values were taken yet."""
    return len(new), -sum(used[value] for value in values)


def pytest_collection_finish() -> None:
    """What was imported and collected stays: the garbage collector need not look at it again.

    Nor at the rest after every 700 objects, which takes it 3 % of the time.
    """
    gc.freeze()
    gc.set_threshold(50_000)
    gc.enable()


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Say that the kernel was not tested, which the letters of single tests hide."""
    skipped = terminalreporter.stats.get("skipped", [])
    count = sum(native.MISSING in str(report.longrepr) for report in skipped)
    if count:
        terminalreporter.write_line(f"{count} tests of the kernel were skipped: {native.MISSING}")


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> object:
    """All tests of a file, or of files that share much, in one process, which makes it once."""
    from xdist.scheduler import LoadFileScheduling

    shared = {f"tests/{file}": what for what, files in TOGETHER.items() for file in files}

    class Scheduling(LoadFileScheduling):  # type: ignore[misc]
        def _split_scope(self, nodeid: str) -> str:
            file = str(super()._split_scope(nodeid))
            return shared.get(file, file)

    config.option.loadscopereorder = False  # the order is that of pytest_collection_modifyitems
    return Scheduling(config, log)
