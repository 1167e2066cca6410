"""The grasp matrix, and splits and coordinates of internal wrenches.

Hand i exerts h_i = (f_i; m_i), force and torque on the object at p_i, world axes [N, N m]. With
r_i = p_i - o and o the object's origin,

    G = [G_1 ... G_N],  G_i = [1 0; [r_i]x 1],      w = G h      (Uchiyama and Dauchez 1988)

is the wrench at o, shape (6,), and G_i' V the twist of hand i. Any X with G X = 1 splits

    h = X w + h_int,   h_int = (1 - X G) h,   G h_int = 0

h_int does no work on the object for any X, so work alone does not decide which X is right:

    Walker, Freeman, Marcus 1991   f_i = a_i F,  m_i = a_i (M - r_i x F), shares a_i of sum 1
    Erhart, Hirche 2015            X = W G' (G W G')^-1,  W = diag(m_i 1, j_i 1)

The second treats hands as free bodies of mass m_i and inertia j_i; m = 1 kg and j = 1 kg m2 is the
pseudoinverse, whose result depends on the unit of length. Walker's hands exert torques that a
contact may not transmit; there take the second with a small j. About the line through two hands a
hand has to exert a torque, so j cannot be zero.

Two hands have a section wrench, :func:`section`, and three a virtual linkage,
:func:`virtual_linkage`.
"""

from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from coopqp.base.errors import GraspError
from coopqp.base.spec import Array


def grasp_matrix(points: ArrayLike, origin: ArrayLike) -> Array:
    """G with w = G h, shape (6, 6 N), from the hands' points (N, 3) and the object's origin [m]."""
    levers, one = np.asarray(points, float) - np.asarray(origin, float), np.eye(3)
    return np.hstack([np.zeros((6, 0)), *(pin.SE3(one, p).toDualActionMatrix() for p in levers)])


def moved(wrench: Array, point: ArrayLike, to: ArrayLike) -> Array:
    """A wrench, shape (6,), given at a point [m], expressed at another."""
    found = np.array(wrench, float)
    found[3:] += pin.skew(np.asarray(point, float) - np.asarray(to, float)) @ found[:3]
    return found


@dataclass(frozen=True)
class Split:
    """What moves the object and what is internal, at one instant."""

    G: Array  # grasp matrix, shape (6, 6 N)
    X: Array  # hands' wrenches for a wrench on the object, G X = 1, shape (6 N, 6)

    @property
    def projector(self) -> Array:
        """1 - X G, from h to its internal part, shape (6 N, 6 N)."""
        return np.eye(len(self.X)) - self.X @ self.G


def walker(points: ArrayLike, origin: ArrayLike, shares: ArrayLike) -> Split:
    """Walker's split: every hand exerts its share of force and of torque.

    It is invariant to the object's origin, the hands' points and the units. ``shares`` a_i, shape
    (N,), are at least 0 and sum to 1.
    """
    p, o, a = (np.asarray(given, float) for given in (points, origin, shares))
    X = np.vstack([share * grasp_matrix([o], place) for share, place in zip(a, p, strict=True)])
    return Split(grasp_matrix(p, o), X)


def virtual_inertia(
    points: ArrayLike, origin: ArrayLike, masses: ArrayLike, inertias: ArrayLike
) -> Split:
    """Erhart and Hirche's split: hands as free bodies of virtual mass [kg] and inertia [kg m2].

    Of masses and inertias, more than 0 and each of shape (N,), only ratios count; inertias are
    about hands' points.
    """
    G = grasp_matrix(points, origin)
    WGt = np.repeat(np.array([masses, inertias], float).T.ravel(), 3)[:, None] * G.T
    return Split(G, np.asarray(np.linalg.solve(G @ WGt, WGt.T).T, float))


#: The rows of a section wrench, and their units.
COMPONENTS = ("squeeze", "shear_up", "shear_side", "twist", "bend_up", "bend_side")
UNITS = ("N", "N", "N", "N m", "N m", "N m")
#: Hands that are nearer to each other have no direction between them [m].
NEAREST = 1e-3
#: Where "up" has less than this of it across e, x stands for it.
STEEP = 0.1


@dataclass(frozen=True)
class Section:
    """The section through the middle between two hands at p_1 and p_2: squeeze, shear, twist, bend.

    With c the middle and e the direction from hand 1 to hand 2, the section transmits the wrench
    (Uchiyama and Dauchez 1988)

        s = (h_1 at c - h_2 at c) / 2

        squeeze   s_f . e      [N]      > 0 presses the object
        shear     s_f across e [N]      the hands slide past each other
        twist     s_m . e      [N m]    they turn against each other about e
        bend      s_m across e [N m]    they tilt against each other

    It is dual to the relative twist V_1 - V_2: the hands' power is w . (V_1 + V_2)/2 + s . (V_1 -
    V_2). With equal shares it is Walker's internal wrench. With h_1 + h_2 = 0 at c,

        m_1 + m_2 = (p_2 - p_1) x s_f,   (m_1 - m_2)/2 = s_m

    The two directions across e are up, the world's z less its part along e, and e x up. Where e is
    within some degrees of the vertical, the world's x replaces z.
    """

    middle: Array  # c, shape (3,) [m]
    axes: Array  # rows e, up and e x up, shape (3, 3)
    rows: Array  # from (h_1; h_2), each at its hand, to the components, shape (6, 12)

    def of(self, h: Array) -> Array:
        """Components of both hands' wrenches at their points, shape (2, 6) or (12,) [N, N m]."""
        return np.asarray(self.rows @ np.ravel(h), float)


def section(p_1: Array, p_2: Array) -> Section:
    """The section between two hands at points (3,) [m]; GraspError: they are in one place."""
    way = np.asarray(p_2, float) - p_1
    length = float(np.linalg.norm(way))
    if not length > NEAREST:
        raise GraspError(
            f"two hands are {1e3 * length:.2g} mm apart: there is no direction between them"
        )
    axes, middle = across(way / length), np.asarray(p_1 + 0.5 * way, float)
    rows = 0.5 * grasp_matrix([p_1, p_2], middle)
    rows[:, 6:] *= -1.0
    return Section(middle, axes, (axes @ rows.reshape(2, 3, 12)).reshape(6, 12))


def across(e: Array) -> Array:
    """Rows e, up and e x up of a unit direction, shape (3, 3)."""
    up = np.array([0.0, 0.0, 1.0]) - e[2] * e
    if np.linalg.norm(up) < STEEP:
        up = np.array([1.0, 0.0, 0.0]) - e[0] * e
    up /= np.linalg.norm(up)
    return np.array([e, up, pin.skew(e) @ up])


#: The edges, by hands.
EDGES = ((0, 1), (0, 2), (1, 2))
#: Three hands are on one line where the triangle is flatter than this, as height over length.
FLAT = 1e-3


def virtual_linkage(points: Array) -> Array:
    """Pushes along the edges between three hands at points of shape (3, 3) [m].

    The virtual linkage of Williams and Khatib 1993: E (9, 3) has a column an edge, the unit vector
    e_ij at hand i and its opposite at hand j, so that t > 0 presses hands i and j towards each
    other. Forces f = (f_1; f_2; f_3) split into

        f = W_f^+ F + E t,   t = E^+ f

    with W_f the grasp matrix of forces alone, whose null space is the range of E. Torques of the
    hands, all nine, count as internal. On one line E has rank 2 and the split does not exist.

    Returns:
        E^+, from (f_1; f_2; f_3) to the pushes t [N], shape (3, 9).
    """
    p = np.asarray(points, float)
    E = np.zeros((9, 3))
    for k, (i, j) in enumerate(EDGES):
        e = (p[j] - p[i]) / np.linalg.norm(p[j] - p[i])
        E[3 * i : 3 * i + 3, k], E[3 * j : 3 * j + 3, k] = e, -e
    return np.asarray(np.linalg.pinv(E), float)


def squeeze_rows(points: Array) -> dict[tuple[int, int], Array]:
    """Rows, shape (6 N,), from the hands' wrenches to the squeeze of each pair, by pair.

    The section's of two hands, the virtual linkage's of three; none where that does not exist.
    """
    if len(points) == 2:
        return {(0, 1): section(points[0], points[1]).rows[0]}
    if len(points) != 3:
        return {}
    longest = max(float(np.linalg.norm(points[j] - points[i])) for i, j in EDGES)
    area = float(np.linalg.norm(np.cross(points[1] - points[0], points[2] - points[0])))
    if not longest or area / longest**2 < FLAT:
        return {}
    rows = np.zeros((3, 3, 6))
    rows[:, :, :3] = virtual_linkage(points).reshape(3, 3, 3)
    return dict(zip(EDGES, rows.reshape(3, 18), strict=True))
