"""Why a run did not reach its goal and what would do, and why a tick fell short.

whole              a run, or arms at rest now: from the end to a sentence; objects lost
explained_phase    a phase of a run as recorded, and rerun, such as with limits relaxed
goal               errors of tasks, position limits with their multipliers, inverse kinematics
diagnosis          limits, reach, contradiction, too few degrees of freedom
insufficient_time  what slows a run that geometry does not block, and velocities not followed
tick               one tick: its rows and answer, tasks not met in full; what blocks it
words              the explanation of a run, and the sentences
"""

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
