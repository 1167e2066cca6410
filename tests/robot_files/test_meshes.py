"""Meshes against coal's own loader, and hostile ones, each refused with its line."""

from __future__ import annotations

import os
import struct
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import coal
import numpy as np
import pytest
from scenario_files import needs_robots

from coopqp.base.errors import InvalidValueError
from coopqp.robot_files.meshes import read_mesh
from coopqp.robots.example_robot import robots

ONE = (1.0, 1.0, 1.0)
CORNERS = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 2.0, 0.0], [0.0, 0.0, 3.0]])
SIDES = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])

OBJ = """\
v 0 0 0
v 1 0 0
v 0 2 0 # y
v 0 0 3 1 0.5 0.5
f 1 3 2
f 1/1 2/2 4/4
f -4//1 -1//2 -2//3
f 2 3 4
"""


def text_stl() -> str:
    facets = "".join(
        "facet normal 0 0 0\n outer loop\n"
        + "".join("  vertex {} {} {}\n".format(*CORNERS[i]) for i in side)
        + " endloop\nendfacet\n"
        for side in SIDES
    )
    return f"solid tetrahedron\n{facets}endsolid tetrahedron\n"


def binary_stl(count: int = 4, header: bytes = b"solid by name alone") -> bytes:
    triangles = b"".join(struct.pack("<12fH", 0, 0, 0, *CORNERS[side].ravel(), 0) for side in SIDES)
    return header.ljust(80) + struct.pack("<I", count) + triangles


POINTS = " ".join(f"{x:g}" for x in CORNERS.ravel())
INDICES = " ".join(map(str, SIDES.ravel()))
DAE = f"""<COLLADA version="1.4.1">
<library_geometries><geometry id="g"><mesh>
<source id="s"><float_array id="a" count="12">{POINTS}</float_array>
<technique_common><accessor source="#a" count="4" stride="3">
<param name="X" type="float"/><param name="Y" type="float"/><param name="Z" type="float"/>
</accessor></technique_common></source>
<vertices id="v"><input semantic="POSITION" source="#s"/></vertices>
<triangles count="4"><input semantic="VERTEX" source="#v" offset="0"/><p>{INDICES}</p></triangles>
</mesh></geometry></library_geometries>
<library_nodes><node id="n"><instance_geometry url="#g"/></node></library_nodes>
<library_visual_scenes><visual_scene id="scene">
<node><translate>1 2 3</translate><rotate>0 0 1 90</rotate><scale>1 2 1</scale>
<instance_geometry url="#g"/></node>
<node><matrix>0 -2 0 1 2 0 0 2 0 0 2 3 0 0 0 1</matrix><instance_node url="#n"/></node>
</visual_scene></library_visual_scenes>
<scene><instance_visual_scene url="#scene"/></scene>
</COLLADA>
"""
INSTEAD = {
    "tristrips": "<p>0 1 2 3</p><p>3 2 1</p>",
    "trifans": "<p>0 1 2 3</p>",
    "polygons": "<p>0 1 2 3</p><p>3 2 1</p>",
    "polylist": "<vcount>4 3</vcount><p>0 1 2 3 3 2 1</p>",
}


def dae_of(kind: str) -> str:
    """With other faces."""
    faces = DAE.replace(f"<p>{INDICES}</p>", INSTEAD[kind])
    return faces.replace('triangles count="4"', f'{kind} count="2"').replace("triangles", kind)


GOOD = {
    "a.obj": OBJ,
    "t.stl": text_stl(),
    "b.STL": binary_stl(),
    "d.dae": DAE,
    **{f"{kind}.dae": dae_of(kind) for kind in INSTEAD},
}

Write = Callable[[str, str | bytes], Path]


@pytest.fixture
def write(tmp_path: Path) -> Write:
    def write(name: str, content: str | bytes) -> Path:
        path = tmp_path / name
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        return path

    return write


def rows_of(points: np.ndarray) -> np.ndarray:
    """Points, each once and in order; coal's are single-precision numbers."""
    return np.unique(np.round(points, 4) + 0.0, axis=0)


def by_coal(path: Path) -> np.ndarray:
    """Vertices; its triangles are those of the first part alone where there are several."""
    mesh = coal.MeshLoader(coal.NODE_TYPE.BV_AABB).load(str(path), np.array(ONE))
    return rows_of(np.array(mesh.vertices()))


@pytest.mark.parametrize("name", GOOD)
def test_a_mesh_has_the_vertices_that_coal_finds(name: str, write: Write) -> None:
    path = write(name, GOOD[name])
    assert rows_of(read_mesh(path, ONE).vertices) == pytest.approx(by_coal(path), abs=2e-4)


#: Turned by a right angle about z and put to (1, 2, 3), with each node's scale.
PLACED = [
    np.array([1, 2, 3]) + np.column_stack([-y * b, x * a, z * c])
    for a, b, c in ((1, 2, 1), (2, 2, 2))
    for x, y, z in [CORNERS.T]
]
SOLID = {"d.dae": SIDES.tolist(), "trifans.dae": [[0, 1, 2], [0, 2, 3]]}
SOLID |= {
    "polygons.dae": [*SOLID["trifans.dae"], [1, 2, 3]],
    "polylist.dae": [*SOLID["trifans.dae"], [1, 2, 3]],
    "tristrips.dae": [[0, 1, 2], [1, 2, 3], [1, 2, 3]],
}


@pytest.mark.parametrize("name", SOLID)
def test_every_part_of_a_scene_has_its_triangles_where_it_is(name: str, write: Write) -> None:
    mesh = read_mesh(write(name, GOOD[name]), ONE)
    found = sorted(sorted(map(tuple, t)) for t in np.round(mesh.vertices[mesh.corners], 6).tolist())
    expected = [part[side].tolist() for part in PLACED for side in SOLID[name]]
    assert found == sorted(sorted(map(tuple, triangle)) for triangle in expected)


@pytest.mark.parametrize("name", ["a.obj", "t.stl", "b.STL"])
def test_a_tetrahedron_has_its_volume(name: str, write: Write) -> None:
    """Gauss: the sum of a . (b x c) / 6 over the triangles, scaled by 2 3 5."""
    mesh = read_mesh(write(name, GOOD[name]), (2.0, 3.0, 5.0))
    assert len(mesh.vertices) == 4
    a, b, c = mesh.vertices[mesh.corners].transpose(1, 0, 2)
    assert np.einsum("ti,ti->", a, np.cross(b, c)) / 6.0 == pytest.approx(30.0)


@needs_robots
def test_meshes_of_robots_have_the_vertices_that_coal_finds() -> None:
    folder = robots()["ur5_robot"].parents[2]
    left = {".stl": 3, ".dae": 3, ".obj": 3}
    files = sorted(folder.glob("*_description/meshes/**/*.*"), key=lambda path: path.stat().st_size)
    for path in files:
        if left.get(path.suffix, 0) and path.stat().st_size > 2_000:
            left[path.suffix] -= 1
            found, expected = rows_of(read_mesh(path, ONE).vertices), by_coal(path)
            assert np.array([found.min(axis=0), found.max(axis=0)]) == pytest.approx(
                np.array([expected.min(axis=0), expected.max(axis=0)]), abs=2e-4
            )
            assert len(found) == pytest.approx(len(expected), rel=0.02)  # of rounding
    assert set(left.values()) == {0}


def obj(old: str, new: str) -> tuple[str, str]:
    assert old in OBJ
    return "m.obj", OBJ.replace(old, new)


def stl(old: str, new: str) -> tuple[str, str]:
    assert old in text_stl()
    return "m.stl", text_stl().replace(old, new, 1)


def dae(old: str, new: str) -> tuple[str, str]:
    assert old in DAE
    return "m.dae", DAE.replace(old, new)


NAN, THREE = struct.pack("<f", np.nan), struct.pack("<f", 3.0)
BAD: dict[str, tuple[tuple[str, str | bytes], str]] = {
    "a word in OBJ": (obj("1 0 0", "1 zwei 0"), ":2: found '1 zwei 0', needs 3 numbers"),
    "NaN in OBJ": (obj("v 1 0 0", "v nan 0 0"), ":2: found 'nan 0 0', needs 3 numbers"),
    "two numbers": (obj("v 1 0 0", "v 1 0"), ":2: found '1 0', needs 3 numbers"),
    "a comma": (obj("v 1 0 0", "v 1,5 0 0"), ":2: found '1,5 0 0', needs 3 numbers"),
    "an underscore": (obj("v 1 0 0", "v 1_0 0 0"), ":2: found '1_0 0 0', needs 3 numbers"),
    "no such vertex": (obj("f 2 3 4", "f 2 3 9"), ":8: needs vertex 9, but there are 4"),
    "vertex 0": (obj("f 2 3 4", "f 0 3 4"), ":8: found '0 3 4', needs 3 vertices"),
    "before the first": (obj("-4//1", "-5//1"), ":7: found '-5//1 -1//2 -2//3'"),
    "a huge number": (obj("f 2 3 4", f"f 2 3 {10**30}"), ":8: found '2 3 1000"),
    "two corners": (obj("f 2 3 4", "f 2 3"), ":8: found '2 3', needs 3 vertices"),
    "no faces": (("m.obj", OBJ[: OBJ.index("f")]), ": has no surface"),
    "a point": (("m.obj", "v 1 1 1\n" * 3 + "f 1 2 3\n"), ": has no surface"),
    "far away": (obj("v 1", "v 1e300"), ": reaches 1e[+]300 m far, needs at most 10000 m"),
    "nothing": (("m.obj", ""), ": has no surface"),
    "NaN in text": (stl("1.0", "nan"), ":6: found '.*nan.*', needs 3 numbers"),
    "text cut short": (stl("endsolid tetrahedron", ""), ":30: ends in the middle"),
    "four corners": (stl(" endloop", "vertex 0 0 0\n endloop"), ":8: a triangle with 4 corners"),
    "another word": (stl("endfacet", "endfacett"), ":8: found 'endfacett'"),
    "a triangle less": (("m.stl", binary_stl(5)), ": is no whole STL file: 284 bytes are not"),
    "a huge count": (("m.stl", binary_stl(2**32 - 1, b"\0")), ": is no whole STL file: 284 bytes"),
    "a wrong header": (("m.stl", binary_stl(3, b"\0")), ": is no whole STL file: 284 bytes"),
    "binary cut short": (("m.stl", binary_stl()[:150]), ": is no whole STL file: 150 bytes"),
    "no header": (("m.stl", b"\0" * 60), ": is no whole STL file: 60 bytes"),
    "no triangles": (("m.stl", binary_stl(0)[:84]), ": has no surface"),
    "NaN in binary": (("m.stl", binary_stl().replace(THREE, NAN)), ": a vertex is nowhere"),
    "another kind": (("m.ply", "ply\n"), ": is of no kind that is read: .stl, .obj, .dae"),
    "a word in DAE": (dae(POINTS, "a " + POINTS), ":3: <float_array>: needs finite numbers"),
    "numbers are missing": (dae(POINTS, POINTS[:-2]), ":4: <accessor>: 11 numbers are not"),
    "stride 0": (dae('stride="3"', 'stride="0"'), ":4: <accessor>: 12 numbers are not 4 times 0"),
    "a large count": (dae('count="4" s', 'count="4000000000" s'), ":4: <accessor> count: found"),
    "an offset": (dae('offset="0"', 'offset="-1"'), ":8: <input> offset: found '-1'"),
    "an index": (dae(INDICES, INDICES[:-1] + "9"), ":8: <triangles>: no vertex 9; it has 4"),
    "no such id": (dae('url="#n"', 'url="#x"'), ":14: <instance_node> url: no node '#x'"),
    "a circle": (
        dae('<node id="n">', '<node id="n"><instance_node url="#n"/>'),
        ":10: <node>: nod",
    ),
    "a matrix": (dae("<matrix>0", "<matrix>"), ":14: <matrix>: found 15 numbers, needs 16"),
    "a skew": (dae("<matrix>0", "<skew/><matrix>0"), ":14: <skew>: is not read; take it out"),
    "no scene": (("m.dae", "<COLLADA/>"), ":1: <COLLADA>: has no scene"),
    "deep nodes": (("m.dae", "<COLLADA>" + "<node>" * 100_000), ":1: elements inside elements"),
    "entities": (("m.dae", "<!DOCTYPE r [<!ENTITY a 'b'>]>" + DAE), ":1: has a DOCTYPE"),
    "a vcount": (("m.dae", dae_of("polylist").replace("4 3<", "4 4000000000<")), ":8: <polylist>:"),
}


@pytest.mark.parametrize("name", BAD)
def test_a_hostile_mesh_is_refused_with_its_line(name: str, write: Write) -> None:
    (file, content), words = BAD[name]
    with pytest.raises(InvalidValueError, match=rf"^mesh \S*{file}{words}") as caught:
        read_mesh(write(file, content), ONE)
    assert "\n" not in str(caught.value)


def test_instances_of_instances_are_bounded(write: Write) -> None:
    """Ten nodes that each have ten of the next are ten billion."""
    levels = "".join(
        f'<node id="n{i}">{f"""<instance_node url="#n{k}"/>""" * 10}</node>'
        for i, k in pairwise(range(11))
    )
    nodes = f'<library_nodes>{levels}<node id="n10"><instance_geometry url="#g"/></node>'
    bomb = DAE.replace("<library_nodes>", nodes).replace('url="#n"', 'url="#n0"')
    with pytest.raises(InvalidValueError, match="nodes inside nodes are more than 10000"):
        read_mesh(write("bomb.dae", bomb), ONE)  # else it would never end


def test_other_files_that_a_mesh_names_are_not_opened(write: Write, tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.mtl")
    path = write("m.obj", "mtllib pipe.mtl\n" + OBJ)
    assert len(read_mesh(path, ONE).corners) == 4
