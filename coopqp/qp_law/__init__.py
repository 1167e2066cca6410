"""One tick of the QP law, readable from top to bottom; :mod:`coopqp.qp_law.law` is where it begins.

bounds      the limits of a tick
way_back    the way back for joints that start outside of them
level       one QP: objective, rows, solver, verification
equations   the damping of a level
priorities  later levels, each within what the ones before leave free
nearest     hard and scaled tasks that cannot hold
drift       the drift correction in part, and acceleration limits
safety      the look at the loops after the step
"""
