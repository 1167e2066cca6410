"""The page in a real browser, without a screen: its mouse drags a gizmo, and the object follows."""

from __future__ import annotations

import re
import shutil
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from typing import Any

import numpy as np
import pytest

from coopqp.base.spec import Array
from coopqp.scenario.loader import load
from coopqp.viewer.messages import PageSetup
from coopqp.viewer.page import FOV, GIZMO, view
from coopqp.viewer.play import play
from coopqp.viewer.player import Player

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
WIDTH, HEIGHT = 1000, 360  # small, because software draws it
VIEWPORT = {"width": WIDTH, "height": HEIGHT}
PATIENCE = 60_000  # [ms], where the machine is busy
UP = np.array([0.0, 0.0, 1.0])
#: Graphics by software; a sandbox is not to be had in every container.
FLAGS = ["--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--no-sandbox"]

pytestmark = [
    pytest.mark.skipif(CHROMIUM is None, reason="needs a chromium on the path"),
    pytest.mark.skipif(find_spec("playwright") is None, reason="needs playwright"),
    pytest.mark.skipif(find_spec("viser") is None, reason="needs coopqp[viewer]"),
]


@contextmanager
def served(player: Player) -> Iterator[str]:
    """The player behind a page, in a thread as it would be in a process."""
    address: list[str] = []
    there, over = threading.Event(), threading.Event()

    def opened(page: str) -> None:
        address.append(page)
        there.set()

    def work() -> None:
        play(player, "127.0.0.1", 0, opened, goes_on=lambda: not over.is_set())

    thread = threading.Thread(target=work)
    thread.start()
    assert there.wait(PATIENCE / 1000.0)
    try:
        yield address[0]
    finally:
        over.set()
        thread.join()


@contextmanager
def browser() -> Iterator[Any]:
    from playwright.sync_api import sync_playwright

    with sync_playwright() as api:
        chromium = api.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        yield chromium
        chromium.close()


def pixel(show: PageSetup, place: Array) -> tuple[float, float]:
    """Where a place is seen, by the pinhole that the page says its camera is."""
    middle, eye = view(show)
    ahead = (middle - eye) / np.linalg.norm(middle - eye)
    right = np.cross(ahead, UP)
    right /= np.linalg.norm(right)
    away = place - eye
    scale = 0.5 * HEIGHT / np.tan(0.5 * FOV) / float(away @ ahead)
    x, y = scale * away @ right, -scale * away @ np.cross(right, ahead)
    return 0.5 * WIDTH + float(x), 0.5 * HEIGHT + float(y)


def settled(page: Any, player: Player) -> str:
    """What the page says once the arms rest: by how much they are short, and that is so."""
    end = time.monotonic() + PATIENCE / 1000.0
    said = ""
    while time.monotonic() < end:
        said = page.inner_text("[data-tone]")
        lane = player.controllers[0]
        off = 1e3 * float(np.linalg.norm(lane.targets()["reach"] - lane.state.p_WO))
        found = re.search(r"stops ([\d.]+) mm short", said)
        if found and float(found[1]) == pytest.approx(off, abs=0.5):
            return said
        page.wait_for_timeout(200)
    raise AssertionError(said)


@pytest.mark.full
def test_a_gizmo_is_dragged_where_it_is_unreachable_and_the_limit_is_named() -> None:
    player = Player(load("point_on_point"), ("qp",))
    show, goal = player.show(), np.array([0.13, 0.05, 0.03])
    player.speed = 4.0
    asked: list[str] = []
    with served(player) as url, browser() as chromium:
        page = chromium.new_page(viewport=VIEWPORT, device_scale_factor=0.5)
        page.on("request", lambda request: asked.append(request.url))
        page.goto(url)
        page.wait_for_selector('[data-tone="reached"]', timeout=PATIENCE)
        before = player.controllers[0].state.p_WO.copy()
        np.testing.assert_allclose(before, goal, atol=1e-3)
        tip = goal + UP * 0.85 * GIZMO * max(show.size)  # on the head of the arrow up
        page.mouse.move(*pixel(show, tip))
        page.wait_for_timeout(200)
        page.mouse.down()
        for share in (0.3, 0.6, 1.0):
            page.mouse.move(*pixel(show, tip + UP * 0.10 * share))
            page.wait_for_timeout(50)
        page.mouse.up()
        page.wait_for_selector('[data-tone="blocked"]', timeout=PATIENCE)
        said = settled(page, player)
    assert "LElbowRoll (lower" in said
    assert "relax " in said
    sent = player.controllers[0].targets()["reach"]
    np.testing.assert_allclose(sent[:2], goal[:2], atol=1e-4)  # straight up, as the arrow goes
    assert sent[2] == pytest.approx(0.13, abs=0.02)
    moved = player.controllers[0].state.p_WO - before
    assert moved[2] > 0.07  # it has followed, as far as it can
    outside = [u for u in asked if not u.startswith((url, "data:", "blob:", f"ws{url[4:]}"))]
    assert outside == []
