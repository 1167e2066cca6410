"""Geoms of which no body can be made: refused with their line, as MuJoCo refuses them."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from coopqp.base.errors import InvalidValueError
from coopqp.robot_files.mjcf import read_mjcf
from coopqp.robot_files.mjcf_defaults import all_given
from coopqp.robot_files.xml import read_xml

FILE = """<mujoco>
{top}
<worldbody><body name="b"><joint name="j"/>
{geom}
<geom size="0.1"/></body></worldbody></mujoco>
"""
TETRAHEDRON = '<asset><mesh name="m" vertex="0 0 0 1 0 0 0 1 0 0 0 1"/></asset>'
BAD = [
    ("", '<geom type="box" size="1"/>', 4, "size: found '1'; a box needs 3 above 0"),
    ("", '<geom type="capsule" size="0.1"/>', 4, "size: found '0.1'; a capsule needs 2 above 0"),
    ("", "<geom/>", 4, "size: is missing; a sphere needs 1 above 0"),
    ("", '<geom type="blob" size="1"/>', 4, "type: unknown type 'blob'; did you mean 'box'?"),
    ("", '<geom type="mesh"/>', 4, "type: is mesh, but no mesh is named"),
    (TETRAHEDRON, '<geom type="mesh" mesh="n"/>', 4, "mesh: unknown mesh 'n'; known: m"),
    ("", '<geom size="1" fromto="0 0 0 0 0 1"/>', 4, "fromto: a sphere has none"),
    ("", '<inertial pos="0 0 0" diaginertia="1 1 1"/>', 4, ": needs a mass"),
    (
        '<default><geom type="box"/></default>',
        '<geom size="1 1"/>',
        4,
        "size: found '1 1'; a box needs 3 above 0",
    ),
    ("<default><default/></default>", "", 2, ": needs a class"),
    ('<compiler eulerseq="xyw"/>', '<geom size="1" euler="0 0 1"/>', 2, "eulerseq: found 'xyw'"),
    ('<asset><mesh name="m"/></asset>', '<geom type="mesh" mesh="m"/>', 2, ": needs a file, or"),
    ('<asset><mesh name="m" vertex="a"/></asset>', "", 2, "vertex: found 'a', needs 12"),
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


def test_defaults_give_what_mujoco_gives(tmp_path: Path) -> None:
    mujoco = pytest.importorskip("mujoco")
    path = tmp_path / "m.xml"
    path.write_text(
        """<mujoco><default><geom size="0.1"/>
          <default class="wide"><geom size="0.2 0.3" type="capsule"/>
            <default class="long"><geom size="0.2 0.9"/></default></default></default>
        <worldbody><geom name="floor" type="plane" size="1 1 1"/>
          <body childclass="wide"><geom name="one"/><body><geom name="two" class="long"/>
            <body childclass="long"><geom name="three"/><geom name="four" class="main"/>
        </body></body></body></worldbody></mujoco>"""
    )
    xml, theirs = read_xml(path, ["mujoco"], "MJCF"), mujoco.MjModel.from_xml_path(str(path))
    found = {given.element.get("name"): given.attributes for given in all_given(xml, "geom")}
    assert list(found) == ["floor", "one", "two", "three", "four"]
    for name, given in found.items():
        size = [float(number) for number in given["size"].split()]
        assert theirs.geom(name).size[: len(size)].tolist() == size


def test_colours_and_names_of_files_that_are_not_looked_at_harm_nothing(tmp_path: Path) -> None:
    path = tmp_path / "m.xml"
    top = '<asset><mesh name="m" file="without an end"/><material name="x" texture="none"/></asset>'
    path.write_text(FILE.format(top=top, geom='<geom size="1" material="none"/>'))
    read = read_mjcf(path)
    assert [shape.size for shape in read.collision_shapes] == [(1.0,), (0.1,)]
