"""Whether a loop can begin where a robot says that it is; else what the robot may have wrong.

Units, signs and the order of joints are what drivers get wrong, and all look like joints. Two
things are known of them: their ranges, and how the hands lie to each other by the scenario's start.
A joint is refused beyond its range by more than a servo is off. Hands that lie otherwise are looked
at once more after each change that undoes one such mistake: a mistake is named where exactly this
change puts the hands where they belong. Six numbers fit then that did not, so that chance is out.
"""

import itertools
from collections.abc import Iterator

import numpy as np
import pinocchio as pin

from coopqp.base.errors import GraspError, InvalidValueError
from coopqp.base.spec import Array
from coopqp.base.wording import counted
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.loop_observer import MOST_ORIENTATION, MOST_POSITION

#: Beyond a limit by so much, joints still count as at it: servos sag by some mrad, and encoders are
#: off by some 10 mrad. Limit recovery brings them back. What is in other units is off by far more.
OFF, OFF_SLIDING = 0.05, 0.005  # [rad], [m]
#: Hands that are so near to where they belong are there, with encoders 2 mrad off [m], [rad].
FITS_POSITION, FITS_ORIENTATION = 10e-3, 30e-3
#: Least cosine between the way that joints go and one that explains it.
ALIKE = 0.9
#: Changes that fit are all named if there are so many, and none if there are more.
MOST_NAMED = 2


def check_range(chain: ClosedChain, q: Array) -> None:
    """Refuse joints, shape (n,), that are out of their range by more than a servo is off."""
    beyond = _beyond(chain, q)
    if not (beyond > 0.0).any():
        return
    i = int(np.argmax(beyond))
    low, high, unit = chain.lower[i], chain.upper[i], chain.joint_units[i]
    out, side = (low - q[i], "below") if q[i] < low else (q[i] - high, "above")
    far = f"{out:.{3 if out >= 100.0 else 2}g}"  # 151, not 1.5e+02
    words = f"{chain.joint_names[i]} reads {q[i]:.3g} {unit}, {far} {unit} {side} its range"
    hint, others = likely_mistake(chain, q), int((beyond > 0.0).sum()) - 1
    more = f", and {counted(others, 'other joint')} outside theirs" if others else ""
    way_out = "" if hint else "; if it is really there, say start_outside: true"
    raise InvalidValueError(
        f"{words}{f': {hint}' if hint else '.'} Its range is {low:.3g} to {high:.3g} {unit}{more}"
        f"{way_out}"
    )


def check_hands(chain: ClosedChain, q: Array, *, placed: bool) -> None:
    """Refuse hands that lie to each other otherwise than at the chain's start.

    With ``placed``, as where the scenario has the object's place, by more than a model's error;
    else they may hold it otherwise, and are refused where a mistake of the driver explains it.
    """
    where, hint = _elsewhere(chain, q)
    if where and placed:
        asks = f": {hint} Else bring" if hint else "; bring"
        around = "" if hint else ", or leave out object_in_hand and object.pose to hold it as it is"
        raise GraspError(
            f"{where} the scenario says they hold the object, more than a model's error{asks} the "
            f"robot near the scenario's start{around}"
        )
    if hint:
        words = "With that they are as there; if the joints are right, give the scenario this start"
        raise GraspError(f"{where} the scenario starts: {hint} {words}")


def check_object(held: pin.SE3, measured: pin.SE3) -> None:
    """Refuse an object that was measured farther from the hands than a model's error."""
    apart = float(np.linalg.norm(measured.translation - held.translation))
    turned = float(np.linalg.norm(pin.log3(held.rotation.T @ measured.rotation)))
    if apart > MOST_POSITION or turned > MOST_ORIENTATION:
        raise GraspError(
            f"object_pose: {1e3 * apart:.0f} mm and {1e3 * turned:.0f} mrad from where the hands "
            "hold the object by the scenario, more than a model's error; is it of the object's "
            "frame, in the scenario's world?"
        )


def check_resumed(chain: ClosedChain, q: Array, *, outside: bool) -> None:
    """Refuse to go on where the object is not held as before the rest, or joints are no joints.

    Commands begin anew at q: with a wrong encoder the arms would jump, and tear at the object.
    """
    if not outside:
        check_range(chain, q)
    where, hint = _elsewhere(chain, q)
    if where:
        asks = f": {hint} Else bring" if hint else "; bring"
        raise GraspError(f"{where} they held the object{asks} the arms back, or reset the loop")


def _elsewhere(chain: ClosedChain, q: Array) -> tuple[str, str]:
    """Words on hands that are farther off than a model's error, and the likely mistake."""
    apart, turned = chain.loop_error_sizes(q)
    if apart <= MOST_POSITION and turned <= MOST_ORIENTATION:
        return "", ""
    where = f"the hands are {1e3 * apart:.0f} mm and {1e3 * turned:.0f} mrad from how"
    return where, likely_mistake(chain, q)


def likely_mistake(chain: ClosedChain, q: Array) -> str:
    """The one mistake of a driver that explains joints q, as a question; empty if none does.

    Angles of more than a turn that are inside their ranges in degrees need no hands to tell.
    """
    found = []
    for words, other in _changes(chain, q):
        if (_beyond(chain, other) > 0.0).any():
            continue
        apart, turned = chain.loop_error_sizes(other)
        if apart <= FITS_POSITION and turned <= FITS_ORIENTATION:
            found.append(words)
    outside, degrees = _beyond(chain, q) > 0.0, _in_radians(chain, q)
    turns = np.abs(q[outside & (degrees != q)]) > 2.0 * np.pi
    if not found and turns.any() and not (_beyond(chain, degrees) > 0.0).any():
        found = ["degrees"]
    return f"{' or '.join(found)}?" if 0 < len(found) <= MOST_NAMED else ""


def posed_mistake(chain: ClosedChain, q: Array, off: float) -> str:
    """The one mistake without which joints q are within ``off`` of the start; empty if none is."""
    near = [words for words, x in _changes(chain, q) if (np.abs(x - chain.q_start) <= off).all()]
    return " or ".join(near[:MOST_NAMED])


def staying_mistake(chain: ClosedChain, q: Array, gone: Array) -> str:
    """The one mistake with which a command to stay at q moves joints the way they have gone."""
    found, best = "", ALIKE * float(np.linalg.norm(gone))
    for words, x in _changes(chain, q):
        way = x - q
        if (along := float(gone @ way) / max(float(np.linalg.norm(way)), 1e-9)) > best + 1e-9:
            found, best = words, along
    return found


def _beyond(chain: ClosedChain, q: Array) -> Array:
    """By how much joints are farther out than a servo is off, negative inside, shape (n,)."""
    off = np.where([unit == "m" for unit in chain.joint_units], OFF_SLIDING, OFF)
    return np.asarray(np.maximum(chain.lower - q, q - chain.upper) - off)


def _in_radians(chain: ClosedChain, q: Array) -> Array:
    turns = np.array([unit == "rad" for unit in chain.joint_units])
    turns[chain.passive] = False
    return np.where(turns, np.radians(q), q)


def _changes(chain: ClosedChain, q: Array) -> Iterator[tuple[str, Array]]:
    """Joints with one mistake undone, and what it was."""
    yield "degrees", _in_radians(chain, q)
    place = {name: i for i, name in enumerate(chain.joint_names)}
    robot = chain.robot
    arms = {arm.name: [place[name] for name in robot.arm_joints(arm)] for arm in robot.arms}
    for (a, joints), (b, others) in itertools.combinations(arms.items(), 2):
        if len(joints) == len(others):
            words = "arms swapped" if len(arms) == 2 else f"arms {a} and {b} swapped"
            yield words, _with(q, [*joints, *others], q[[*others, *joints]])
    for joints in arms.values():
        for i, j in itertools.combinations(joints, 2):
            names = f"{chain.joint_names[i]} and {chain.joint_names[j]}"
            yield f"{names} swapped", _with(q, [i, j], q[[j, i]])
    for i in sorted({i for joints in arms.values() for i in joints}):
        name = chain.joint_names[i]
        yield f"sign of {name}", _with(q, [i], -q[i])
        if chain.joint_units[i] == "rad":
            for by, words in ((np.pi / 2.0, "90 degrees"), (2.0 * np.pi, "a turn")):
                for way in (by, -by):
                    yield f"{name} off by {words}", _with(q, [i], q[i] + way)


def _with(q: Array, at: list[int], values: Array) -> Array:
    other = q.copy()
    other[at] = values
    return other
