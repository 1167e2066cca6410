"""Colours of the page; those that say something are Okabe and Ito's, safe for the colour-blind."""

from __future__ import annotations

import numpy as np

from coopqp.viewer.messages import Tone

Rgb = tuple[int, int, int]

LINK: Rgb = (214, 218, 222)
NEAR: Rgb = (240, 228, 66)  # on the way to a limit
AT: Rgb = (213, 94, 0)
BEYOND: Rgb = (150, 20, 110)
GOAL: Rgb = (0, 158, 115)
FORCE: Rgb = (194, 24, 127)  # as in reports
WEIGHT: Rgb = (70, 70, 70)
#: Share of half the range that is left where a joint begins to change its colour.
WARNS = 0.25
#: Steps between the two colours, so that links do not change with every frame.
STEPS = 6

TONES: dict[Tone, str] = {
    "reached": "#009E73",
    "moving": "#0072B2",
    "blocked": "#D55E00",
    "broken": "#96146E",
    "waiting": "#6B7280",
}


def of_joint(left: float, base: Rgb) -> Rgb:
    """Colour of a link by what its joint has left to its nearer limit, in half ranges."""
    if left < 0.0:
        return BEYOND
    if left == 0.0:
        return AT
    if left >= WARNS:
        return base
    near = np.ceil(STEPS * (1.0 - left / WARNS)) / STEPS
    first, last = (base, NEAR) if near < 0.5 else (NEAR, AT)
    return mixed(first, last, 2.0 * near if near < 0.5 else 2.0 * near - 1.0)


def mixed(first: Rgb, last: Rgb, share: float) -> Rgb:
    """A colour between two."""
    between = (1.0 - share) * np.array(first) + share * np.array(last)
    r, g, b = np.round(between).astype(int).tolist()
    return r, g, b


def rgb(color: str) -> Rgb:
    """The numbers of a colour such as "#0072B2"."""
    r, g, b = (int(color[i : i + 2], 16) for i in (1, 3, 5))
    return r, g, b


def css(color: Rgb) -> str:
    """The same for a page."""
    return "#" + "".join(f"{part:02X}" for part in color)
