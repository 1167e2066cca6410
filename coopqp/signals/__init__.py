"""The signals: one file each, the YAML name is the file's name."""

from coopqp.signals.circle import Circle
from coopqp.signals.input import Input
from coopqp.signals.line import Line
from coopqp.signals.waypoints import Waypoints

__all__ = ["Circle", "Input", "Line", "Waypoints"]
