"""QP each tick; :mod:`coopqp.qp_law` is the law, here are its settings."""

from typing import ClassVar, Literal

from coopqp.base.errors import InvalidValueError
from coopqp.base.spec import NonNegative, Positive, spec
from coopqp.closed_loop.admittance import Admittance, internal_force_control
from coopqp.controller import ALL_FEATURES, Controller, ControlProblem, Features, Law
from coopqp.kernel.flat import why_not
from coopqp.kernel.law import KernelLaw
from coopqp.qp_law.law import QPLaw


@spec
class QPController(Controller):
    """QP each tick: tasks as objectives, loop closure and limits as hard constraints."""

    uses_solver: ClassVar[bool] = True
    supports: ClassVar[Features] = ALL_FEATURES | {"forces"}

    damping: Positive = 1e-6
    """Cost of |v|^2 [s2/rad2]; makes the answer unique. Below 1e-9 solvers begin to disagree."""
    error_damping: NonNegative = 0.5
    """Share of the damping with which no step overshoots where arms are stretched; 0 for none."""

    engine: Literal["auto", "python", "kernel"] = "auto"
    """auto: the compiled kernel where it can do the problem; python: never; kernel: always."""
    admittance: Admittance | None = None
    """Internal force control for the squeeze of an internal_wrench task; needed there."""

    def build(self, problem: ControlProblem) -> Law:
        """Preallocate the QPs and open the solver, or the kernel, on them.

        Raises:
            InvalidValueError: engine is kernel, which cannot do this problem; a force is asked for
                that admittance cannot bring about, or without a stated stiffness.
        """
        return self.unprepared(problem).prepare()

    def unprepared(self, problem: ControlProblem) -> QPLaw | KernelLaw:
        """The same; what only rare ticks need is built in the first of them."""
        reason = why_not(problem)
        if self.engine == "python" or (self.engine == "auto" and reason):
            return self.plain(problem)
        if reason:
            raise InvalidValueError(f"engine: kernel cannot do this: {reason}; use engine: auto")
        force = internal_force_control(problem, self.admittance)
        return KernelLaw(problem, self.damping, self.error_damping, force)

    def plain(self, problem: ControlProblem) -> QPLaw:
        """The law in Python, whatever the engine: what studies look into."""
        force = internal_force_control(problem, self.admittance)
        return QPLaw(problem, self.damping, self.error_damping, force)
