"""The task that asks for internal wrenches: its rows between two and three hands, and signals."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from chains import planar_pair, ring, three_arms

from coopqp.base.errors import CoopqpError
from coopqp.base.spec import Array
from coopqp.closed_loop.grasp_matrix import virtual_linkage
from coopqp.closed_loop.hands import WrenchStack, hands, points
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.state import State
from coopqp.signals import Waypoints
from coopqp.tasks import InternalWrench


def stack_of(chain: ClosedChain, **settings: Any) -> tuple[WrenchStack, Array]:
    """Rows at the start, and where the hands are."""
    start = State(chain)
    stack = WrenchStack([InternalWrench(**settings)], start)
    stack.update(start)
    return stack, points(hands(chain), start.p_WO, start.R_WO)


def test_hands_that_press_on_each_other_squeeze(chain: ClosedChain) -> None:
    stack, at = stack_of(chain, squeeze=7.0, twist=0.0)
    e = (at[1] - at[0]) / np.linalg.norm(at[1] - at[0])
    h = np.concatenate([5.0 * e, 0.3 * e, -5.0 * e, -0.3 * e])
    assert np.allclose(stack.error(h), [5.0 - 7.0, 0.3])
    assert [row.unit for row in stack.rows] == ["N", "N m"]
    # The other way round hand 1 is the other one: the same squeeze, and the same twist.
    swapped, _ = stack_of(chain, squeeze=7.0, twist=0.0, arms=("left", "right"))
    assert np.allclose(swapped.error(h), [5.0 - 7.0, 0.3])


def test_between_three_hands_a_squeeze_is_the_push_along_their_edge() -> None:
    chain = three_arms()
    stack, at = stack_of(chain, squeeze=2.0, arms=("left", "right"))
    names = [hand.arm for hand in hands(chain)]
    i, j = sorted((names.index("left"), names.index("right")))
    e = (at[j] - at[i]) / np.linalg.norm(at[j] - at[i])
    h = np.zeros((3, 6))
    h[i, :3], h[j, :3] = 4.0 * e, -4.0 * e
    assert np.allclose(stack.error(h), [2.0])
    other = next(k for k in range(3) if k not in (i, j))
    rest = np.zeros((3, 6))
    rest[other, 3:] = 1.0  # a torque is no push
    assert np.allclose(stack.error(rest), [-2.0])
    assert virtual_linkage(at).shape == (3, 9)


def test_a_signal_says_how_much_and_when(chain: ClosedChain) -> None:
    way = Waypoints(times=[0.0, 1.0], values=[[2.0], [6.0]], between="linear")
    task, state = InternalWrench(squeeze=way), State(chain)
    stack = WrenchStack([task], state)
    for t, wanted in ((0.0, 2.0), (0.5, 4.0), (3.0, 6.0)):
        state.t = t
        stack.update(state)
        assert stack.wanted[0] == pytest.approx(wanted)
    assert task.end == 1.0


@pytest.mark.parametrize(
    ("make", "settings", "words"),
    [
        (three_arms, {"squeeze": 1.0}, "3 hands hold the object; say between which two"),
        (three_arms, {"twist": 1.0, "arms": ("left", "right")}, "a squeeze along their edge"),
        (planar_pair, {"squeeze": 1.0, "arms": ("left", "rihgt")}, "did you mean 'right'"),
        (lambda: ring(4, 5), {"squeeze": 1.0, "arms": ("a", "b")}, "found 4 hands"),
    ],
)
def test_pairs_that_do_not_have_it_are_refused(
    make: Any, settings: dict[str, Any], words: str
) -> None:
    with pytest.raises(CoopqpError, match=words):
        stack_of(make(), **settings)


@pytest.mark.parametrize(
    ("released", "words"), [(("left",), "one hand holds the object; what cancels needs two"),
                            (("left", "right"), "no hand holds the object; what cancels needs")],
)  # fmt: skip
def test_hands_that_are_free_are_no_pair(released: tuple[str, ...], words: str) -> None:
    chain = planar_pair()
    with pytest.raises(CoopqpError, match=words):
        stack_of(chain.handed_over(chain.q_start, released), squeeze=1.0)


def test_one_arm_is_no_pair() -> None:
    with pytest.raises(ValueError, match="needs two different ones"):
        InternalWrench(squeeze=1.0, arms=("left", "left"))
