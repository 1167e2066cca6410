"""One sentence on a run."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scenario_files import phased

from coopqp.comparison import summarize
from coopqp.controller_run import run


@pytest.mark.xfail(strict=True, reason="the verdict looks for limits at the end of the run alone")
def test_the_verdict_blames_a_limit_of_the_phase_that_missed(tmp_path: Path) -> None:
    made = phased(tmp_path)
    trace = run(made, controller="qp")
    trace.task_error[60, 0] = 0.1  # of the first phase, where no joint was at a limit
    trace.q[-1, 0] = trace.upper[0]
    verdict = summarize(made, {"qp": trace}).verdicts["qp"]
    assert "off the goal of 'carry.reach'" in verdict
    assert "held back by" not in verdict


def test_the_verdict_reaches_no_goal_with_an_error_that_is_not_a_number(tmp_path: Path) -> None:
    made = phased(tmp_path)
    trace = run(made, controller="qp")
    trace.task_error[60, 0] = np.nan
    comparison = summarize(made, {"qp": trace})
    assert not comparison.metrics["qp"]["reached"]
    assert "eaches the goal" not in comparison.verdicts["qp"]
