"""Arms and object keep a distance from things in the world: d_dot >= -gain (d - distance).

Things are boxes, balls, cylinders and the convex hulls of meshes that stand still; what is hollow
is given in parts. Bodies are those of ``self_collision``. With n the unit normal from a body to a
thing at their nearest points and d their signed distance,

    n' J_body v <= gain (d - distance)

A body that is too close by more than a millimetre may not come closer, but is not pushed back
(:func:`coopqp.limit.damp`).
"""

from typing import Annotated, Literal

from pydantic import Field

from coopqp.base.errors import InvalidValueError, under
from coopqp.base.reading import FilePath
from coopqp.base.spec import Lengths3, Name, Pose, Positive, spec
from coopqp.grasp import pose_matrix
from coopqp.limits._bodies import Body, Pair, bodies_of, named_bodies, of_shape
from coopqp.limits._keep_apart import SHOWN, KeepApart, check_count
from coopqp.model.closed_chain import ClosedChain
from coopqp.model.marker import Marker, SolidMarker
from coopqp.robot import Shape

#: A thing this many times the arms' reach away is never met [-].
FAR = 3.0
METRES = "; lengths are metres"


@spec
class RoundSize:
    """Size of a cylinder along its z axis."""

    radius: Positive
    """[m]"""
    length: Positive
    """[m]"""


@spec
class Obstacle(Pose):
    """One thing in the world: its pose, and one of box, sphere, cylinder and mesh."""

    box: Lengths3 | None = None
    """Edges along its axes [m]."""
    sphere: Positive | None = None
    """Radius [m]."""
    cylinder: RoundSize | None = None
    """{radius: m, length: m}, along its z axis."""
    mesh: FilePath | None = None
    """A file of triangles such as STL or OBJ; its convex hull counts."""
    scale: Lengths3 = (1.0, 1.0, 1.0)
    """Of the mesh, along its axes."""

    def __post_init__(self) -> None:
        Pose.__post_init__(self)
        kinds = ("box", "sphere", "cylinder", "mesh")
        given = [kind for kind in kinds if getattr(self, kind) is not None]
        if len(given) != 1:
            found = " and ".join(given) or "none"
            raise ValueError(f"needs one of {', '.join(kinds)}; found {found}")
        if self.mesh is None and self.scale != (1.0, 1.0, 1.0):
            raise ValueError(f"scale: is of a mesh; give the {given[0]} the size it shall have")

    @property
    def shape(self) -> Shape:
        """As robots have it, in the world."""
        kind: Literal["mesh", "box", "sphere", "cylinder"] = "mesh"
        size: tuple[float, ...] = self.scale
        if self.box is not None:
            kind, size = "box", self.box
        elif self.sphere is not None:
            kind, size = "sphere", (self.sphere,)
        elif self.cylinder is not None:
            kind, size = "cylinder", (self.cylinder.radius, self.cylinder.length)
        placement = pose_matrix(self)
        return Shape(frame="universe", placement=placement, kind=kind, size=size, mesh=self.mesh)


@spec
class Obstacles(KeepApart):
    """Arms and object keep a distance from things in the world."""

    name: Name = "obstacles"
    """Your name for it in rows and tables; give it when there are several."""
    shapes: Annotated[dict[str, Obstacle], Field(min_length=1)]
    """By your name for it: {box, sphere, cylinder or mesh; position: [m], rpy or rpy_deg}."""
    bodies: tuple[str, ...] | None = None
    """Names of bodies, patterns such as *hand*, or "object"; all that move if omitted."""

    def start_faults(self, chain: ClosedChain) -> tuple[str, ...]:
        """Bodies that are in a thing, a sentence for each thing."""
        by_thing: dict[str, list[tuple[str, float]]] = {}
        for body, thing, depth in self.inside(chain):
            by_thing.setdefault(thing.name, []).append((body.name, depth))
        return tuple(
            f"{self.name}: {_inside(thing, found)}; move one of them"
            f"{METRES if found[0][1] > chain.reach else ''}"
            for thing, found in by_thing.items()
        )

    def notes(self, chain: ClosedChain) -> tuple[str, ...]:
        """Parts of the robot that are no bodies, and bodies that start too near."""
        at_start = self.at_start(chain)
        nearest: dict[str, float] = {}
        for _, thing, d in at_start:
            nearest.setdefault(thing.name, d)
        far = (
            f"{self.name}: {thing} is {nearest[thing]:.3g} m from all bodies, but the arms reach "
            f"{chain.reach:.2g} m{METRES}"
            for thing in self.shapes
            if nearest[thing] > FAR * chain.reach
        )
        return (*self.unseen(chain), *self.nearer(at_start), *far)

    def marks(self, t: float) -> tuple[Marker, ...]:
        shapes = (thing.shape for thing in self.shapes.values())
        return tuple(
            SolidMarker(
                kind=shape.kind,
                size=shape.size,
                mesh=shape.mesh,
                rotation=shape.placement.rotation,
                position=shape.placement.translation,
            )
            for shape in shapes
        )

    def watched(self, chain: ClosedChain) -> list[Pair]:
        """All bodies that move, or those named, with all things."""
        bodies, faults = bodies_of(chain)
        if self.bodies is not None:
            named = list[Body]()
            for i, name in enumerate(self.bodies):
                with under("bodies", i):
                    named += named_bodies(f"{self.name}.bodies: ", name, bodies, faults)
            bodies = list(dict.fromkeys(named))
        moved = [body for body in bodies if body.joint]
        if not moved and chain.standing:  # the object alone
            moved = bodies
        if not moved:
            words = "no body that moves is named, so that nothing is watched"
            raise InvalidValueError(f"{self.name}.bodies: {words}").at("bodies")
        check_count(self.name, len(moved) * len(self.shapes))
        things = [_thing(self.name, *thing) for thing in self.shapes.items()]
        return [(body, thing) for body in moved for thing in things]


def _inside(thing: str, found: list[tuple[str, float]]) -> str:
    """Bodies in a thing, the deepest first, with their depths [m]."""
    (body, depth), *others = found
    more = [f", {name} {1e3 * d:.1f} mm" for name, d in others[: SHOWN - 1]]
    end = ", ..." if len(found) > SHOWN else ""
    return f"{body} is {1e3 * depth:.1f} mm in {thing} at the start{''.join(more)}{end}"


def _thing(owner: str, name: str, thing: Obstacle) -> Body:
    try:
        return Body(name, 0, of_shape(thing.shape))
    except InvalidValueError as error:
        words = f"{owner}.shapes.{name}: {error}"
        key = ("mesh",) if thing.mesh else ()
        raise InvalidValueError(words).at("shapes", name, *key) from None
