"""Which tasks a grasp can meet, and how well it moves along them."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
import scipy.linalg
from chains import closed_states, planar_pair, stretched_pair

from coopqp.base.spec import Array
from coopqp.closed_loop.mobility import LENGTH, Mobility, manipulability, mobility
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.state import State

SCALE = np.array([1.0, 1.0, 1.0, LENGTH, LENGTH, LENGTH])


def rows_of_object(chain: ClosedChain) -> Array:
    """The object's Jacobian at the start, (6, n)."""
    return State(chain).J_task.copy()


def test_tasks_that_cannot_be_met_together(chain: ClosedChain, firm: Mobility) -> None:
    """Three rows for the position, one along what is impossible: four rows, three of them free."""
    J = rows_of_object(chain)
    along = SCALE**2 * np.array(firm.impossible[0].twist)
    found = mobility(chain, task_rows=[("reach", J[:3]), ("twist", along[None] @ J)])
    assert [(t.name, t.rows, t.rank) for t in found.tasks] == [("reach", 3, 3), ("twist", 1, 0)]
    assert (found.tasks_rows, found.tasks_rank) == (4, 3)
    assert "ask 4 rows, of which only 3 can be met" in found.verdict()


def test_each_task_can_be_met_but_not_both(chain: ClosedChain) -> None:
    """A position and an orientation: three rows each, four free motions."""
    J = rows_of_object(chain)
    found = mobility(chain, task_rows=[("reach", J[:3]), ("turn", J[3:])])
    assert [t.rank for t in found.tasks] == [3, 3]
    assert (found.tasks_rows, found.tasks_rank) == (6, 4)
    assert "only 4 can be met" in found.verdict()


def test_tasks_that_can_be_met_say_what_is_left(chain: ClosedChain) -> None:
    found = mobility(chain, task_rows=[("reach", rows_of_object(chain)[:3])])
    assert (found.tasks_rows, found.tasks_rank) == (3, 3)
    assert "can all be met: 3 rows, 1 degree of freedom left" in found.verdict()


def test_tasks_rank_does_not_depend_on_the_unit_of_the_task(chain: ClosedChain) -> None:
    """In micrometres or in kilometres, the same motions are free."""
    J = rows_of_object(chain)[:3]
    for unit in (1e6, 1e-3):
        assert mobility(chain, task_rows=[("reach", unit * J)]).tasks_rank == 3


def test_largest_task_is_the_object_freedom(chain: ClosedChain, firm: Mobility) -> None:
    """Any choice of rows of the object's twist: never more than four together."""
    J = rows_of_object(chain)
    ranks = [
        mobility(chain, task_rows=[("rows", J[list(rows)])], samples=1).tasks_rank
        for rows in itertools.combinations(range(6), 5)
    ]
    assert max(ranks) == firm.object_freedom == 4


@pytest.mark.parametrize("rows", [[0, 1, 2], [2], [0, 2, 4], [3, 4, 5], [0, 1, 2, 4]])
def test_manipulability_by_hand(chain: ClosedChain, rows: list[int]) -> None:
    """sqrt(det(M M')) with M the twists along an orthonormal basis of the free motions."""
    for q, _ in closed_states(chain, 10):
        J = State(chain, q).J_task[rows].copy()
        M = J @ scipy.linalg.null_space(chain.loop_jacobian(q))
        determinant = max(np.linalg.det(M @ M.T), 0.0)
        assert manipulability(chain, q, J) == pytest.approx(math.sqrt(determinant), rel=1e-6)


def test_manipulability_is_zero_at_a_singular_pose() -> None:
    """And of more rows than there are freedoms."""
    pair, stretched = planar_pair(), stretched_pair()
    planar = [0, 1, 5]
    good = manipulability(pair, pair.q_start, rows_of_object(pair)[planar])
    lost = manipulability(stretched, stretched.q_start, rows_of_object(stretched)[planar])
    assert good > 1e-3
    assert lost < 1e-12
    assert manipulability(pair, pair.q_start, rows_of_object(pair)) == pytest.approx(0, abs=1e-15)
