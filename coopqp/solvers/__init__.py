"""The solvers: one file each, the YAML name is the file's name; or any backend of qpsolvers."""

from coopqp.solvers.daqp import Daqp as Daqp
from coopqp.solvers.osqp import Osqp as Osqp
from coopqp.solvers.proxqp import Proxqp as Proxqp
from coopqp.solvers.qpsolvers import Qpsolvers as Qpsolvers
