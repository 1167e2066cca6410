"""Random rollouts of the QP law that look for a broken promise.

arrangements  which arms hold the object how, from the shipped scenarios
goals         random tasks
draw          a whole random problem from one seed
signs         what a recorded rollout shows: rattling, standing still, an overrun
ending        where it ended, and why there
trial         the rollouts, on all cores
summary       one line a kind
"""

from coopqp.study.stress.summary import Summary, summarize
from coopqp.study.stress.trial import Rollout, one_rollout, stress

__all__ = ["Rollout", "Summary", "one_rollout", "stress", "summarize"]
