"""A file becomes a :class:`coopqp.scenario.scenario.Scenario`, or a list of all its faults."""
