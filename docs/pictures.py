"""Draws the pictures of the explanations.

    python docs/pictures.py

From runs, into SVG files in docs/pictures, without fonts of their own.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

import coopqp
from coopqp import Profile, Scenario, Trace
from coopqp.base.spec import Array
from coopqp.model.profile import KINDS
from coopqp.tasks import JointCentering, PointOnPlane, Posture

HERE = Path(__file__).parent / "pictures"
BLUE, RED, GREY, GREEN = "#1f77b4", "#d62728", "#888888", "#2ca02c"
COLORS = (GREY, RED, GREEN, BLUE)
WIDTH, HEIGHT, EDGE = 460, 260, 46  # of a picture, and free for words [px]


@dataclass
class Picture:
    """Curves over two axes.

    Attributes:
        x, y: least and largest value shown.
        label_x, label_y: words along the axes.
        parts: SVG elements.
    """

    x: tuple[float, float]
    y: tuple[float, float]
    label_x: str
    label_y: str
    parts: list[str] = field(default_factory=list)

    def at(self, x: float, y: float) -> tuple[float, float]:
        """In pixels."""
        (a, b), (c, d) = self.x, self.y
        across = EDGE + (x - a) / (b - a) * (WIDTH - EDGE - 12)
        return across, 12 + (d - y) / (d - c) * (HEIGHT - EDGE - 12)

    def line(
        self, x: Sequence[float], y: Sequence[float], color: str, width: float = 2.0, dash: str = ""
    ) -> None:
        """A curve."""
        points = " ".join("{:.1f},{:.1f}".format(*self.at(a, b)) for a, b in zip(x, y, strict=True))
        dashed = f' stroke-dasharray="{dash}"' if dash else ""
        self.parts.append(
            f'<polyline points="{points}" fill="none" stroke="{color}" stroke-width="{width}"'
            f'{dashed} stroke-linejoin="round"/>'
        )

    def dot(self, x: float, y: float, color: str, radius: float = 3.5) -> None:
        """A point."""
        across, down = self.at(x, y)
        self.parts.append(
            f'<circle cx="{across:.1f}" cy="{down:.1f}" r="{radius}" fill="{color}"/>'
        )

    def words(self, x: float, y: float, text: str, color: str = "#333333") -> None:
        """Words that begin there."""
        across, down = self.at(x, y)
        self._text(across, down, text, color)

    def write(self, name: str, ticks_x: Sequence[float], ticks_y: Sequence[str | float]) -> None:
        """With axes; a tick of y may be a text such as 1e-3, for a logarithm."""
        for tick in ticks_x:
            across, down = self.at(tick, self.y[0])
            self._text(across, down + 16, f"{tick:g}", anchor="middle")
        for label in ticks_y:
            value = math.log10(float(label)) if isinstance(label, str) else label
            across, down = self.at(self.x[0], value)
            self._text(across - 6, down + 4, str(label), anchor="end")
        left, bottom = self.at(self.x[0], self.y[0])
        self._text((left + WIDTH) / 2, HEIGHT - 10, self.label_x, anchor="middle")
        self._text(0, 0, self.label_y, anchor="middle", turned=f"translate(12 {HEIGHT / 2 - 15}) ")
        axes = f'<path d="M{left} 8V{bottom}H{WIDTH - 8}" fill="none" stroke="#333333"/>'
        body = "\n".join([axes, *self.parts])
        HERE.mkdir(exist_ok=True)
        (HERE / name).write_text(
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}" '
            f'width="{WIDTH}" height="{HEIGHT}" font-family="sans-serif" font-size="12">\n'
            f'<rect width="{WIDTH}" height="{HEIGHT}" fill="white"/>\n{body}\n</svg>\n',
            encoding="utf-8",
        )

    def _text(
        self, x: float, y: float, text: str, color: str = "#333333", anchor: str = "start",
        turned: str = "",
    ) -> None:  # fmt: skip
        turn = f' transform="{turned}rotate(-90)"' if turned else ""
        self.parts.append(
            f'<text x="{x:.1f}" y="{y:.1f}" fill="{color}" text-anchor="{anchor}"{turn}>'
            f"{text}</text>"
        )


def main() -> None:
    """Draw all of them."""
    profiles()
    closed_chain()
    minimum_representation()
    schemes()
    drift()


def profiles() -> None:
    """Share of the way over time, by kind."""
    picture = Picture((0.0, 2.0), (0.0, 1.05), "time [s]", "share of the way")
    t = np.linspace(0.0, 2.0, 161)
    for kind, color in zip(KINDS, COLORS, strict=True):
        profile = Profile(kind=kind, duration=1.0, delay=0.5)  # type: ignore[arg-type]
        picture.line(t.tolist(), [profile.at(x)[0] for x in t.tolist()], color)
    for i, (kind, color) in enumerate(zip(KINDS, COLORS, strict=True)):
        picture.words(1.25, 0.42 - 0.1 * i, kind, color)
    picture.write("profiles.svg", (0, 0.5, 1, 1.5, 2), (0.0, 0.5, 1.0))


def closed_chain() -> None:
    """NAO's arms and the box from above, at the start and at the goal."""
    trace = coopqp.run(coopqp.load("point_on_point"), controller="qp")
    picture = Picture((-0.26, 0.26), (-0.01, 0.25), "to the right [m]", "forward [m]")
    for row, dash in ((0, "4 3"), (-1, "")):
        _draw_arms(picture, trace, row, dash)
    picture.words(-0.25, 0.235, "dashed: start")
    picture.words(-0.075, 0.015, "left arm", RED)
    picture.words(0.015, 0.015, "right arm", BLUE)
    picture.words(-0.02, 0.195, "the box", GREY)
    picture.write("closed_chain.svg", (-0.2, -0.1, 0, 0.1, 0.2), (0.0, 0.1, 0.2))


def _draw_arms(picture: Picture, trace: Trace, row: int, dash: str) -> None:
    for (_, points), color in zip(trace.points.items(), (BLUE, RED), strict=True):
        places = points[row]
        picture.line((-places[:, 1]).tolist(), places[:, 0].tolist(), color, 3.0, dash)
        for place in places:
            picture.dot(-place[1], place[0], color, 2.5)
    box = np.array([[1, 1], [1, -1], [-1, -1], [-1, 1], [1, 1]]) * [0.04, 0.095]
    flat = np.column_stack([box, np.zeros(5)]) @ trace.rotation[row].T + trace.position[row]
    picture.line((-flat[:, 1]).tolist(), flat[:, 0].tolist(), GREY, 2.0, dash)


def minimum_representation() -> None:
    """One row, the height, is met in many ways: the box from the side, by secondary objective."""
    scenario = coopqp.load("point_on_plane")
    table = PointOnPlane(
        name="table", normal=(0, 0, 1), through=(0, 0, 0.08), profile=Profile(duration=1.5)
    )
    right = scenario.chain.q_start[:5]
    asked = (
        JointCentering(),
        Posture(goal={"right": np.add(right, (0.5, 0.0, 0.3, 0.5, 0.0)).tolist()}),
        Posture(goal={"right": np.subtract(right, (0.4, 0.1, 0.3, 0.4, 0.0)).tolist()}),
    )
    picture = Picture((0.06, 0.3), (0.02, 0.14), "forward [m]", "up [m]")
    picture.line((0.06, 0.3), (0.08, 0.08), "#000000", 1.0, "2 3")
    for secondary, color in zip(asked, (BLUE, RED, GREEN), strict=True):
        trace = coopqp.run(_with(scenario, table, secondary), controller="qp")
        corners = np.array([[1, 1], [1, -1], [-1, -1], [-1, 1], [1, 1]]) * 0.04
        flat = np.column_stack([corners[:, 0], np.zeros(5), corners[:, 1]])
        edge: Array = flat @ trace.rotation[-1].T + trace.position[-1]
        picture.line(edge[:, 0].tolist(), edge[:, 2].tolist(), color)
        picture.dot(trace.position[-1, 0], trace.position[-1, 2], color)
    picture.words(0.065, 0.083, "the plane")
    picture.write("minimum_representation.svg", (0.1, 0.15, 0.2, 0.25), (0.05, 0.1))


def _with(scenario: Scenario, task: PointOnPlane, secondary: JointCentering | Posture) -> Scenario:
    return replace(scenario, tasks=(task,), secondary=(secondary,))


def schemes() -> None:
    """Condition numbers of the 210 choices of four joints, sorted."""
    found = coopqp.mobility(coopqp.load("point_on_point").chain)
    picture = Picture((0, 210), (1.0, 18.0), "schemes, best first", "condition number")
    for name, color in (("condition", BLUE), ("condition_start", RED)):
        values = sorted(min(getattr(scheme, name), 1e18) for scheme in found.schemes)
        picture.line(range(210), [math.log10(value) for value in values], color)
    picture.words(10, 13.5, "generic poses (median)", BLUE)
    picture.words(10, 12.2, "the symmetric start", RED)
    picture.line((0, 210), (8, 8), GREY, 1.0, "2 3")
    picture.words(10, 8.4, "singular above", GREY)
    picture.write("schemes.svg", (0, 50, 100, 150, 200), ("1e2", "1e8", "1e16"))


def drift() -> None:
    """How far the hands come apart, with and without the correction."""
    scenario = coopqp.load("point_on_point")
    picture = Picture((0.0, 3.0), (-9.0, 0.0), "time [s]", "loop error [mm]")
    for kappa, color, above in ((0.0, RED, 0.3), (1.0, GREEN, -1.1), (100.0, BLUE, 1.2)):
        trace = coopqp.run(replace(scenario, kappa=kappa), controller="pseudoinverse")
        error = np.log10(np.clip(1e3 * trace.loop_position, 1e-9, None))
        picture.line(trace.t.tolist(), error.tolist(), color)
        picture.words(2.2, float(error[220]) + above, f"kappa {kappa:g}", color)
    picture.write("drift.svg", (0, 1, 2, 3), ("1e-8", "1e-4", "1e-2", "1"))


if __name__ == "__main__":
    main()
