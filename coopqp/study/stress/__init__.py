"""Random rollouts of the QP law that look for a broken promise.

arrangements  which arms hold the object how, from the shipped scenarios
goals         random tasks
draw          a whole random problem from one seed
masses        the same for plants with masses, with errors of the model
driving       runs a law and keeps what happens
signs         what a recorded rollout shows: standing still, an overrun
firmness      hard tasks that end farther off than as soft ones
ending        where it ended, and why there
judgement     how one rollout went
squeeze       the internal force that the servos' gravity feed-forward explains
pair          a rollout on a plant with masses, without and with errors of the model
pressing      a random problem of hands that press
contacts      rollouts of these on rigid bodies, and one line a kind
trial         the rollouts, on all cores
summary       one line a kind
"""

from coopqp.study.stress.contacts import (
    ContactRollout,
    contact_rollout,
    stress_contacts,
    summarize_contacts,
)
from coopqp.study.stress.judgement import Rollout
from coopqp.study.stress.summary import Summary, summarize
from coopqp.study.stress.trial import one_rollout, stress

__all__ = [
    "ContactRollout",
    "Rollout",
    "Summary",
    "contact_rollout",
    "one_rollout",
    "stress",
    "stress_contacts",
    "summarize",
    "summarize_contacts",
]
