"""The leader: says where the box shall be, 60 times a second, to a port on this machine.

python examples/teleoperation/leader.py 5005

It stands for a leader arm, a gamepad or a hand before a camera; here a point goes round. Each
message is one datagram of JSON: the value, and when it was sent by the machine's monotonic clock,
which is one for all its processes.
"""

from __future__ import annotations

import json
import math
import socket
import sys
import time

RATE = 60.0  # [Hz]
CENTRE, RADIUS, PERIOD = (0.16, 0.0, 0.055), 0.015, 3.0  # [m], [m], [s]


def main(port: int) -> None:
    """Send until somebody kills it."""
    began = time.monotonic()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as way:
        while True:
            now = time.monotonic()
            angle = 2.0 * math.pi * (now - began) / PERIOD
            y, z = CENTRE[1] + RADIUS * math.sin(angle), CENTRE[2] + RADIUS * math.cos(angle)
            message = {"target": [CENTRE[0], y, z], "sent": now}
            way.sendto(json.dumps(message).encode(), ("127.0.0.1", port))
            time.sleep(1.0 / RATE)


if __name__ == "__main__":
    main(int(sys.argv[1]))
