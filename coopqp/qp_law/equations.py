"""The damping of a level, and the numbers that several levels share."""

from __future__ import annotations

from dataclasses import dataclass

from coopqp.solver import norm
from coopqp.state import State

#: Cost of a missing share of what may be done in part, far above any soft task.
SCALE_WEIGHT = 1e3
#: A share of the drift correction from here on is all of it.
ALL_OF_IT = 1.0 - 1e-6
#: Speed below which what is scaled counts as at rest [m/s, rad/s].
LEAST_SPEED = 1e-4
#: Damping that scaled tasks and decided rows may ask for; beyond it solvers see a wall.
MOST_DAMPING = 1e4


@dataclass(frozen=True)
class Damping:
    """Cost d of |v|^2 with which a step does not overshoot where the arms are stretched.

    A tick is a Gauss-Newton step. About the pose where it should rest, along a direction u that
    the tasks hardly see, it goes a = dt (g s^2 + u'S u) / (s^2 + d) of the way, with s^2 = u'J'W J
    u, and S what the tasks' second derivatives add, |S| <= bend
    (:meth:`coopqp.task.TaskStack.bend`). Above a = 2 it swings farther each time until a bound
    stops it; d = dt bend keeps a below 1, and half of that below 2.

    Attributes:
        least: what d is where nothing bends.
        share: of the damping that rules out any overshoot.
        dt: control period [s].
    """

    least: float
    share: float
    dt: float

    def of(self, bend: float) -> float:
        """What a bend adds to d, share dt bend."""
        return self.share * self.dt * bend

    def of_drift(self, state: State, kappa: float) -> float:
        """What a drift correction adds that is done in part; nothing where the last tick did all.

        Its share has the cost w (1 - s)^2. Near a singular pose what is left of a millimetre would
        ask for full speed, and for full speed back in the next tick. As above, dt w L / |kappa e|
        is enough for one arm of reach L, twice that for two.

        Args:
            state: of the tick.
            kappa: gain of the drift correction [1/s].
        """
        if state.corrected >= ALL_OF_IT:
            return 0.0
        wanted = kappa * norm(state.e_loop)
        return 2.0 * self.dt * SCALE_WEIGHT * state.chain.reach / max(wanted, LEAST_SPEED)
