"""The panel of the page: the verdict, buttons, laws, dials, the recording."""

from __future__ import annotations

from collections.abc import Callable
from html import escape
from typing import Any

from coopqp.viewer import colors
from coopqp.viewer.messages import Asked, Dial, Frame, Show

Ask = Callable[[Asked], None]
Arrange = Callable[[str, int], None]

OVERLAID, APART = "all, one over the other", "all, side by side"
BUTTONS = {"Play": "play", "Pause": "pause", "One tick": "step", "Reset": "reset"}
DRAG = "Drag the box, or the arrows and rings at a goal; the arms follow as far as they can."
STILL = "Nothing can be dragged here: what the tasks ask for moves by itself, or has no place."
STEERED = "Nothing can be dragged here; move the sliders below Inputs, and the arms follow."
#: Limits that are listed by name.
MOST = 4


class Panel:
    """The panel of a page."""

    def __init__(self, server: Any, show: Show, ask: Ask, arrange: Arrange) -> None:
        self._gui, self._show, self._ask, self._arrange = server.gui, show, ask, arrange
        self._texts: dict[int, str] = {}
        self._gui.add_html(_head(show))
        self._verdict = self._gui.add_html("")
        self._buttons()
        self._status = self._gui.add_html("")
        self._choice()
        self._table = self._gui.add_html("")
        self._gui.add_html(_legend(show))
        self._all_dials()
        self._record()

    def draw(self, frame: Frame) -> None:
        """Everything as it is now."""
        self._set(self._verdict, _verdict(frame))
        self._set(self._status, _status(frame, self._show))
        self._set(self._table, _table(frame, self._show))
        self._set(self._recorded, _recorded(frame, self._show))

    def end(self) -> None:
        """Say that nobody plays any more."""
        self._set(self._verdict, _box('<div data-tone="ended">coopqp play has ended.</div>'))
        self._set(self._status, _box("ended"))

    def _set(self, handle: Any, text: str) -> None:
        """Send a text that has changed."""
        if self._texts.get(id(handle)) != text:
            self._texts[id(handle)] = handle.content = text

    def _buttons(self) -> None:
        buttons = self._gui.add_button_group("", tuple(BUTTONS))
        self._tell(buttons.on_click, lambda: Asked(BUTTONS[buttons.value]))
        speed = self._gui.add_slider("speed", 0.05, 4.0, 0.05, 1.0, hint="1 is real time")
        self._tell(speed.on_update, lambda: Asked("speed", 0, (float(speed.value),)))

    def _tell(self, register: Callable[[Any], Any], asked: Callable[[], Asked]) -> None:
        """Ask for something whenever somebody uses a control."""

        async def tell(event: Any) -> None:
            self._ask(asked())

        register(tell)

    def _choice(self) -> None:
        """Which laws are seen; nothing to choose where there is one."""
        names = [law.name for law in self._show.laws]
        if len(names) == 1:
            return
        choice = self._gui.add_dropdown("law", [*names, OVERLAID, APART], names[0])
        main = 0

        async def choose(event: Any) -> None:
            nonlocal main
            if choice.value in names:
                main = names.index(choice.value)
                self._ask(Asked("main", main))
            how = {OVERLAID: "overlaid", APART: "apart"}.get(choice.value, "one")
            self._arrange(how, main)

        choice.on_update(choose)

    def _all_dials(self) -> None:
        with self._folder("Gains, weights, priorities, kappa"):
            for group in dict.fromkeys(dial.group for dial in self._show.dials):
                with self._folder(group, shut=False):
                    for dial in self._show.dials:
                        if dial.group == group:
                            self._slider(dial, "dial")
        if self._show.knobs:
            with self._folder("Inputs", shut=False):
                for dial in self._show.knobs:
                    self._slider(dial, "knob")

    def _slider(self, dial: Dial, what: str) -> None:
        label = dial.label if what == "dial" else f"{dial.group} {dial.label}"
        slider = self._gui.add_slider(label, dial.low, dial.high, dial.step, dial.value)
        self._tell(slider.on_update, lambda: Asked(what, dial.key, (float(slider.value),)))

    def _record(self) -> None:
        with self._folder("Recording", shut=False):
            self._recorded = self._gui.add_html("")
            if self._show.folder:
                save = self._gui.add_button("Save", hint=f"to {self._show.folder}")
                self._tell(save.on_click, lambda: Asked("save"))

    def _folder(self, name: str, *, shut: bool = True) -> Any:
        return self._gui.add_folder(name, expand_by_default=not shut)


def _box(content: str, *, style: str = "") -> str:
    return (
        '<div style="margin:0 0.75em 0.5em 0.75em;font-size:0.875em;line-height:1.4;'
        f'overflow-wrap:anywhere;{style}">{content}</div>'
    )


def _head(show: Show) -> str:
    title = f'<div style="font-weight:600;font-size:1.15em">{escape(show.title)}</div>'
    words = escape(show.description)
    hint = DRAG if show.gizmos else STEERED if show.knobs else STILL
    return _box(f'{title}<div>{words}</div><div style="opacity:0.7;margin-top:0.35em">{hint}</div>')


def _verdict(frame: Frame) -> str:
    color = colors.TONES[frame.tone]
    active = ", ".join(map(escape, frame.active[:MOST]))
    if len(frame.active) > MOST:
        active += f" and {len(frame.active) - MOST} more"
    active = active or ("none" if frame.explained else "unknown")
    rows = [f'<div style="font-weight:600" data-tone="{frame.tone}">{escape(frame.sentence)}</div>']
    rows.append(f'<div style="margin-top:0.35em">Limits at their bound: {active}</div>')
    if frame.detail and frame.tone in ("blocked", "broken"):
        rows.append(
            f'<div style="opacity:0.7;margin-top:0.35em">This tick: {escape(frame.detail)}</div>'
        )
    style = (
        f"border-left:5px solid {color};padding:0.5em 0.6em;background:{color}14;border-radius:3px;"
        "min-height:5.5em"
    )
    return _box("".join(rows), style=style)


def _status(frame: Frame, show: Show) -> str:
    state = f"playing at {frame.factor:.2f} of real time" if frame.playing else "paused"
    phase = show.phases[frame.phase]
    words = [f"t = {frame.t:.2f} s", state]
    if len(show.phases) > 1:
        words.insert(1, f"phase {frame.phase + 1} of {len(show.phases)}: {escape(phase)}")
    if frame.playing:
        words.append(f"slowest tick {frame.tick_us / 1000.0:.1f} ms")
    return _box(" · ".join(words), style="opacity:0.8;font-variant-numeric:tabular-nums")


def _table(frame: Frame, show: Show) -> str:
    rows = []
    for i, (look, drawn) in enumerate(zip(show.laws, frame.laws, strict=True)):
        mark = f'<span style="color:{look.color}">&#9632;</span>'
        name = f"<b>{escape(look.name)}</b>" if i == frame.main else escape(look.name)
        wrong = f'<div style="color:{colors.TONES["broken"]}">{escape(drawn.broken)}</div>'
        words = escape(drawn.words) + (wrong if drawn.broken else "")
        rows.append(f'<div style="margin-bottom:0.25em">{mark} {name}: {words}</div>')
    return _box("".join(rows))


def _legend(show: Show) -> str:
    parts = [
        (colors.css(colors.LINK), "link whose joint is free"),
        (colors.css(colors.NEAR), "near its limit"),
        (colors.css(colors.AT), "at it"),
        (colors.css(colors.BEYOND), "past it"),
        (show.laws[0].color, "object"),
        (colors.css(colors.GOAL), "way to the goal"),
    ]
    if show.forces:
        parts += [
            (colors.css(colors.FORCE), "what each hand does to the object (above the hand)"),
            (colors.css(colors.WEIGHT), "its weight (below it)"),
        ]
    swatches = " ".join(
        f'<span style="white-space:nowrap;margin-right:0.6em"><span style="display:inline-block;'
        f"width:0.8em;height:0.8em;border-radius:2px;background:{color};border:1px solid #0003;"
        f'margin-right:0.3em"></span>{escape(word)}</span>'
        for color, word in parts
    )
    return _box(swatches, style="font-size:0.8em")


def _recorded(frame: Frame, show: Show) -> str:
    if show.folder:
        text = f"{frame.recorded:.1f} s since the beginning; coopqp compare replays it."
    else:
        text = f"{frame.recorded:.1f} s; begin with --record OUT to save it."
    note = f'<div style="margin-top:0.3em">{escape(frame.note)}</div>' if frame.note else ""
    return _box(text + note)
