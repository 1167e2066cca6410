"""The process of the page: viser's server with a scene and a panel. It loads nothing from outside.

viser is imported here alone, so that the control loop's process has none of it. It sends what has
changed alone. Colours with a meaning are Okabe and Ito's, safe for the colour-blind.
"""

import threading
import time
from collections.abc import Callable, Sequence
from html import escape
from typing import Any

import numpy as np

from coopqp.base.spec import Array
from coopqp.viewer.gate import guard
from coopqp.viewer.messages import Action, ControllerFrame, Dial, Frame, PageSetup, Tone
from coopqp.viewer.worker import Peer

OVERLAID, APART = "all, one over the other", "all, side by side"
BUTTONS = {"Play": "play", "Pause": "pause", "One tick": "step", "Reset": "reset"}
DRAG = "Drag the box, or the arrows and rings at a goal; the arms follow as far as they can."
STILL = "Nothing can be dragged here: what the tasks ask for moves by itself, or has no place."
STEERED = "Nothing can be dragged here; move the sliders below Inputs, and the arms follow."
MAX_LIMITS = 4  # that are listed by name
FAREWELL = 0.2  # for the last messages to go out [s]

Rgb = tuple[int, int, int]
Send = Callable[[Action], None]

LINK: Rgb = (214, 218, 222)
NEAR: Rgb = (240, 228, 66)  # on the way to a limit
AT: Rgb = (213, 94, 0)
BEYOND: Rgb = (150, 20, 110)
GOAL: Rgb = (0, 158, 115)
FORCE: Rgb = (194, 24, 127)  # as in reports
WEIGHT: Rgb = (70, 70, 70)
TONES: dict[Tone, str] = {
    "reached": "#009E73",
    "moving": "#0072B2",
    "blocked": "#D55E00",
    "broken": "#96146E",
    "waiting": "#6B7280",
}
WARNS = 0.25  # distance to a limit, over half the range, where a joint begins to change its colour
STEPS = 6  # between two colours, so that links do not change with every frame

GHOST = 0.35  # opacity of a controller that is drawn over another one
LET_GO = 0.7  # a gizmo that has not been dragged for so long is free [s]
LEAST = 1e-6  # a smaller motion is not drawn [m]
GIZMO, THIN, SPACED = 0.9, 0.02, 1.15  # in longest edges of the object, and of the visible space

#: Where the camera is at first, in diagonals of the visible space, and its field of view [rad].
BEFORE, BESIDE, FOV = (1.35, -0.65, 0.55), (0.55, -1.4, 0.55), 0.8
#: In windows narrower than this [px] the camera is farther away and looks lower.
NARROW, FARTHER, LOWER = 600, 1.5, 0.35


def serve(peer: Peer, setup: PageSetup, host: str, port: int, allowed: Sequence[str]) -> None:
    """Serve the page until the player ends; to pages of ``allowed`` origins, too."""
    import viser

    guarded = guard(host, allowed)
    server = viser.ViserServer(host=host, port=port, label="coopqp play", verbose=False)
    used = server.get_port()
    if not guarded:
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
        self, gui: Any, setup: PageSetup, send: Send, arrange: Callable[[str, int], None]
    ) -> None:
        self._gui, self._setup, self._send, self._arrange = gui, setup, send, arrange
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
        self._verdict.content = _verdict(frame)
        self._status.content = _status(frame, self._setup)
        self._round.visible = frame.ghost is not None
        self._table.content = _table(frame, self._setup)
        self._recorded.content = _recorded(frame, self._setup)

    def end(self) -> None:
        self._verdict.content = _box('<div data-tone="ended">coopqp play has ended.</div>')
        self._status.content = _box("ended")

    def _on(self, register: Callable[[Any], Any], action: Callable[[], Action]) -> None:
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
        words = escape(drawn.errors) + (wrong if drawn.broken else "")
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
    how = how if setup.folder else "; begin with --record OUT to save it"
    note = f'<div style="margin-top:0.3em">{escape(frame.note)}</div>' if frame.note else ""
    return _box(f"{frame.recorded:.1f} s{how}.{note}")


def of_joint(left: float, base: Rgb) -> Rgb:
    """Colour of a link by its joint's distance to the nearer limit, over half the range."""
    if left < 0.0:
        return BEYOND
    if left == 0.0:
        return AT
    if left >= WARNS:
        return base
    near = 2.0 * np.ceil(STEPS * (1.0 - left / WARNS)) / STEPS
    return mixed(base, NEAR, near) if near < 1.0 else mixed(NEAR, AT, near - 1.0)


def mixed(first: Rgb, last: Rgb, share: float) -> Rgb:
    """A colour between two."""
    between = (1.0 - share) * np.array(first) + share * np.array(last)
    r, g, b = np.round(between).astype(int).tolist()
    return r, g, b


def rgb(color: str) -> Rgb:
    """The numbers of a colour such as "#0072B2"."""
    r, g, b = bytes.fromhex(color[1:])
    return r, g, b


def css(color: Rgb) -> str:
    """The inverse of :func:`rgb`."""
    return f"#{bytes(color).hex().upper()}"


def view(setup: PageSetup) -> tuple[Array, Array]:
    """Target and position of the camera at first, beside the longer horizontal edge, (3,) [m]."""
    size = setup.high - setup.low
    middle, aside = 0.5 * (setup.low + setup.high), BESIDE if size[0] > size[1] else BEFORE
    return middle, middle + float(np.linalg.norm(size)) * np.array(aside)


class Scene:
    """The scene of a page."""

    def __init__(self, server: Any, setup: PageSetup, send: Send) -> None:
        self._setup, self._send, self._server, self._scene = setup, send, server, server.scene
        self._size = max(setup.size)
        low, (middle, eye) = setup.low, view(setup)
        wide = float(np.linalg.norm(setup.high - low))
        self._middle, self._diagonal, self._aside = middle, wide, eye - middle
        self._scene.set_up_direction("+z")
        camera = server.initial_camera
        camera.look_at, camera.position = tuple(middle), tuple(eye)
        camera.fov, camera.near = FOV, 0.01 * wide
        self._scene.configure_default_lights(cast_shadow=False)
        self._scene.world_axes.visible = False
        cell, edge = 10.0 ** np.floor(np.log10(wide / 2.0)), 4.0 * wide
        self._scene.add_grid(
            "/floor", edge, edge, cell_size=cell, section_size=5.0 * cell,
            cell_color=(232, 234, 237), section_color=(214, 217, 221), fade_distance=6.0 * wide,
            shadow_opacity=0.0, position=(middle[0], middle[1], low[2]),
        )  # fmt: skip
        laws = [(f"/law{i}", rgb(color)) for i, color in enumerate(setup.laws.values())]
        self._drawn = [_Controller(server, setup, law, send) for law in laws]
        self._ghost = _Controller(server, setup, ("/ghost", GOAL), send)
        self._gizmos = [self._gizmo(i) for i in range(len(setup.gizmos))]
        self._dragged = [0.0] * len(setup.gizmos)
        look: Any = {"thickness": THIN * self._size, "visible": False}
        self._outlines = self._scene.add_line_segments("/goals", np.zeros((1, 2, 3)), GOAL, **look)
        self.arrange("one", 0)

    def arrange(self, how: str, main: int) -> None:
        """Choose what is visible: one, overlaid or apart; the main controller alone with "one"."""
        size = self._setup.high - self._setup.low
        across = np.array([1.0, 0.0, 0.0] if size[0] > size[1] else [0.0, -1.0, 0.0])
        width = SPACED * float(np.abs(across) @ size)
        for i, drawn in enumerate(self._drawn):
            shift = width * (i - main) * across if how == "apart" else np.zeros(3)
            shown, ghost = how != "one" or i == main, how == "overlaid" and i != main
            drawn.place(shown=shown, ghost=ghost, shift=shift, draggable=i == main)
        if how == "apart":  # the camera steps back
            middle = self._middle + width * (0.5 * (len(self._drawn) - 1) - main) * across
            for client in self._server.get_clients().values():
                client.camera.position = middle + (0.8 + 0.5 * len(self._drawn)) * self._aside
                client.camera.look_at = middle

    def draw(self, frame: Frame) -> None:
        for drawn, each in zip(self._drawn, frame.laws, strict=True):
            drawn.draw(each)
        self._ghost.show(frame.ghost)
        now = time.monotonic()
        for handle, pose, touched in zip(self._gizmos, frame.gizmos, self._dragged, strict=True):
            handle.visible = pose is not None
            if pose is not None and now - touched > LET_GO:
                _move(handle, pose)
        _set_points(self._outlines, frame.outlines, visible=len(frame.outlines) > 0)

    def fit(self, client: Any) -> None:
        """Move the camera so that a narrow window shows the scene above the panel."""
        camera = client.camera
        if camera.image_width >= NARROW:
            return
        below = np.array([0.0, 0.0, LOWER * self._diagonal])
        camera.position = self._middle - below + FARTHER * self._aside
        camera.look_at = self._middle - below  # after the position, which takes it along

    def _gizmo(self, i: int) -> Any:
        gizmo = self._setup.gizmos[i]
        handle = self._scene.add_transform_controls(
            f"/gizmo/{i}", scale=GIZMO * self._size, line_width=3.5, disable_axes=not gizmo.moves,
            disable_sliders=not gizmo.moves, disable_rotations=not gizmo.turns, depth_test=False,
            visible=False,
        )  # fmt: skip
        place = (0.0, 0.0, -0.35 * self._size)
        self._scene.add_label(f"/gizmo/{i}/name", f"goal: {gizmo.label}", position=place)

        async def drag(event: Any) -> None:
            self._dragged[i] = time.monotonic()
            w, *turn = _numbers(handle.wxyz)
            self._send(Action("drag", i, (*_numbers(handle.position), *turn, w)))

        handle.on_update(drag)
        return handle


class _Controller:
    def __init__(self, server: Any, setup: PageSetup, drawn: tuple[str, Rgb], send: Send) -> None:
        scene, (name, self._color) = server.scene, drawn
        self._bodies = setup.bodies
        self._send, self._root = send, scene.add_frame(name, show_axes=False)
        look: Any = {"color": LINK, "side": "double", "flat_shading": True}
        add, surfaces = scene.add_mesh_simple, enumerate(body.surface for body in setup.bodies)
        self._links = [add(f"{name}/link{k}", s.vertices, s.corners, **look) for k, s in surfaces]
        self._held = scene.add_box(f"{name}/object", color=self._color, dimensions=setup.size)
        size = max(setup.size)
        self._arrows, self._weight = (
            scene.add_arrows(
                f"{name}/{what}", np.zeros((1, 2, 3)), color,
                shaft_radius=0.03 * size, head_radius=0.07 * size, head_length=0.14 * size,
                visible=False,
            )
            for what, color in (("forces", FORCE), ("weight", WEIGHT))
        )  # fmt: skip
        self._base, self._shown, self._draggable = LINK, True, False
        self._held.on_drag(self._pull)

    async def _pull(self, event: Any) -> None:
        if event.phase != "end" and self._draggable:
            pull = np.subtract(event.end_position, event.start_position)
            self._send(Action("carry", 0, _numbers(np.asarray(self._held.position) + pull)))

    def place(self, *, shown: bool, ghost: bool, shift: Array, draggable: bool) -> None:
        self._shown, self._draggable = shown, draggable
        self._root.visible = shown
        self._root.position = shift
        self._base = mixed(LINK, self._color, 0.45) if ghost else LINK
        for node in (*self._links, self._held):
            node.opacity = GHOST if ghost else None

    def show(self, drawn: ControllerFrame | None) -> None:
        """Draw it as a ghost, or not at all."""
        if self._shown != (drawn is not None):
            self.place(shown=drawn is not None, ghost=True, shift=np.zeros(3), draggable=False)
            for body, node in zip(self._bodies, self._links, strict=True):
                node.visible = body.joint > 0
        self.draw(drawn)

    def draw(self, drawn: ControllerFrame | None) -> None:
        if not self._shown or drawn is None:
            return
        _move(self._held, drawn.held)
        for k, (body, node) in enumerate(zip(self._bodies, self._links, strict=True)):
            left = 1.0
            if body.joint:
                _move(node, drawn.bodies[k])
                left = float(drawn.left[body.joint - 1])
            node.color = of_joint(left, self._base)
        for node, arrows in ((self._arrows, drawn.arrows), (self._weight, drawn.weight)):
            lengths = np.abs(arrows[:, 1] - arrows[:, 0])
            _set_points(node, arrows, visible=bool(lengths.max(initial=0.0) > LEAST))


def _set_points(node: Any, points: Array, *, visible: bool) -> None:
    """Show segments or arrows, shape (., 2, 3) [m], or hide them."""
    if visible:
        node.points = points.astype(np.float32)
    node.visible = visible


def _move(node: Any, pose: Array) -> None:
    """Put a node to a pose x, y, z, qx, qy, qz, qw, unless it is there."""
    place, turn = pose[:3], pose[[6, 3, 4, 5]]
    if np.abs(np.asarray(node.position) - place).max() > LEAST:
        node.position = place
    if np.abs(np.asarray(node.wxyz) - turn).max() > LEAST:
        node.wxyz = turn


def _numbers(values: Any) -> tuple[float, ...]:
    return tuple(float(x) for x in values)
