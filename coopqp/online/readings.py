"""What a robot says of its joints, looked at before it is believed."""

from __future__ import annotations

from typing import Any

import numpy as np

from coopqp.checked import Array, real
from coopqp.closed_chain import ClosedChain
from coopqp.solver import Status
from coopqp.wording import said

#: Joints measured farther from the last than this many times what their velocity limit allows,
#: and this much beside it for noise [rad, m], have jumped.
FASTER, NOISE = 1.5, 0.02
#: Speed of joints without a limit, beyond which they have jumped [rad/s, m/s].
UNLIMITED = 1e6


class Readings:
    """The last configuration that was believed.

    Args:
        chain: whose joints.
        silent_after: how long the last reading counts where there is no new one [s].

    Attributes:
        q: of all joints, shape (n,) [rad, m]; NaN before the first. Passive joints that the robot
            does not tell of are where they were commanded.
        note: what was wrong with the last reading; empty if nothing was.
    """

    def __init__(self, chain: ClosedChain, silent_after: float = 0.0) -> None:
        n, self._silent_after = chain.n, silent_after
        self.q, self.note = np.full(n, np.nan), ""
        self._found, self._step = np.zeros((2, n))
        self._passive = chain.passive
        self._own = np.setdiff1d(np.arange(n), chain.passive)
        self._names, self._units = chain.joint_names, chain.joint_units
        self._most = FASTER * np.nan_to_num(np.abs(chain.velocity), posinf=UNLIMITED)
        self._since = 0.0
        self._heard = -np.inf
        self._judged: Status | None = None

    def forget(self) -> None:
        """Believe the next reading wherever it is."""
        self.q[:], self._heard = np.nan, -np.inf

    def take(self, q: Any, commanded: Array, now: float) -> Status | None:
        """Look at a reading.

        Args:
            q: shape (n,), or that of the robot's own joints; None where there is none.
            commanded: where the joints were told to be, shape (n,).
            now: [s].

        Returns:
            What is wrong with it; None if nothing is, and then :attr:`q` is this reading.
        """
        if q is None and now - self._heard < self._silent_after:
            return self._judged
        self.note = ""
        if q is None:
            return Status.ROBOT_SILENT
        self._heard, self._judged = now, self._judge(q, commanded, now)
        return self._judged

    def _judge(self, q: Any, commanded: Array, now: float) -> Status | None:
        if not self._read(q, commanded):
            return Status.NOT_MEASURED
        np.subtract(self._found, self.q, self._step)
        np.abs(self._step, self._step)
        np.subtract(self._step, NOISE + self._most * max(0.0, now - self._since), self._step)
        if (self._step > 0.0).any():  # not so where nothing was believed before
            self._say_jump(now)
            self._since = now  # so that what stays elsewhere does not come to be possible
            return Status.MEASURED_JUMPED
        self.q[:], self._since = self._found, now
        return None

    def _read(self, q: Any, commanded: Array) -> bool:
        found = self._found
        try:
            given = real(q)
        except Exception as error:  # noqa: BLE001 - anything can come from a driver
            self.note = said(error) or f"found {type(q).__name__}, needs numbers"
            return False
        if given.shape == found.shape:
            found[:] = given
        elif given.shape == self._own.shape:
            found[:] = commanded
            found[self._own] = given
        else:
            self.note = f"found shape {given.shape}, needs {found.shape}"
            return False
        if not np.isfinite(found).all():
            bad = [self._names[i] for i in np.flatnonzero(~np.isfinite(found))]
            self.note = f"no finite number for {', '.join(bad)}"
            return False
        return True

    def _say_jump(self, now: float) -> None:
        i = int(np.argmax(np.where(np.isnan(self._step), -np.inf, self._step)))
        way, unit = self._found[i] - self.q[i], self._units[i]
        self.note = f"{self._names[i]} by {way:+.3g} {unit} in {now - self._since:.3g} s"
