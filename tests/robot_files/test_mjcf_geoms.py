"""Geoms of which no body can be made: refused with their line, as MuJoCo refuses them."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from coopqp.base.errors import InvalidValueError
from coopqp.robot_files.mjcf import read_mjcf

FILE = """<mujoco>
{top}
<worldbody><body name="b"><joint name="j"/>
{geom}
<geom size="0.1"/></body></worldbody></mujoco>
"""
TETRAHEDRON = '<asset><mesh name="m" vertex="0 0 0 1 0 0 0 1 0 0 0 1"/></asset>'
BAD = [
    ("", '<geom type="box" size="1"/>', 4, "size: found '1': none may be missing"),
    ("", '<geom type="capsule" size="0.1"/>', 4, "size: found '0.1': none may be missing"),
    ("", "<geom/>", 4, "none may be missing, and each size must"),
    ("", '<geom type="blob" size="1"/>', 4, "type: invalid keyword: 'blob'"),
    ("", '<geom type="mesh"/>', 4, "type: found 'mesh': type mesh needs a mesh"),
    (TETRAHEDRON, '<geom type="mesh" mesh="n"/>', 4, "mesh: mesh 'n' not found"),
    (
        "",
        '<geom size="1" fromto="0 0 0 0 0 1"/>',
        4,
        "fromto: found '0 0 0 0 0 1': fromto req",
    ),
    ("", '<inertial pos="0 0 0" diaginertia="1 1 1"/>', 4, "required attribute missing: 'mass'"),
    (
        '<default><geom type="box"/></default>',
        '<geom size="1 1"/>',
        4,
        "size: found '1 1': none may be missing",
    ),
    ("<default><default/></default>", "", 2, "empty class name"),
    (
        '<compiler eulerseq="xyw"/>',
        '<geom size="1" euler="0 0 1"/>',
        4,
        "euler: found '0 0 1': orientation specification error",
    ),
    (
        '<asset><mesh name="m"/></asset>',
        '<geom type="mesh" mesh="m"/>',
        2,
        "at least 4 vertices required",
    ),
    ('<asset><mesh name="m" vertex="a"/></asset>', "", 2, "vertex: found 'a': bad format"),
]


@pytest.mark.parametrize(("top", "geom", "line", "words"), BAD)
def test_what_mujoco_refuses_is_refused_with_its_line(
    tmp_path: Path, top: str, geom: str, line: int, words: str
) -> None:
    mujoco = pytest.importorskip("mujoco")
    path = tmp_path / "m.xml"
    path.write_text(FILE.format(top=top, geom=geom))
    place = rf"m\.xml:{line}: <\w+[^>]*>:? ?"
    with pytest.raises(InvalidValueError, match=place + re.escape(words)):
        read_mjcf(path)
    with pytest.raises(ValueError, match="rror"):
        mujoco.MjModel.from_xml_path(str(path))


def test_colours_and_names_of_files_that_are_not_looked_at_harm_nothing(tmp_path: Path) -> None:
    path = tmp_path / "m.xml"
    top = '<asset><mesh name="m" file="without an end"/><material name="x" texture="none"/></asset>'
    path.write_text(FILE.format(top=top, geom='<geom size="1" material="none"/>'))
    read = read_mjcf(path)
    assert [shape.size for shape in read.collision_shapes] == [(1.0,), (0.1,)]
