"""Ways round: shelves with two arms, and goals of arms below six joints.

    python benchmarks/planning.py shelves --data shelves.json --scene CLONE [--seeds 100]
    python benchmarks/planning.py goals [--goals 300] [--runs]
    python benchmarks/planning.py blocked [--blocked 50]

The shelves are those of Cohn et al. (ICRA 2024): two iiwa14 hold an object between bottom, middle
and top, six ordered pairs and 20 random ones. CLONE is a checkout of
cohnt/constrained-bimanual-planning-example, whose meshes are read; shelves.json has its numbers.
Grippers count. A plan is timed from the call to a shortened path that was looked at a second time
at 0.01 rad; the paths are written to --out, one file for each of the first ten seeds. ``linked`` is
by how much ``tests/linking.py``'s number of the goal differs from the start's, which no motion
changes as the arms' line never passes through itself; why, is told last for each two pieces of it.

Goals are the places of a point of the object at closed configurations inside the limits and free,
with a ball in the way in half of those of robots that watch bodies: how many ``reach`` finds, in
how many of them a hand would have to turn once round against another to get to any configuration
that it finds, which closed loops never let it, how many of NAO's are cut off by what
``tests/attitudes.py`` writes down of its arms, how many ``plan`` finds a way to and, with --runs,
how many a run that follows it reaches, and how many the QP alone does.

Blocked are rollouts of ``tests.stress`` that end so: to how many goals ``plan`` finds a way, from
the start or, where that is outside the limits on purpose, from where the run is stuck; and how
many a run that follows it reaches.
"""

from __future__ import annotations

import argparse
import itertools
import json
import re
import sys
import time
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import coopqp
from coopqp.assessment import assess
from coopqp.base.errors import CoopqpError
from coopqp.base.spec import Array
from coopqp.controller import ControlProblem
from coopqp.controllers import QPController
from coopqp.limits import JointAcceleration, Obstacles, SelfCollision
from coopqp.limits.obstacles import Obstacle
from coopqp.model.profile import Profile
from coopqp.planning.closed_space import Budget, ClosedSpace
from coopqp.planning.plan import Plan, Planner
from coopqp.report.planning import write_plan
from coopqp.scenario.loader import load
from coopqp.scenario.planned import PlanReference, Way, following, way_tasks
from coopqp.scenario.scenario import Scenario
from coopqp.study.explanation.goal import PositionLimits
from coopqp.tasks import PointOnPoint
from coopqp.viewer.explainer import inside

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
ROBOTS = ("point_on_point", "two_so101", "baxter_tray", "two_pandas", "three_ur")
#: Kept between bodies, so that nothing touches between the points that are looked at [m].
KEPT = 1e-3
#: How long a run stays where its plan ends [s].
SETTLED = 0.5
DH_ALPHA, DH_D = np.deg2rad([-90, 90, 90, -90, -90, 90, 0]), (0.36, 0, 0.42, 0, 0.4, 0, 0.081)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", choices=("shelves", "goals", "blocked"))
    parser.add_argument("--data", type=Path, help="shelves.json")
    parser.add_argument("--scene", type=Path, help="the checkout with the meshes")
    parser.add_argument("--seeds", type=int, default=100)
    parser.add_argument("--random-seeds", type=int, default=10)
    parser.add_argument("--goals", type=int, default=300)
    parser.add_argument("--blocked", type=int, default=50)
    parser.add_argument("--robots", nargs="*", default=ROBOTS)
    parser.add_argument(
        "--runs", action="store_true", help="run what was planned, and the QP alone"
    )
    parser.add_argument("--out", type=Path, default=Path("out/planning"))
    asked = parser.parse_args()
    if asked.what == "shelves" and not (asked.data and asked.scene):
        parser.error("shelves needs --data shelves.json and --scene CLONE, which has its meshes")
    asked.out.mkdir(parents=True, exist_ok=True)
    if asked.what == "shelves":
        shelves(asked)
    elif asked.what == "blocked":
        blocked(asked)
    else:
        for name in asked.robots:
            goals(name, asked)


def shelves(asked: argparse.Namespace) -> None:
    from linking import Line

    data = json.loads(asked.data.read_text())
    named = {name: np.array(c["q"]) for name, c in data["configurations"].items()}
    scene = load_scene(data, asked.scene, asked.out, named["bottom"], named["top"])
    line = Line(scene.chain)
    pairs = [
        (f"{a}->{b}", named[a], named[b], asked.seeds) for a, b in itertools.permutations(named, 2)
    ]
    pairs += [
        (f"public[{i}]", np.array(p["start"]), np.array(p["goal"]), asked.random_seeds)
        for i, p in enumerate(data["pairs"]["public"])
    ]
    rows: dict[str, list[dict[str, float]]] = {}
    for name, start, goal, seeds in pairs:
        for seed in range(seeds):
            begun, cpu = time.perf_counter(), time.process_time()
            problem = scene.problem(chain=scene.chain.moved(start))
            ready = time.perf_counter() - begun
            found = Planner(problem, scene.duration).path(Budget(seed=seed), goals=goal)
            wall, spent = time.perf_counter() - begun, time.process_time() - cpu
            rows.setdefault(name, []).append(_measured(found, wall - ready, spent))
            if found.success and seed < 10:
                np.savez(asked.out / f"{name.replace('->', '_')}_{seed}.npz", q=found.q)
        linked = round(line.number(goal) - line.number(start))
        print(_line(name, rows.get(name, [])), f"linked {linked:+d}", flush=True)
    groups = {
        "named": [row for name in rows if "->" in name for row in rows[name]],
        "random": [row for name in rows if "->" not in name for row in rows[name]],
    }
    for name, group in groups.items():
        print(_line(name, group))
    _told(ClosedSpace(scene.problem()))


def _told(space: ClosedSpace) -> None:
    """Why no two pieces of the closed line ever cross, and by how much."""
    for held in space.line.held() if space.line else ():
        unit = "rad" if held.why == "bend" else "m"
        print(f"{' | '.join(held.pieces):80s} {held.why:7s} {held.margin:.4f} {unit}")


def _measured(found: Plan, wall: float, cpu: float) -> dict[str, float]:
    seen = found.verification
    return {
        "found": float(found.success), "proven": float(found.proven), "wall": wall,
        "cpu": cpu, "length": found.length,
        "search": found.seconds.get("search", 0.0), "verify": found.seconds.get("verify", 0.0),
        "open": seen.open if seen else np.nan,
    }  # fmt: skip


def _line(name: str, rows: list[dict[str, float]]) -> str:
    if not rows:
        return f"{name}: none"
    good = [row for row in rows if row["found"]]

    def of(key: str, share: float = 50.0, among: list[dict[str, float]] = rows) -> float:
        return float(np.percentile([row[key] for row in among], share))

    return (
        f"{name:16s} solved {len(good)}/{len(rows)}, proven impossible "
        f"{sum(row['proven'] for row in rows):.0f}  "
        f"wall {of('wall'):.3f} / {of('wall', 95):.3f} s  "
        f"CPU {of('cpu'):.3f} / {of('cpu', 95):.3f} s  search {of('search'):.3f} s  "
        f"verify {of('verify'):.3f} s  "
        + (
            f"length {of('length', 50, good):.2f} rad  open {1e3 * of('open', 100, good):.4f} mm"
            if good
            else ""
        )
    )


def load_scene(data: Any, clone: Path, out: Path, start: Array, goal: Array) -> Scenario:
    """The shelves as a scenario, with the pairs of bodies that the referee looks at."""
    (out / "iiwa14_gripper.urdf").write_text(_urdf(data, clone))
    link = out / "bimanual"
    if not link.exists():
        link.symlink_to(clone.resolve())
    rel = data["closure"]["right_link7_in_left_link7"]
    R, p = np.array(rel["rotation"]), np.array(rel["position_m"])
    right = {"position": (R.T @ (np.array([0, 0, 0.3]) - p)).tolist(), "rpy": _rpy(R.T)}
    arm = {
        "urdf": {
            "path": "iiwa14_gripper.urdf",
            "package_dirs": ["."],
            "arms": {"arm": "iiwa_link_7"},
        }
    }
    place, turn = _object(goal)
    obstacles, own = _pairs(data)
    things = data["obstacles"]
    shapes = {n: {"box": o["box_m"], "position": o["position_m"]} for n, o in things.items()}
    watched = [
        {
            "obstacles": {
                "name": "shelves",
                "distance": KEPT,
                "bodies": sorted(obstacles),
                "shapes": shapes,
            }
        },
        {"self_collision": {"distance": KEPT, "pairs": own}},
    ]
    at = data["bases"]["right"]["position_m"]
    robots = {"left": {"robot": arm}, "right": {"robot": arm, "position": at}}
    profile = {"kind": "quintic", "duration": 4.0}
    acceleration = {"joint_acceleration": {"max": 8.5}}
    scenario = {
        "robot": {"several": {"robots": robots}},
        "object": {"size": [0.04, 0.04, 0.04], "mass": 0.5},
        "grasps": {
            "left/arm": {"rigid": {"object_in_hand": {"position": [0, 0, 0.3]}}},
            "right/arm": {"rigid": {"object_in_hand": right}},
        },
        "start": {"left/arm": start[:7].tolist(), "right/arm": start[7:].tolist()},
        "tasks": [{"pose": {"goal": {"position": place, "rpy": turn}, "profile": profile}}],
        "limits": ["joint_position", "joint_velocity", acceleration, *watched],
        "controllers": ["qp"], "dt": 0.01, "duration": 8.0,
    }  # fmt: skip
    path = out / "shelves.yaml"
    path.write_text(json.dumps(scenario, indent=1))
    return load(path)


def _pairs(data: Any) -> tuple[set[str], list[list[str]]]:
    """Bodies that meet the shelves, and pairs that meet each other, in our names."""
    bodies, own = set(), []
    for pair in data["collision"]["pairs_with_grippers"]:
        a, b = (_named(name) for name in pair)
        if "/" not in a or "/" not in b:
            bodies.add(b if "/" not in a else a)
        else:
            own.append([a, b])
    return bodies, own


def _named(name: str) -> str:
    side, slash, link = name.partition("/")
    if not slash:
        return name
    link = (
        link.replace("link_", "iiwa_link_")
        if link.startswith("link_")
        else link.removeprefix("wsg_")
    )
    return f"{side}/{'wsg_body' if link == 'body' else link}"


def _urdf(data: Any, clone: Path) -> str:
    text = (clone / "models/iiwa14_convex_decimated_collision.urdf").read_text()
    for pattern in (
        r"<visual.*?</visual>", r"<(drake:collision_filter_group|transmission|gazebo).*?</\1>",
        r"<frame [^>]*/>|<drake:[^>]*/>|<!--.*?-->|\s+drake:acceleration=\"[^\"]*\"",
    ):  # fmt: skip
        text = re.sub(pattern, "", text, flags=re.S)
    parts = []
    for name, g in data["gripper"]["in_link7"].items():
        mesh = f'<mesh filename="package://bimanual/{data["hulls"]["finger"]["file"]}"/>'
        shape = f'<box size="{_text(g["box_m"])}"/>' if "box_m" in g else mesh
        parts.append(
            f'<link name="{name}"><collision><geometry>{shape}</geometry></collision></link>'
            f'<joint name="{name}_joint" type="fixed"><parent link="iiwa_link_7"/>'
            f'<child link="{name}"/>'
            f'<origin xyz="{_text(g["position_m"])}" rpy="{_text(_rpy(g["rotation"]))}"/></joint>'
        )
    return text.replace("</robot>", "".join(parts) + "</robot>")


def _text(values: Any) -> str:
    return " ".join(f"{x:.12g}" for x in values)


def _rpy(rotation: Any) -> list[float]:
    R = np.array(rotation)
    return [
        float(np.arctan2(R[2, 1], R[2, 2])),
        float(np.arcsin(-R[2, 0])),
        float(np.arctan2(R[1, 0], R[0, 0])),
    ]


def _object(q: Array) -> tuple[list[float], list[float]]:
    T = np.eye(4)
    for angle, alpha, d in zip(q[:7], DH_ALPHA, DH_D, strict=True):
        c, s, a, b = np.cos(angle), np.sin(angle), np.cos(alpha), np.sin(alpha)
        T = T @ np.array([[c, -s * a, s * b, 0], [s, c * a, -c * b, 0], [0, b, a, d], [0, 0, 0, 1]])
    return (T[:3, 3] + 0.3 * T[:3, 2]).tolist(), _rpy(T[:3, :3])


# Below six joints.


def goals(name: str, asked: argparse.Namespace) -> None:
    """Goals of one robot: those of a point of the object, drawn from closed configurations."""
    from attitudes import is_cut_off

    rng, count = np.random.default_rng(20261123), Counter[str]()
    seconds, looks, beyond = list[float](), list[float](), 0.0
    written = list[dict[str, Any]]()
    for i, (scenario, q) in enumerate(drawn(name, asked.goals, rng)):
        problem = scenario.problem()
        begun = time.process_time()
        found = coopqp.reach(scenario, seed=i)
        looks.append(time.process_time() - begun)
        count["reachable"] += bool(found.solutions)
        count["cut off"] += bool(found.solutions) and all(one.cut_off for one in found.solutions)
        count["by surfaces"] += is_cut_off(problem.chain, np.array(scenario.tasks[0].goal))
        begun = time.process_time()
        way = Planner(problem, scenario.duration).plan(Budget(seed=i))
        seconds.append(time.process_time() - begun)
        count["planned"] += way.success
        written.append(_goal(scenario, q) | {"planned": way.success, "length": way.length})
        if not way.success:
            print(f"{name} {i}: {way.sentence[:100]}", flush=True)
        if not asked.runs:
            continue
        count["alone"] += _run(scenario)[0]
        if way.success:
            path, *_ = write_plan(way, replace(scenario, source=""), asked.out)
            reached, most = _run(following(scenario, PlanReference(plan=path)))
            beyond = max(beyond, most)
            count["followed"] += reached
            if not reached:
                print(f"{name} {i}: planned, but the run does not reach", flush=True)
    chain = load(name).chain
    about = {"scenario": name, "joints": chain.joint_names, "start": chain.q_start.tolist()}
    (asked.out / f"{name}.json").write_text(json.dumps({**about, "goals": written}, indent=1))
    keys = ("reachable", "planned", "followed", "alone", "cut off", "by surfaces")
    told = ", ".join(f"{key} {count[key]}" for key in keys)
    half, p95 = np.percentile(seconds, [50, 95])
    print(
        f"{name}: {asked.goals} goals: {told}; plan {half:.3f} / {p95:.3f} CPU s, reach "
        f"{np.median(looks):.3f} CPU s, limits exceeded by at most {beyond:.1g}",
        flush=True,
    )


def _goal(scenario: Scenario, q: Array) -> dict[str, Any]:
    """A goal for those who run theirs on it: metres, rad, the world's axes."""
    walls = [limit for limit in scenario.limits if isinstance(limit, Obstacles)]
    balls = [one.shapes["ball"] for one in walls if one.name == "ball"]
    return {
        "goal_of_object_origin": scenario.tasks[0].goal,
        "closed_configuration_there": q.tolist(),
        "ball": {"radius": balls[0].sphere, "center": balls[0].position} if balls else None,
    }


def _run(scenario: Scenario) -> tuple[bool, float]:
    """Whether the QP reaches the goal, and by how much it exceeds a limit at most."""
    trace = coopqp.compare(scenario, controllers=["qp"]).traces["qp"]
    found = assess(trace)
    least = min((float(margin.min()) for margin in trace.margins.values()), default=0.0)
    return bool(found.reached and found.succeeds), max(-least, 0.0)


def drawn(name: str, goals: int, rng: np.random.Generator) -> Any:
    """Scenarios of a robot, each with a closed, free configuration that meets its goal."""
    base = load(name)
    kinds = tuple(type(limit) for limit in base.limits)
    limits = (
        base.limits if JointAcceleration in kinds else (*base.limits, JointAcceleration(max=20.0))
    )
    plain = replace(base, limits=limits, phases=())
    made = 0
    while made < goals:
        blocked = bool(made % 2) and SelfCollision in kinds
        scenario = _built(_with_ball(plain, rng) if blocked else plain, base)
        space = ClosedSpace(scenario.problem())
        if not space.is_free(space.chain.q_start[None])[0]:
            continue
        q = space.sample(rng, 64)
        q = q[space.project(q)]
        q = q[space.is_free(q)] if len(q) else q
        if not len(q):
            continue
        X = space.chain.object_pose(q[0])
        task = PointOnPoint(
            name="reach", goal=X.translation.tolist(), gain=5.0,
            profile=Profile(kind="quintic", duration=2.0),
        )  # fmt: skip
        made += 1
        yield _built(replace(scenario, tasks=(task,), duration=4.0), base), q[0]


def _built(scenario: Scenario, base: Scenario) -> Scenario:
    """The scenario with the robot and the chain of another, which are not built again."""
    vars(scenario).update(robot_model=base.robot_model, chain=base.chain)
    return scenario


def _with_ball(scenario: Scenario, rng: np.random.Generator) -> Scenario:
    """The scenario with a ball somewhere within the arms' reach of the object."""
    at = scenario.chain.start_position + rng.normal(scale=0.3 * scenario.chain.reach, size=3)
    ball = Obstacle(sphere=0.06 * scenario.chain.reach, position=at.tolist())
    return replace(
        scenario, limits=(*scenario.limits, Obstacles(name="ball", shapes={"ball": ball}))
    )


# Blocked runs.


def blocked(asked: argparse.Namespace) -> None:
    from stress.draw import draw

    count, seconds = Counter[str](), list[float]()
    for seed in itertools.count():
        if count.total() == asked.blocked:
            break
        problem = draw(seed).problem
        outcome, q = _ends(problem)
        if outcome != "blocked":
            continue
        if any(task.asks_velocity for task in problem.tasks):
            count["a task asks for a velocity, which is met at no place"] += 1
            continue
        begun = time.process_time()
        kind, way, problem = _way_of(problem, q, seed)
        seconds.append(time.process_time() - begun)
        if way is None or not way.success:
            count[kind] += 1
            continue
        along = Way(way.t, way.timed, way.object, np.zeros((0, 0)))
        tasks = way_tasks(along, problem.dt, stands=False)
        followed = replace(problem, tasks=tasks, secondary=())
        law = QPController().unprepared(followed)
        state = law.start()
        law.run(state, len(way.t) + round(SETTLED / problem.dt))
        ends, _ = _ends(replace(problem, chain=problem.chain.moved(state.q)))
        count[f"found {kind}, and the run that follows it ends: {ends}"] += 1
        if ends != "reached":
            print(f"seed {seed}: found {kind}, {ends}", flush=True)
    for words, number in count.most_common():
        print(f"{number:4d} {words}")
    half, p95 = np.percentile(seconds, [50, 95])
    print(f"of seeds 0 to {seed - 1}; plan {half:.3f} / {p95:.3f} CPU s", flush=True)


def _way_of(
    problem: ControlProblem, q: Array, seed: int
) -> tuple[str, Plan | None, ControlProblem]:
    """A way from the start, or from where the run is stuck if it began outside its limits.

    What came of it, in words; and the problem that begins where the way does.
    """
    chain, end = problem.chain, max(task.end for task in problem.tasks)
    bounds, kind = PositionLimits(problem), "from the start"
    if (np.maximum(bounds.lower - chain.q_start, chain.q_start - bounds.upper) > 0.0).any():
        kind = "from where it is stuck, as it began outside its limits"
        chain = chain.moved(inside(problem, q, seed))
        problem = replace(problem, chain=chain)
    try:
        way = Planner(problem, end).plan(Budget(seed=seed))
    except CoopqpError as error:
        return f"no plan: {str(error).partition(':')[0]}", None, problem
    if not way.success:
        kind = re.sub(r"-?[0-9][0-9.e-]*", "#", way.sentence)
        kind = re.split(r"[:;]", re.sub(r"\bt#\S*", "t", kind))
        return ": ".join(kind[:2])[:100], way, problem
    return kind, way, problem


def _ends(problem: ControlProblem) -> tuple[str, Array]:
    """How a rollout of the stress ends, and where, shape (n,)."""
    from stress.driving import drive_on, record_of
    from stress.ending import PartErrors, ending

    law = QPController().unprepared(problem)
    state = law.start()
    record, errors = record_of(problem), PartErrors(problem, state)
    drive_on(law, state, record, errors)
    return str(ending(law, state, record, errors).outcome), state.q.copy()


if __name__ == "__main__":
    main()
