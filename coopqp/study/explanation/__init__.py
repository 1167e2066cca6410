"""Why a run did not reach its goal and what would do, and why a tick fell short."""

from coopqp.study.explanation.tick import Explanation, at_bound, explain
from coopqp.study.explanation.whole import explain_run, explain_standing
from coopqp.study.explanation.words import RunExplanation

__all__ = [
    "Explanation",
    "RunExplanation",
    "at_bound",
    "explain",
    "explain_run",
    "explain_standing",
]
