"""A scenario that is played: its controllers side by side, and what people do to them.

No clock and no process: whoever plays it calls :meth:`Player.do` for an action of the page,
:meth:`Player.tick` when it is time and :meth:`Player.frame` to draw.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from coopqp.assessment.thresholds import rests
from coopqp.base.errors import CoopqpError
from coopqp.base.spec import Array
from coopqp.execution.controller_run import check_plant, controller_of
from coopqp.model.state import State
from coopqp.report.curves import chosen_styles
from coopqp.report.scene.playback import Place
from coopqp.scenario.input import FARTHEST
from coopqp.scenario.planned import Way
from coopqp.scenario.scenario import Scenario
from coopqp.signal import Kind
from coopqp.viewer import messages, picture
from coopqp.viewer.simulated_controller import SimulatedController
from coopqp.viewer.steering import Handle, Recording, dials_of, handles, with_dials, with_inputs

SLOWEST, FASTEST = 0.05, 4.0
MAX_FORCE = 100.0  # range of the slider of a force whose input has no bounds [N, N m]
STUCK = 0.02  # arms that are blocked and slower are stuck [rad/s, m/s]
#: How far a ghost goes between two frames [s], and ticks that it stays at the end.
GHOST_STEP, GHOST_RESTS = 1.0 / 30.0, 50
ENDED = "explanations have ended with their process; begin coopqp play anew to have them"


class Player:
    """A scenario that is played, by all of its controllers if none is named.

    CoopqpError: a controller that was named cannot be built, or none can.
    """

    def __init__(
        self, scenario: Scenario, names: Sequence[str] = (), folder: Path | None = None
    ) -> None:
        self._read, self._folder = scenario, folder
        self.scenario, self._steered = with_inputs(scenario)  # for all that can be dragged
        self._handles = handles(self.scenario, self._steered)
        self._dials = {dial.key: dial for dial in dials_of(self.scenario)}
        self._values: dict[messages.Key, float] = {}
        self.playing, self.speed = False, 1.0
        self._main = 0
        self.has_explainer = self.has_planner = True  # whether their processes are alive
        self.refused: dict[str, str] = {}  # controllers that are left out, and why
        self._names = self._playable(tuple(names))
        self._bodies, self.faults = picture.all_bodies(self.scenario)
        self._place = Place(self.scenario)
        self.reset()
        self._knobs = tuple(self._own_knobs())

    def reset(self) -> None:
        """Begin anew; dials keep their values."""
        scenario = with_dials(self.scenario, self._values)
        self._hands = {field.name: list(field.start) for field in self._steered if field.start}
        self.controllers = [SimulatedController(scenario, n, self._hands) for n in self._names]
        self.recording = Recording(self._read, self._steered, self._names, self._values)
        self.explanation, self._changed, self.note = messages.Explanation(), False, ""
        self.way_round: messages.WayRound | None = None  # where the arms are stuck, if known
        self._planned_for: object = None  # the goals of the last search for a way round
        self._ghost = 0
        self.tick()

    @property
    def _controller(self) -> SimulatedController:
        return self.controllers[self._main]

    def tick(self) -> None:
        self._apply_dials()
        try:
            for controller in self.controllers:
                controller.tick()
        except CoopqpError as error:  # the next phase cannot begin from here
            self.playing, self.note = False, str(error)
            self.recording.end("has ended with the run")
            return
        run, feed = self.controllers[0].run, self.controllers[0].feed
        kinds = {name: channel.kind for name, channel in feed.inputs.channels.items()}
        self.recording.add(run.index, run.since, run.state.t, feed.arrived, kinds)

    def do(self, action: messages.Action) -> None:
        """Carry out an action of the page; one that makes no sense is ignored."""
        what, value = action.what, action.value
        if not (np.abs(np.array(value, float)) < FARTHEST).all():
            return
        if what in ("play", "pause"):
            self.playing = what == "play"
        elif what == "step":
            self.playing = False
            self.tick()
        elif what == "reset":
            self.reset()
        elif what == "speed" and value:
            self.speed = float(np.clip(value[0], SLOWEST, FASTEST))
        elif what == "main" and isinstance(action.which, int):
            self._main = action.which % len(self.controllers)
            self.explanation = messages.Explanation()
        elif what == "save":
            self.save()
        elif what == "follow":
            self._follow()
        else:
            self._steer(action)

    def save(self) -> Path | None:
        """Write the recording; where nothing can be written the note says why."""
        if self._folder is None:
            return None
        try:
            path = self.recording.save(self._folder)
        except CoopqpError as error:
            self.note = str(error)
            return None
        self.note = f"wrote {path}"
        return path

    def show(self) -> messages.PageSetup:
        low, high = picture.space(self.scenario, self._bodies)
        keeps = {c.name: "limits" in c.run.controller.supports for c in self.controllers}
        return messages.PageSetup(
            title=self.scenario.name,
            description=self.scenario.description,
            laws={name: style.color for name, style in chosen_styles(keeps).items()},
            bodies=self._bodies,
            size=self.scenario.held.size,
            low=low,
            high=high,
            gizmos=tuple(handle.gizmo for handle in self._handles),
            dials=tuple(self._dials.values()),
            knobs=self._knobs,
            phases=tuple(phase.name for phase in self.scenario.schedule),
            forces=picture.FORCES in self.controllers[0].plant.signals,
            folder="" if self._folder is None else str(self._folder),
        )

    def frame(self, factor: float = 0.0, tick_us: float = 0.0) -> messages.Frame:
        """Everything now; the measured speed of time and the longest tick [us] are given."""
        self._apply_dials()
        controller = self._controller
        laws = tuple(picture.drawn(each, self._bodies) for each in self.controllers)
        tone, sentence = self._verdict(controller, laws[self._main])
        targets, phase = controller.targets(), controller.run.index
        gizmos = tuple(
            handle.pose(targets, controller.state) if handle.gizmo.phase == phase else None
            for handle in self._handles
        )
        recorded = f"the recording {self.recording.note}" if self.recording.note else ""
        return messages.Frame(
            t=controller.t,
            phase=phase,
            playing=self.playing,
            factor=factor,
            laws=laws,
            main=self._main,
            gizmos=gizmos,
            outlines=self._outlines(controller, gizmos),
            tone=tone,
            sentence=sentence,
            explanation=self.explanation,
            explained=self.has_explainer,
            recorded=self.recording.seconds,
            note="; ".join(filter(None, (recorded, self.note))),
            tick_us=tick_us,
            ghost=self._ghost_frame(),
        )

    @property
    def is_stuck(self) -> bool:
        """Whether a way round is due, and nobody looks for one yet."""
        controller = self._controller
        if not self.explanation.blocked or controller.follows or not controller.at_targets:
            return False
        slow = np.abs(controller.state.v).max(initial=0.0) < STUCK
        return bool(slow) and self._planned_for != self._goals()

    def ask_way(self) -> messages.Snapshot:
        self._planned_for, self.way_round = self._goals(), None
        return self.snapshot()

    def _goals(self) -> object:
        """What a way round is for; the way is of no use for other goals."""
        controller = self._controller
        targets = {name: value.tolist() for name, value in controller.targets().items()}
        return self._main, controller.run.index, targets

    def _offered(self) -> Way | None:
        """The way round that can be followed now."""
        if self._controller.follows or self._planned_for != self._goals():
            self._planned_for, self.way_round = None, None
        return self.way_round.way if self.way_round else None

    def _follow(self) -> None:
        if (way := self._offered()) is None:
            return
        try:
            self._controller.follow(way)
        except CoopqpError as error:
            self.note = str(error)
        else:
            self.playing = True
            self.recording.end("ends where a way round was followed; reset begins another")

    def _ghost_frame(self) -> messages.ControllerFrame | None:
        """Some frames farther along the way that is offered, again and again."""
        if (way := self._offered()) is None:
            return None
        self._ghost += max(1, round(GHOST_STEP / self.scenario.dt))
        q = way.q[min(self._ghost % (len(way.q) + GHOST_RESTS), len(way.q) - 1)]
        return picture.still(State(self._controller.run.problem.chain, q), self._bodies)

    def snapshot(self) -> messages.Snapshot:
        controller, state = self._controller, self._controller.state
        return messages.Snapshot(  # which is sent to another process, and so copied
            law=controller.name,
            dials=dict(self._values),
            starts=tuple(controller.starts),
            state=state.kept(),
            targets=controller.targets(),
            rests=rests(state.v) and controller.at_targets,
        )

    def _playable(self, named: Sequence[str]) -> tuple[str, ...]:
        """The controllers that can be built; those that were named have to be."""
        names = []
        for name in named or self.scenario.controllers:
            try:
                check_plant(self.scenario, controller_of(self.scenario, name), name)
                SimulatedController(self.scenario, name, {})
            except CoopqpError as error:
                if named:
                    raise
                self.refused[name] = str(error)
            else:
                names.append(name)
        if not names:
            raise CoopqpError("; ".join(f"{name}: {why}" for name, why in self.refused.items()))
        return tuple(dict.fromkeys(names))

    def _own_knobs(self) -> list[messages.Dial]:
        """Inputs of the scenario's own that no gizmo steers."""
        steered, knobs = {field.name for field in self._steered}, []
        inputs = SimulatedController(self.scenario, self._names[0], {}).feed.inputs
        for name, channel in inputs.channels.items():
            for i, column in enumerate(channel.kind.columns if name not in steered else ()):
                now = float(channel.value[i])
                low, high = self._range(name, channel.kind, i)
                low, high = min(low, now), max(high, now)
                step = (high - low) / 200.0
                knobs.append(messages.Dial((name, i), name, column, low, high, step, now))
        return knobs

    def _range(self, name: str, kind: Kind, i: int) -> tuple[float, float]:
        """Range of an input's slider: its bounds, within those of joints."""
        settings, chain = self.scenario.inputs[name], self.controllers[0].run.problem.chain
        high = settings.velocity if kind.velocity else np.pi if kind.each else MAX_FORCE
        low = -high
        if kind.each:
            joint = chain.joint_names.index(kind.columns[i])
            if np.isfinite(chain.upper[joint] - chain.lower[joint]):
                low, high = float(chain.lower[joint]), float(chain.upper[joint])
        if i < kind.numbers and settings.lower:
            low = max(low, settings.lower[i])
        if i < kind.numbers and settings.upper:
            high = min(high, settings.upper[i])
        return low, high

    def _steer(self, action: messages.Action) -> None:
        controller, which, value = self._controller, action.which, action.value
        targets = controller.targets()
        if action.what == "drag" and isinstance(which, int) and which < len(self._handles):
            self._send(self._handles[which], value)
        elif action.what == "carry" and len(value) == 3:
            now = (h for h in self._handles if h.gizmo.phase == controller.run.index)
            if handle := next((h for h in now if h.gizmo.moves), None):
                self._send(handle, handle.carried(value, targets, controller.state).tolist())
        elif action.what == "dial" and which in self._dials and value:
            dial = self._dials[which]
            self._values[dial.key] = float(np.clip(value[0], dial.low, dial.high))
            self._changed = True
        elif action.what == "knob" and value:
            for name, column in (k.key for k in self._knobs if k.key == which):
                if name in targets:
                    self._hands.setdefault(name, targets[name].tolist())[column] = value[0]

    def _send(self, handle: Handle, pose: Sequence[float]) -> None:
        if len(pose) == 7 and 0.5 < np.linalg.norm(pose[3:]) < 2.0:
            turn = np.array(pose[3:]) / np.linalg.norm(pose[3:])
            self._hands |= dict(handle.sent([*pose[:3], *turn.tolist()]))

    def _apply_dials(self) -> None:
        """Build the controllers anew once, however often dials have been turned since."""
        if not self._changed:
            return
        self._changed = False
        scenario = with_dials(self.scenario, self._values)
        try:
            for controller in self.controllers:
                controller.change(scenario)
        except CoopqpError as error:
            self.note = str(error)
        self.recording.end("ends where a dial was turned; reset begins another")

    def _outlines(self, controller: SimulatedController, gizmos: Sequence[Array | None]) -> Array:
        """The tasks' markers, and lines from the object to what can be dragged."""
        pairs = zip(self._handles, gizmos, strict=True)
        movable = [(h.point, X[:3]) for h, X in pairs if X is not None and h.gizmo.moves]
        ways = [np.stack([controller.state.point(point), goal])[None] for point, goal in movable]
        return np.concatenate([picture.outlines(controller, self._place), *ways])

    def _verdict(
        self, controller: SimulatedController, drawn: messages.ControllerFrame
    ) -> tuple[messages.Tone, str]:
        if drawn.broken:
            return "broken", _sentence(drawn.broken, drawn.errors)
        if stale := controller.state.inputs.stale:
            dragged = {field.name for field in self._steered}
            how = "drag it or turn it" if dragged & set(stale) else "move its sliders"
            return "waiting", _sentence(f"nothing arrives at {', '.join(stale)}; {how}")
        if drawn.reached and controller.at_targets:
            return "reached", _sentence("at the goal", drawn.errors)
        if controller.follows:
            return "moving", _sentence("on the way round", drawn.errors)
        if self.explanation.blocked:
            way = "looking for a way round" if self._planned_for else ""
            way = self.way_round.sentence if self.way_round else way
            return "blocked", _sentence(self.explanation.sentence, way)
        if not self.has_explainer:
            return "waiting", _sentence("not at the goal", drawn.errors, ENDED)
        if not self.playing:
            return "waiting", _sentence("paused", drawn.errors)
        return "moving", _sentence("on its way", drawn.errors)


def _sentence(*parts: str) -> str:
    text = "; ".join(filter(None, parts))
    return f"{text[:1].upper()}{text[1:]}."
