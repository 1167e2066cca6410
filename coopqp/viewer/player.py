"""A scenario that is played: its laws side by side, and what people do to them.

No clock and no process: whoever plays it calls :meth:`Player.do` with what was asked,
:meth:`Player.tick` when it is time and :meth:`Player.frame` to have something to look at.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from coopqp.assessment.thresholds import rests
from coopqp.base.errors import CoopqpError
from coopqp.base.spec import Array
from coopqp.execution.controller_run import check_plant, controller_of
from coopqp.report.scene.markers import Place
from coopqp.report.style import chosen_styles
from coopqp.scenario.scenario import Scenario
from coopqp.signal import Kind
from coopqp.viewer import picture
from coopqp.viewer.dials import dials_of, turned
from coopqp.viewer.live import Handle, handles, with_inputs
from coopqp.viewer.messages import (
    Asked,
    Dial,
    Frame,
    LawFrame,
    LawLook,
    Look,
    Placed,
    Show,
    Told,
    Tone,
)
from coopqp.viewer.recording import Recording
from coopqp.viewer.simulated_controller import SimulatedController

#: Nearer than this an input is where it goes to.
ARRIVED = 1e-6
SLOWEST, FASTEST = 0.05, 4.0
#: What the slider of a force goes up to where its input has no bounds [N, N m].
MOST_FORCE = 100.0
ENDED = "explanations have ended with their process; begin coopqp play anew to have them"
UNTOLD = Told(False, "", (), "")


class Player:
    """A scenario that is played, by all of its controllers if none is named.

    Raises:
        CoopqpError: a controller that was named cannot be built, or none can.

    Attributes:
        scenario: with inputs for all that can be dragged.
        lanes: one a law. refused: laws that are left out, and why.
        told: what the explainer has said last. explains: whether there is one.
        recording: since the last reset. note: what there is to say beside.
    """

    def __init__(
        self, scenario: Scenario, names: Sequence[str] = (), folder: Path | None = None
    ) -> None:
        self._read, self._folder = scenario, folder
        self.scenario, self._lives = with_inputs(scenario)
        self._handles = handles(self.scenario, self._lives)
        self._dials = {dial.key: dial for dial in dials_of(self.scenario)}
        self._values: dict[str, float] = {}
        self._hands: dict[str, list[float]] = {}
        self.playing, self.speed, self.note = False, 1.0, ""
        self._main, self._turned = 0, False
        self.told, self.explains = UNTOLD, True
        self.refused: dict[str, str] = {}
        self._names = self._playable(tuple(names))
        self._bodies, self.faults = picture.surfaces(self.scenario)
        self._place = Place(self.scenario)
        self.reset()
        self._knobs = tuple(self._own_knobs())

    def reset(self) -> None:
        """Begin anew; dials stay as they are turned."""
        scenario = turned(self.scenario, self._values)
        self._hands.clear()
        self._hands |= {live.name: list(live.start) for live in self._lives if live.start}
        self.lanes = [SimulatedController(scenario, name, self._hands) for name in self._names]
        self.recording = Recording(self._read, self._lives, self._names, self._values)
        self.told, self._turned = UNTOLD, False
        self.note = ""
        self.tick()

    def tick(self) -> None:
        """Let all laws do a tick."""
        self._apply_dials()
        try:
            for lane in self.lanes:
                lane.tick()
        except CoopqpError as error:  # the next phase cannot begin from here
            self.playing, self.note = False, str(error)
            self.recording.end("has ended with the run")
            return
        first = self.lanes[0]
        kinds = {name: channel.kind for name, channel in first.feed.inputs.channels.items()}
        t = first.state.t
        self.recording.add(first.run.index, first.run.since, t, first.feed.arrived, kinds)

    def do(self, asked: Asked) -> None:
        """What somebody has asked for on the page; what makes no sense is left alone."""
        value = asked.value
        if not np.isfinite(np.array(value, float)).all():
            return
        if asked.what in ("play", "pause"):
            self.playing = asked.what == "play"
        elif asked.what == "step":
            self.playing = False
            self.tick()
        elif asked.what == "reset":
            self.reset()
        elif asked.what == "speed" and value:
            self.speed = float(np.clip(value[0], SLOWEST, FASTEST))
        elif asked.what == "main":
            self._main, self.told = int(asked.which) % len(self.lanes), UNTOLD
        elif asked.what == "save":
            self.save()
        else:
            self._reach_for(asked)

    def unexplained(self) -> None:
        """There is no explainer any more; nothing that it has said is said again."""
        self.explains, self.told = False, UNTOLD

    def save(self) -> Path | None:
        """Write what is recorded; where nothing can be written the note says so."""
        if self._folder is None:
            return None
        try:
            path = self.recording.save(self._folder)
        except CoopqpError as error:
            self.note = str(error)
            return None
        self.note = f"wrote {path}"
        return path

    def show(self) -> Show:
        """What does not change."""
        low, high = picture.space(self.scenario, self._bodies)
        laws = {lane.name: lane.keeps_limits for lane in self.lanes}
        looks = chosen_styles(laws)
        return Show(
            title=self.scenario.name,
            description=self.scenario.description,
            laws=tuple(LawLook(name, looks[name].color, keeps) for name, keeps in laws.items()),
            bodies=self._bodies,
            joints=self.scenario.chain.joint_names,
            size=self.scenario.held.size,
            low=low,
            high=high,
            gizmos=tuple(handle.look for handle in self._handles),
            dials=tuple(self._dials.values()),
            knobs=self._knobs,
            phases=tuple(phase.name for phase in self.scenario.schedule),
            forces=picture.FORCES in self.lanes[0].plant.signals,
            folder="" if self._folder is None else str(self._folder),
        )

    def frame(self, factor: float = 0.0, tick_us: float = 0.0) -> Frame:
        """Everything as it is now; how fast time goes on, and the longest tick of late [us]."""
        self._apply_dials()
        lane = self.lanes[self._main]
        laws = tuple(picture.drawn(each, self._bodies) for each in self.lanes)
        tone, sentence = self._verdict(lane, laws[self._main])
        gizmos = self._gizmo_poses(lane)
        recorded = f"the recording {self.recording.note}" if self.recording.note else ""
        return Frame(
            t=lane.t,
            phase=lane.run.index,
            playing=self.playing,
            speed=self.speed,
            factor=factor,
            laws=laws,
            main=self._main,
            gizmos=gizmos,
            outlines=self._outlines(lane, gizmos),
            tone=tone,
            sentence=sentence,
            active=self.told.active,
            detail=self.told.detail,
            explained=self.explains,
            recorded=self.recording.seconds,
            note="; ".join(filter(None, (recorded, self.note))),
            tick_us=tick_us,
        )

    def placed(self) -> Placed:
        """The law that is explained, as the explainer has to build it."""
        lane = self.lanes[self._main]
        return Placed(lane.name, dict(self._values), tuple(lane.starts))

    def look(self) -> Look:
        """The instant that is to be explained."""
        lane = self.lanes[self._main]
        state = lane.state
        return Look(  # which is sent to another process, and so copied
            t=state.t,
            q=state.q,
            v=state.v,
            memory=state.memory.numbers,
            gap=state.gap,
            corrected=state.corrected,
            measured=state.q_measured,
            hand_wrench=state.hand_wrench,
            inputs={name: (of.kind, of.value, of.rate) for name, of in state.inputs.items()},
            targets=lane.targets(),
            rests=rests(state.v) and _arrived(lane),
        )

    def _playable(self, asked: Sequence[str]) -> tuple[str, ...]:
        """The laws that can be built; those that were asked for have to be."""
        found = []
        for name in asked or self.scenario.controllers:
            try:
                check_plant(self.scenario, controller_of(self.scenario, name), name)
                SimulatedController(self.scenario, name, {})
            except CoopqpError as error:
                if asked:
                    raise
                self.refused[name] = str(error)
            else:
                found.append(name)
        if not found:
            raise CoopqpError("; ".join(f"{name}: {why}" for name, why in self.refused.items()))
        return tuple(dict.fromkeys(found))

    def _own_knobs(self) -> list[Dial]:
        """Inputs of the scenario's own that no gizmo steers."""
        held = {live.name for live in self._lives}
        lane, found = SimulatedController(self.scenario, self._names[0], {}), []
        for name, channel in lane.feed.inputs.channels.items():
            for i, column in enumerate(channel.kind.columns if name not in held else ()):
                key, now = f"{name}/{i}", float(channel.value[i])
                low, high = self._travel(name, channel.kind, i)
                low, high = min(low, now), max(high, now)
                found.append(Dial(key, name, column, low, high, (high - low) / 200.0, now))
        return found

    def _travel(self, name: str, kind: Kind, i: int) -> tuple[float, float]:
        """Between what a slider of an input goes: its bounds, within those of joints."""
        settings, chain = self.scenario.inputs[name], self.lanes[0].run.problem.chain
        most = settings.velocity if kind.velocity else np.pi if kind.each else MOST_FORCE
        low, high = -most, most
        if kind.each:
            joint = chain.joint_names.index(kind.columns[i])
            if np.isfinite(chain.upper[joint] - chain.lower[joint]):
                low, high = float(chain.lower[joint]), float(chain.upper[joint])
        if i < kind.numbers and settings.lower:
            low = max(low, settings.lower[i])
        if i < kind.numbers and settings.upper:
            high = min(high, settings.upper[i])
        return low, high

    def _reach_for(self, asked: Asked) -> None:
        """A gizmo, the object, a dial or a knob."""
        lane, which, value = self.lanes[self._main], asked.which, asked.value
        targets = lane.targets()
        if asked.what == "drag" and isinstance(which, int) and which < len(self._handles):
            self._send(self._handles[which], value)
        elif asked.what == "carry" and len(value) == 3:
            placed = (h for h in self._handles if h.look.phase == lane.run.index and h.look.moves)
            for handle in list(placed)[:1]:
                self._send(handle, handle.carried(value, targets, lane.state).tolist())
        elif asked.what == "dial" and which in self._dials and value:
            dial = self._dials[str(which)]
            self._values[dial.key] = float(np.clip(value[0], dial.low, dial.high))
            self._turned = True
        elif asked.what == "knob" and value:
            name, _, column = str(which).rpartition("/")
            if name in targets and any(knob.key == which for knob in self._knobs):
                numbers = self._hands.setdefault(name, targets[name].tolist())
                numbers[int(column)] = value[0]

    def _send(self, handle: Handle, pose: Sequence[float]) -> None:
        if len(pose) == 7 and 0.5 < np.linalg.norm(pose[3:]) < 2.0:
            turn = np.array(pose[3:]) / np.linalg.norm(pose[3:])
            self._hands |= dict(handle.sent([*pose[:3], *turn.tolist()]))

    def _apply_dials(self) -> None:
        """Build the laws anew once, however often dials have been turned since."""
        if not self._turned:
            return
        self._turned = False
        scenario = turned(self.scenario, self._values)
        try:
            for lane in self.lanes:
                lane.turn(scenario)
        except CoopqpError as error:
            self.note = str(error)
        self.recording.end("ends where a dial was turned; reset begins another")

    def _gizmo_poses(self, lane: SimulatedController) -> tuple[Array | None, ...]:
        targets = lane.targets()
        return tuple(
            handle.pose(targets, lane.state) if handle.look.phase == lane.run.index else None
            for handle in self._handles
        )

    def _outlines(self, lane: SimulatedController, gizmos: Sequence[Array | None]) -> Array:
        """What tasks ask for, and the ways from the object to what can be dragged."""
        ways = [
            np.stack([lane.state.point(handle.point), pose[:3]])[None]
            for handle, pose in zip(self._handles, gizmos, strict=True)
            if pose is not None and handle.look.moves
        ]
        return np.concatenate([picture.outlines(lane, self._place), *ways])

    def _verdict(self, lane: SimulatedController, drawn: LawFrame) -> tuple[Tone, str]:
        """What is to be said of the law that is explained."""
        stale = lane.state.inputs.stale
        if drawn.broken:
            return "broken", _sentence(drawn.broken, drawn.words)
        if stale:
            dragged = {live.name for live in self._lives}
            how = "drag it or turn it" if dragged & set(stale) else "move its sliders"
            return "waiting", _sentence(f"nothing arrives at {', '.join(stale)}; {how}")
        if drawn.reached and _arrived(lane):
            return "reached", _sentence("at the goal", drawn.words)
        if self.told.blocked:
            return "blocked", _sentence(self.told.sentence)
        if not self.explains:
            return "waiting", _sentence("not at the goal", drawn.words, ENDED)
        if not self.playing:
            return "waiting", _sentence("paused", drawn.words)
        return "moving", _sentence("on its way", drawn.words)


def _arrived(lane: SimulatedController) -> bool:
    """Whether all that is followed is where it goes to."""
    channels = lane.feed.inputs.channels.values()
    return all(np.abs(c.value - c.target).max(initial=0.0) < ARRIVED for c in channels)


def _sentence(*parts: str) -> str:
    text = "; ".join(filter(None, parts))
    return f"{text[:1].upper()}{text[1:]}."
