"""What every task keeps: rows, finite differences of its error, units, its line in the manual."""

from __future__ import annotations

import dataclasses
import json
import re
from pathlib import Path

import numpy as np
import pytest
from chains import Walk
from example_tasks import AT_ONCE, EXAMPLES, IN_SPACE, PLACED, TIMES, H, at, error, over, rows
from free_body import FreeBody, block_of
from pydantic import TypeAdapter
from ruamel.yaml import YAML

from coopqp.model.closed_chain import ClosedChain
from coopqp.model.state import State
from coopqp.scenario.catalog import Catalog
from coopqp.scenario.form import chosen, one_of
from coopqp.task import Task


@over(EXAMPLES)
def test_task_has_as_many_rows_as_names_and_all_are_finite(
    task: Task, chain: ClosedChain, closed_loop_walk: Walk
) -> None:
    k = len(task.rows(chain))
    assert k == len(set(task.rows(chain))) > 0
    for q in closed_loop_walk(chain, 3):
        for t in TIMES:
            stack = rows(task, at(chain, q, t))
            assert (stack.e.shape, stack.rate.shape, stack.J.shape) == ((k,), (k,), (k, chain.n))
            assert all(np.isfinite(a).all() for a in (stack.e, stack.rate, stack.J))


@over(EXAMPLES)
def test_task_looks_at_the_state_and_leaves_it_alone(
    task: Task, chain: ClosedChain, closed_loop_walk: Walk
) -> None:
    state = at(chain, closed_loop_walk(chain, 1)[0], 0.7)
    arrays = (state.q, state.v, state.p_WO, state.R_WO, state.J_ext, state.loop_error)
    before = [a.copy() for a in arrays]
    rows(task, state)
    for a, b in zip(arrays, before, strict=True):
        np.testing.assert_array_equal(a, b)


@pytest.mark.each_value
@over(PLACED)
@pytest.mark.parametrize("t", TIMES)
def test_error_changes_at_jacobian_times_velocity_less_rate(
    task: Task, t: float, chain: ClosedChain, closed_loop_walk: Walk, rng: np.random.Generator
) -> None:
    """e_dot = J v - rate, once with the joints moving and once with the reference alone."""
    for q in closed_loop_walk(chain, 4):
        stack = rows(task, at(chain, q, t))
        for v in (rng.normal(size=chain.n), np.zeros(chain.n)):
            after = error(task, at(chain, q + H * v, t + H))
            before = error(task, at(chain, q - H * v, t - H))
            e_dot = (after - before) / (2 * H)
            np.testing.assert_allclose(stack.J @ v - stack.rate, e_dot, atol=1e-7)


@over(PLACED)
def test_jacobian_holds_joint_by_joint(
    task: Task, chain: ClosedChain, closed_loop_walk: Walk
) -> None:
    for q in closed_loop_walk(chain, 3):
        J = rows(task, at(chain, q, 0.7)).J
        for joint, unit in enumerate(np.eye(chain.n)):
            far, near = (
                error(task, at(chain, q + d, 0.7)) - error(task, at(chain, q - d, 0.7))
                for d in (20 * H * unit, 10 * H * unit)
            )
            # Of fourth order: the logarithm of half a turn is strongly curved and loses digits.
            np.testing.assert_allclose(J[:, joint], (8 * near - far) / (120 * H), atol=1e-8)


@over({n: k for n, k in IN_SPACE.items() if n not in AT_ONCE})
def test_smooth_reference_sets_out_from_where_the_point_is(task: Task, chain: ClosedChain) -> None:
    np.testing.assert_allclose(error(task, State(chain)), 0, atol=1e-15)


def test_every_task_is_in_the_docs_with_an_example_that_can_be_read() -> None:
    """Its name, keys and example; keys in bold are those that must be given."""
    text = (Path(__file__).parents[2] / "docs" / "tasks.md").read_text(encoding="utf-8")
    lines = re.findall(r"^\| `(\w+)` \|.*\|.*\|(.*)\| `(.*)` \|$", text, re.MULTILINE)
    tasks = Catalog().entries("tasks")
    assert sorted(name for name, _, _ in lines) == sorted(tasks)
    read = TypeAdapter(one_of(Catalog(), "tasks"))
    for name, keys, example in lines:
        found = chosen(read.validate_json(json.dumps(YAML(typ="safe").load(example))))
        assert found[0] == name
        fields = {field.name: field for field in dataclasses.fields(tasks[name].cls)}
        assert set(re.findall(r"\w+", keys)) - {"or"} <= set(fields)
        needed = {n for n, f in fields.items() if f.default is dataclasses.MISSING}
        bold = " ".join(re.findall(r"\*\*(.*?)\*\*", keys))
        assert needed <= set(bold.split())


@over(EXAMPLES)
def test_parts_cover_the_rows_in_their_units(task: Task, chain: ClosedChain) -> None:
    parts = task.parts(chain)
    assert sum(part.rows for part in parts) == len(task.rows(chain))
    assert all(part.rows and part.unit and part.tolerance > 0.0 for part in parts)
    assert len({part.name for part in parts}) == len(parts)


@pytest.mark.parametrize(
    ("name", "dimension"),
    [
        ("point on plane", 1), ("distance", 1), ("point on line", 2), ("line on plane", 2),
        ("point on circle", 2), ("pointing", 2), ("point on point", 3), ("plane on plane", 3),
        ("orientation", 3), ("line on line", 4), ("revolute", 5), ("prismatic", 5), ("pose", 6),
        ("relative motion", 6), ("twist", 3), ("spin", 1),
    ],
)  # fmt: skip
def test_task_has_as_many_rows_as_dimensions_and_they_are_independent(
    name: str, dimension: int, chain: ClosedChain, rng: np.random.Generator
) -> None:
    # Two arms of five joints cannot move their object every way, but move apart every way.
    state = State(chain) if name == "relative motion" else FreeBody(rng).state
    block = block_of(EXAMPLES[name], state, chain)
    assert len(block.e) == np.linalg.matrix_rank(block.J, tol=1e-6) == dimension
