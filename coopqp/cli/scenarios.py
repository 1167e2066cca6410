"""Commands on scenario files: run them, look at them, check them, play them."""

import math
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import click

from coopqp.base.errors import CoopqpError, Fault, ScenarioError
from coopqp.cli import options
from coopqp.cli.options import print_json, read_scenario, say, say_left_out, say_wrote, show

COLLECTIONS = (
    "robots", "grasps", "tasks", "signals", "limits", "controllers", "solvers", "plants", "metrics",
    "scenarios", "studies",
)  # fmt: skip


class _Range(click.FloatRange):
    """NaN is in no range."""

    def convert(self, value: Any, param: Any, ctx: Any) -> Any:
        number = super().convert(value, param, ctx)
        if math.isnan(number):
            self.fail(f"{value} is not in the range {self._describe_range()}.", param, ctx)
        return number


@click.command()
@options.SCENARIO
@click.option("--out", type=options.WRITTEN, help="Folder for the report and the data.")
@click.option("--controllers", default="", help="Comma-separated, instead of the scenario's.")
@options.SOLVER
@options.catalogued
@options.JSON
def compare(scenario: str, controllers: str, solver: str | None, catalog: Any, **to: Any) -> None:
    """Run a scenario under several controllers and report what each of them did.

    SCENARIO is a YAML file or the name of a shipped scenario (coopqp list scenarios).
    """
    loaded = read_scenario(scenario, catalog, solver)
    names = [name.strip() for name in controllers.split(",") if name.strip()]
    compare_on(loaded, names or list(loaded.controllers), **to)


@click.command()
@options.SCENARIO
@click.option("--controller", required=True, help="Which one.")
@click.option("--out", type=options.WRITTEN, help="Folder for the report and the data.")
@options.SOLVER
@options.catalogued
@options.JSON
def run(scenario: str, controller: str, solver: str | None, catalog: Any, **to: Any) -> None:
    """Run one controller on a scenario."""
    compare_on(read_scenario(scenario, catalog, solver), [controller], **to)


@click.command()
@options.SCENARIO
@click.option("--actuated", help="Scheme to ask about: joints, or q1,q2,... by order.")
@click.option("--phase", help="Which phase of the scenario; the first if omitted.")
@click.option("--html", "page", type=options.WRITTEN, help="Write a page to this file.")
@options.catalogued
@options.JSON
def mobility(
    scenario: str, actuated: str | None, phase: str | None, page: Path | None, catalog: Any,
    as_json: bool,
) -> None:  # fmt: skip
    """Tell what a scenario's grasp allows, before anything moves."""
    from coopqp.report import files, mobility

    scheme = [name.strip() for name in actuated.split(",")] if actuated is not None else None
    study = mobility.study(read_scenario(scenario, catalog), scheme, phase=phase)
    if page:
        files.write_one(page, mobility.page(study))
    if as_json:
        print_json(mobility.as_json(study))
    else:
        show(*mobility.tables(study), study.verdict())
        say_wrote(*filter(None, [page]))
    if study.refused:
        raise study.refused


@click.command(name="solve-start")
@options.SCENARIO
@click.option("--seed", type=click.IntRange(0), help="Of the tries, instead of the scenario's.")
@options.catalogued
@options.JSON
def solve_start(scenario: str, seed: int | None, catalog: Any, as_json: bool) -> None:
    """Find joint values, inside the limits, with which every arm reaches its grasp.

    The scenario gives object.pose and every grasp's object_in_hand; its own start does not count.
    Without object.pose the loops are closed near its own start, wherever that puts the object.
    """
    from coopqp.scenario.loader import load_and_solve
    from coopqp.scenario.start_solver import yaml_text

    with options.bar("solving") as progress:
        report = lambda done, total: progress(done / total)  # noqa: E731
        start = load_and_solve(scenario, catalog, seed=seed, progress=report)
    if as_json:
        keys = {key: getattr(start, key) for key in ("start", "margin", "tries")}
        print_json(keys | {"found": start.candidates})
    else:
        click.echo(yaml_text(start), nl=False)


@click.command()
@options.SCENARIO
@click.option("--seed", type=click.IntRange(0), help="Of the starts, instead of the scenario's.")
@options.catalogued
@options.JSON
def reach(scenario: str, seed: int | None, catalog: Any, as_json: bool) -> None:
    """Look for configurations inside all limits that meet a scenario's tasks at their goals.

    SCENARIO is a YAML file or the name of a shipped scenario (coopqp list scenarios). The table has
    a line for each way the arms bend, with the configuration of the largest joint margin, the least
    distance of a joint from its limit [rad, m]; clearance is what limits in space have left.
    """
    from coopqp.planning import reach as look
    from coopqp.report import planning as report

    with options.bar("looking") as progress:
        result = look(read_scenario(scenario, catalog), seed=seed, progress=progress)
    if as_json:
        click.echo(report.reach_json(result))
        return
    say(result.sentence, aside=False)
    if result.solutions:
        show(report.configurations(result))


@click.command()
@options.SCENARIO
@click.option(
    "--out", type=options.WRITTEN, help="Folder for the path, and for a scenario that follows it."
)
@click.option("--keep", multiple=True, metavar="TASK", help="Met all along; more than once.")
@click.option(
    "--seconds", type=_Range(0.01, 3600.0), default=10.0, show_default=True, help="At most."
)
@click.option("--seed", type=click.IntRange(0), help="Of the search, instead of the scenario's.")
@options.catalogued
@options.JSON
def plan(
    scenario: str, out: Path | None, keep: tuple[str, ...], seconds: float, seed: int | None,
    catalog: Any, as_json: bool,
) -> None:  # fmt: skip
    """Find a way to a scenario's goals round what is in the way, with the loops closed all along.

    SCENARIO is a YAML file or the name of a shipped scenario (coopqp list scenarios).
    """
    from coopqp.planning import Budget, plan
    from coopqp.report import files, planning

    loaded = read_scenario(scenario, catalog)
    budget = Budget(seconds=seconds, seed=loaded.seed if seed is None else seed)
    planning.check_written(out, loaded, planning.PATH)
    with files.checked_folder(out), options.bar("planning") as progress:
        result = plan(loaded, keep=keep, budget=budget, progress=progress)
        if not result.success:
            raise CoopqpError(result.sentence)
        written = planning.write_plan(result, loaded, out, keep) if out else ()
    click.echo(planning.plan_json(result)) if as_json else say(result.sentence, aside=False)
    say_wrote(*written, aside=as_json)


@click.command(name="check-robot")
@options.SCENARIO
@click.option(
    "--driver", type=click.Path(exists=True, dir_okay=False, path_type=Path),
    help="Python file with robot(scenario), a driver with read and write; else one is simulated.",
)  # fmt: skip
@click.option("--posed", is_flag=True, help="Its arms are put by hand as at the scenario's start.")
@options.catalogued
def check_robot(scenario: str, driver: Path | None, posed: bool, catalog: Any) -> None:
    """Move each joint of a robot by a degree before it holds anything, and name what is wrong.

    Wrong signs, swapped joints and arms, degrees, dead sensors. The hands must be empty, with room
    of 50 mm all round. With --posed nothing moves before all joints read as they are put, which
    shows what reading and commanding have wrong alike.
    """
    from coopqp.online.joint_check import check_joints, first_reading, pose_faults
    from coopqp.online.loop import OnlineLoop
    from coopqp.online.simulated import SimulatedRobot

    loaded = read_scenario(scenario, catalog)
    own_time: dict[str, Any] = {} if driver else {"clock": None}
    loop = OnlineLoop(loaded, next(iter(loaded.controllers)), **own_time)
    with _blamed(driver):
        robot = _driver(driver, loaded) if driver else SimulatedRobot(loop)
        if posed and (faults := pose_faults(loaded.chain, first_reading(loop, robot))):
            raise CoopqpError("\n".join(f"{joint} {words}" for joint, words in faults.items()))
        found = check_joints(loop, robot)
    if not found.ok:
        raise CoopqpError(str(found))
    say(str(found), aside=False)


@click.command()
@click.argument("dataset", type=options.FOLDER)
@click.option("--scenario", default="two_so101", help="With the robot; two_so101 if omitted.")
@click.option("--column", type=click.Choice(["action", "observation.state"]), default="action")
@click.option("--calibration", nargs=2, type=click.Path(exists=True), metavar="LEFT RIGHT",
              help="LeRobot's files: their ranges bound the joints.")  # fmt: skip
@click.option("--shares", is_flag=True, help="Joints are -100 to 100 of their range, not degrees.")
@click.option("--distance", type=_Range(0.0), default=0.01, help="Between the arms [m].")
@click.option("--loop", type=_Range(0.0, min_open=True), default=1e-3, help="May open by [m].")
@options.catalogued
def audit(
    dataset: Path, scenario: str, column: str, calibration: tuple[str, str] | None, shares: bool,
    distance: float, loop: float, catalog: Any,
) -> None:  # fmt: skip
    """Tell which recorded frames of a LeRobot dataset break limits, distances or the loop.

    DATASET is the folder of two SO-101 with meta/info.json, version 3.0.
    """
    from coopqp.adapters.dataset import audit as look
    from coopqp.adapters.motors import MotorUnits

    own: dict[str, Any] = {"use_degrees": not shares}
    units = MotorUnits.read(*calibration, **own) if calibration else MotorUnits(**own)
    loaded = read_scenario(scenario, catalog)
    kept = {"distance": distance, "loop_position": loop}
    for episode in look(dataset, loaded, units, column=column, **kept):
        click.echo(str(episode))


def _driver(file: Path, scenario: Any) -> Any:
    """What robot(scenario) of a user's file makes."""
    import runpy

    from coopqp.base.wording import USERS
    from coopqp.online.real_time import check_driver

    with _blamed(file, always=True):
        make = runpy.run_path(str(file), run_name=f"{USERS}driver").get("robot")
        if not callable(make):
            raise CoopqpError(f"{file}: has no function robot(scenario)")
        robot = make(scenario)
    check_driver(robot)
    return robot


@contextmanager
def _blamed(file: Path | None, *, always: bool = False) -> Iterator[None]:
    """Say so where a driver raises: its methods do so below our own, its file always."""
    from coopqp.base.wording import by_user, raised

    try:
        yield
    except (KeyboardInterrupt, CoopqpError):
        raise
    except BaseException as error:  # it may raise anything, and exit
        if file is None or not (always or by_user(error)):
            raise
        words = raised(error, str(file)).replace(": raises ", ": your driver raises ", 1)
        raise CoopqpError(words) from None


@click.command()
@click.argument("scenarios", nargs=-1, required=True)
@options.catalogued
def validate(scenarios: tuple[str, ...], catalog: Any) -> None:
    """Check scenarios, and studies, files or shipped; every fault is listed with its line."""
    faults: list[Fault] = []
    for name in scenarios:
        try:
            if _is_study(name):
                from coopqp.study.sweep import read_study

                for note in read_study(Path(name), catalog).notes:
                    say(f"note: {note}")
            else:
                loaded = read_scenario(name, catalog)
                refused = _refused(loaded, list(loaded.controllers), f"{name}: ")
                if len(refused) == len(loaded.controllers) > 0:
                    raise next(iter(refused.values()))
        except ScenarioError as error:
            faults.extend(error.faults)
        except CoopqpError as error:
            faults.append(Fault(name, str(error)))
        else:
            say(f"{name}: ok", aside=False)
    if faults:
        raise ScenarioError(faults)


def _is_study(name: str) -> bool:
    """Whether a file has the keys of a study, and names no robot."""
    from coopqp.scenario.loader import find, shipped
    from coopqp.scenario.yaml import read_yaml

    if name in shipped("studies") and not Path(name).exists():
        return True
    data = read_yaml(find(name)).data
    return "robot" not in data and bool({"vary", "samples"} & set(data))


def _refused(scenario: Any, names: list[str], place: str = "") -> dict[str, CoopqpError]:
    """Why controllers cannot be built: told, unless it is all of them, with notes on the others."""
    from coopqp.execution.controller_run import built, controller_of

    refused: dict[str, CoopqpError] = {}
    for name in names:
        controller_of(scenario, name)
        try:
            built(scenario, name)
        except CoopqpError as error:
            refused[name] = error
    if len(refused) < len(names):
        say_left_out(refused, place)
    options.print_notes(scenario, [name for name in names if name not in refused])
    return refused


@click.command(name="list")
@click.argument("kind", required=False, type=click.Choice(COLLECTIONS))
@options.catalogued
@options.JSON
def list_(kind: str | None, catalog: Any, as_json: bool) -> None:
    """List what scenarios can name, with a line of help each."""
    from coopqp.report.table import help_lines, names_table

    rows = {k: help_lines(k, catalog) for k in ([kind] if kind else COLLECTIONS)}
    if as_json:
        print_json(rows)
    else:
        show(names_table(rows))


@click.command()
@click.option("--study", is_flag=True, help="Of study files instead, which coopqp sweep runs.")
@options.catalogued
def schema(catalog: Any, study: bool) -> None:
    """Print the JSON Schema of scenario files, for editors."""
    from coopqp.scenario.form import file_model
    from coopqp.study.sweep import reader

    data = reader.schema(catalog) if study else file_model(catalog).model_json_schema()
    print_json(data)


def compare_on(scenario: Any, controllers: list[str], out: Path | None, *, as_json: bool) -> None:
    """Run, print the table or JSON, and write the report to a folder, if one is given."""
    from coopqp.execution.comparison import compare as run_all
    from coopqp.report import files, table

    refused = _refused(scenario, controllers)
    if out:
        files.check_folder(out)
    with table.progress_bars(controllers, scenario.ticks) as progress:
        comparison = run_all(scenario, controllers=controllers, progress=progress)
    say_left_out({name: why for name, why in comparison.refused.items() if name not in refused})
    for line in comparison.faults:
        say(f"warning: {line}")
    if as_json:
        click.echo(files.metrics_json(comparison), nl=False)
    else:
        show(table.summary(comparison))
    # Written last: what goes wrong here takes nothing away from what the run has shown.
    written = files.write(comparison, out) if out else []
    if not as_json:
        say_wrote(*written)


@click.command()
@options.SCENARIO
@click.option(
    "--controller", "controllers", multiple=True,
    help="Which; may be given more than once. All of the scenario's if omitted.",
)  # fmt: skip
@click.option("--port", type=int, default=8080, help="Of the page; any that is free if 0.")
@click.option("--host", default="127.0.0.1", help="Address to listen on; this machine's alone.")
@click.option(
    "--allow-origin", "origins", multiple=True, metavar="URL",
    help="A page that may use this one beside itself, as behind a proxy; more than once.",
)  # fmt: skip
@click.option("--speed", type=_Range(0.05, 4.0), default=1.0, help="Times real time, at first.")
@click.option(
    "--record", type=options.WRITTEN,
    help="Folder for a recording, which coopqp compare replays; written at the end too.",
)  # fmt: skip
@options.SOLVER
@options.catalogued
def play(
    scenario: str, controllers: tuple[str, ...], port: int, host: str, origins: tuple[str, ...],
    speed: float, record: Path | None, solver: str | None, catalog: Any,
) -> None:  # fmt: skip
    """Play a scenario on a page in the browser, where its goals can be dragged.

    SCENARIO is a YAML file or the name of a shipped scenario (coopqp list scenarios).
    """
    from coopqp.viewer import gate, play, steering
    from coopqp.viewer.player import Player

    play.check_viewer()
    play.check_address(host, port)
    gate.checked_origins(origins)
    if record:
        steering.check_folder(record)
    loaded = read_scenario(scenario, catalog, solver)
    player = Player(loaded, controllers, record)
    player.speed = speed
    say_left_out(player.refused)
    for line in player.faults:
        say(f"warning: {line}")
    options.print_notes(loaded, [run.name for run in player.controllers], steered=True)
    try:
        opened = lambda page: click.echo(f"{page}  (Ctrl-C ends it)")  # noqa: E731
        play.play(player, host, port, opened, origins=origins)
    except CoopqpError:
        player.save()  # the recording survives the page
        raise
    except KeyboardInterrupt:
        words = f"ended after {player.controllers[0].t:.2f} s"
        if record:
            player.save()
            words += f"; {player.note}"
        click.echo(words)


@click.command(context_settings={"ignore_unknown_options": True})
@options.SCENARIO
@click.argument("ros_args", nargs=-1, type=click.UNPROCESSED, metavar="[--ros-args ...]")
@options.catalogued
def ros(scenario: str, ros_args: tuple[str, ...], catalog: Any) -> None:
    """Run a scenario on a robot as a node of ROS 2 (docs/ros.md).

    Its parameters and topics are ROS's own, after --ros-args.
    """
    from coopqp.ros.node import run_node

    if ros_args and ros_args[0] != "--ros-args":
        raise click.UsageError(f"found {ros_args[0]}; what is for ROS comes after --ros-args")
    click.echo(str(run_node(read_scenario(scenario, catalog), ros_args)))
