"""The process of the page: viser's server with a scene and a panel. It loads nothing from outside.

viser is imported here alone, so that the control loop's process has none of it.
"""

import threading
import time
from collections.abc import Callable, Sequence
from html import escape
from typing import Any

from coopqp.viewer.gate import guard
from coopqp.viewer.messages import Action, Dial, Frame, PageSetup
from coopqp.viewer.scene import AT, BEYOND, FORCE, GOAL, LINK, NEAR, TONES, WEIGHT, Scene, css
from coopqp.viewer.worker import Peer

OVERLAID, APART = "all, one over the other", "all, side by side"
BUTTONS = {"Play": "play", "Pause": "pause", "One tick": "step", "Reset": "reset"}
DRAG = "Drag the box, or the arrows and rings at a goal; the arms follow as far as they can."
STILL = "Nothing can be dragged here: what the tasks ask for moves by itself, or has no place."
STEERED = "Nothing can be dragged here; move the sliders below Inputs, and the arms follow."
MAX_LIMITS = 4  # that are listed by name
FAREWELL = 0.2  # for the last messages to go out [s]


def serve(peer: Peer, setup: PageSetup, host: str, port: int, allowed: Sequence[str]) -> None:
    """Serve the page until the player ends; to pages of ``allowed`` origins, too."""
    import viser

    asked = guard(host, allowed)
    server = viser.ViserServer(host=host, port=port, label="coopqp play", verbose=False)
    used = server.get_port()
    if not asked:
        peer.send(f"viser {viser.__version__} cannot be kept from foreign pages; install 1.1")
        return
    if port and used != port:  # somebody was faster
        peer.send(f"port {port} is taken; take another with --port")
        return
    lock, begun = threading.Lock(), False

    def send(action: Action) -> None:
        with lock:
            peer.send(action)

    server.gui.configure_theme(
        control_width="large", show_logo=False, show_share_button=False, brand_color=(0, 114, 178)
    )
    with server.atomic():  # viser keeps all browsers alike, also those that come late
        scene = Scene(server, setup, send)
        panel = _Panel(server.gui, setup, send, scene.arrange)

    async def begin(client: Any) -> None:
        """Time starts when the first browser connects."""
        nonlocal begun
        scene.fit(client)
        if not begun:
            begun = True
            send(Action("play"))

    server.on_client_connect(begin)
    peer.send(used)
    for frame in peer.messages():
        with server.atomic():
            scene.draw(frame)
            panel.draw(frame)
    panel.end()
    server.flush()
    time.sleep(FAREWELL)


class _Panel:
    """The sentence, buttons, controllers, dials and the recording."""

    def __init__(
        self,
        gui: Any,
        setup: PageSetup,
        send: Callable[[Action], None],
        arrange: Callable[[str, int], None],
    ) -> None:
        self._gui, self._setup, self._send, self._arrange = gui, setup, send, arrange
        self._texts: dict[int, str] = {}
        gui.add_html(_head(setup))
        self._round = gui.add_button("Go round", visible=False, hint="along the ghost's way")
        self._on(self._round.on_click, lambda: Action("follow"))
        self._verdict = gui.add_html("")
        buttons = gui.add_button_group("", tuple(BUTTONS))
        self._on(buttons.on_click, lambda: Action(BUTTONS[buttons.value]))
        speed = gui.add_slider("speed", 0.05, 4.0, 0.05, 1.0, hint="1 is real time")
        self._on(speed.on_update, lambda: Action("speed", 0, (float(speed.value),)))
        self._status = gui.add_html("")
        self._choice()
        self._table = gui.add_html("")
        gui.add_html(_legend(setup))
        with gui.add_folder("Gains, weights, priorities, kappa", expand_by_default=False):
            for group in dict.fromkeys(dial.group for dial in setup.dials):
                with gui.add_folder(group):
                    for dial in setup.dials:
                        if dial.group == group:
                            self._slider(dial, "dial", dial.label)
        if setup.knobs:
            with gui.add_folder("Inputs"):
                for knob in setup.knobs:
                    self._slider(knob, "knob", f"{knob.group} {knob.label}")
        with gui.add_folder("Recording"):
            self._recorded = gui.add_html("")
            if setup.folder:
                save = gui.add_button("Save", hint=f"to {setup.folder}")
                self._on(save.on_click, lambda: Action("save"))

    def draw(self, frame: Frame) -> None:
        self._set(self._verdict, _verdict(frame))
        self._set(self._status, _status(frame, self._setup))
        if self._round.visible != (frame.ghost is not None):
            self._round.visible = frame.ghost is not None
        self._set(self._table, _table(frame, self._setup))
        self._set(self._recorded, _recorded(frame, self._setup))

    def end(self) -> None:
        self._set(self._verdict, _box('<div data-tone="ended">coopqp play has ended.</div>'))
        self._set(self._status, _box("ended"))

    def _set(self, handle: Any, text: str) -> None:
        if self._texts.get(id(handle)) != text:
            self._texts[id(handle)] = handle.content = text

    def _on(self, register: Callable[[Any], Any], action: Callable[[], Action]) -> None:
        """Send an action whenever somebody uses a control."""

        async def act(event: Any) -> None:
            self._send(action())

        register(act)

    def _choice(self) -> None:
        """Which controllers are visible; nothing to choose where there is one."""
        names = list(self._setup.laws)
        if len(names) == 1:
            return
        choice = self._gui.add_dropdown("law", [*names, OVERLAID, APART], names[0])
        main = 0

        async def choose(event: Any) -> None:
            nonlocal main
            if choice.value in names:
                main = names.index(choice.value)
                self._send(Action("main", main))
            self._arrange({OVERLAID: "overlaid", APART: "apart"}.get(choice.value, "one"), main)

        choice.on_update(choose)

    def _slider(self, dial: Dial, what: str, label: str) -> None:
        slider = self._gui.add_slider(label, dial.low, dial.high, dial.step, dial.value)
        self._on(slider.on_update, lambda: Action(what, dial.key, (float(slider.value),)))


def _box(content: str, *, style: str = "") -> str:
    return (
        '<div style="margin:0 0.75em 0.5em 0.75em;font-size:0.875em;line-height:1.4;'
        f'overflow-wrap:anywhere;{style}">{content}</div>'
    )


def _head(setup: PageSetup) -> str:
    title = f'<div style="font-weight:600;font-size:1.15em">{escape(setup.title)}</div>'
    words = escape(setup.description)
    hint = DRAG if setup.gizmos else STEERED if setup.knobs else STILL
    return _box(f'{title}<div>{words}</div><div style="opacity:0.7;margin-top:0.35em">{hint}</div>')


def _verdict(frame: Frame) -> str:
    color, explained = TONES[frame.tone], frame.explanation
    active = ", ".join(map(escape, explained.active[:MAX_LIMITS]))
    if len(explained.active) > MAX_LIMITS:
        active += f" and {len(explained.active) - MAX_LIMITS} more"
    active = active or ("none" if frame.explained else "unknown")
    rows = [f'<div style="font-weight:600" data-tone="{frame.tone}">{escape(frame.sentence)}</div>']
    rows.append(f'<div style="margin-top:0.35em">Limits at their bound: {active}</div>')
    if explained.detail and frame.tone in ("blocked", "broken"):
        detail = f"This tick: {escape(explained.detail)}"
        rows.append(f'<div style="opacity:0.7;margin-top:0.35em">{detail}</div>')
    style = (
        f"border-left:5px solid {color};padding:0.5em 0.6em;background:{color}14;border-radius:3px;"
        "min-height:5.5em"
    )
    return _box("".join(rows), style=style)


def _status(frame: Frame, setup: PageSetup) -> str:
    words = [f"t = {frame.t:.2f} s"]
    if len(setup.phases) > 1:
        phase = escape(setup.phases[frame.phase])
        words.append(f"phase {frame.phase + 1} of {len(setup.phases)}: {phase}")
    words.append(f"playing at {frame.factor:.2f} of real time" if frame.playing else "paused")
    if frame.playing:
        words.append(f"slowest tick {frame.tick_us / 1000.0:.1f} ms")
    return _box(" · ".join(words), style="opacity:0.8;font-variant-numeric:tabular-nums")


def _table(frame: Frame, setup: PageSetup) -> str:
    rows = []
    for i, ((law, color), drawn) in enumerate(zip(setup.laws.items(), frame.laws, strict=True)):
        mark = f'<span style="color:{color}">&#9632;</span>'
        name = f"<b>{escape(law)}</b>" if i == frame.main else escape(law)
        wrong = f'<div style="color:{TONES["broken"]}">{escape(drawn.broken)}</div>'
        words = escape(drawn.words) + (wrong if drawn.broken else "")
        rows.append(f'<div style="margin-bottom:0.25em">{mark} {name}: {words}</div>')
    return _box("".join(rows))


def _legend(setup: PageSetup) -> str:
    parts = {
        "link whose joint is free": css(LINK),
        "near its limit": css(NEAR),
        "at it": css(AT),
        "past it": css(BEYOND),
        "object": next(iter(setup.laws.values())),
        "way to the goal": css(GOAL),
    }
    if setup.forces:
        parts["what each hand does to the object (above the hand)"] = css(FORCE)
        parts["its weight (below it)"] = css(WEIGHT)
    swatches = " ".join(
        f'<span style="white-space:nowrap;margin-right:0.6em"><span style="display:inline-block;'
        f"width:0.8em;height:0.8em;border-radius:2px;background:{color};border:1px solid #0003;"
        f'margin-right:0.3em"></span>{escape(word)}</span>'
        for word, color in parts.items()
    )
    return _box(swatches, style="font-size:0.8em")


def _recorded(frame: Frame, setup: PageSetup) -> str:
    how = " since the beginning; coopqp compare replays it"
    text = (
        f"{frame.recorded:.1f} s{how if setup.folder else '; begin with --record OUT to save it'}."
    )
    note = f'<div style="margin-top:0.3em">{escape(frame.note)}</div>' if frame.note else ""
    return _box(text + note)
