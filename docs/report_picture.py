"""Takes the picture of a report, docs/report.png.

    python docs/report_picture.py

Needs the extra ``test`` (playwright) and Chromium.
"""

from __future__ import annotations

import shutil
from pathlib import Path
from tempfile import TemporaryDirectory

from playwright.sync_api import sync_playwright

import coopqp
from coopqp.report.files import write

PICTURE = Path(__file__).parent / "report.png"
WIDTH = 1280  # [px]


def main() -> None:
    """From its top to the end of the playback."""
    with TemporaryDirectory() as folder, sync_playwright() as api:
        write(coopqp.compare(coopqp.load("point_on_point")), Path(folder))
        chromium = api.chromium.launch(executable_path=shutil.which("chromium"))
        page = chromium.new_page(viewport={"width": WIDTH, "height": 2000})
        page.goto(Path(folder, "report.html").as_uri())
        page.wait_for_timeout(2000)
        box = page.locator("#playback").bounding_box()
        assert box, "the page has no playback"
        clip = {"x": 0, "y": 0, "width": WIDTH, "height": box["y"] + box["height"] + 12}
        page.screenshot(path=PICTURE, clip=clip)  # type: ignore[arg-type]
        chromium.close()


if __name__ == "__main__":
    main()
