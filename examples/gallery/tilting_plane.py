"""
A plane that tilts
==================

test
"""

import matplotlib.pyplot as plt

import coopqp

scenario = coopqp.load("tilting_plane")
trace = coopqp.run(scenario, controller="qp")
plt.plot(trace.position)
