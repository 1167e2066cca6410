"""Motions that are decided beforehand: whether goals can be reached, by which way, and how fast."""

from coopqp.planning.closed_space import Budget as Budget
from coopqp.planning.plan import Plan as Plan
from coopqp.planning.plan import plan as plan
from coopqp.planning.plan import way_round as way_round
from coopqp.planning.reach import Reach as Reach
from coopqp.planning.reach import reach as reach
from coopqp.planning.timing import with_fastest_profiles as with_fastest_profiles
