"""The damping of a level, and the numbers that several levels share."""

from dataclasses import dataclass

import numpy as np

from coopqp.base.spec import Array
from coopqp.model.state import State
from coopqp.solver import norm
from coopqp.task import TaskStack

#: Cost of a missing share of what may be done in part, far above any soft task.
SCALE_WEIGHT = 1e3
#: A share of the Baumgarte stabilisation from here on is all of it.
ALL_OF_IT = 1.0 - 1e-6
#: Speed below which what is scaled counts as at rest [m/s, rad/s].
LEAST_SPEED = 1e-4
#: Damping that scaled tasks and decided rows may ask for; beyond it solvers see a wall.
MOST_DAMPING = 1e4
#: While a joint reverses again and again damping grows so many times a reversal, up to the most,
GROWS, MOST_GROWN = 1.5, 16.0
#: and fades as the joints travel, to 1/e in this much [rad, m], or while they move and none has
#: reversed of late, to 1/e in this time [s]: arms at rest keep it.
FADES_IN, FADES_AFTER = 0.2, 0.3
#: A joint moves from this speed on, and reverses where it moves the other way than it did last
#: [rad/s, m/s], however fast others are: chatter grows from little, and is damped while small.
SWINGS_AT = 2e-4
#: It does again and again after so many reversals, of which each counts this share less with every
#: tick, to next to nothing; or at once, if it reverses in two consecutive ticks.
REVERSALS, FORGETS, NO_REVERSAL = 4.0, 0.985, 1e-300
#: Second over first order of hard or scaled rows' step from which on they are softened.
BENDS = 2.0
#: What a later level pulls falls to no less than this share of what it was a tick before, while
#: that is more than FIRM: a pull that passes through zero is no reason to let go [1/s].
LETS_GO, FIRM = 0.97, 100.0


@dataclass(frozen=True)
class Damping:
    """Cost d of |v|^2 with which a step does not overshoot where the arms are stretched.

    A tick is a Gauss-Newton step. About the pose of rest, along a nearly singular direction u, it
    goes a = dt (g s^2 + u'S u) / (s^2 + d) of the way, with s^2 = u'J'W J u, and S the part of the
    tasks' second derivatives, |S| <= L (:meth:`coopqp.task.TaskStack.curvature`). Above a = 2 it
    oscillates ever more until a bound stops it; d = dt L keeps a below 1, half of it below 2.

    That holds of each level alone. Two that share one nearly singular direction may overshoot
    together: then joints reverse again and again, and all damping grows (:func:`note_chatter`).

    ``base`` is d without curvature, ``share`` c of what rules out any overshoot, dt in s.
    """

    base: float
    share: float
    dt: float

    def of(self, curvature: float, state: State) -> float:
        """What a curvature L adds to d, share dt L; more of it where joints have oscillated."""
        return self.share * (1.0 + float(state.memory["chatter"][0])) * self.dt * curvature

    def of_tasks(self, tasks: TaskStack, state: State) -> float:
        """What soft tasks add to d.

        The curvature of joint objectives is unknown: chatter makes them slower, as many times
        as other damping has grown.
        """
        grown = float(state.memory["chatter"][0]) if self.share > 0.0 else 0.0
        return self.of(tasks.curvature(state.v), state) + grown * tasks.joint_weight

    def overreaches(self, bounds: Array, done: Array, v: Array) -> float:
        """How far hard or scaled rows are softened, 0 to 1, as they see ``done`` of v.

        So they are where a tick bends them by more than BENDS times what it moves them: a linear
        step would pass the singularity.
        """
        bent = 0.5 * self.dt * norm(bounds) * float(v @ v) if self.share > 0.0 else 0.0
        return min(max(bent / (BENDS * max(norm(done), LEAST_SPEED)) - 1.0, 0.0), 1.0)

    def of_drift(self, state: State, kappa: float) -> float:
        """What a reduced Baumgarte correction adds; nothing where the last tick did all.

        Its share has the cost w (1 - s)^2. Near a singularity the rest of a millimetre would ask
        for full speed, to and fro. As above, dt w L / |kappa e| is enough for one arm of reach L,
        twice that for two.
        """
        if state.corrected >= ALL_OF_IT:
            return 0.0
        wanted = kappa * norm(state.e_loop)
        return 2.0 * self.dt * SCALE_WEIGHT * state.chain.reach / max(wanted, LEAST_SPEED)


def note_chatter(state: State, v: Array, dt: float) -> None:
    """Remember which joints reverse in v, for the damping of the next ticks.

    Kept are how much the damping has grown, and each joint's latest reversals: how many, signed by
    the way it went last.
    """
    chatter, speeds = state.memory["chatter"], np.abs(v)
    ways, times, moves = chatter[1:], np.abs(chatter[1:]), speeds > SWINGS_AT
    back, at_once = moves & (v * ways < 0.0), times == np.round(times)  # has not faded
    more = np.minimum(1.0 + times, REVERSALS)
    most = np.where(at_once, REVERSALS, more)[back].max(initial=0.0)
    again = max(float(most) - REVERSALS + 1.0, 0.0)
    goes_on = moves.any() and times.max() < 1.0
    rate = float(speeds.max(initial=0.0)) / FADES_IN + goes_on / FADES_AFTER
    faded = max((1.0 + chatter[0]) / (1.0 + dt * rate), 1.0)
    chatter[0] = (min(GROWS**again * (1.0 + chatter[0]), MOST_GROWN) if again else faded) - 1.0
    times = np.where(back, more, np.maximum(FORGETS * times, NO_REVERSAL))
    ways[:] = times * np.where(moves, np.sign(v), np.sign(ways))


def held_pull(new: float, old: float) -> float:
    """What a later level pulls at decided rows, for the next tick; old is of the tick before."""
    held = LETS_GO * old
    return max(new, held) if held > FIRM else new
