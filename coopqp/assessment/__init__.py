"""The assessment of a run: what it reached, what it kept, how it ended.

Nothing else decides any of it: metrics, tables, studies, explanations and pictures read it here.
"""

from coopqp.assessment.assessment import Assessment, assess

__all__ = ["Assessment", "assess"]
