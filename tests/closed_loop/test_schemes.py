"""Which joints may be actuated."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg
from chains import PAPER_SCHEME, closed_states

from coopqp.base.errors import InvalidValueError, UnknownNameError
from coopqp.closed_loop.mobility import Mobility, mobility
from coopqp.model.closed_chain import ClosedChain


def test_seventy_one_of_210_schemes_never_work_and_ninety_one_not_at_the_start(
    firm: Mobility,
) -> None:
    assert firm.schemes_complete
    assert firm.schemes_total == len(firm.schemes) == 210
    assert firm.inadmissible == 71
    assert firm.inadmissible_start == 91
    assert len({s.joints for s in firm.schemes}) == 210


def test_schemes_are_judged_as_the_free_motions_say(chain: ClosedChain, firm: Mobility) -> None:
    """A scheme works where its joints' rows of the null-space basis are regular."""
    poses = [q for q, _ in closed_states(chain, 10)]
    at_start = scipy.linalg.null_space(chain.loop_jacobian(chain.q_start))
    bases = [scipy.linalg.null_space(chain.loop_jacobian(q)) for q in poses]
    for scheme in firm.schemes:
        joints = [chain.joint_names.index(name) for name in scheme.joints]
        smallest = [np.linalg.svd(N[joints], compute_uv=False)[-1] for N in bases]
        assert scheme.admissible == (max(smallest) > 1e-7)
        smallest_at_start = np.linalg.svd(at_start[joints], compute_uv=False)[-1]
        assert scheme.admissible_start == (smallest_at_start > 1e-7)


def test_papers_scheme_is_lost_at_the_start(firm: Mobility) -> None:
    assert firm.requested is not None
    assert firm.requested.joints == PAPER_SCHEME
    assert firm.requested.admissible
    assert not firm.requested.admissible_start
    assert 50 < firm.requested.condition < 5000
    assert firm.requested in firm.lost_at_start
    assert len(firm.lost_at_start) == 20
    assert "admissible at generic poses" in firm.verdict()
    assert "singular at the start" in firm.verdict()


def test_schemes_come_best_first(firm: Mobility) -> None:
    conditions = [s.condition for s in firm.schemes]
    assert conditions == sorted(conditions)
    assert firm.schemes[0].admissible
    assert firm.schemes[0].admissible_start


def test_verdict_on_an_inadmissible_and_on_a_good_scheme(
    chain: ClosedChain, firm: Mobility
) -> None:
    bad = mobility(chain, requested=firm.schemes[-1].joints).verdict()
    assert "is inadmissible: it is singular at every pose" in bad
    good = mobility(chain, requested=firm.schemes[0].joints).verdict()
    assert "is admissible (condition" in good


@pytest.mark.parametrize(
    ("asked", "message"),
    [
        (PAPER_SCHEME[:3], "found 3 joints, needs 4"),
        ([*PAPER_SCHEME, "LElbowYaw"], "found 5 joints, needs 4"),
        ([*PAPER_SCHEME[:3], "RElbowYaw"], "RElbowYaw given more than once"),
        ([*PAPER_SCHEME[:3], "LElbowYwa"], "unknown joint 'LElbowYwa'; did you mean 'LElbowYaw'"),
        ([], "found 0 joints, needs 4"),
    ],
)
def test_asked_for_scheme_that_is_none(chain: ClosedChain, asked: list[str], message: str) -> None:
    with pytest.raises((InvalidValueError, UnknownNameError), match=message):
        mobility(chain, requested=asked)


def test_passive_joint_is_no_part_of_a_scheme(hinged: ClosedChain) -> None:
    with pytest.raises(InvalidValueError, match="passive"):
        mobility(hinged, requested=[*hinged.joint_names[:5], "right.hinge"])
