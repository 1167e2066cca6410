"""Random goals under every law: how often it reaches, stays inside the limits, keeps the loop.

draw     a start and a goal from one seed
reach    whether bounded inverse kinematics finds a way to hold the goal inside the limits
trial    what is compared; the runs, on all cores
paired   one law against another on the same goals
summary  counts with intervals, by class of goal
table    what the command prints
"""

from coopqp.study.statistics.draw import arenas
from coopqp.study.statistics.summary import Line, summarize, wilson
from coopqp.study.statistics.table import tables
from coopqp.study.statistics.trial import GoalRun, LawRun, kept, one_goal, statistics

__all__ = [
    "GoalRun",
    "LawRun",
    "Line",
    "arenas",
    "kept",
    "one_goal",
    "statistics",
    "summarize",
    "tables",
    "wilson",
]
