"""The follower: two arms carry a box where the leader says, in a loop of 500 Hz.

python examples/teleoperation/follower.py            # says its port; then, in another terminal,
python examples/teleoperation/leader.py 5005         # and kill it whenever you like

When the leader falls silent the target goes stale: the arms come to rest and the follower says why.
A second later it ends; so it does at Ctrl-C. The plant stands for a robot: replace it by a class
with the same two methods, ``read`` and ``write``, and take ``reference="commanded"``, the default.
"""

from __future__ import annotations

import json
import socket
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import coopqp
from coopqp import OnlineLoop, Status, real_time
from coopqp.online.simulated import SimulatedRobot

PORT = 5005
SILENCE = 1.0  # for how long the leader may be silent before it all ends [s]


class Leader:
    """What the leader has sent, and a word when that changes something.

    Args:
        loop: told to end when the leader stays silent.
        port: on this machine; 0 for any that is free.
        say: takes a sentence.
    """

    def __init__(self, loop: OnlineLoop, port: int, say: Callable[[str], None]) -> None:
        self._loop, self._say = loop, say
        self._way = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._way.bind(("127.0.0.1", port))
        except OSError:
            self._way.close()
            raise
        self._way.setblocking(False)
        self.port: int = self._way.getsockname()[1]
        self._said = ""
        self._heard: float | None = None

    def __call__(self) -> Mapping[str, Any] | None:
        """The newest message, for the next tick; never waits."""
        newest = None
        while True:
            try:
                newest = self._way.recv(4096)
            except BlockingIOError:
                break
        self._look_at_the_last_tick()
        if newest is None:
            return None
        self._heard = self._loop.now
        try:
            message = json.loads(newest)
            return {"target": (message["target"], message["sent"])}
        except (ValueError, KeyError, TypeError):
            return {"target": newest}  # no message: the tick refuses it and says so

    def _look_at_the_last_tick(self) -> None:
        loop = self._loop
        causes = [c.value for c in loop.command.causes if c not in (Status.OPTIMAL, Status.LATE)]
        words = "; ".join(causes) or "the arms follow"
        if loop.ticks and words != self._said:
            self._said = words
            self._say(f"{loop.state.t:7.3f} s: {words} {loop.note}".rstrip())
        if self._heard is not None and loop.now - self._heard > SILENCE:
            loop.end(f"the leader has sent nothing for {SILENCE:g} s")

    def close(self) -> None:
        """Give the port back."""
        self._way.close()


def follow(
    port: int = PORT,
    *,
    out: Path | None = None,
    say: Callable[[str], None] = print,
    ready: Callable[[int], None] = lambda port: None,
) -> OnlineLoop:
    """Follow a leader until it falls silent.

    Args:
        port: on this machine; 0 for any that is free.
        out: folder for the session, to be played again by ``coopqp compare``.
        say: takes each sentence.
        ready: told the port.
    """
    scenario = coopqp.load(Path(__file__).with_name("nao.yaml"))
    # A machine that does other things too: it may stall for longer than a robot would bear.
    loop = OnlineLoop(scenario, "qp", reference="measured", patience=0.5, out=out)
    leader, robot = Leader(loop, port, say), SimulatedRobot(loop)
    try:
        say(f"waiting for a leader on port {leader.port} of this machine")
        ready(leader.port)
        say(str(real_time(loop, robot, inputs=leader)))
    finally:
        leader.close()
    return loop


if __name__ == "__main__":
    try:
        follow(int(sys.argv[1]) if len(sys.argv) > 1 else PORT)
    except OSError as error:
        sys.exit(f"port {sys.argv[1:] or PORT}: {error.strerror}; name another one")
