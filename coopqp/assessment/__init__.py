"""The assessment of a run: what it reached, what it kept, how it ended.

thresholds   every number that decides, with its unit and its reason
limits       what limits had left in a run, what it was beyond, and at which it was
assessment   all answers on one run
verdict      the same in one sentence

Nothing else decides any of it: metrics, tables, studies, explanations and pictures read it here.
"""

from coopqp.assessment.assessment import Assessment, assess

__all__ = ["Assessment", "assess"]
