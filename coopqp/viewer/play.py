"""The clock of a player: ticks in real time, the page and the explainer beside it."""

from __future__ import annotations

import errno
import importlib.util
import socket
import time
from collections.abc import Callable
from dataclasses import replace

from coopqp.base.errors import CoopqpError, InternalError, InvalidValueError, MissingDependencyError
from coopqp.viewer import explainer, page
from coopqp.viewer.beside import Beside
from coopqp.viewer.messages import Asked, Opened, Placed, Told
from coopqp.viewer.player import Player

#: Time between two frames, and two explanations [s].
FRAME, EXPLANATION = 1.0 / 30.0, 0.2
#: Later than this the clock is put right, and what is lost is lost [s].
LATE = 0.25
#: Longest stretch of ticks before the page is heard again, and longest sleep [s].
STRETCH, NAP = 0.05, 0.02
#: Time for the page to answer at first [s].
PATIENCE = 60.0
#: Over this time the pace is averaged [s].
AVERAGED = 1.0
MOST_PORT = 65535
PORTS = "take another with --port, or any that is free with --port 0"
HOSTS = "needs an address of this machine: 127.0.0.1, or 0.0.0.0 for all that it has"


def check_viewer() -> None:
    """Refuse to play without what the page needs.

    Raises:
        MissingDependencyError: with the extra.
    """
    if importlib.util.find_spec("viser") is None:
        raise MissingDependencyError("coopqp play", "viewer")


def check_address(host: str, port: int) -> None:
    """Refuse a port that is taken, and an address that is none.

    Raises:
        InvalidValueError: with what may help.
    """
    if not 0 <= port <= MOST_PORT:
        raise InvalidValueError(f"--port: found {port}, needs 0 to {MOST_PORT}")
    try:
        family, kind, _, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        with socket.socket(family, kind) as found:
            found.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            found.bind(address)
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
) -> None:
    """Play until Ctrl-C, or until ``goes_on`` says no; ``opened`` is told the page's address.

    Raises:
        CoopqpError: the page cannot be opened, or breaks down.
    """
    beside = Beside(page.serve, player.show(), host, port)
    # A copy leaves behind what was built of it: not every model can be sent.
    thinker = Beside(explainer.serve, replace(player.scenario))
    try:
        opened(_address(beside, host))
        _Clock(player, beside, thinker).run(goes_on)
    finally:
        beside.end()
        thinker.end()


def _address(beside: Beside, host: str) -> str:
    try:
        for thing in beside.received(PATIENCE):
            if isinstance(thing, Opened):
                if thing.fault:
                    raise CoopqpError(thing.fault)
                return f"http://{f'[{host}]' if ':' in host else host}:{thing.port}"
    except EOFError:
        pass
    raise InternalError("the page did not open; see what is printed above")


class _Clock:
    """Time, and who is served when."""

    def __init__(self, player: Player, beside: Beside, thinker: Beside) -> None:
        self._player, self._page, self._thinker = player, beside, thinker
        self._next_tick = self._next_frame = self._next_thought = 0.0
        self._placed: Placed | None = None
        self._thinks = True
        self._done: list[tuple[float, float]] = []  # when ticks were done, and how long [us]

    def run(self, goes_on: Callable[[], bool]) -> None:
        """Until somebody ends it."""
        while goes_on():
            now = time.perf_counter()
            self._hear()
            self._think(now)
            self._tick(now)
            self._draw(now)
            now = time.perf_counter()
            rest = min(self._next_frame, self._next_tick if self._player.playing else now + NAP)
            time.sleep(min(max(rest - now, 0.0), NAP))

    def _hear(self) -> None:
        try:
            for thing in self._page.received():
                if isinstance(thing, Asked):
                    self._player.do(thing)
        except EOFError:
            if name := self._page.killed_by:
                raise CoopqpError(f"the page's process was ended from outside by {name}") from None
            raise InternalError("the page has broken down; see what is printed above") from None

    def _think(self, now: float) -> None:
        """Let the explainer have something new; without it the page has fewer words."""
        if not self._thinks:
            return
        try:
            for thing in self._thinker.received():
                if isinstance(thing, Told):
                    self._player.told = thing
        except EOFError:
            self._thinks = False
            self._player.unexplained()
            return
        if not self._thinker.ready or now < self._next_thought:
            return
        placed = self._player.placed()
        if self._placed is None or not _same(self._placed, placed):
            self._placed = placed
            self._thinker.send(placed)
            return
        self._thinker.send(self._player.look())
        self._next_thought = now + EXPLANATION

    def _tick(self, now: float) -> None:
        player = self._player
        if not player.playing:
            self._next_tick = now
            return
        if now - self._next_tick > LATE:
            self._next_tick = now
        until = now + STRETCH
        while player.playing and self._next_tick <= now < until:
            player.tick()
            self._next_tick += player.scenario.dt / player.speed
            now = time.perf_counter()
            self._done.append((now, max(lane.us for lane in player.lanes)))

    def _draw(self, now: float) -> None:
        if not self._page.ready or now < self._next_frame:
            return
        self._done = [one for one in self._done if one[0] > now - AVERAGED]
        factor = len(self._done) * self._player.scenario.dt / AVERAGED
        longest = max((us for _, us in self._done), default=0.0)
        self._page.send(self._player.frame(factor, longest))
        self._next_frame = max(self._next_frame + FRAME, now)


def _same(one: Placed, other: Placed) -> bool:
    """Whether the explainer's law is still the one."""
    same = (one.law, one.dials, len(one.starts)) == (other.law, other.dials, len(other.starts))
    return same and all((a == b).all() for a, b in zip(one.starts, other.starts, strict=True))
