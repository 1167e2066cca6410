"""Why a run did not reach its goal and what would do, and why a tick fell short."""

from coopqp.study.explanation.tick import Explanation, Relaxation, at_bound, explain
from coopqp.study.explanation.whole import Standing, explain_run, explain_standing
from coopqp.study.explanation.words import RunExplanation

__all__ = [
    "Explanation",
    "Relaxation",
    "RunExplanation",
    "Standing",
    "at_bound",
    "explain",
    "explain_run",
    "explain_standing",
]
