"""The laws that are compared, each as its file has it, without settings."""

from __future__ import annotations

from dataclasses import dataclass

from coopqp.controller import Controller
from coopqp.controllers import (
    DampedPseudoinverse,
    Pseudoinverse,
    PseudoinverseNullSpace,
    QPController,
    SaturationNullSpace,
    TwoStep,
    WeightedLeastNorm,
)
from coopqp.task import Task
from coopqp.tasks import JointLimitBarrier

#: Gain of the barrier [1/s]: the best of 0.05 to 0.5 on other goals than seeds below 10,000 draw.
BARRIER_GAIN = 0.5


@dataclass(frozen=True)
class Compared:
    """A law that takes part.

    Attributes:
        controller: its plug-in.
        secondary: instead of the scenario's secondary objectives, if any.
    """

    controller: Controller
    secondary: tuple[Task, ...] = ()


LAWS = {
    "qp": Compared(QPController()),
    "saturation_null_space": Compared(SaturationNullSpace()),
    "weighted_least_norm": Compared(WeightedLeastNorm()),
    "null_space with barrier": Compared(
        PseudoinverseNullSpace(), (JointLimitBarrier(gain=BARRIER_GAIN),)
    ),
    "pseudoinverse_null_space": Compared(PseudoinverseNullSpace()),
    "pseudoinverse": Compared(Pseudoinverse()),
    "damped_pseudoinverse": Compared(DampedPseudoinverse()),
    "two_step": Compared(TwoStep()),
}
