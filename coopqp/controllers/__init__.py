"""The controllers: one file each, the YAML name is the file's name."""

from coopqp.controllers.damped_pseudoinverse import DampedPseudoinverse as DampedPseudoinverse
from coopqp.controllers.passive_grasp_pid import PassiveGraspPid as PassiveGraspPid
from coopqp.controllers.pseudoinverse import Pseudoinverse as Pseudoinverse
from coopqp.controllers.pseudoinverse_null_space import (
    PseudoinverseNullSpace as PseudoinverseNullSpace,
)
from coopqp.controllers.qp import QPController as QPController
from coopqp.controllers.saturation_null_space import SaturationNullSpace as SaturationNullSpace
from coopqp.controllers.torque_qp import TorqueQp as TorqueQp
from coopqp.controllers.two_step import TwoStep as TwoStep
from coopqp.controllers.weighted_least_norm import WeightedLeastNorm as WeightedLeastNorm
from coopqp.controllers.wrench_split import WrenchSplit as WrenchSplit
