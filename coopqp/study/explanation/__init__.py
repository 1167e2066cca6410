"""Why a run did not reach its goal and what would do, and why a tick fell short.

whole          a run: from its end to a sentence
leg, answer    a phase of a run as it was; what is said of it
lost           an object that hands which press have lost
goal, room     where tasks want the arms to be; where limits let them
search         inverse kinematics inside or without the limits
diagnosis      limits, reach, contradiction, too few freedoms
shares         which limits hold back, by force
excess, cure   what would do, and a rerun that shows it
rerun          the run again with something changed
contradiction  tasks that cannot hold together
late           what slows a run that geometry does not block
velocity       velocities that could not be followed
words          the sentences
unmet          hard and scaled tasks that are not met in full
asked, tick    one tick: what was asked, and the answer; what leaves it no motion
standing       arms at rest now: what keeps them from their goals
"""

from coopqp.study.explanation.answer import RunExplanation
from coopqp.study.explanation.asked import Asked, asked_now
from coopqp.study.explanation.standing import Standing, explain_standing
from coopqp.study.explanation.tick import (
    Explanation,
    Relaxation,
    at_bound,
    explain,
    explain_asked,
)
from coopqp.study.explanation.whole import explain_run

__all__ = [
    "Asked",
    "Explanation",
    "Relaxation",
    "RunExplanation",
    "Standing",
    "asked_now",
    "at_bound",
    "explain",
    "explain_asked",
    "explain_run",
    "explain_standing",
]
