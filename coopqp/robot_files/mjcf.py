"""Reading MuJoCo files (MJCF) with MuJoCo's own compiler.

The XML is read here, within bounds and with its includes, and written anew an element to a line, so
that lines in MuJoCo's messages are elements of the file. Sections that do not describe the robot
are left out. MuJoCo gets the triangles of meshes only where a body's mass is that of its mesh.
"""

import difflib
import re
import warnings
import xml.etree.ElementTree as ET
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any
from xml.sax.saxutils import quoteattr

import numpy as np

from coopqp.base.errors import InvalidValueError, needs
from coopqp.base.reading import absolute
from coopqp.base.spec import FARTHEST
from coopqp.robot_files.mjcf_model import Geoms, Named, floating, followers, pinocchio_model, row_of
from coopqp.robot_files.selection import Description
from coopqp.robot_files.xml import (
    ALIKE,
    MAX_DEPTH,
    MAX_ELEMENTS,
    fault,
    pinocchio_says,
    read_xml,
    stderr_lines,
)

#: Elements that are left out, by their parents.
LEFT_OUT = {
    "mujoco": "size statistic visual extension contact deformable tendon sensor custom keyframe",
    "asset": "hfield skin texture material model",
    "default": "texture material camera light pair equality tendon plugin",
    "equality": "connect weld tendon flex flexvert flexstrain distance",
    "body": "camera light plugin",
    "worldbody": "camera light",
    "frame": "camera light",
    "geom": "plugin",
    "mesh": "plugin",
    "compiler": "lengthrange",
    "actuator": "plugin",
}
#: Macros of MuJoCo, which make any number of bodies.
NOT_READ = {
    "replicate": "write out what it repeats",
    "attach": "write out what it attaches, or include it",
    "composite": "take it out",
    "flexcomp": "take it out",
}
#: Attributes that name something, which may be called "nan".
NAMES = ("name", "class", "childclass", "model", "file", "joint", "joint1", "joint2", "mesh")
LONGEST = 250  # letters of an attribute or its name; MuJoCo truncates long messages, with the line
LONG = ("vertex", "normal", "texcoord", "face", "user", "file")  # that may be longer
NOT_A_NUMBER = re.compile(r"(^|\s)[+-]?nan", re.IGNORECASE)
#: MuJoCo's messages, and plainer ones.
PLAIN = {
    "^(XML )?Error: (Error: )?": "",
    "Schema violation: unrecognized attribute:": "unknown attribute",
    "Schema violation: unrecognized element": "unknown element",
    "mass and inertia of moving bodies must.*": "moves, but has no mass or inertia of its own",
    r"size \d must be positive in .*": "none may be missing, and each size must be above 0",
    "mesh geom .* must have valid meshid": "type mesh needs a mesh",
}
#: Words of URDF files, and what MuJoCo has for them.
OTHERWISE = {
    "revolute": "hinge", "continuous": "hinge", "prismatic": "slide", "floating": "free",
    "spherical": "ball", "link": "body", "collision": "geom", "visual": "geom", "origin": "pos",
    "xyz": "pos", "position": "pos", "rpy": "euler", "radius": "size", "length": "size",
    "filename": "file", "lower": "range", "upper": "range", "cube": "box",
}  # fmt: skip
#: Bounds on sizes in the compiled model: elements, their array, and the bound.
BOUNDS = (
    ("joints", "jnt_pos", FARTHEST),
    ("geoms", "geom_pos", FARTHEST),
    ("geoms", "geom_size", FARTHEST),
    ("sites", "site_pos", FARTHEST),
    ("bodies", "body_pos", FARTHEST),
    ("bodies", "body_ipos", FARTHEST),
    ("bodies", "body_mass", 1e6),
    ("bodies", "body_inertia", 1e12),
)
#: Words that stand for themselves.
KEYWORDS = (
    "hinge", "slide", "ball", "free", "sphere", "capsule", "cylinder", "ellipsoid", "box", "plane",
    "mesh", "true", "false", "auto", "degree", "radian",
)  # fmt: skip


def read_mjcf(path: Path) -> Description:
    """Read a MuJoCo file; InvalidValueError: none, or no MJCF; MissingDependencyError: mujoco."""
    xml = read_xml(path, ["mujoco"], "MJCF")
    _Includes(absolute(path)).fill_in(xml)
    _take_out(xml)
    if xml.find("worldbody//body") is None:
        raise fault(xml, "is not a robot: has no <body>")
    return _Compiled(_mujoco(), xml, path).description()


def _mujoco() -> ModuleType:
    with needs("a robot from an MJCF file", "mujoco"):
        import mujoco
    found: ModuleType = mujoco
    return found


class _Includes:
    """Replaces <include> by the contents of files; path: of the outermost one."""

    def __init__(self, path: Path) -> None:
        self._folder, self._seen, self._left = path.parent, {path}, MAX_ELEMENTS

    def fill_in(self, element: ET.Element, depth: int = 0) -> None:
        """Replace the includes in an element; none may be included twice, or too large."""
        if depth > MAX_DEPTH:
            raise fault(element, f"elements inside elements are more than {MAX_DEPTH} deep")
        children: list[ET.Element] = []
        for child in element:
            if child.tag == "include":
                children.extend(self._included(child, depth))
            else:
                self.fill_in(child, depth + 1)
                children.append(child)
        element[:] = children

    def _included(self, include: ET.Element, depth: int) -> ET.Element:
        path = absolute(self._folder / include.get("file", ""))
        if path in self._seen:  # as in MuJoCo; else ten small files can be ten billion
            name = include.get("file")
            raise fault(include, f"file '{name}' is included already")
        self._seen.add(path)
        try:
            found = read_xml(path, ["mujocoinclude", "mujoco"], "MJCF")
        except InvalidValueError as error:
            raise fault(include, f"{error}") from None
        self._left -= sum(1 for _ in found.iter())
        if self._left < 0:
            raise fault(include, f"what is included has more than {MAX_ELEMENTS} elements")
        self.fill_in(found, depth)
        return found


def _take_out(xml: ET.Element) -> None:
    """Leave out what is not read, and refuse what MuJoCo would not refuse."""
    for element in xml.iter():
        if element.tag in NOT_READ:
            raise fault(element, f"is not read; {NOT_READ[element.tag]}")
        texts = [text for key, text in element.attrib.items() if key not in LONG]
        if len(longest := max((element.tag, *element.attrib, *texts), key=len)) > LONGEST:
            words = f"found '{longest[:40]}...', which has more than {LONGEST} letters"
            raise InvalidValueError(f"{getattr(element, 'place', '')}: {words}")
        for key, text in element.attrib.items():
            if key not in NAMES and NOT_A_NUMBER.search(text):
                raise fault(element, f"found '{text[:40]}', needs finite numbers", key)
        out = LEFT_OUT.get(element.tag, "").split()
        element[:] = [child for child in element if child.tag not in out]
        if element.tag == "actuator":
            element[:] = [e for e in element if "joint" in e.attrib or "jointinparent" in e.attrib]
        element.attrib.pop("material", None)
        if element.tag == "mesh" and (file := element.get("file")):
            element.set("name", element.get("name") or Path(file).stem)  # older MuJoCo wants one


def _lines(xml: ET.Element) -> tuple[str, list[ET.Element]]:
    """The file with an element to a line, and the elements in the order of their lines."""
    lines, elements = list[str](), list[ET.Element]()

    def write(element: ET.Element) -> None:
        given = "".join(f" {key}={quoteattr(text)}" for key, text in element.attrib.items())
        lines.append(f"<{element.tag}{given}>")
        elements.append(element)
        for child in element:
            write(child)
        lines[-1] += f"</{element.tag}>"

    write(xml)
    return "\n".join(lines), elements


class _Compiled:
    def __init__(self, mujoco: ModuleType, xml: ET.Element, path: Path) -> None:
        self._path = path
        text, self._elements = _lines(xml)
        try:
            self._spec: Any = mujoco.MjSpec.from_string(text)
            self._spec.compiler.fusestatic = self._spec.compiler.discardvisual = False
            self._spec.compiler.LRopt.mode = mujoco.mjtLRMode.mjLRMODE_NONE  # it would simulate
            self._geoms = Geoms(mujoco, self._spec, path)
            with warnings.catch_warnings(), stderr_lines([]):
                warnings.simplefilter("ignore")  # of a first step in a simulation
                self._model: Any = self._spec.compile()
        except (ValueError, mujoco.FatalError) as error:
            raise self._refusal(str(error)) from None
        self._check_bounds()

    def description(self) -> Description:
        named = Named(self._model)
        try:
            model = pinocchio_model(self._model, named)
        except ValueError as error:  # of names
            words = f"is not a robot that can be read: {pinocchio_says(error)}"
            raise fault(self._elements[0], words) from None
        drawn, collide = self._geoms.shapes(self._model, named)
        joints = ((x, self._element(x.info or x.parent.info)) for x in self._spec.joints)
        placed = ((row_of(x, self._model.joint), getattr(e, "place", "")) for x, e in joints)
        return Description(
            name=self._elements[0].get("model") or self._path.stem,
            model=model,
            followers=followers(self._model, named),
            floating=floating(self._model, named),
            shapes=drawn,
            collision_shapes=collide,
            unseen=self._geoms.unseen(self._model, named),
            warnings=self._geoms.warnings(self._model, named, drawn, collide),
            places={named.joints[i]: place for i, place in placed if place},
        )

    def _element(self, message: str) -> ET.Element:
        """The element whose line a message names; the outermost one where none is."""
        line = re.search(r"line (\d+)", message)
        return self._elements[int(line[1]) - 1 if line else 0]

    def _refusal(self, message: str) -> InvalidValueError:
        """MuJoCo's words, with the place in the file and the nearest name of what is misspelt."""
        words, element = message.strip().partition("\n")[0], self._element(message)
        for pattern, plain in PLAIN.items():
            words = re.sub(pattern, plain, words)
        if element.tag == "body" and re.search("mass|inertia", words):
            element = element if (own := element.find("inertial")) is None else own
        if words == "unknown element":
            words += f" '{element.tag}'"
        return fault(element, f"{words}{self._hint(words, element)}", _attribute(words, element))

    def _hint(self, words: str, element: ET.Element) -> str:
        """What an unknown word may have been meant to be."""
        quoted = re.search("'(.+?)'", words)
        word = quoted[1] if quoted else ""
        schema = _schema()
        if words == f"unknown element '{element.tag}'":
            known = set(schema)
        elif words.startswith("unknown attribute"):
            known = schema.get(element.tag, set()) - set(element.attrib)
        else:
            names = (e.get(key, "") for e in self._elements for key in ("name", "class"))
            known = {*KEYWORDS, *names}
        if word in known:
            return ""
        if OTHERWISE.get(word) in known:
            return f"; it is called '{OTHERWISE[word]}' here"
        alike = difflib.get_close_matches(word, known, 1, ALIKE)
        return f"; did you mean '{alike[0]}'?" if alike else ""

    def _check_bounds(self) -> None:
        """Refuse sizes that no robot has, which MuJoCo accepts."""
        for elements, array, maximum in BOUNDS:
            values = np.abs(getattr(self._model, array))
            if not (values <= maximum).all():
                row = int(np.argwhere(~(values <= maximum))[0][0])
                wrong = next(e for e in getattr(self._spec, elements) if e.id == row)
                words = f"comes to {np.max(values[row]):g}, needs sizes of at most {maximum:g}"
                raise fault(self._element(wrong.info), words, array.partition("_")[2])


def _attribute(words: str, element: ET.Element) -> str:
    """The attribute that a message is about, if that is clear."""
    for key, text in element.attrib.items():
        if f"'{text}'" in words:
            return key
    for key, text in element.attrib.items():
        if key not in NAMES and re.search(rf"\b{key}\b", words):
            return f"{key}: found '{text[:40]}'"
    return ""


@cache
def _schema() -> dict[str, set[str]]:
    """The attributes of each element of MuJoCo's own schema."""
    found, tag = dict[str, set[str]](), ""
    for line in _mujoco().mj_printSchema(False, False).splitlines():
        words = line.split()
        if len(words) > 1 and re.fullmatch(r"\(.\)", words[1]):
            tag, words = words[0].removeprefix("(world)"), words[2:]
        found.setdefault(tag, set()).update(words)
    return found
