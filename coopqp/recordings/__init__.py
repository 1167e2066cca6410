"""Recorded runs in files that other tools open: what is in them, written and read back.

A run is rows of named columns, as ``trace.csv`` has them. Every format keeps all of them, bit for
bit, and the scenario beside them, so that ``explain`` and ``replay`` work on each; MCAP and rosbag2
tell the same again in the messages that Foxglove and ROS 2 know.
"""
