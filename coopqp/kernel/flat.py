"""A problem as flat arrays, which is all that the kernel knows of it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin

from coopqp.base.spec import Array
from coopqp.controller import ControlProblem
from coopqp.limit import JointBounds, TwistBounds, opening
from coopqp.model.closed_chain import ClosedChain
from coopqp.robot import axis_of

Flat = dict[str, Any]

LARGE = 1e300  # stands for no limit


def flat_model(chain: ClosedChain) -> Flat | None:
    """Joints with their axes turned to z, and the arms; None where a joint is of another kind.

    Args:
        chain: the closed chain.
    """
    return chain.once(_flat_model)


def _flat_model(chain: ClosedChain) -> Flat | None:
    model = chain.model
    slides, parents, placements = [], [], []
    for j in range(1, model.njoints):
        axis = _axis(model.joints[j])
        if axis is None or model.idx_vs[j] != j - 1:
            return None
        slides.append(float(axis[0]))
    axes = chain.once(turned)
    for j in range(1, model.njoints):
        parent = int(model.parents[j])
        parents.append(float(parent - 1))
        X = model.jointPlacements[j]
        placements.append(
            _placement(axes[parent].T @ X.rotation @ axes[j], axes[parent].T @ X.translation)
        )
    tips, objects = [], []
    for frame in chain.frames:
        f = model.frames[frame]
        tips.append(float(f.parentJoint - 1))
        A = axes[f.parentJoint].T
        objects.append(_placement(A @ f.placement.rotation, A @ f.placement.translation))
    return {
        "parents": np.array(parents),
        "slides": np.array(slides),
        "placements": np.concatenate(placements),
        "tips": np.array(tips),
        "object_placements": np.concatenate(objects),
        "alpha": np.ascontiguousarray(chain.alpha),
        "holding": float(chain.holding),
    }


def turned(chain: ClosedChain) -> list[Array]:
    """The kernel's frame of each joint in the joint's own, a rotation; of the world first.

    Args:
        chain: the closed chain, whose joints have one axis each.
    """
    axes = [_axis(chain.model.joints[j]) for j in range(1, chain.model.njoints)]
    return [np.eye(3), *(np.eye(3) if axis is None else _z_along(axis[1]) for axis in axes)]


def flat_settings(
    problem: ControlProblem, damping: float, error_damping: float, inequalities: int
) -> Flat:
    """Numbers of a problem that hold for all ticks.

    Args:
        problem: what to control.
        damping: cost of |v|^2.
        error_damping: share of the damping that rules out any overshoot.
        inequalities: how many rows of limits there are.
    """
    chain, budget = problem.chain, problem.budget
    return {
        "dt": problem.dt,
        "kappa": problem.kappa,
        "damping": damping,
        "error_damping": error_damping,
        "reach": chain.reach,
        "budget": np.array(
            [
                budget.equality,
                budget.bound,
                budget.accuracy,
                budget.loop_position,
                budget.loop_orientation,
            ]
        ),
        "lower": np.maximum(chain.lower, -LARGE),
        "upper": np.minimum(chain.upper, LARGE),
        "second_order": opening(chain, problem.dt).ravel(),
        "inequalities": float(inequalities),
        "relaxes": float(problem.on_infeasible == "scale"),
    }


def flat_joint_limit(bounds: JointBounds) -> Flat:
    """Bounds on the joints, as numbers."""
    return {
        "kind": float(bounds.of),
        "lower": np.maximum(bounds.lower, -LARGE),
        "upper": np.minimum(bounds.upper, LARGE),
        "step": np.zeros(0) if bounds.step is None else bounds.step,
        "speed": float(bounds.speed),
    }


def flat_twist_limit(bounds: TwistBounds, at: int) -> Flat:
    """Rows that see the object's twist, as numbers.

    Args:
        bounds: on the twist.
        at: the first of the rows.
    """
    return {
        "at": float(at),
        "components": np.array(bounds.components, float),
        "bounds": np.array(bounds.bounds, float),
        "points": np.array(bounds.points, float).ravel(),
        "normal": np.array(bounds.normal, float),
        "offset": float(bounds.offset),
        "gain": float(bounds.gain),
    }


def kept_rows(chain: ClosedChain) -> Array:
    """1 for each loop row that the solvers see, shape (6 L,) of the closed loops."""
    kept = np.zeros(chain.loops.closed)
    kept[list(chain.loops.kept)] = 1.0
    return kept


def _axis(joint: pin.JointModel) -> tuple[bool, Array] | None:
    """Whether a joint slides, and along or about which axis."""
    S = axis_of(joint)
    if S is None:
        return None
    linear, angular = S[:3], S[3:]
    if linear.any() and angular.any():
        return None
    slides = bool(linear.any())
    return slides, linear if slides else angular


def _z_along(axis: Array) -> Array:
    """A rotation A with A e_z along the axis."""
    d = axis / np.linalg.norm(axis)
    if d[2] == 1.0:
        return np.eye(3)
    least = int(np.argmin(np.abs(d)))
    x = np.eye(3)[least] - d[least] * d
    x /= np.linalg.norm(x)
    return np.column_stack([x, np.cross(d, x), d])


def _placement(R: Array, p: Array) -> Array:
    return np.concatenate([R.ravel(), p])
