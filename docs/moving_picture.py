"""Makes the moving picture of the README, docs/playback.webp.

    python docs/moving_picture.py

The playback of a report, two controllers side by side, frame by frame. Needs the extra ``test``
(playwright), Pillow and Chromium.
"""

from __future__ import annotations

import io
import shutil
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from PIL import Image
from playwright.sync_api import Page, sync_playwright

import coopqp
from coopqp import Trace
from coopqp.report.files import write

PICTURE = Path(__file__).parent / "playback.webp"
WIDTH, HEIGHT = 840, 300  # of the page, of each robot [px]
SCALE = 1.25  # pixels of the picture for each of the page
EVERY = 2  # frame of the playback
REST = 2000  # at the end [ms]
CONTROLLERS = ("qp", "pseudoinverse")
BEYOND = 1e-4  # rad
LOOKS = f"""
  .pane canvas {{ height: {HEIGHT}px !important; }}
  .pane h3 {{ font-size: 19px !important; }}
  .readout {{ white-space: nowrap; font-size: 15.5px !important; font-weight: 600; color: #222; }}
"""
SHOW = """([frame, captions]) => {
  const slider = document.getElementById("frame");
  slider.value = frame;
  slider.dispatchEvent(new Event("input"));
  document.querySelectorAll("#playback .readout").forEach((readout, i) => {
    [readout.textContent, readout.style.color] = captions[i];
  });
}"""


def main() -> None:
    """All frames of one run."""
    comparison = coopqp.compare(coopqp.load("point_on_point"), controllers=CONTROLLERS)
    traces = [comparison.traces[name] for name in CONTROLLERS]
    with TemporaryDirectory() as folder, sync_playwright() as api:
        write(comparison, Path(folder))
        chromium = api.chromium.launch(executable_path=shutil.which("chromium"))
        size = {"width": WIDTH - 2, "height": 1600}
        page = chromium.new_page(viewport=size, device_scale_factor=SCALE)  # type: ignore[arg-type]
        page.goto(Path(folder, "report.html").as_uri())
        page.add_style_tag(content=LOOKS)
        page.set_viewport_size({"width": WIDTH, "height": 1600})  # canvases of another size
        page.evaluate(SHOW, [0, [("-", "")] * len(traces)])
        frames, times = _frames(page, traces)
        chromium.close()
    steps = [round(1000.0 * step) for step in np.diff(times)] + [REST]
    frames[0].save(
        PICTURE, save_all=True, append_images=frames[1:], duration=steps, loop=0, quality=70,
        method=6,
    )  # fmt: skip


def _frames(page: Page, traces: list[Trace]) -> tuple[list[Image.Image], list[float]]:
    """Pictures of the playback, and their times [s]."""
    panes = page.locator("#playback .panes")
    panes.scroll_into_view_if_needed()
    box = panes.bounding_box()
    assert box, "the page has no playback"
    clip = {side: round(box[side]) for side in ("x", "y", "width", "height")}
    last = int(page.locator("#frame").get_attribute("max") or 0)
    pictures, times = [], []
    for frame in [*range(0, last, EVERY), last]:
        page.evaluate(SHOW, [frame, [("", "")] * len(traces)])
        times.append(float(page.locator("#playback").get_attribute("data-time") or 0.0))
        page.evaluate(SHOW, [frame, [_caption(trace, times[-1]) for trace in traces]])
        shot = page.screenshot(clip=clip)  # type: ignore[arg-type]
        pictures.append(Image.open(io.BytesIO(shot)).convert("RGB"))
    return pictures, times


def _caption(trace: Trace, t: float) -> tuple[str, str]:
    """How far the goal is and the worst joint's limit, and a colour."""
    k = int(np.abs(trace.t - t).argmin())
    margins = np.minimum(trace.q[k] - trace.lower, trace.upper - trace.q[k])
    margin = float(margins.min())
    if margin < -BEYOND:
        words, color = f"{-margin:.2f} rad beyond a limit", "#c1121f"
    else:
        words, color = "at a limit" if margin < BEYOND else "inside its limits", "#222"
    return f"goal {1e3 * trace.goal_error[k, 0]:.0f} mm away · {words}", color


if __name__ == "__main__":
    main()
