"""Surfaces with fewer triangles, for pages that load and turn at once.

All vertices within a cell of a grid become one (vertex clustering), at the point nearest to the
planes of the triangles there, so that edges and rims survive: Lindstrom, Out-of-core
simplification of large polygonal models, SIGGRAPH 2000.

Letters: v vertices, t triangles, c cells.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from coopqp.checked import Array
from coopqp.report.scene.triangles import Triangles

Ints = NDArray[np.int64]

FLAT = 1e-2  # share of a cell's largest eigenvalue below which its planes leave the point free


def thinned(surface: Triangles, cell: float) -> Triangles:
    """The surface with one vertex in each cell of a grid, of this edge [m].

    No vertex leaves its cell, so that the surface moves by less than a cell's diagonal.
    """
    cells, of_vertex = _cells(surface, cell)
    corners = of_vertex[surface.corners]
    points = _nearest_to_planes(surface, of_vertex, corners, len(cells))
    points = np.clip(points, cells * cell, (cells + 1) * cell)
    used, kept = np.unique(_distinct(corners), return_inverse=True)
    return Triangles(points[used], kept.reshape(-1, 3))


def count_thinned(surface: Triangles, cell: float) -> int:
    """How many triangles :func:`thinned` would leave."""
    _, of_vertex = _cells(surface, cell)
    return len(_distinct(of_vertex[surface.corners]))


def _cells(surface: Triangles, cell: float) -> tuple[Ints, Ints]:
    """The cells that have vertices, shape (c, 3), and the number of each vertex's, shape (v,)."""
    cells = np.floor(surface.vertices / cell).astype(np.int64)
    numbers = _number(cells - cells.min(axis=0, initial=0))
    _, first, of_vertex = np.unique(numbers, return_index=True, return_inverse=True)
    return cells[first], of_vertex


def _distinct(corners: Ints) -> Ints:
    """Corners of the triangles with three distinct ones, each triangle once, shape (., 3)."""
    ordered = np.sort(corners, axis=1)
    whole = (ordered[:, 0] != ordered[:, 1]) & (ordered[:, 1] != ordered[:, 2])
    ordered = ordered[whole]
    _, first = np.unique(_number(ordered), return_index=True)
    distinct: Ints = ordered[first]
    return distinct


def _number(rows: Ints) -> Ints:
    """One number for each row of three that are not negative, the same for the same ones."""
    base = rows.max(initial=0) + 1
    number: Ints = (rows[:, 0] * base + rows[:, 1]) * base + rows[:, 2]
    return number


def _nearest_to_planes(surface: Triangles, of_vertex: Ints, corners: Ints, count: int) -> Array:
    """Of each cell the point with the least sum of squared distances to its planes.

    A plane counts with its triangle's area. Where planes leave the point free it is as near to the
    mean of the cell's vertices as they allow. Shape (c, 3) [m]; ``corners`` are cells.
    """
    total = _sums(of_vertex, surface.vertices, count)
    mean: Array = total / np.bincount(of_vertex, minlength=count)[:, None]
    a, b, c = np.moveaxis(surface.vertices[surface.corners], 1, 0)
    normal = np.cross(b - a, c - a)  # as long as twice the area
    length = np.sqrt(np.linalg.norm(normal, axis=1, keepdims=True))
    planes = np.divide(normal, length, out=np.zeros_like(normal), where=length > 0.0)
    away = [((a - mean[cell]) * planes).sum(axis=1, keepdims=True) for cell in corners.T]
    off = _sums(corners.T.ravel(), np.concatenate([planes * d for d in away]), count)
    squares = (planes[:, :, None] * planes[:, None, :]).reshape(-1, 9)
    A = _sums(corners.T.ravel(), np.tile(squares, (3, 1)), count).reshape(-1, 3, 3)
    sizes, axes = np.linalg.eigh(A)
    firm = sizes > FLAT * np.maximum(sizes[:, -1:], np.finfo(float).tiny)
    inverse = np.divide(1.0, sizes, out=np.zeros_like(sizes), where=firm)
    best: Array = mean + np.einsum("cij,cj,ckj,ck->ci", axes, inverse, axes, off)
    return best


def _sums(of_row: Ints, rows: Array, count: int) -> Array:
    """Sum of the rows of each cell, shape (count, columns) (np.add.at is slow)."""
    return np.column_stack([np.bincount(of_row, column, count) for column in rows.T])
