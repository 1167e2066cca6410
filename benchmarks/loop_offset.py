"""What the observer of the loop-closure offset does where servos sag and grips yield, as tables.

python benchmarks/loop_offset.py [seeds]        all that is asked; one minute a seed, and two more
python benchmarks/loop_offset.py traps          what the observer does not know, one seed
python benchmarks/loop_offset.py others         three arms, hinges, admittance, reference "measured"
python benchmarks/loop_offset.py friction       fingers that hold by friction alone, in MuJoCo

Two Pandas lift a box by 15 cm in 1.5 s and hold it to 13 s. Their links are 1 mm, grasps 1 mm and
encoders 5 mrad off; the box's weight is not in the servos' feed-forward. Cells: half of the
difference of the hands' forces in the mean of the last half second / at worst [N] / how far the
offset has gone [mm] / how far a grip has crept or slipped [mm], the worst of all seeds.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np
import pinocchio as pin

import coopqp
from coopqp.base.spec import Array, Pose
from coopqp.controller import ControlProblem, Law
from coopqp.controllers import QPController
from coopqp.model.loop_observer import LoopObserver, Observer
from coopqp.model.state import State
from coopqp.plant import Disturbance, Plant, PlantModel, Slip
from coopqp.plants import Mujoco, QuasiStatic
from coopqp.plants import mujoco as mujoco_plant
from coopqp.plants._dynamic import Servo, ServoLaw
from coopqp.scenario.scenario import Scenario

ERRORS = Disturbance(link_length=1e-3, grasp_offset=1e-3, encoder_offset=5e-3)
SECONDS, HALF_A_SECOND = 13.0, 0.5
UP, TURNED = Pose(position=(0.6, 0.0, 0.6)), Pose(position=(0.6, 0.0, 0.6), rpy_deg=(0, 0, 40))
Stiffness = float | Mapping[str, float]
Started = tuple[Law, PlantModel, State]
#: What is asked. Known servos: at the end [N], and on the way so many times the better of earlier
#: and none. Unknown ones: at the end more than no observer [N]. Held by friction, with known
#: servos: at 13 s [N] and slip [m], and what the loop offset moves by until 60 s [m].
MOST, TIMES, MORE, BY_FRICTION, SLIPS, DRIFTS = 1.0, 1.2, 1.0, 0.5, 5e-3, 1e-4


class Earlier(LoopObserver):
    """The law before the servos' sag was known of, whose loop offset never stays."""

    def _unload(self, state: State, along: Array | None, *, rests: bool) -> float:
        self._sag  # noqa: B018 - as made for the other law
        return 0.0

    def _look_back(self, left: Array, *, rests: bool) -> None:
        pass


@dataclass(frozen=True)
class Case:
    """A lift: what the plant is, and what the observer is told of it (its stiffness if None)."""

    name: str
    plant: QuasiStatic
    mass: float
    goal: Pose = UP
    off: Disturbance = ERRORS
    told: Stiffness | None = None
    most: float = MOST


@cache
def pandas() -> Scenario:
    scenario = replace(coopqp.load("two_pandas"), secondary=())
    scenario.chain  # noqa: B018 - built once
    return scenario


def springs(stiffness: Stiffness, grip: float = 1e6, **others: Any) -> QuasiStatic:
    return QuasiStatic(**{"object_compensated": 0.0, **others}, stiffness=stiffness, grip=grip)


def weak_wrists(seed: int | None = None) -> dict[str, float]:
    """2000 N m/rad, 300 in the wrists; with a seed each off by up to 30 %."""
    rng = np.random.default_rng(seed)
    off = (lambda: float(rng.uniform(0.7, 1.3))) if seed is not None else (lambda: 1.0)
    names = pandas().chain.joint_names
    return {name: off() * (300.0 if name[-1] in "567" else 2000.0) for name in names}


def cases(seed: int) -> list[Case]:
    turn = replace(ERRORS, grasp_offset=2e-3)
    slips = replace(ERRORS, slip=Slip(at=5.0, by=5e-3))
    return [
        Case("weld, 3000, 4.8", springs(3000.0), 4.8),
        Case("weld, 30000, 1.2", springs(3e4), 1.2),
        Case("weld, turn 40 deg, grasp 2 mm", springs(3000.0), 1.2, TURNED, turn),
        Case(
            "the same, arms' feed-forward 5 % off",
            springs(3000.0, arms_compensated=0.95), 1.2, TURNED, turn,
        ),
        Case("weld, grasp jumps 5 mm at 5 s", springs(3000.0), 1.2, UP, slips),
        Case("grip 2e4, 3000, 1.2", springs(3000.0, 2e4), 1.2),
        Case("grip 2e3, 3000, 1.2", springs(3000.0, 2e3), 1.2),
        Case("grip 2e3, 300, 4.8", springs(300.0, 2e3), 4.8, most=2.5),
        Case("grip 2e4, creeps, 2000, 4.8", springs(2000.0, 2e4, creep=2e4), 4.8),
        Case("grip 2e4, slips above 30 N, 2000, 4.8", springs(2000.0, 2e4, slip_force=30.0), 4.8),
        Case(
            "grip 2e4, creeps, 1.2, weak wrists, K +-30 %",
            springs(weak_wrists(seed), 2e4, creep=2e4), 1.2,
        ),
    ]  # fmt: skip


def traps() -> list[Case]:
    """What the observer is not told, on a firm and on a creeping grip."""
    firm, soft = springs(3000.0), springs(2000.0, 2e4, creep=2e4)
    heavier = replace(ERRORS, object_mass=2.0)
    found = []
    for name, plant in (("weld", firm), ("creeps", soft)):
        for trap, changed, off in (
            ("object twice as heavy", {}, heavier),
            ("centre of mass 5 cm off", {}, replace(ERRORS, object_com=(0.05, 0.0, 0.0))),
            ("weight in the feed-forward", {"object_compensated": 1.0}, ERRORS),
            ("integral part, 1 s", {"integral_time": 1.0}, ERRORS),
            ("joint friction 2 N m", {"joint_friction": 2.0}, ERRORS),
        ):
            found.append(Case(f"{name}, {trap}", replace(plant, **changed), 2.4, off=off))
        half = 0.5 * float(plant.stiffness)  # type: ignore[arg-type]
        found.append(Case(f"{name}, K believed x0.5", plant, 2.4, told=half))
    off = springs(weak_wrists(0), 2e4, creep=2e4)
    return [*found, Case("creeps, weak wrists, K off by 30 %", off, 2.4, told=weak_wrists())]


def laws(case: Case) -> dict[str, Observer]:
    told = case.told or case.plant.stiffness
    assert told is not None
    double = {k: 2.0 * v for k, v in told.items()} if isinstance(told, Mapping) else 2.0 * told
    return {
        "no observer": Observer(enabled=False),
        "earlier": Observer(most=0.03),
        "nothing known": Observer(),
        "known": Observer(stiffness=told),
        "known, K believed x2": Observer(stiffness=double),
    }


def built(scenario: Scenario, name: str, plant: PlantModel | None = None) -> Started:
    problem = scenario.problem()
    chosen = next((x for x in scenario.controllers.values() if isinstance(x, QPController)), None)
    law = (chosen or QPController()).build(problem)
    if name == "earlier":
        law.observer = Earlier(problem.chain, problem.dt, problem.observer)
    plant = plant or scenario.plant.build(problem, scenario.seed, scenario.disturbance)
    return law, plant, law.start(q_measured=plant.measured)


def lift(scenario: Scenario, started: Started) -> Array:
    """By tick the force [N], the offset's way, slip [m] and whether it is not optimal, (T, 4)."""
    law, plant, state = started
    begun, found = state.loop_offset.copy(), np.full((scenario.ticks, 4), np.nan)
    for k in range(scenario.ticks):
        command = law.tick(state)
        plant.step(state, command)
        if plant.lost:
            return np.full_like(found, np.nan)
        first, last = plant.signals["hand_wrench"].reshape(2, 6)[:, :3]
        found[k, :2] = (
            0.5 * np.linalg.norm(first - last),
            np.linalg.norm((state.loop_offset - begun)[:3]),
        )
        odd = command.status is not coopqp.Status.OPTIMAL
        found[k, 2:] = plant.signals["slip"].max(), odd
    return found


def summary(ways: list[Array], dt: float) -> dict[str, float]:
    """The worst of some lifts."""
    last = -round(HALF_A_SECOND / dt)
    return {
        "end": max(float(way[last:, 0].mean()) for way in ways),
        "worst": max(float(way[:, 0].max()) for way in ways),
        "loop_offset": max(1e3 * float(way[-1, 1]) for way in ways),
        "slip": max(1e3 * float(way[:, 2].max()) for way in ways),
        "odd": max(float(way[:, 3].mean()) for way in ways),
    }


def scenario_of(plant: Plant, mass: float, goal: Pose, off: Disturbance) -> Scenario:
    (task,) = pandas().tasks
    moved = replace(task, goal=goal, profile=replace(task.profile, duration=1.5))
    held = replace(pandas().held, mass=mass)
    base = replace(pandas(), tasks=(moved,), held=held, plant=plant)
    return replace(base, disturbance=off, duration=SECONDS)


def cell(worst: Mapping[str, float]) -> str:
    text = f"{worst['end']:.2f}/{worst['worst']:.1f}/{worst['loop_offset']:.1f}"
    text += f"/{worst['slip']:.1f}" if worst["slip"] > 0.05 else ""
    return text + (f" ({100 * worst['odd']:.0f} % not optimal)" if worst["odd"] else "")


def met(case: Case, found: Mapping[str, Mapping[str, float]]) -> str:
    none, earlier, unknown, known = (found[name] for name in list(found)[:4])
    allowed = {
        f"end {known['end']:.2f} of {case.most:.1f}": known["end"] <= case.most,
        f"way {known['worst'] / min(none['worst'], earlier['worst']):.2f} of {TIMES}": (
            known["worst"] <= TIMES * min(none["worst"], earlier["worst"])
        ),
        f"unknown {unknown['end'] - none['end']:+.2f} of {MORE:+.1f}": (
            unknown["end"] <= none["end"] + MORE
        ),
    }
    return verdict(allowed)


def verdict(allowed: Mapping[str, bool]) -> str:
    return ", ".join(text + ("" if holds else " NOT MET") for text, holds in allowed.items())


def table(of: Any, seeds: range, *, asked: bool = False) -> None:
    names = [*laws(of(0)[0]), *(["asked"] if asked else [])]
    print(f"| case (K N m/rad, kg) | {' | '.join(names)} |\n|{'---|' * (1 + len(names))}")
    for i, case in enumerate(of(0)):
        found = {}
        for name in laws(case):
            ways = []
            for seed in seeds:
                own = of(seed)[i]
                scenario = scenario_of(own.plant, own.mass, own.goal, own.off)
                scenario = replace(scenario, seed=seed, observer=laws(own)[name])
                ways.append(lift(scenario, built(scenario, name)))
            found[name] = summary(ways, scenario.dt)
        row = [cell(worst) for worst in found.values()] + ([met(case, found)] if asked else [])
        print(f"| {case.name} | {' | '.join(row)} |", flush=True)


def others() -> None:
    """Three arms, hinges, a squeeze by admittance; largest internal force across the squeeze."""
    slight, slighter = (replace(ERRORS, encoder_offset=x) for x in (2e-3, 3e-3))
    ur, pads = coopqp.load("three_ur"), coopqp.load("position_pair")
    nao = coopqp.load("passive_grasp_pose")
    slow = tuple(replace(task, gain=5.0) for task in nao.tasks)
    nao = replace(nao, dt=0.01, kappa=100.0, tasks=slow, held=replace(nao.held, mass=0.6))
    pads = replace(pads, held=replace(pads.held, mass=4.0))
    for name, scenario, stiffness, grip, off in (
        ("three UR arms", ur, 5000.0, 1e6, slight),
        ("NAO, hinges", nao, 60.0, 1e6, slighter),
        ("two UR5, admittance 60 N", pads, 8000.0, 2e4, replace(ERRORS, delay=1)),
    ):
        plant = springs(stiffness, grip)
        told = replace(scenario, plant=plant, disturbance=off, duration=8.0)
        for law, observer in laws(Case(name, plant, 0.0)).items():
            print(
                f"{name}, {law}: {across(replace(told, observer=observer), law):.2f} N", flush=True
            )
    for case in (cases(0)[0], cases(0)[6], cases(0)[8]):
        print(f'{case.name}, reference="measured": {followed(case):.1f} N', flush=True)


def across(scenario: Scenario, name: str) -> float:
    """In the mean of the last half second [N]."""
    law, plant, state = built(scenario, name)
    state.hand_wrench, found = plant.hand_wrench, []
    for _ in range(scenario.ticks):
        plant.step(state, law.tick(state))
        force = plant.signals["internal_wrench"].reshape(-1, 6)[:, :3]
        if law.force_control:
            force = force - np.outer(
                force @ law.force_control.along[:3], law.force_control.along[:3]
            )
        found.append(float(np.linalg.norm(force, axis=1).max()))
    return float(np.mean(found[-round(HALF_A_SECOND / scenario.dt) :]))


def followed(case: Case) -> float:
    """After 5 s of commands from measured joints [N]."""
    scenario = scenario_of(case.plant, case.mass, case.goal, case.off)
    law, plant, _ = built(scenario, "")
    state = law.start(plant.measured)
    for _ in range(500):
        plant.step(state, law.tick(state))
        state.q[:], state.q_measured = plant.measured, None
    first, last = plant.signals["hand_wrench"].reshape(2, 6)[:, :3]
    return 0.5 * float(np.linalg.norm(first - last))


#: Handles of the box between fingers: half sizes [m], along the hands' line, grip and height.
HANDLE, FINGER = (0.02, 0.01, 0.02), (0.012, 0.004, 0.012)
#: Each finger's force [N] and slide [m]; friction of rubber.
PINCH, SLIDE, FRICTION = 60.0, 0.02, 0.8


class Fingers(mujoco_plant.MujocoModel):
    """Two sprung fingers a hand on a handle of the object, by MuJoCo's contacts as they are."""

    def __init__(self, problem: ControlProblem, seed: int, off: Disturbance) -> None:
        super().__init__(problem, Mujoco(), seed, off)
        chain = problem.chain
        bare = chain.carrying(replace(chain.held, mass=1e-9))
        self.servo = ServoLaw(bare, Servo())
        self.stiffness = dict(zip(chain.joint_names, self.servo.stiffness.tolist(), strict=True))
        self.signals["tau"], self.signals["slip"] = self.servo.tau, np.zeros(2)
        assert self.measured is not None
        self.servo.hold(self.measured)

    def _open(self) -> None:
        written = mujoco_plant.mjcf
        mujoco_plant.mjcf = self._with_fingers  # type: ignore[assignment]
        try:
            super()._open()
        finally:
            mujoco_plant.mjcf = written
        geoms = (self._model.geom(i) for i in range(self._model.ngeom))
        self._pads = {geom.id: int(geom.name[-2]) for geom in geoms if "finger" in geom.name}

    def _with_fingers(self, chain: Any, *others: Any) -> str:
        text = re.sub(r"<equality>.*</equality>", "", mjcf(chain, *others), flags=re.S)
        text, pairs = text.replace(' contact="disable"', ""), ""
        for i, (hand, frame) in enumerate(zip(self.hand_signals.hands, chain.frames, strict=True)):
            p = hand.X_OC.translation
            X = chain.model.frames[frame].placement * pin.SE3(np.eye(3), p)
            fingers = "".join(finger(X, i, side) for side in (-1, 1))
            text = text.replace(
                f'<site name="end[{hand.arm}]"', f'{fingers}<site name="end[{hand.arm}]"'
            )
            handle = box(f"handle[{i}]", HANDLE, pin.SE3(np.eye(3), p))
            text = text.replace('<freejoint name="object"/>', f'<freejoint name="object"/>{handle}')
            pairs += "".join(
                f'<pair geom1="finger{side}[{i}]" geom2="handle[{i}]" condim="4" '
                f'friction="{FRICTION} {FRICTION} 0.005 1e-4 1e-4"/>'
                for side in (-1, 1)
            )
        return text.replace("<contact>", f"<contact>{pairs}")

    def energy(self) -> tuple[float, float]:
        """Also how far the handles are from where the hands have taken them."""
        found = super().energy()
        for i, site in enumerate(self._ends):
            way = self._data.site_xpos[site] - self._data.xpos[self._object]
            self.signals["slip"][i] = np.linalg.norm(way)
        return found


mjcf = mujoco_plant.mjcf


def box(name: str, half: tuple[float, ...], X: pin.SE3) -> str:
    size, place = " ".join(map(str, half)), " ".join(map(str, X.translation))
    x, y, z, w = pin.Quaternion(X.rotation).coeffs()
    return (
        f'<geom name="{name}" type="box" size="{size}" pos="{place}" quat="{w} {x} {y} {z}" '
        'contype="0" conaffinity="0" mass="0.001"/>'
    )


def finger(X: pin.SE3, hand: int, side: int) -> str:
    """A body that a spring presses on the handle along the object's y."""
    at = X * pin.SE3(np.eye(3), np.array([0.0, side * (HANDLE[1] + FINGER[1]), 0.0]))
    place = " ".join(map(str, at.translation))
    x, y, z, w = pin.Quaternion(at.rotation).coeffs()
    return (
        f'<body pos="{place}" quat="{w} {x} {y} {z}" gravcomp="1"><joint type="slide" '
        f'axis="0 {-side} 0" stiffness="{PINCH / SLIDE}" springref="{SLIDE}" damping="20"/>'
        '<inertial pos="0 0 0" mass="0.05" diaginertia="1e-4 1e-4 1e-4"/>'
        f"{box(f'finger{side}[{hand}]', FINGER, pin.SE3.Identity())}</body>"
    )


def friction() -> None:
    """Cells as above, at 13 s and at 60 s."""
    print("| law | at 13 s | at 60 s | asked |\n|---|---|---|---|")
    scenario = replace(scenario_of(Mujoco(), 4.8, UP, ERRORS), duration=60.0)
    told = Fingers(scenario.problem(), 0, ERRORS).stiffness
    early = round(SECONDS / scenario.dt)
    none: list[dict[str, float]] = []
    for name, observer in {
        "no observer": Observer(enabled=False),
        "earlier": Observer(most=0.03),
        "nothing known": Observer(),
        "known": Observer(stiffness=told),
    }.items():
        held = replace(scenario, observer=observer)
        way = lift(held, built(held, name, Fingers(held.problem(), 0, ERRORS)))
        found = [summary([part], held.dt) for part in (way[:early], way)]
        none = none or found
        soon, late = found
        drift = abs(late["loop_offset"] - soon["loop_offset"])
        asked = {}
        if name == "nothing known":
            asked = {
                f"{one['end'] - other['end']:+.2f} of {MORE:+.1f} N": one["end"]
                <= other["end"] + MORE
                for one, other in zip(found, none, strict=True)
            }
        elif name == "known":
            asked = {
                f"{soon['end']:.2f} of {BY_FRICTION} N": soon["end"] <= BY_FRICTION,
                f"slip {soon['slip']:.1f} of {1e3 * SLIPS:.1f} mm": soon["slip"] <= 1e3 * SLIPS,
                f"drift {drift:.2f} of {1e3 * DRIFTS} mm": drift <= 1e3 * DRIFTS,
            }
        print(f"| {name} | {cell(soon)} | {cell(late)} | {verdict(asked)} |", flush=True)


if __name__ == "__main__":
    what = sys.argv[1] if len(sys.argv) > 1 else "1"
    if what == "friction":
        friction()
    elif what == "others":
        others()
    elif what == "traps":
        table(lambda seed: traps(), range(1))
    else:
        table(cases, range(int(what)), asked=True)
        friction()
