"""Torque control: the QP over accelerations and hand wrenches, in reading order from program."""
