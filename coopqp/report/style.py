"""How each controller is drawn: safe for the colour-blind, and distinct in black and white.

Colours are those of Okabe and Ito, Color Universal Design (2008).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import count

from coopqp.trace import Trace

BLUE, VERMILION, GREEN, PURPLE = "#0072B2", "#D55E00", "#009E73", "#CC79A7"
BLACK, SKY, ORANGE = "#000000", "#56B4E9", "#E69F00"

QP_COLORS = (BLUE, SKY, BLACK, PURPLE, GREEN, ORANGE)
OTHER_COLORS = (VERMILION, GREEN, PURPLE, BLACK, ORANGE, SKY)

#: Lengths of dash, gap, dash, gap ... [px]; the empty one is a full line.
QP_DASHES = ("", "16,4", "8,4", "3,4", "16,4,3,4", "8,3,2,3,2,3")
OTHER_DASHES = ("8,4", "2,3", "9,3,2,3", "16,4", "5,2", "12,3,2,3,2,3")

# The QP lies under the others and each of these under the next, so that all show where they agree.
QP_WIDTH, OTHER_WIDTHS = 4.5, (2.4, 1.9, 1.5)  # px


@dataclass(frozen=True)
class Style:
    """A line: colour such as "#0072B2", dashes and gaps or none [px], width [px]."""

    color: str
    dash: str
    width: float

    def line(self) -> dict[str, object]:
        dash = ",".join(f"{length}px" for length in self.dash.split(",")) if self.dash else "solid"
        return {"color": self.color, "dash": dash, "width": self.width, "simplify": False}

    def swatch(self) -> str:
        """A sample of the line, as SVG."""
        return (
            '<svg class="swatch" width="46" height="12" aria-hidden="true">'
            f'<line x1="1" y1="6" x2="45" y2="6" stroke="{self.color}" '
            f'stroke-width="{self.width}" stroke-dasharray="{self.dash or "none"}"/></svg>'
        )


def styles(traces: Mapping[str, Trace]) -> dict[str, Style]:
    """A style for each controller; who keeps limits is thick, the first of them full blue."""
    return chosen_styles({name: trace.keeps_limits for name, trace in traces.items()})


def chosen_styles(keeps_limits: Mapping[str, bool]) -> dict[str, Style]:
    """The same by whether each controller keeps limits."""
    chosen: dict[str, Style] = {}
    before = {True: count(), False: count()}
    for name, keeps in keeps_limits.items():
        colors, dashes = (QP_COLORS, QP_DASHES) if keeps else (OTHER_COLORS, OTHER_DASHES)
        i = next(before[keeps])
        width = QP_WIDTH if keeps else OTHER_WIDTHS[min(i, len(OTHER_WIDTHS) - 1)]
        chosen[name] = Style(colors[i % len(colors)], dashes[i % len(dashes)], width)
    return chosen
