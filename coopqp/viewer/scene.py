"""What stands in space on the page: robots, objects, goals to drag, forces."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np

from coopqp.base.spec import Array
from coopqp.viewer import colors
from coopqp.viewer.messages import Asked, Frame, LawFrame, Show

#: How solid a law is that is drawn over another one.
GHOST = 0.35
#: After this without a move a gizmo is nobody's any more [s].
LET_GO = 0.7
#: A part that moves by less stays where it is drawn [m].
STILL = 1e-6
#: Sizes, in the object's longest edge, and of the space that is seen.
GIZMO, THIN, APART = 0.9, 0.02, 1.15

#: Where the camera is at first, in diagonals of the space that is seen, and how wide it sees [rad].
BEFORE, BESIDE, FOV = (1.35, -0.65, 0.55), (0.55, -1.4, 0.55), 0.8
#: A window below is narrow [px]: the camera goes farther off and looks lower, in the same measures.
NARROW, FARTHER, LOWER = 600, 1.5, 0.35

Ask = Callable[[Asked], None]


def view(show: Show) -> tuple[Array, Array]:
    """What the camera looks at at first, and from where, shape (3,) each [m].

    Aside of the longer horizontal edge of what there is.
    """
    middle, aside = 0.5 * (show.low + show.high), BESIDE if _longer_along_x(show) else BEFORE
    return middle, middle + float(np.linalg.norm(show.high - show.low)) * np.array(aside)


def _longer_along_x(show: Show) -> bool:
    size = show.high - show.low
    return bool(size[0] > size[1])


class Scene:
    """The scene of a page."""

    def __init__(self, server: Any, show: Show, ask: Ask) -> None:
        self._show, self._ask, self._server, self._scene = show, ask, server, server.scene
        self._size = max(show.size)
        self._look_around(server)
        self._laws = [_Law(server, show, i, ask) for i in range(len(show.laws))]
        self._gizmos = [self._gizmo(i) for i in range(len(show.gizmos))]
        self._dragged = [0.0] * len(show.gizmos)
        thin = THIN * self._size
        nothing = np.zeros((1, 2, 3))
        self._outlines = self._scene.add_line_segments(
            "/goals", nothing, colors.GOAL, thickness=thin, visible=False
        )
        self.arrange("one", 0)

    def arrange(self, how: str, main: int) -> None:
        """Choose what is seen: one, overlaid or apart; the main law alone with "one"."""
        across = np.array([1.0, 0.0, 0.0] if _longer_along_x(self._show) else [0.0, -1.0, 0.0])
        width = APART * float(np.abs(across) @ (self._show.high - self._show.low))
        for i, law in enumerate(self._laws):
            law.place(
                shown=how != "one" or i == main,
                ghost=how == "overlaid" and i != main,
                shift=width * (i - main) * across if how == "apart" else np.zeros(3),
                draggable=i == main,
            )
        if how == "apart":
            self._step_back(width * (0.5 * (len(self._laws) - 1) - main) * across)

    def _step_back(self, shift: Array) -> None:
        """Let all laws be seen side by side."""
        for client in self._server.get_clients().values():
            middle, far = self._middle + shift, 0.8 + 0.5 * len(self._laws)
            client.camera.position = middle + far * self._aside
            client.camera.look_at = middle

    def draw(self, frame: Frame) -> None:
        """Everything as it is now."""
        for law, drawn in zip(self._laws, frame.laws, strict=True):
            law.draw(drawn)
        now = time.monotonic()
        for handle, pose, touched in zip(self._gizmos, frame.gizmos, self._dragged, strict=True):
            if handle.visible != (pose is not None):
                handle.visible = pose is not None
            if pose is not None and now - touched > LET_GO:
                _move(handle, pose)
        seen = len(frame.outlines) > 0
        if seen:
            self._outlines.points = frame.outlines.astype(np.float32)
        if self._outlines.visible != seen:
            self._outlines.visible = seen

    def fit(self, client: Any) -> None:
        """Let somebody with a narrow window see what stands above the panel."""
        camera = client.camera
        if camera.image_width >= NARROW:
            return
        below = np.array([0.0, 0.0, LOWER * self._wide])
        camera.position = self._middle - below + FARTHER * self._aside
        camera.look_at = self._middle - below  # after the position, which takes it along

    def _look_around(self, server: Any) -> None:
        low, (middle, eye) = self._show.low, view(self._show)
        wide = float(np.linalg.norm(self._show.high - low))
        self._middle, self._wide, self._aside = middle, wide, eye - middle
        server.scene.set_up_direction("+z")
        camera = server.initial_camera
        camera.look_at, camera.position = tuple(middle), tuple(eye)
        camera.fov, camera.near = FOV, 0.01 * wide
        server.scene.configure_default_lights(cast_shadow=False)
        server.scene.world_axes.visible = False
        cell = 10.0 ** np.floor(np.log10(wide / 2.0))
        edge = 4.0 * wide
        server.scene.add_grid(
            "/floor", edge, edge, cell_size=cell, section_size=5.0 * cell,
            cell_color=(232, 234, 237), section_color=(214, 217, 221), fade_distance=6.0 * wide,
            shadow_opacity=0.0, position=(middle[0], middle[1], low[2]),
        )  # fmt: skip

    def _gizmo(self, i: int) -> Any:
        look = self._show.gizmos[i]
        handle = self._scene.add_transform_controls(
            f"/gizmo/{i}",
            scale=GIZMO * self._size,
            line_width=3.5,
            disable_axes=not look.moves,
            disable_sliders=not look.moves,
            disable_rotations=not look.turns,
            depth_test=False,
            visible=False,
        )
        self._scene.add_label(
            f"/gizmo/{i}/name", f"goal: {look.label}", position=(0.0, 0.0, -0.35 * self._size)
        )

        async def drag(event: Any) -> None:
            self._dragged[i] = time.monotonic()
            self._ask(Asked("drag", i, (*_numbers(handle.position), *_turn(handle.wxyz))))

        handle.on_update(drag)
        return handle


class _Law:
    """What is drawn of one law."""

    def __init__(self, server: Any, show: Show, i: int, ask: Ask) -> None:
        scene, look = server.scene, show.laws[i]
        self._bodies, self._look = show.bodies, look
        self._ask, self._root = ask, scene.add_frame(f"/law{i}", show_axes=False)
        made = {"color": colors.LINK, "side": "double", "flat_shading": True}
        self._links = [
            scene.add_mesh_simple(f"/law{i}/link{k}", body.vertices, body.corners, **made)
            for k, body in enumerate(show.bodies)
        ]
        self._held = scene.add_box(
            f"/law{i}/object", color=colors.rgb(look.color), dimensions=show.size
        )
        size = max(show.size)
        self._arrows, self._weight = (
            scene.add_arrows(
                f"/law{i}/{name}", np.zeros((1, 2, 3)), color,
                shaft_radius=0.03 * size, head_radius=0.07 * size, head_length=0.14 * size,
                visible=False,
            )
            for name, color in (("forces", colors.FORCE), ("weight", colors.WEIGHT))
        )  # fmt: skip
        self._colors = [colors.LINK] * len(self._links)
        self._base, self._shown, self._draggable = colors.LINK, True, False
        self._held.on_drag(self._pull)

    async def _pull(self, event: Any) -> None:
        """Where the object is pulled, its origin is to go."""
        if event.phase != "end" and self._draggable:
            pull = np.subtract(event.end_position, event.start_position)
            self._ask(Asked("carry", 0, _numbers(np.asarray(self._held.position) + pull)))

    def place(self, *, shown: bool, ghost: bool, shift: Array, draggable: bool) -> None:
        """Where and how it is drawn."""
        self._shown, self._draggable = shown, draggable
        self._root.visible = shown
        self._root.position = shift
        tint = colors.mixed(colors.LINK, colors.rgb(self._look.color), 0.45)
        self._base = tint if ghost else colors.LINK
        for node in (*self._links, self._held):
            node.opacity = GHOST if ghost else None

    def draw(self, drawn: LawFrame) -> None:
        """As it is now."""
        if not self._shown:
            return
        for body, node, pose in zip(self._bodies, self._links, drawn.bodies, strict=True):
            if body.joint is not None:
                _move(node, pose)
        _move(self._held, drawn.held)
        for k, body in enumerate(self._bodies):
            left = 1.0 if body.joint is None else float(drawn.left[body.joint])
            color = colors.of_joint(left, self._base)
            if color != self._colors[k]:
                self._colors[k] = self._links[k].color = color
        _point(self._arrows, drawn.arrows)
        _point(self._weight, drawn.weight)


def _point(node: Any, arrows: Array) -> None:
    """Let arrows go from and to, shape (., 2, 3); none are seen where nothing has a length."""
    seen = len(arrows) > 0 and bool(np.abs(arrows[:, 1] - arrows[:, 0]).max() > STILL)
    if seen:
        node.points = arrows.astype(np.float32)
    if node.visible != seen:
        node.visible = seen


def _move(node: Any, pose: Array) -> None:
    """Put a node to a pose x, y, z, qx, qy, qz, qw, unless it is there."""
    place, turn = pose[:3], pose[[6, 3, 4, 5]]
    if np.abs(np.asarray(node.position) - place).max() > STILL:
        node.position = place
    if np.abs(np.asarray(node.wxyz) - turn).max() > STILL:
        node.wxyz = turn


def _numbers(values: Any) -> tuple[float, ...]:
    return tuple(float(x) for x in values)


def _turn(wxyz: Any) -> tuple[float, ...]:
    """A quaternion in the order of all else, x, y, z, w."""
    w, x, y, z = _numbers(wxyz)
    return x, y, z, w
