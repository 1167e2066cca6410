"""The process of the page: viser's server, a scene and a panel. It never asks for anything outside.

viser is imported here alone, so that the control loop's process has none of it.
"""

from __future__ import annotations

import threading
import time
from typing import Any

from coopqp.viewer.beside import Line
from coopqp.viewer.messages import Asked, Frame, Opened, Show
from coopqp.viewer.panel import Panel
from coopqp.viewer.scene import Scene

#: Time for the last words to go out [s].
FAREWELL = 0.2


def serve(line: Line, show: Show, host: str, port: int) -> None:
    """Serve the page until the player ends."""
    import viser

    server = viser.ViserServer(host=host, port=port, label="coopqp play", verbose=False)
    found = server.get_port()
    if port and found != port:  # somebody was faster
        line.send(Opened(fault=f"port {port} is taken; take another with --port"))
        return
    page = _Page(server, show, line)
    line.send(Opened(found))
    for thing in line.things():
        if isinstance(thing, Frame):
            page.draw(thing)
    page.end()


class _Page:
    """The page of all browsers; viser keeps them alike, and tells those that come late."""

    def __init__(self, server: Any, show: Show, line: Line) -> None:
        self._server, self._line = server, line
        self._lock, self._begun = threading.Lock(), False
        server.gui.configure_theme(
            control_width="large", show_logo=False, show_share_button=False,
            brand_color=(0, 114, 178),
        )  # fmt: skip
        with server.atomic():
            self._scene = Scene(server, show, self._ask)
            self._panel = Panel(server, show, self._ask, self._scene.arrange)

        server.on_client_connect(self._begin)

    async def _begin(self, client: Any) -> None:
        """Time goes on from when somebody looks."""
        self._scene.fit(client)
        if not self._begun:
            self._begun = True
            self._ask(Asked("play"))

    def draw(self, frame: Frame) -> None:
        """Everything as it is now."""
        with self._server.atomic():
            self._scene.draw(frame)
            self._panel.draw(frame)

    def end(self) -> None:
        """Tell browsers that this is the end."""
        self._panel.end()
        self._server.flush()
        time.sleep(FAREWELL)

    def _ask(self, asked: Asked) -> None:
        with self._lock:
            self._line.send(asked)
