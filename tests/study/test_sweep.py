"""Studies: what is varied, what comes of it, and that nothing of it is lost."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from command_line import typed
from plate_study import HERE, STUDY, table_of, written

from coopqp.assessment import assess
from coopqp.base.errors import CoopqpError, ScenarioError
from coopqp.cli.studies import _LivePage
from coopqp.execution.controller_run import run
from coopqp.scenario.loader import load, shipped
from coopqp.study.engine import Engine, Share
from coopqp.study.sweep import kept_study, read_study, scenario_of_row, sweep

pq = pytest.importorskip("pyarrow.parquet")
perhaps = _LivePage.update


def refused(folder: Path, *changes: tuple[str, str]) -> list[str]:
    """Faults of the study with some of its text replaced."""
    text = STUDY
    for before, after in changes:
        assert before in text
        text = text.replace(before, after)
    with pytest.raises(ScenarioError) as caught:
        read_study(written(folder, text))
    return [str(fault).removeprefix(f"{folder}/") for fault in caught.value.faults]


# What is asked


def test_points_are_scipys_in_the_units_of_the_study(plate: Path) -> None:
    from scipy.stats import qmc  # which takes long to import, in the process that needs it

    study = read_study(plate / "study.yaml")
    rng = np.random.default_rng([1, 0x5A3B])
    u = qmc.Sobol(4, seed=rng).random(8)
    for k in range(8):
        goal, mass = study.variant(k).values
        np.testing.assert_allclose(goal, [0.30 + 0.1 * u[k, 0], -0.05 + 0.15 * u[k, 1], 0.0])
        assert mass == pytest.approx(0.1 * 20.0 ** u[k, 3])


def test_shipped_studies_go_by_name_as_scenarios_do() -> None:
    names = shipped("studies")
    assert "reach_of_nao" in names
    for name, path in names.items():
        assert read_study(Path(name)).file.text == path.read_text(encoding="utf-8")
        assert name in typed("list", "studies").stdout
        assert typed("validate", name).stdout == f"{name}: ok\n"
    with pytest.raises(ScenarioError, match="unknown shipped study 'reach_of_nap'; did you mean"):
        read_study(Path("reach_of_nap"))


def test_seeds_are_spawned_from_one(plate: Path) -> None:
    study = read_study(plate / "study.yaml")
    children = np.random.SeedSequence(1).spawn(8)
    assert [study.variant(k).seed for k in range(8)] == [
        int(child.generate_state(1)[0]) for child in children
    ]


@pytest.mark.parametrize("method", ["random", "latin_hypercube", "sobol"])
def test_samples_stay_inside_and_follow_the_seed(plate: Path, method: str) -> None:
    text = STUDY.replace("sobol: 8", f"{method}: 16")
    one, same = (read_study(written(plate, text)) for _ in range(2))
    other = read_study(written(plate, text.replace("seed: 1", "seed: 2")))
    masses = [[s.variant(k).values[1] for k in range(16)] for s in (one, same, other)]
    assert masses[0] == masses[1] != masses[2]
    assert all(0.1 <= mass <= 2.0 for mass in masses[0])


def test_a_grid_is_every_level_with_every_other(plate: Path) -> None:
    text = STUDY.replace("{log: [0.1, 2.0]}", "{values: [0.5, 1.5]}").replace("sobol: 8", "grid: 3")
    study = read_study(written(plate, text))
    assert study.points.count == 3 * 3 * 1 * 2
    values = [study.variant(k).values for k in range(18)]
    assert len({json.dumps(v) for v in values}) == 18
    assert {goal[0] for goal, _ in values} == {0.3, 0.35, 0.4}  # not 0.35000000000000003


def test_a_grid_has_no_intervals_unless_something_is_drawn(plate: Path) -> None:
    def exact(text: str) -> bool:
        return read_study(written(plate, text)).exact

    grid = STUDY.replace("sobol: 8", "grid: 2")
    assert exact(grid)
    assert not exact(STUDY)
    assert not exact(grid.replace("object.mass", "disturbance.object_mass"))


def test_levels_of_whole_numbers_are_whole(plate: Path) -> None:
    text = STUDY.replace("object.mass: {log: [0.1, 2.0]}", "seed: {range: [1, 7, 4]}")
    study = read_study(written(plate, text.replace("sobol: 8", "grid: 1")
                               .replace("box: [[0.30, -0.05, 0.0], [0.40, 0.10, 0.0]]",
                                        "values: [[0.3, 0.0, 0.0]]")))  # fmt: skip
    assert [study.variant(k).values[1] for k in range(4)] == [1, 3, 5, 7]


def test_normal_has_its_mean_and_deviation(plate: Path) -> None:
    text = STUDY.replace("log: [0.1, 2.0]", "normal: [1.0, 0.1]").replace("sobol: 8", "sobol: 1024")
    study = read_study(written(plate, text))
    masses = [study.variant(k).values[1] for k in range(1024)]
    assert np.mean(masses) == pytest.approx(1.0, abs=1e-3)
    assert np.std(masses) == pytest.approx(0.1, abs=1e-3)


def test_any_key_by_its_path(plate: Path) -> None:
    paths = {
        "tasks.slide.goal[1]": ("tasks", 0, "point_on_point", "goal", 1),
        "tasks.point_on_point.gain": ("tasks", 0, "point_on_point", "gain"),
        "tasks[0].point_on_point.weight": ("tasks", 0, "point_on_point", "weight"),
        "secondary.joint_centering.gain": ("secondary", 0, "joint_centering", "gain"),
        "limits.joint_position.margin": ("limits", 0, "joint_position", "margin"),
        "robot.planar_pair.distance": ("robot", "planar_pair", "distance"),
        "start_deg.right[0]": ("start_deg", "right", 0),
        "budget.loop_position": ("budget", "loop_position"),
    }
    for path, location in paths.items():
        text = f"scenario: plate.yaml\nvary:\n  {path}: {{values: [0.2]}}\nsamples: grid\n"
        (varied,) = read_study(written(plate, text)).varied
        assert varied.location == location


SHIPPED = sorted((Path(__file__).parents[2] / "studies").glob("*.yaml"))


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.stem)
def test_shipped_studies_can_be_read(path: Path) -> None:
    study = read_study(path)
    assert not study.notes
    assert study.rows <= 1000  # a minute


# What is wrong with it


@pytest.mark.parametrize(
    ("before", "after", "line", "words"),
    [
        ("tasks.slide.goal", "tasks.slid.goal", 3, "unknown task 'slid'; did you mean 'slide'?"),
        ("slide.goal", "slide.gaol", 3, "unknown key 'gaol'; did you mean 'goal'"),
        ("0.10, 0.0]]", "0.10, 0.0], [2, 3]]", 3, "found 2 levels; needs 3, or one for all"),
        ("{sobol: 8, seed: 1}", "", 6, "found null; needs a way to sample, such as sobol: 1024"),
        ("sobol: 8", "sobol: true", 6, "found true; needs a whole number"),
        ("plate.yaml", "study.yaml", 1, "'study.yaml' is a study; needs a scenario"),
        (
            "object.mass",
            "tasks[0].gain",
            4,
            "'tasks[0]' is a point_on_point; write tasks[0].point_on_point.gain",
        ),
        ("object.mass", "object.size.0", 4, "'object.size' is a list of values; needs a place"),
        ("object.mass", "''", 4, "'' is not a path; needs one such as tasks.reach.goal"),
        ("log: [0.1, 2.0]", "choice: [1.0, true]", 4, "found true; needs a number"),
        ("log: [0.1, 2.0]", "choice: [1.0, 2020-01-01]", 4, 'found "2020-01-01"; needs a number'),
        ("log: [0.1, 2.0]", "values: [1.0,\n  -1.0]", 5, "found -1"),
        (
            "object.mass: {log: [0.1, 2.0]}",
            "tasks.slide.profile: {choice: [{kind: quintic}, \n   {kind: stp}]}",
            5,
            'kind: found "stp"; needs',
        ),
        (
            "choice: [qp, pseudoinverse]",
            "choice: [{qp: {damping: 1}},\n    {qp: {damping: 2}}]",
            6,
            "the name 'qp' is taken; give this one another, such as {qp: {name: other}}",
        ),
        ("choice: [qp,", "choice: [\n   qp,\n   pq,", 7, "unknown controller 'pq'"),
        ("object.mass", "object.mas", 4, "unknown key 'mas'; did you mean 'mass'?"),
        ("object.mass", "objekt.mass", 4, "unknown key 'objekt'; did you mean 'object'"),
        ("log: [0.1", "log: [0.0", 4, "a logarithm needs numbers above 0"),
        ("log: [0.1, 2.0]", "log: [2.0, 0.1]", 4, "is empty: 2 to 0.1; give the least first"),
        ("log: [0.1, 2.0]", "lgo: [1, 2]", 4, "unknown variation 'lgo'; did you mean 'log'?"),
        ("log: [0.1, 2.0]", "values: [a]", 4, 'values[0]: found "a"; needs a number or a list'),
        ("log: [0.1, 2.0]", "values: []", 4, "is empty; needs a list of at least one value"),
        ("log: [0.1, 2.0]", "values: [1, 1]", 4, "has 1 twice; leave one out"),
        ("log: [0.1, 2.0]", "choice: [heavy, light]", 4, 'found "heavy"; needs a number'),
        (
            "log: [0.1, 2.0]",
            "range: [0, 1], log: [1, 2]",
            4,
            "found 2 keys; needs exactly one of box",
        ),
        ("log: [0.1, 2.0]", "normal: [1, 0]", 4, "a deviation of 0; needs more than 0"),
        ("object.mass: {log: [0.1, 2.0]}", "tasks.slide: {choice: [a]}", 4, "is the same as"),
        ("choice: [qp,", "choice: [pq,", 5, "unknown controller 'pq'; did you mean 'qp'"),
        ("sobol: 8", "sobl: 8", 6, "unknown way to sample 'sobl'; did you mean 'sobol'?"),
        ("sobol: 8", "sobol: 0", 6, "found 0; needs a whole number of 1 to"),
        ("sobol: 8", "sobol: 8, random: 8", 6, "found 2; needs exactly one of grid"),
        ("sobol: 8, seed: 1", "grid: null", 3, "has no levels for a grid; give it levels"),
        ("[loop_error_max]", "[loop_eror_max]", 7, "unknown metric 'loop_eror_max'; did you mean"),
        ("metrics:", "metric:", 7, "unknown key 'metric'; did you mean 'metrics'?"),
    ],
)
def test_faults_are_told_with_their_line(
    plate: Path, before: str, after: str, line: int, words: str
) -> None:
    (fault, *_) = refused(plate, (before, after))
    assert fault.startswith(f"study.yaml:{line}: ")
    assert words in fault


def test_all_faults_at_once_and_exit_code_2(plate: Path) -> None:
    changes = (("sobol: 8", "sobl: 8"), ("metrics:", "metric:"), ("log: [0.1", "log: [-1"))
    text = STUDY
    for before, after in changes:
        text = text.replace(before, after)
    result = typed("sweep", written(plate, text), "--out", plate / "out")
    assert result.exit_code == 2
    assert result.stderr.count("error: ") == 3
    assert not (plate / "out").exists()


def test_a_scenario_that_cannot_be_read_is_the_studys_fault(plate: Path) -> None:
    (fault,) = refused(plate, ("plate.yaml", "plates.yaml"))
    assert fault.startswith("study.yaml:1: scenario: plates.yaml: cannot be read")
    (plate / "plate.yaml").write_text("robot: planar_pair\ndt: x\n", encoding="utf-8")
    goal = "tasks.slide.goal: {box: [[0.30, -0.05, 0.0], [0.40, 0.10, 0.0]]}"
    assert goal in STUDY
    with pytest.raises(ScenarioError, match=r"plate\.yaml:2: dt: found"):
        read_study(written(plate, STUDY.replace(goal, "kappa: {range: [0, 1]}")))


# What comes of it


def test_rows_are_what_the_scenario_gives_by_itself(plate: Path) -> None:
    study = read_study(plate / "study.yaml")
    sweep(study, plate / "out", engine=HERE)
    rows = table_of(plate / "out")
    assert [row["row"] for row in rows] == list(range(16))
    text, controller = scenario_of_row(kept_study(plate / "out"), 5)
    (plate / "row.yaml").write_text(text, encoding="utf-8")
    scenario = load(plate / "row.yaml")
    assert (controller, list(scenario.controllers)) == ("pseudoinverse", ["pseudoinverse"])
    trace = run(scenario, controller=controller)
    row = rows[5]
    assert row["task_error.slide"] == float(assess(trace).errors[0])
    assert row["loop_error_max.position"] == float(trace.loop_position.max())
    assert row["object.mass"] == scenario.held.mass
    assert row["variant_seed"] == scenario.seed
    assert row["success"] is row["reached"]


def test_a_variant_that_is_no_scenario_is_a_row_with_its_reason(plate: Path) -> None:
    text = STUDY.replace("object.mass: {log: [0.1, 2.0]}", "dt: {values: [0.01, 0.02]}")
    sweep(read_study(written(plate, text)), plate / "out", engine=HERE)
    rows = table_of(plate / "out")
    wrong = [row for row in rows if row["dt"] == 0.02]
    assert len(wrong) == 8
    for row in wrong:
        assert row["state"] == "invalid"
        assert "kappa: found 100.0; needs at most 1/dt" in str(row["reason"])
        assert row["success"] is None
    assert all(row["state"] == "done" for row in rows if row["dt"] == 0.01)


def test_shares_make_the_same_file_as_one_command(plate: Path) -> None:
    study = read_study(plate / "study.yaml")
    sweep(study, plate / "whole", engine=HERE)
    for number in (3, 1, 2):
        sweep(study, plate / "shared", engine=Engine(jobs=1, share=Share(number, 3)))
    assert table_of(plate / "whole") == table_of(plate / "shared")
    assert pq.read_schema(plate / "whole" / "results.parquet").equals(
        pq.read_schema(plate / "shared" / "results.parquet"), check_metadata=True
    )


@pytest.mark.parametrize(
    ("change", "word"),
    [
        (lambda folder: written(folder, STUDY.replace("seed: 1", "seed: 2")), "the study file"),
        (
            lambda folder: (folder / "plate.yaml").write_text(
                (folder / "plate.yaml").read_text(encoding="utf-8").replace("mass: 0.5", "mass: 1")
            ),
            "the scenario",
        ),
    ],
)
def test_a_folder_of_another_study_is_refused(plate: Path, change: object, word: str) -> None:
    sweep(read_study(plate / "study.yaml"), plate / "out", engine=HERE)
    before = (plate / "out" / "results.parquet").read_bytes()
    assert callable(change)
    change(plate)
    with pytest.raises(CoopqpError, match=f"belongs to another study.*: {word}"):
        sweep(read_study(plate / "study.yaml"), plate / "out", engine=HERE)
    assert (plate / "out" / "results.parquet").read_bytes() == before


def test_results_of_another_version_are_refused(
    plate: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    study = read_study(plate / "study.yaml")
    sweep(study, plate / "out", engine=HERE)
    monkeypatch.setattr("coopqp.__version__", "99.0")
    with pytest.raises(CoopqpError, match="coopqp itself differs"):
        sweep(study, plate / "out", engine=HERE)


def test_the_command_runs_shows_and_tells(plate: Path) -> None:
    out = plate / "out"
    result = typed("sweep", plate / "study.yaml", "--out", out, "--jobs", "1")
    assert result.exit_code == 0
    assert "pseudoinverse" in result.output
    assert "slide " in result.output
    instead = typed("explain", out)
    assert instead.exit_code == 2
    assert "holds a study; 'coopqp sweep" in instead.stderr
    page = (out / "report.html").read_text(encoding="utf-8")
    assert page.count("<svg") == 2  # the legend's, one a law; nothing a row
    told = json.loads(typed("sweep", out, "--table", "--json").stdout)
    assert {line["controller"] for line in told["lines"]} == {"qp", "pseudoinverse"}
    assert told["rows"] == 16
    shown = typed("sweep", out, "--show", "3")
    assert shown.exit_code == 0
    assert (out / "rows" / "3" / "report.html").exists()
    assert typed("sweep", out, "--show", "16").exit_code == 2
    assert typed("sweep", plate / "study.yaml").exit_code == 2
    assert typed("sweep", plate / "nothing", "--table").exit_code == 2


def test_the_page_is_drawn_while_it_runs(plate: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("coopqp.cli.studies._LivePage.EVERY", 0.0)
    seen = []

    def drawn(self: object) -> None:
        perhaps(self)
        seen.append("still to come" in (plate / "out" / "report.html").read_text(encoding="utf-8"))

    monkeypatch.setattr("coopqp.cli.studies._LivePage.update", drawn)
    result = typed("sweep", plate / "study.yaml", "--out", plate / "out", "--jobs", "1", "--watch")
    assert result.exit_code == 0
    assert seen[0]
    assert "still to come" not in (plate / "out" / "report.html").read_text(encoding="utf-8")


def test_a_folder_whose_points_cannot_be_drawn_again_is_refused(
    plate: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    sweep(read_study(plate / "study.yaml"), plate / "out", engine=HERE)
    monkeypatch.setattr("coopqp.study.sweep.space.MIXED", 1)
    result = typed("sweep", plate / "out", "--table")
    assert result.exit_code == 2
    assert "by another scipy or numpy" in result.stderr
