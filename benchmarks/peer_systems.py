"""The peers that share an environment with coopqp, each as a motion of the same job.

A motion sleeps for a time before each tick [s], so that caches and clocks are a loop's, and returns
the median of its ticks [us] and how far from the last target it ends [m]. A tick begins when the
target is set and ends when the joints have moved.
"""

from __future__ import annotations

from collections.abc import Callable
from statistics import median
from time import perf_counter_ns, sleep
from typing import Literal

import daqp
import numpy as np
import pink
import pinocchio as pin
from peer_jobs import TARGET, TICKS, Job
from pink.limits import ConfigurationLimit, VelocityLimit
from pink.tasks import FrameTask, RelativeFrameTask

from coopqp.base.spec import Array
from coopqp.controllers import QPController
from coopqp.signal import POINT, InputValues, Trajectory

Motion = Callable[[float], tuple[float, float]]
DAMPING = 1e-6
#: daqp's word for a row that is an equality.
EQUALITY = 5


def median_us(step: Callable[[int], None], pause: float) -> float:
    """Of the ticks of a motion."""
    times = []
    for k in range(TICKS):
        if pause:
            sleep(pause)
        before = perf_counter_ns()
        step(k)
        times.append(perf_counter_ns() - before)
    return 1e-3 * median(times)


def kernel(job: Job) -> Motion:
    """coopqp, compiled."""
    return _coopqp(job, "kernel")


def plain(job: Job) -> Motion:
    """coopqp, the same law in Python."""
    return _coopqp(job, "python")


def _coopqp(job: Job, engine: Literal["kernel", "python"]) -> Motion:
    problem = job.problem
    built = QPController(engine=engine).build(problem)

    def motion(pause: float) -> tuple[float, float]:
        state = built.start()
        target = Trajectory(POINT, state.p_WO)
        state.inputs = InputValues()
        state.inputs[TARGET] = target
        value, targets = target.value, job.targets

        def step(k: int) -> None:
            value[...] = targets[k]
            built.step(state)

        us = median_us(step, pause)
        state.update()
        return us, float(np.linalg.norm(state.p_WO - targets[-1]))

    return motion


def pinks(job: Job) -> Motion:
    """Pink with daqp: the loops are constraints."""
    chain, dt = job.problem.chain, job.problem.dt
    limits = [ConfigurationLimit(chain.model, 1.0), VelocityLimit(chain.model)]
    first, *others = (chain.model.frames[frame].name for frame in chain.frames)

    def motion(pause: float) -> tuple[float, float]:
        at = pink.Configuration(chain.model, chain.model.createData(), chain.q_start)
        reach = FrameTask(first, position_cost=1.0, orientation_cost=0.0, gain=job.gain * dt)
        loops = [
            RelativeFrameTask(other, first, position_cost=1.0, orientation_cost=1.0)
            for other in others
        ]
        for loop in loops:
            loop.set_target_from_configuration(at)
        R = at.get_transform_frame_to_world(first).rotation.copy()

        def step(k: int) -> None:
            reach.set_target(pin.SE3(R, job.targets[k]))
            v = pink.solve_ik(
                at, [reach], dt, solver="daqp", limits=limits, constraints=loops, damping=DAMPING
            )
            at.integrate_inplace(v, dt)

        us = median_us(step, pause)
        end = at.get_transform_frame_to_world(first).translation
        return us, float(np.linalg.norm(end - job.targets[-1]))

    return motion


def minks(job: Job) -> Motion | None:
    """The same by mink on MuJoCo; None where it is not installed."""
    try:
        import mink
        import mujoco
    except ImportError:
        return None
    chain, dt = job.problem.chain, job.problem.dt
    model = mujoco.MjModel.from_xml_string(job.urdf)
    at_q = [int(model.joint(name).qposadr[0]) for name in chain.joint_names]
    limits = [
        mink.ConfigurationLimit(model, gain=1.0),
        mink.VelocityLimit(model, dict(zip(chain.joint_names, chain.velocity, strict=True))),
    ]
    q = np.zeros(model.nq)
    q[at_q] = chain.q_start

    def motion(pause: float) -> tuple[float, float]:
        at = mink.Configuration(model, q=q)
        reach = mink.FrameTask("object0", "body", 1.0, 0.0, gain=job.gain * dt)
        loops = [
            mink.RelativeFrameTask(f"object{i}", "body", "object0", "body", 1.0, 1.0)
            for i in range(1, len(chain.arms))
        ]
        for loop in loops:
            loop.set_target_from_configuration(at)
        R = at.get_transform_frame_to_world("object0", "body").rotation()

        def step(k: int) -> None:
            reach.set_target(mink.SE3.from_rotation_and_translation(R, job.targets[k]))
            v = mink.solve_ik(
                at, [reach], dt, "daqp", damping=DAMPING, limits=limits, constraints=loops
            )
            at.integrate_inplace(v, dt)

        us = median_us(step, pause)
        end = at.get_transform_frame_to_world("object0", "body").translation()
        return us, float(np.linalg.norm(end - job.targets[-1]))

    return motion


def by_hand(job: Job) -> Motion:
    """Pinocchio and daqp without anything between them: no names, no checks."""
    chain, dt = job.problem.chain, job.problem.dt
    model, n, frames = chain.model, chain.n, chain.frames
    m = 6 * (len(frames) - 1)
    H, f = np.zeros((n, n)), np.zeros(n)
    A = np.zeros((m, n))
    lower, upper = np.zeros(n + m), np.zeros(n + m)
    clean = np.zeros(n + m, np.intc)
    clean[n:] = EQUALITY
    eye = DAMPING * np.eye(n)

    def motion(pause: float) -> tuple[float, float]:
        data, q, sense = model.createData(), chain.q_start.copy(), clean.copy()

        def jacobian(frame: int) -> Array:
            pin.updateFramePlacement(model, data, frame)
            return pin.getFrameJacobian(model, data, frame, pin.LOCAL_WORLD_ALIGNED)

        def step(k: int) -> None:
            pin.computeJointJacobians(model, data, q)
            J = jacobian(frames[0])
            X = data.oMf[frames[0]]
            for i, frame in enumerate(frames[1:]):
                rows = slice(6 * i, 6 * i + 6)
                np.subtract(jacobian(frame), J, A[rows])
                Y, e = data.oMf[frame], upper[n + 6 * i : n + 6 * i + 6]
                e[:3] = (X.translation - Y.translation) / dt
                e[3:] = pin.log3(Y.rotation.dot(X.rotation.T)) / -dt
            lower[n:] = upper[n:]
            J = J[:3]
            np.add(J.T.dot(J), eye, H)
            np.dot(J.T, job.gain * (X.translation - job.targets[k]), f)
            np.maximum((chain.lower - q) / dt, -chain.velocity, lower[:n])
            np.minimum((chain.upper - q) / dt, chain.velocity, upper[:n])
            sense[:] = clean
            v, _, _, _ = daqp.solve(H, f, A, upper, lower, sense)
            np.add(q, dt * v, q)

        us = median_us(step, pause)
        pin.framesForwardKinematics(model, data, q)
        return us, float(np.linalg.norm(data.oMf[frames[0]].translation - job.targets[-1]))

    return motion
