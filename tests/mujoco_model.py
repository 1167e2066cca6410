"""The same closed chain in MuJoCo, written out body by body: an oracle that shares no code."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin

from coopqp.base.spec import Array
from coopqp.model.closed_chain import ClosedChain


@dataclass(frozen=True)
class Work:
    """Virtual work along closed-loop motions.

    Attributes:
        motions: of the chain's joints, orthonormal columns, shape (n, f).
        done: generalised force that the motors must supply along each, shape (f,) [N m].
    """

    motions: Array
    done: Array


class MujocoChain:
    """Arms as nested bodies, the object as a free body, one weld per hand.

    Args:
        chain: with revolute joints alone.
    """

    def __init__(self, chain: ClosedChain) -> None:
        import mujoco

        self._mujoco: Any = mujoco
        self.chain = chain
        spec = mujoco.MjSpec()
        spec.option.jacobian = mujoco.mjtJacobian.mjJAC_DENSE
        spec.option.timestep = 1e-4
        spec.option.gravity = [0.0, 0.0, -9.81]
        spec.compiler.balanceinertia = False
        bodies = self._add_arms(spec)
        self._add_object(spec, bodies)
        self.model = spec.compile()
        self.data = mujoco.MjData(self.model)
        self._q = [self.model.joint(name).qposadr[0] for name in chain.joint_names]
        self._v = [self.model.joint(name).dofadr[0] for name in chain.joint_names]
        self._object_q = self.model.joint("object").qposadr[0]
        self._object_v = self.model.joint("object").dofadr[0]

    def _add_arms(self, spec: Any) -> list[Any]:
        model = self.chain.model
        bodies = [spec.worldbody]
        for joint in range(1, model.njoints):
            X = model.jointPlacements[joint]
            body = bodies[model.parents[joint]].add_body(
                name=model.names[joint], pos=X.translation, quat=_quat(X.rotation)
            )
            axis = _axis(model, joint)
            body.add_joint(
                name=model.names[joint], axis=axis, type=self._mujoco.mjtJoint.mjJNT_HINGE
            )
            inertia = model.inertias[joint]
            # A link behind a passive joint has no mass; MuJoCo needs a trace of one.
            _set_inertia(body, max(inertia.mass, 1e-9), inertia.lever, inertia.inertia)
            bodies.append(body)
        return bodies

    def _add_object(self, spec: Any, bodies: list[Any]) -> None:
        chain, held = self.chain, self.chain.held.body()
        body = spec.worldbody.add_body(name="object", pos=chain.start_position)
        body.add_freejoint(name="object")
        _set_inertia(body, held.mass, held.lever, held.inertia)
        for frame_id in chain.frames:
            frame = chain.model.frames[frame_id]
            weld = spec.add_equality(
                type=self._mujoco.mjtEq.mjEQ_WELD,
                objtype=self._mujoco.mjtObj.mjOBJ_BODY,
                name1=bodies[frame.parentJoint].name,
                name2="object",
            )
            # anchor in body 2, pose of body 2 in body 1, weight of the rotation
            X = frame.placement
            weld.data[:11] = [0, 0, 0, *X.translation, *_quat(X.rotation), 1.0]

    def gravity_work(self, q: Array) -> Work:
        """What the motors must do at rest."""
        return self.work(q, np.zeros(self.chain.n), np.zeros(self.chain.n))

    def work(self, q: Array, v: Array, a: Array) -> Work:
        """What the motors must do for a motion, along MuJoCo's closed-loop motions.

        Args:
            q: of the chain's joints, loops closed.
            v: their velocity.
            a: their acceleration.
        """
        mujoco, model, data = self._mujoco, self.model, self.data
        self._place(q, v)
        mujoco.mj_forward(model, data)
        J = data.efc_J.reshape(data.nefc, model.nv)
        assert np.abs(data.efc_pos).max() < 1e-6, "the welds are open"
        assert np.abs(J @ data.qvel).max() < 1e-6, "the welds are opening"
        _, sizes, rows = np.linalg.svd(J)
        free = rows[np.sum(sizes > 1e-8 * sizes[0]) :].T
        qacc = np.zeros(model.nv)
        qacc[self._v] = a
        qacc[self._object_v : self._object_v + 6] = self._object_acceleration(q, v, a)
        inertia = np.zeros(model.nv)
        mujoco.mj_mulM(model, data, inertia, qacc)
        done = free.T @ (inertia + data.qfrc_bias)
        # Any motion of the joints moves the object, so that the joints' part spans them all.
        motions, triangle = np.linalg.qr(free[self._v])
        return Work(motions, np.linalg.solve(triangle.T, done))

    def _place(self, q: Array, v: Array) -> None:
        data, at = self.data, self._object_q
        X, twist = self._object_by_differences(q, v)
        data.qpos[self._q], data.qvel[self._v] = q, v
        data.qpos[at : at + 3], data.qpos[at + 3 : at + 7] = X.translation, _quat(X.rotation)
        data.qvel[self._object_v : self._object_v + 6] = twist

    def _object_by_differences(self, q: Array, v: Array) -> tuple[pin.SE3, Array]:
        """Pose, and velocity as MuJoCo counts it: linear in the world, angular in the body."""
        h = 1e-5
        before, now, after = (self._object_pose(q + k * h * v) for k in (-1, 0, 1))
        linear = (after.translation - before.translation) / (2 * h)
        angular = pin.log3(before.rotation.T @ after.rotation) / (2 * h)
        return now, np.concatenate([linear, angular])

    def _object_acceleration(self, q: Array, v: Array, a: Array) -> Array:
        h = 2e-5
        twists = [
            self._object_by_differences(q + k * h * v + 0.5 * h * h * a, v + k * h * a)[1]
            for k in (-1, 1)
        ]
        return np.asarray((twists[1] - twists[0]) / (2 * h))

    def _object_pose(self, q: Array) -> pin.SE3:
        """Where MuJoCo's first arm carries the object."""
        mujoco, model, data = self._mujoco, self.model, self.data
        data.qpos[self._q] = q
        mujoco.mj_kinematics(model, data)
        frame = self.chain.model.frames[self.chain.frames[0]]
        body = data.body(self.chain.model.names[frame.parentJoint])
        return pin.SE3(body.xmat.reshape(3, 3).copy(), body.xpos.copy()) * frame.placement


def _set_inertia(body: Any, mass: float, com: Array, matrix: Array) -> None:
    moments, axes = np.linalg.eigh(matrix)
    if np.linalg.det(axes) < 0.0:
        axes[:, 0] *= -1.0
    body.explicitinertial = True
    body.mass, body.ipos, body.iquat = mass, com, _quat(axes)
    body.inertia = np.maximum(moments, 1e-12)


def _axis(model: pin.Model, joint: int) -> Array:
    """The joint's axis in its own frame, from what its coordinate does."""
    data = model.createData()
    pin.computeJointJacobians(model, data, np.zeros(model.nq))
    column = pin.getJointJacobian(model, data, joint, pin.LOCAL)[:, model.idx_vs[joint]]
    assert np.allclose(column[:3], 0.0), "a prismatic joint"
    return np.asarray(column[3:])


def _quat(R: Array) -> list[float]:
    x, y, z, w = pin.Quaternion(np.asarray(R)).coeffs()
    return [w, x, y, z]
