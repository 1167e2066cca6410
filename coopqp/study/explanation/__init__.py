"""Why a run did not reach its goal and what would do, and why a tick fell short."""

from coopqp.study.explanation.tick import Explanation as Explanation
from coopqp.study.explanation.tick import at_bound as at_bound
from coopqp.study.explanation.tick import explain as explain
from coopqp.study.explanation.whole import explain_run as explain_run
from coopqp.study.explanation.whole import explain_standing as explain_standing
from coopqp.study.explanation.words import RunExplanation as RunExplanation
