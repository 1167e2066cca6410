"""The controllers: one file each, the YAML name is the file's name."""

from coopqp.controllers.damped_pseudoinverse import DampedPseudoinverse
from coopqp.controllers.passive_grasp_pid import PassiveGraspPid
from coopqp.controllers.pseudoinverse import Pseudoinverse
from coopqp.controllers.pseudoinverse_null_space import PseudoinverseNullSpace
from coopqp.controllers.qp import QPController
from coopqp.controllers.saturation_null_space import SaturationNullSpace
from coopqp.controllers.torque_qp import TorqueQp
from coopqp.controllers.two_step import TwoStep
from coopqp.controllers.weighted_least_norm import WeightedLeastNorm
from coopqp.controllers.wrench_split import WrenchSplit

__all__ = [
    "DampedPseudoinverse",
    "PassiveGraspPid",
    "Pseudoinverse",
    "PseudoinverseNullSpace",
    "QPController",
    "SaturationNullSpace",
    "TorqueQp",
    "TwoStep",
    "WeightedLeastNorm",
    "WrenchSplit",
]
