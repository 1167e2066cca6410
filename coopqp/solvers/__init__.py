"""The solvers: one file each, the YAML name is the file's name; or any backend of qpsolvers."""

from coopqp.solvers.daqp import Daqp
from coopqp.solvers.osqp import Osqp
from coopqp.solvers.proxqp import Proxqp
from coopqp.solvers.qpsolvers import Qpsolvers

__all__ = ["Daqp", "Osqp", "Proxqp", "Qpsolvers"]
