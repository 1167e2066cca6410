"""A study of 100,000 variants: memory of all its processes on the way, and its page in a browser.

    python -m benchmarks.large_study                  all of it: half an hour on two cores
    python -m benchmarks.large_study --seconds 300    runs as long; the other rows are copies

The memory is the resident one of the command and its workers, summed, so that what they share
counts several times. With --seconds the command is interrupted, its journal filled up with copies
of the lines that are there, and the command called again: what it then does is to go on with a
hundred variants and to end, with all rows in results and page.
"""

from __future__ import annotations

import argparse
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from benchmarks.studies import written
from coopqp.study.sweep.results import Journal, head_of, records

LEFT = 100  # variants that are run after the others were copied
LIMIT = 2048  # MB
OPEN = 3.0  # s that a browser may take


def tree(pid: int) -> Iterator[int]:
    """A process and all that it has started."""
    yield pid
    path = Path(f"/proc/{pid}/task/{pid}/children")
    try:
        children = path.read_text().split()
    except OSError:
        return
    for child in children:
        yield from tree(int(child))


def resident(pid: int) -> float:
    """Memory of a process and its children [MB]."""
    total = 0
    for one in tree(pid):
        try:
            lines = Path(f"/proc/{one}/status").read_text().splitlines()
        except OSError:
            continue
        total += sum(int(line.split()[1]) for line in lines if line.startswith("VmRSS"))
    return total / 1024.0


def lines(out: Path) -> int:
    """Variants in the journal."""
    path = out / "journal.sqlite3"
    return sum(1 for _ in records(path)) if path.exists() and head_of(path) else 0


def watched(study: Path, out: Path, jobs: int, seconds: float) -> float:
    """Run the command, interrupted after some time; the most memory that it had [MB]."""
    words = ["sweep", str(study), "--out", str(out), "--jobs", str(jobs)]
    client = subprocess.Popen(
        [sys.executable, "-m", "benchmarks.studies", "--as", *words],
        stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
    )  # fmt: skip
    begun, told, most, before = time.monotonic(), time.monotonic(), 0.0, lines(out)
    asked = False
    while client.poll() is None:
        time.sleep(0.2)
        now, memory = time.monotonic(), resident(client.pid)
        most = max(most, memory)
        if now - told > 30.0:
            told, done = now, lines(out)
            rate = (done - before) / (now - begun)
            print(f"{now - begun:6.0f} s {done:7d} variants {rate:6.1f}/s {memory:6.0f} MB")
        if now - begun > seconds and not asked:
            asked = True
            client.send_signal(signal.SIGINT)
    done, took = lines(out), time.monotonic() - begun
    print(
        f"{done - before} variants in {took:.0f} s, {(done - before) / took:.1f}/s, with the start"
    )
    print(f"most memory {most:.0f} MB; ended with {client.returncode}")
    return most


def fill(out: Path, variants: int) -> int:
    """Copy records until few variants are left; how many were copied."""
    path = out / "journal.sqlite3"
    known = [record for _, record in records(path) if record]
    rows = [record["rows"] for record in known]
    there = {record["variant"] for record in known}
    missing = [k for k in range(variants) if k not in there][:-LEFT]
    with Journal.opened(path, {}) as journal:
        journal.append((k, {"variant": k, "rows": rows[k % len(rows)]}) for k in missing)
    return len(missing)


def opened(page: Path, picture: Path) -> float:
    """Time until a page is drawn in a browser without a window [s]."""
    from playwright import sync_api as playwright

    found = shutil.which("chromium") or shutil.which("chromium-browser")
    with playwright.sync_playwright() as api:
        browser = api.chromium.launch(executable_path=found)
        shown = browser.new_page(viewport={"width": 1200, "height": 900})
        begun = time.perf_counter()
        shown.goto(page.resolve().as_uri())
        shown.evaluate("new Promise(done => requestAnimationFrame(() => setTimeout(done, 0)))")
        took = time.perf_counter() - begun
        shown.screenshot(path=picture, full_page=True)
        browser.close()
    return took


def main() -> None:
    asked = argparse.ArgumentParser(description=__doc__)
    asked.add_argument("--variants", type=int, default=100_000)
    asked.add_argument("--jobs", type=int, default=2)
    asked.add_argument("--seconds", type=float, default=float("inf"))
    asked.add_argument("--out", type=Path, help="kept; a folder that is removed if omitted")
    given = asked.parse_args()
    with tempfile.TemporaryDirectory() as place:
        folder = given.out or Path(place)
        folder.mkdir(parents=True, exist_ok=True)
        study, out = written(folder, given.variants), folder / "results"
        most = watched(study, out, given.jobs, given.seconds)
        if lines(out) < given.variants:
            print(f"{fill(out, given.variants)} records copied")
            most = max(most, watched(study, out, given.jobs, float("inf")))
        page = out / "report.html"
        size = page.stat().st_size / 1e6
        took = opened(page, folder / "page.png")
        print(f"{lines(out)} variants, most memory {most:.0f} MB of {LIMIT} MB")
        print(f"page {size:.2f} MB, open in {took:.2f} s of {OPEN:.0f} s")


if __name__ == "__main__":
    main()
