"""Run every block of every page that can be run: python -m tests.pages [PAGE ...]."""

from __future__ import annotations

import sys
import time
import traceback
from pathlib import Path
from tempfile import TemporaryDirectory

import click

sys.path.insert(0, str(Path(__file__).parents[1]))

from pages.blocks import blocks, pages, with_outputs
from pages.stage import Page, stage


def main(asked: list[str]) -> int:
    """Run pages; the number of blocks that failed."""
    failed = 0
    for name, path in pages().items():
        if asked and name not in asked:
            continue
        page = Page(name, whole=True)
        with TemporaryDirectory() as folder, stage(Path(folder)):
            for block, shown in with_outputs(blocks(name, path.read_text(encoding="utf-8"))):
                began = time.monotonic()
                try:
                    page.run(block, shown)
                except Exception:  # noqa: BLE001 - the other blocks are looked at, too
                    failed += 1
                    traceback.print_exc()
                    click.echo(f"{block.place}: FAILED")
                lacking = f", {block.lacks} is not installed" if block.lacks else ""
                click.echo(f"{block.place}: {time.monotonic() - began:.1f} s{lacking}")
    return failed


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]) > 0)
