"""One tick of the QP law, readable from top to bottom; :mod:`coopqp.qp_law.law` is where it begins.

equations    the formulas: normal equations of the tasks, rows of the loops
bounds       the limits of a tick
level        one QP: objective, rows, solver, verification
exact_tasks  hard and scaled tasks as equality rows
priorities   later levels, each within what the ones before leave free
fallback     what is given up when not everything can hold
recovery     the way back for joints that start outside
safety       the look at the loops after the step
"""
