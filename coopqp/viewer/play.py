"""The clock of a player: ticks in real time, the page and the explainer beside it."""

import errno
import importlib.util
import socket
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace

from coopqp.base.errors import CoopqpError, InternalError, InvalidValueError, MissingDependencyError
from coopqp.viewer import explainer, page
from coopqp.viewer.gate import checked_origins
from coopqp.viewer.messages import Explanation
from coopqp.viewer.player import Player
from coopqp.viewer.worker import Worker

FRAME, EXPLANATION = 1.0 / 30.0, 0.2  # between two frames, and two explanations [s]
LATE = 0.25  # a longer delay is not made up for [s]
STRETCH, NAP = 0.05, 0.02  # longest stretch of ticks between two messages, longest sleep [s]
PATIENCE = 60.0  # for the page to answer at first [s]
AVERAGED = 1.0  # time over which the speed is averaged [s]
MAX_PORT = 65535
PORTS = "take another with --port, or any that is free with --port 0"
HOSTS = "needs an address of this machine: 127.0.0.1, or 0.0.0.0 for all that it has"


def check_viewer() -> None:
    """Raise a MissingDependencyError, with the extra, where the page's library is missing."""
    if importlib.util.find_spec("viser") is None:
        raise MissingDependencyError("coopqp play", "viewer")


def check_address(host: str, port: int) -> None:
    """Raise an InvalidValueError for a port that is taken, and an address that is none."""
    if not 0 <= port <= MAX_PORT:
        raise InvalidValueError(f"--port: found {port}, needs 0 to {MAX_PORT}")
    try:
        family, kind, _, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        with socket.socket(family, kind) as tried:
            tried.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            tried.bind(address)
    except (OSError, UnicodeError) as error:
        why = getattr(error, "strerror", None) or str(error)
        if isinstance(error, socket.gaierror | UnicodeError):
            raise InvalidValueError(f"--host: found '{host}': {why}; {HOSTS}") from None
        words = HOSTS if error.errno == errno.EADDRNOTAVAIL else PORTS
        raise InvalidValueError(f"cannot listen on {host}:{port}: {why}; {words}") from None


def play(
    player: Player,
    host: str,
    port: int,
    opened: Callable[[str], None],
    *,
    goes_on: Callable[[], bool] = lambda: True,
    origins: Sequence[str] = (),
) -> None:
    """Play until Ctrl-C, or until ``goes_on`` is false; ``opened`` is called with the address.

    Pages of ``origins`` may use it beside its own, such as https://lab.example; CoopqpError: one is
    none, or the page cannot be opened, or breaks down.
    """
    allowed = checked_origins(origins)
    server = Worker(page.serve, player.show(), host, port, allowed)
    # A copy leaves behind what was built of it: not every model can be sent.
    thinker = Worker(explainer.serve, replace(player.scenario))
    clock = _Clock(player, server, thinker)
    try:
        opened(_address(server, host))
        clock.run(goes_on)
    finally:
        for worker in filter(None, (server, thinker, clock.planner)):
            worker.end()


def _address(server: Worker, host: str) -> str:
    with suppress(EOFError):
        for message in server.received(PATIENCE):
            if isinstance(message, str):
                raise CoopqpError(message)
            return f"http://{f'[{host}]' if ':' in host else host}:{message}"
    raise InternalError("the page did not open; see what is printed above")


class _Clock:
    """Decides when to tick, draw and explain."""

    def __init__(self, player: Player, server: Worker, thinker: Worker) -> None:
        self._player, self._page, self._explainer = player, server, thinker
        self.planner: Worker | None = None  # until it is needed
        self._next_tick = self._next_frame = self._next_explanation = 0.0
        self._done: list[tuple[float, float]] = []  # end of ticks [s], and their duration [us]

    def run(self, goes_on: Callable[[], bool]) -> None:
        while goes_on():
            now = time.perf_counter()
            self._receive()
            self._explain(now)
            self._plan()
            self._tick(now)
            self._draw(now)
            now = time.perf_counter()
            rest = min(self._next_frame, self._next_tick if self._player.playing else now + NAP)
            time.sleep(min(max(rest - now, 0.0), NAP))

    def _receive(self) -> None:
        try:
            for message in self._page.received():
                self._player.do(message)
        except EOFError:
            if name := self._page.killed_by:
                raise CoopqpError(f"the page's process was ended from outside by {name}") from None
            raise InternalError("the page has broken down; see what is printed above") from None

    def _explain(self, now: float) -> None:
        """Send a new state to the explainer; without it the page has fewer words."""
        if not self._player.has_explainer:
            return
        try:
            for message in self._explainer.received():
                self._player.explanation = message
        except EOFError:
            self._player.has_explainer, self._player.explanation = False, Explanation()
            return
        if self._explainer.ready and now >= self._next_explanation:
            self._explainer.send(self._player.snapshot())
            self._next_explanation = now + EXPLANATION

    def _plan(self) -> None:
        """Let the planner look for a way round where the arms are stuck."""
        player = self._player
        if self.planner is None:
            if player.is_stuck:
                self.planner = Worker(explainer.serve_ways, replace(player.scenario))
            return
        try:
            for message in self.planner.received():
                player.way_round = message
        except EOFError:
            player.has_planner = False
        if player.has_planner and self.planner.ready and player.is_stuck:
            self.planner.send(player.ask_way())

    def _tick(self, now: float) -> None:
        player = self._player
        if not player.playing or now - self._next_tick > LATE:
            self._next_tick = now
        until = now + STRETCH
        while player.playing and self._next_tick <= now < until:
            player.tick()
            self._next_tick += player.scenario.dt / player.speed
            now = time.perf_counter()
            self._done.append((now, max(controller.us for controller in player.controllers)))

    def _draw(self, now: float) -> None:
        if not self._page.ready or now < self._next_frame:
            return
        self._done = [one for one in self._done if one[0] > now - AVERAGED]
        factor = len(self._done) * self._player.scenario.dt / AVERAGED
        longest = max((us for _, us in self._done), default=0.0)
        self._page.send(self._player.frame(factor, longest))
        self._next_frame = max(self._next_frame + FRAME, now)
