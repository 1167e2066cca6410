"""Random goals under every law: ``python -m tests.random_goals``.

draw     a start and a goal from one seed
reach    whether bounded inverse kinematics finds a way to hold the goal inside the limits
trial    what is compared; the runs, on all cores
summary  counts with intervals, by class of goal
table    what the command prints
"""
