"""Random rollouts of the QP law in search of a broken promise: ``python -m tests.stress``.

arrangements  which arms hold the object how, from the shipped scenarios
goals, draw   random tasks; a whole random problem from one seed
signs         what a recorded rollout shows: standing still, a violation
driving       runs a law and keeps what happens
ending        where it ended, and why there
firmness      hard tasks that end farther off than as soft ones
judgement     how one rollout went
masses        plants with masses, without and with errors of the model
contacts      hands that press, on rigid bodies
faults        sensors and motors that fail, and what is promised then
trial         the rollouts, on all cores
summary       one line a kind
"""
