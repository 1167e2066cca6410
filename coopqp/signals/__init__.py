"""The signals: one file each, the YAML name is the file's name."""

from coopqp.signals.circle import Circle as Circle
from coopqp.signals.input import Input as Input
from coopqp.signals.line import Line as Line
from coopqp.signals.waypoints import Waypoints as Waypoints
