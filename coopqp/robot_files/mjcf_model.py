"""From a model that MuJoCo has compiled to a pinocchio model and shapes.

MuJoCo's joint frames turn with the body, and a body may have several joints: each is a joint of
pinocchio at its anchor, one after another, and the body's frame is behind the last of them.

MuJoCo gets only the triangles of meshes that a moving body has its mass of, read here within
bounds. In the place of other meshes, and of kinds without a shape here, a geom of negligible mass
stands while it compiles. Planes are left out; geoms that only collide (group above 2) are not
drawn.
"""

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pinocchio as pin

from coopqp.base.errors import InvalidValueError
from coopqp.base.reading import absolute
from coopqp.base.spec import Array
from coopqp.robot import Shape
from coopqp.robot_files.meshes import Mesh, read_mesh
from coopqp.robot_files.selection import Follower
from coopqp.robot_files.xml import missing_meshes

WORLD = "world/"  # prefix of a geom's name that a body has already; names in files may have it, too
#: Numbers of MuJoCo's kinds of joints, motors and equalities.
FREE, BALL, SLIDE, HINGE = 0, 1, 2, 3
AT_JOINT, FIXED_GAIN, NO_BIAS, OF_CONTROL, JOINT_TIE = (0, 1), 0, 0, (0, 2, 3), 2
#: Joints about and along the axes of their body, which pinocchio moves faster.
ALIGNED = {
    (SLIDE, (1.0, 0.0, 0.0)): pin.JointModelPX,
    (SLIDE, (0.0, 1.0, 0.0)): pin.JointModelPY,
    (SLIDE, (0.0, 0.0, 1.0)): pin.JointModelPZ,
    (HINGE, (1.0, 0.0, 0.0)): pin.JointModelRX,
    (HINGE, (0.0, 1.0, 0.0)): pin.JointModelRY,
    (HINGE, (0.0, 0.0, 1.0)): pin.JointModelRZ,
}
UNALIGNED = {SLIDE: pin.JointModelPrismaticUnaligned, HINGE: pin.JointModelRevoluteUnaligned}


def row_of(element: Any, compiled: Any) -> int:
    """A specification's element in the compiled model; before MuJoCo 3.4 it must have a name."""
    return int(element.id if hasattr(element, "id") else compiled(element.name).id)


class Named:
    """Names in a model, in its order; without one such as "body_3".

    Attributes:
        bodies: pinocchio's world first.
        joints: after their body without a name, "upper_joint_2".
        geoms: frames that they are fixed to: their bodies', or their own, "geom_3", in the world.
        sites: empty where they have none.
    """

    def __init__(self, model: Any) -> None:
        self.bodies = ["universe"]
        self.bodies += [model.body(i).name or f"body_{i}" for i in range(1, model.nbody)]
        first = model.body_jntadr[model.jnt_bodyid]
        self.joints = [
            model.joint(i).name or f"{self.bodies[model.jnt_bodyid[i]]}_joint_{i - first[i] + 1}"
            for i in range(model.njnt)
        ]
        self.sites = [model.site(i).name for i in range(model.nsite)]
        self.geoms = [self.bodies[body] for body in model.geom_bodyid]
        taken = {*self.bodies, *self.joints, *self.sites}
        for i in np.flatnonzero(model.geom_bodyid == 0):
            name = model.geom(i).name or f"geom_{i + 1}"
            self.geoms[i] = f"{WORLD}{name}" if name in taken else name


def pinocchio_model(model: Any, named: Named) -> pin.Model:
    """All joints but the free ones, with frames of bodies, sites, joints and the world's geoms."""
    made = pin.Model()
    at = [(0, pin.SE3.Identity())]  # joint of each body, and its pose in that joint
    for body in range(1, model.nbody):
        parent, X = at[model.body_parentid[body]]
        X = X * pose(model.body_pos[body], model.body_quat[body])
        first = model.body_jntadr[body]
        for joint in range(first, first + model.body_jntnum[body]):
            if model.jnt_type[joint] != FREE:
                anchor = pin.SE3(np.eye(3), np.array(model.jnt_pos[joint]))
                at_anchor = X * anchor * _back_to_zero(model, joint)
                parent = _add_joint(made, model, joint, parent, at_anchor, named.joints[joint])
                X = anchor.inverse()
        own = pose(model.body_ipos[body], model.body_iquat[body])
        moments = own.rotation @ np.diag(model.body_inertia[body]) @ own.rotation.T
        inertia = pin.Inertia(float(model.body_mass[body]), own.translation, moments)
        made.appendBodyToJoint(parent, inertia, X)
        made.addBodyFrame(named.bodies[body], parent, X, 0)
        at.append((parent, X))
    turned = [dof for dof in range(model.nv) if model.jnt_type[model.dof_jntid[dof]] != FREE]
    made.armature, made.damping = model.dof_armature[turned], model.dof_damping[turned]
    for site, name in enumerate(named.sites):
        if name:
            joint, X = at[model.site_bodyid[site]]
            X = X * pose(model.site_pos[site], model.site_quat[site])
            made.addFrame(pin.Frame(name, joint, X, pin.FrameType.OP_FRAME), False)
    for geom in np.flatnonzero(model.geom_bodyid == 0):
        made.addBodyFrame(named.geoms[geom], 0, pin.SE3.Identity(), 0)
    return made


def _add_joint(made: pin.Model, model: Any, joint: int, parent: int, X: pin.SE3, name: str) -> int:
    kind, axis = int(model.jnt_type[joint]), np.array(model.jnt_axis[joint])
    if (aligned := ALIGNED.get((kind, tuple(axis.tolist())))) is not None:
        new: Any = aligned()
    else:
        new = UNALIGNED[kind](axis) if kind in UNALIGNED else pin.JointModelSpherical()
    lower, upper = np.full(new.nq, -np.inf), np.full(new.nq, np.inf)
    if model.jnt_limited[joint] and new.nq == 1:
        lower[0], upper[0] = model.jnt_range[joint]
    effort, velocity = np.full(new.nv, _effort(model, joint)), np.full(new.nv, np.inf)
    index = int(made.addJoint(parent, new, X, name, effort, velocity, lower, upper))
    made.addJointFrame(index)
    return index


def _back_to_zero(model: Any, joint: int) -> pin.SE3:
    """From a joint's reference position, as the file draws it, to zero."""
    axis, back = np.array(model.jnt_axis[joint]), -float(model.qpos0[model.jnt_qposadr[joint]])
    if model.jnt_type[joint] == BALL or not back:
        return pin.SE3.Identity()
    if model.jnt_type[joint] == SLIDE:
        return pin.SE3(np.eye(3), back * axis)
    return pin.SE3(pin.exp3(back * axis), np.zeros(3))


def pose(p: Array, quaternion: Array) -> pin.SE3:
    """Of a position and a quaternion with w first."""
    return pin.SE3(pin.Quaternion(*map(float, quaternion)).matrix(), np.array(p))


def _effort(model: Any, joint: int) -> float:
    """Effort limit of a joint's motors in both directions [N m or N]; infinite if unknown."""
    at_joint = np.isin(model.actuator_trntype, AT_JOINT)
    motors = np.flatnonzero((model.actuator_trnid[:, 0] == joint) & at_joint)
    low, high = -np.inf, np.inf
    if len(motors):
        low, high = np.sum([_motor(model, motor) for motor in motors], axis=0)
    if model.jnt_actfrclimited[joint]:
        lower, upper = model.jnt_actfrcrange[joint]
        low, high = max(low, lower), min(high, upper)
    return float(min(-low, high))


def _motor(model: Any, motor: Any) -> tuple[float, float]:
    """Force range of a motor at its joint."""
    low, high = -np.inf, np.inf
    gain, gear = float(model.actuator_gainprm[motor, 0]), float(model.actuator_gear[motor, 0])
    linear = model.actuator_gaintype[motor] == FIXED_GAIN and (
        model.actuator_biastype[motor] == NO_BIAS and model.actuator_dyntype[motor] in OF_CONTROL
    )
    if linear and model.actuator_ctrllimited[motor] and gain:
        low, high = sorted(gain * model.actuator_ctrlrange[motor])
    if model.actuator_forcelimited[motor]:
        lower, upper = model.actuator_forcerange[motor]
        low, high = max(low, lower), min(high, upper)
    low, high = sorted((gear * low, gear * high)) if gear else (0.0, 0.0)
    return low, high


def followers(model: Any, named: Named) -> dict[str, Follower]:
    """Joints that an equality ties to another one."""
    found = {}
    for tie in np.flatnonzero((model.eq_type == JOINT_TIE) & (model.eq_active0 != 0)):
        i, offset, ratio = model.eq_obj2id[tie], *map(float, model.eq_data[tie, :2])
        leader = named.joints[i] if i >= 0 else ""
        own = named.joints[model.eq_obj1id[tie]]
        found[own] = Follower(leader=leader, ratio=ratio, offset=offset)
    return found


def floating(model: Any, named: Named) -> dict[str, frozenset[str]]:
    """Free joints, and the names of all that each moves."""
    root, found = model.body_rootid, {}
    names = [*named.bodies, *named.joints, *named.sites]
    bodies = np.concatenate([np.arange(model.nbody), model.jnt_bodyid, model.site_bodyid])
    for joint in np.flatnonzero(model.jnt_type == FREE):
        moved = np.flatnonzero(root[bodies] == model.jnt_bodyid[joint])
        found[named.joints[joint]] = frozenset(names[i] for i in moved)
    return found


#: Of MuJoCo's geoms kind and size as a shape has them.
SIZES: dict[str, Callable[[list[float]], tuple[float, ...]]] = {
    "box": lambda half: (2.0 * half[0], 2.0 * half[1], 2.0 * half[2]),
    "sphere": lambda size: (size[0],),
    "ellipsoid": lambda radii: (radii[0], radii[1], radii[2]),
    "capsule": lambda size: (size[0], 2.0 * size[1]),
    "cylinder": lambda size: (size[0], 2.0 * size[1]),
}
NOT_READ = ("hfield", "sdf")  # kinds that neither pinocchio nor coal has
#: Mass [kg] and radius [m] of what stands for a geom, and what does so for a mesh.
STAND_IN = 1e-9, 0.1
CORNERS = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
TETRAHEDRON = Mesh(np.vstack([np.zeros(3), np.eye(3)]), CORNERS)
DRAWN = 2  # the last group that is


@dataclass(frozen=True, eq=False)
class _Form:
    """A geom; ``mesh``, called ``name``, is MuJoCo's, None if it is none nor fitted to one."""

    geom: Any
    mesh: Any
    name: str
    kind: str
    collides: bool
    drawn: bool


class Geoms:
    """The geoms of a file; prepares MuJoCo's ``spec`` of it for compilation."""

    def __init__(self, mujoco: ModuleType, spec: Any, path: Path) -> None:
        self._mujoco, self._spec, self._path = mujoco, spec, path
        self._meshes = {mesh.name: mesh for mesh in spec.meshes}
        self._files = {name: self._file(mesh) for name, mesh in self._meshes.items()}
        self._given = {name: mesh.file for name, mesh in self._meshes.items()}
        self._forms = [self._form(geom) for geom in spec.geoms]
        weigh = [form for form in self._forms if form.mesh is not None and self._weighs(form.geom)]
        meshes = [form for form in weigh if form.kind == "mesh"]
        surfaces = {form.name: self._surface(form.name) for form in meshes}
        known = [form for form in meshes if surfaces[form.name] or not self._files[form.name]]
        self._light = [form for form in weigh if form not in known]
        for form in self._forms:
            if form in known:
                form.geom.contype = form.geom.conaffinity = 0  # so that it needs no hull
            elif form.kind in NOT_READ or form.mesh is not None:
                geom = form.geom
                geom.type, geom.meshname, geom.hfieldname = mujoco.mjtGeom.mjGEOM_SPHERE, "", ""
                geom.mass, geom.size[0] = STAND_IN
        for name, mesh in self._meshes.items():
            if mesh.file:
                surface = surfaces.get(name) or TETRAHEDRON
                mesh.uservert, mesh.userface = surface.vertices.ravel(), surface.corners.ravel()
                mesh.file = mesh.content_type = ""

    def _file(self, mesh: Any) -> Path | None:
        """A mesh's file; None where its vertices are in the robot's file."""
        if not mesh.file:
            return None
        name = Path(mesh.file).name if self._spec.strippath else mesh.file
        return Path(absolute(self._path).parent / self._spec.meshdir / name)

    def _form(self, geom: Any) -> _Form:
        looks = not (geom.contype or geom.conaffinity)
        kind = self._mujoco.mjtGeom(geom.type).name.removeprefix("mjGEOM_").lower()
        mesh, drawn = self._meshes.get(geom.meshname), looks or geom.group <= DRAWN
        return _Form(geom, mesh, geom.meshname, kind, collides=not looks, drawn=drawn)

    def _weighs(self, geom: Any) -> bool:
        """Whether a geom contributes to the mass of a moving body."""
        body, of_all = geom.parent, self._spec.compiler.inertiafromgeom
        kinds = self._mujoco.mjtInertiaFromGeom
        own = body.explicitinertial and of_all != kinds.mjINERTIAFROMGEOM_TRUE
        if own or of_all == kinds.mjINERTIAFROMGEOM_FALSE or 0.0 in (geom.mass, geom.density):
            return False
        while body.name != "world" and not body.joints:
            body = body.parent
        return bool(body.joints)

    def _surface(self, name: str) -> Mesh | None:
        """The triangles of a mesh, without its scale; None where they cannot be read."""
        file = self._files[name]
        try:
            return read_mesh(file, (1.0, 1.0, 1.0)) if file else None
        except InvalidValueError:
            return None

    def shapes(self, model: Any, named: Named) -> tuple[tuple[Shape, ...], tuple[Shape, ...]]:
        """Visual and collision shapes; a mesh without a file is in the latter alone."""
        drawn, collide = [], []
        for form in self._forms:
            if shape := self._shape(form, model, named):
                if form.drawn and (shape.mesh is None or os.path.isfile(shape.mesh)):
                    drawn.append(shape)
                if form.collides:
                    collide.append(shape)
        return tuple(drawn), tuple(collide)

    def _shape(self, form: _Form, model: Any, named: Named) -> Shape | None:
        i = row_of(form.geom, model.geom)
        if _why_unseen(form, self._files) or form.kind not in (*SIZES, "mesh"):
            return None
        X, kind, mesh = pose(model.geom_pos[i], model.geom_quat[i]), form.kind, None
        if form.mesh is None:
            size = SIZES[kind](model.geom_size[i].tolist())
        else:
            if (moved := model.geom_dataid[i]) >= 0:  # MuJoCo has centred it
                X = X * pose(model.mesh_pos[moved], model.mesh_quat[moved]).inverse()
            size = tuple(form.mesh.scale.tolist())
            R = pose(np.zeros(3), form.mesh.refquat).rotation.T
            X = X * pin.SE3(R, -np.array(size) * (R @ form.mesh.refpos))
            kind, mesh = "mesh", self._files[form.name]
        named_kind: Any = kind
        return Shape(frame=named.geoms[i], placement=X, kind=named_kind, size=size, mesh=mesh)

    def unseen(self, model: Any, named: Named) -> tuple[str, ...]:
        """Collision geoms that are not read, a sentence each."""
        collide = ((f.geom, _why_unseen(f, self._files)) for f in self._forms if f.collides)
        unseen = ((named.geoms[row_of(geom, model.geom)], why) for geom, why in collide if why)
        return tuple(f"{frame}: {why}" for frame, why in unseen)

    def warnings(
        self, model: Any, named: Named, drawn: Sequence[Shape], collide: Sequence[Shape]
    ) -> tuple[str, ...]:
        """What is not drawn as it is, or weighs less than it should."""
        gone = (k for k, file in self._files.items() if file is None or not os.path.isfile(file))
        missing = [self._given[name] or f"{name}, of vertices" for name in gone]
        rows = [row_of(form.geom, model.geom) for form in self._light]
        visible = {shape.frame for shape in drawn}
        there = [shape for shape in collide if shape.mesh is None or os.path.isfile(shape.mesh)]
        hidden = (shape.frame for shape in there if shape.frame not in visible)
        found = [*missing_meshes(self._path.name, missing, len(self._files))]
        for bodies, words in (
            ((named.geoms[row] for row in rows),
             "lack the mass of meshes that are not read; give <inertial>"),
            (hidden, "are not drawn as they are, since all their geoms are of groups above 2"),
        ):  # fmt: skip
            if names := list(dict.fromkeys(bodies)):
                first = ", ".join(names[:3]) + (", ..." if len(names) > 3 else "")
                found.append(f"{self._path.name}: {len(names)} bodies {words} ({first})")
        return tuple(found)


def _why_unseen(form: _Form, files: Mapping[str, Path | None]) -> str:
    """Why no shape is made of what is no plane; empty if one is."""
    if form.kind in NOT_READ:
        return f"a geom of type {form.kind} is not read"
    if form.mesh is None:
        return ""
    if files[form.name] is None:
        return f"mesh {form.name}: is given by vertices, which are not read; put them in a file"
    if len(set(form.mesh.scale)) > 1 and any(form.mesh.refquat[1:]):
        return f"mesh {form.name}: is turned by refquat and scaled unevenly, which is not read"
    return ""
