"""One tick of the QP law, readable from top to bottom; :mod:`coopqp.qp_law.law` is where it begins.

bounds          the limits of a tick
limit_recovery  joints that start outside of them; the reduced Baumgarte correction
level           one QP: objective, rows, solver, verification; a step in a null space
equations       the damping of a level
priorities      later levels, each within what the ones before leave free
nearest         hard and scaled tasks that cannot hold
safety          step verification: the loops after the step
"""
