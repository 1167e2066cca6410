"""What the bodies of a MuJoCo file look like, weigh and must not hit others with.

Meshes take time to read and matter mostly when drawn: MuJoCo gets the triangles of those alone
that a moving body has its mass of, and they are read here, within bounds. In the place of others,
and of what we have no shape for, a geom that weighs next to nothing stands while it compiles.
Left out are planes; drawn are no geoms that only collide (group above 2).
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pinocchio as pin

from coopqp.base.errors import InvalidValueError
from coopqp.base.reading import absolute
from coopqp.robot import Shape
from coopqp.robot_files.meshes import Mesh, read_mesh
from coopqp.robot_files.mjcf_model import Named, pose
from coopqp.robot_files.xml import missing_meshes

#: Of MuJoCo's geoms kind and size as a shape has them.
SIZES: dict[str, Callable[[list[float]], tuple[float, ...]]] = {
    "box": lambda half: (2.0 * half[0], 2.0 * half[1], 2.0 * half[2]),
    "sphere": lambda size: (size[0],),
    "ellipsoid": lambda radii: (radii[0], radii[1], radii[2]),
    "capsule": lambda size: (size[0], 2.0 * size[1]),
    "cylinder": lambda size: (size[0], 2.0 * size[1]),
}
#: Kinds that neither pinocchio nor coal has.
NOT_READ = ("hfield", "sdf")
#: Mass [kg] and radius [m] of what stands for a geom, and what does so for a mesh.
STAND_IN = 1e-9, 0.1
TETRAHEDRON = Mesh(
    np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]),
    np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]),
)
DRAWN = 2  # the last group that is


@dataclass(frozen=True, eq=False)
class _Form:
    """A geom as the file has it.

    Attributes:
        geom, mesh: of MuJoCo's; no mesh where it neither is one nor is fitted to one.
        name: of the mesh.
        kind: of the geom.
        collides, drawn: what it is for.
    """

    geom: Any
    mesh: Any
    name: str
    kind: str
    collides: bool
    drawn: bool


class Geoms:
    """The geoms of a file, made ready for being compiled.

    Args:
        mujoco: the package.
        spec: the file as MuJoCo has read it; is changed.
        path: of the file.
    """

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
                self._stand_in(form.geom)
        for name, mesh in self._meshes.items():
            if mesh.file:
                surface = surfaces.get(name) or TETRAHEDRON
                mesh.uservert, mesh.userface = surface.vertices.ravel(), surface.corners.ravel()
                mesh.file = mesh.content_type = ""

    def _file(self, mesh: Any) -> Path | None:
        """Of a mesh; None where it has its vertices in the robot's file."""
        if not mesh.file:
            return None
        name = Path(mesh.file).name if self._spec.strippath else mesh.file
        return Path(absolute(self._path).parent / self._spec.meshdir / name)

    def _form(self, geom: Any) -> _Form:
        looks = not (geom.contype or geom.conaffinity)
        return _Form(
            geom=geom,
            mesh=self._meshes.get(geom.meshname),
            name=geom.meshname,
            kind=self._mujoco.mjtGeom(geom.type).name.removeprefix("mjGEOM_").lower(),
            collides=not looks,
            drawn=looks or geom.group <= DRAWN,
        )

    def _weighs(self, geom: Any) -> bool:
        """Whether a body that moves has mass of a geom."""
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

    def _stand_in(self, geom: Any) -> None:
        geom.type, geom.meshname, geom.hfieldname = self._mujoco.mjtGeom.mjGEOM_SPHERE, "", ""
        geom.mass, geom.size[0] = STAND_IN

    def shapes(self, model: Any, named: Named) -> tuple[tuple[Shape, ...], tuple[Shape, ...]]:
        """What is drawn, and what must not hit others; a mesh whose file is not there only here.

        Args:
            model: that MuJoCo has compiled.
            named: names in it.
        """
        drawn, collide = [], []
        for form in self._forms:
            if shape := self._shape(form, model, named):
                if form.drawn and (shape.mesh is None or os.path.isfile(shape.mesh)):
                    drawn.append(shape)
                if form.collides:
                    collide.append(shape)
        return tuple(drawn), tuple(collide)

    def _shape(self, form: _Form, model: Any, named: Named) -> Shape | None:
        """As Shape has it; nothing for a plane, or what cannot be seen."""
        i = form.geom.id
        if _why_unseen(form, self._files) or form.kind not in (*SIZES, "mesh"):
            return None
        X, kind, mesh = pose(model.geom_pos[i], model.geom_quat[i]), form.kind, None
        if form.mesh is None:
            size = SIZES[kind](model.geom_size[i].tolist())
        else:
            if (moved := model.geom_dataid[i]) >= 0:  # MuJoCo has put it about its middle
                X = X * pose(model.mesh_pos[moved], model.mesh_quat[moved]).inverse()
            R, size = (
                pose(np.zeros(3), form.mesh.refquat).rotation.T,
                tuple(form.mesh.scale.tolist()),
            )
            X = X * pin.SE3(R, -np.array(size) * (R @ form.mesh.refpos))
            kind, mesh = "mesh", self._files[form.name]
        named_kind: Any = kind
        return Shape(frame=named.geoms[i], placement=X, kind=named_kind, size=size, mesh=mesh)

    def unseen(self, named: Named) -> tuple[str, ...]:
        """What is not watched, a sentence each."""
        return tuple(
            f"{named.geoms[form.geom.id]}: {why}"
            for form in self._forms
            if form.collides and (why := _why_unseen(form, self._files))
        )

    def warnings(
        self, named: Named, drawn: Sequence[Shape], collide: Sequence[Shape]
    ) -> tuple[str, ...]:
        """What is not drawn as it is, or weighs less than it does.

        Args:
            named: names in the compiled model.
            drawn: shapes of the bodies.
            collide: the same.
        """
        missing = [
            self._given[name] or f"{name}, of vertices"
            for name, file in self._files.items()
            if file is None or not os.path.isfile(file)
        ]
        light = dict.fromkeys(named.geoms[form.geom.id] for form in self._light)
        seen = {shape.frame for shape in drawn}
        there = [shape for shape in collide if shape.mesh is None or os.path.isfile(shape.mesh)]
        hidden = dict.fromkeys(shape.frame for shape in there if shape.frame not in seen)
        found = [*missing_meshes(self._path.name, missing, len(self._files))]
        if light:
            words = "lack the mass of meshes that are not read; give <inertial>"
            found.append(f"{self._path.name}: {len(light)} bodies {words} ({_first(light)})")
        if hidden:
            words = "are not drawn as they are, since all their geoms are of groups above 2"
            found.append(f"{self._path.name}: {len(hidden)} bodies {words} ({_first(hidden)})")
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


def _first(names: Iterable[str]) -> str:
    first = list(names)
    return ", ".join(first[:3]) + (", ..." if len(first) > 3 else "")
