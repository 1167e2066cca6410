"""The assessment of a run: what it reached, what it kept, how it ended.

thresholds   every number that decides, with its unit and its reason
ends         which errors count as a task's end
audit        what limits had left in a run, as they say themselves
limits       what a run was beyond, and at which limits it was
assessment   all answers on one run
verdict      the same in one sentence

Nothing else decides any of it: metrics, tables, studies, explanations and pictures read it here.
"""

from coopqp.assessment.assessment import Assessment, assess

__all__ = ["Assessment", "assess"]
