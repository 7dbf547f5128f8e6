"""A surface in pieces: to sample it finely enough, and to count on small patches of it around points."""

from __future__ import annotations

import numpy as np

NEIGHBOURS = 8  # points tried for each place: the nearest may be on the other side
MOST = 2_000_000  # pieces; beyond that the length asked for grows


def areas(triangles: np.ndarray) -> np.ndarray:
    """Areas (m,) of triangles (m, 3, 3)."""
    return np.linalg.norm(np.cross(*np.diff(triangles, axis=1).transpose(1, 0, 2)), axis=1) / 2


def subdivide(triangles: np.ndarray, length: float, at_least: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """Cut each triangle into k x k equal pieces whose edges are no longer than `length`.

    With barycentric coordinates i / k and j / k of the second and third corner, pieces of a triangle follow one
    another by i, then by j, upright before inverted: i (2 k - i) + 2 j comes first at i, j.

    Parameters
    ----------
    triangles : (m, 3, 3) float64
        Triangles [mm].
    length : float
        Longest edge wanted [mm]; longer ones stay where there would be more than `MOST` pieces.
    at_least : int
        Least k.

    Returns
    -------
    pieces : (n, 3, 3) float64
        The pieces, wound alike [mm].
    parent : (n,) int64
        The triangle each is of.
    """
    longest = np.linalg.norm(triangles - np.roll(triangles, 1, axis=1), axis=2).max(axis=1)
    k = np.maximum(np.ceil(longest / length).astype(np.int64), at_least)
    while np.sum(k**2) > MOST and k.max() > at_least:
        length *= 1.1
        k = np.maximum(np.ceil(longest / length).astype(np.int64), at_least)
    pieces, parents = [], []
    for count in np.unique(k):
        which = np.flatnonzero(k == count)
        corners = _pattern(int(count))
        pieces.append(np.einsum("pqc,mcx->mpqx", corners, triangles[which]).reshape(-1, 3, 3))
        parents.append(np.repeat(which, len(corners)))
    return np.concatenate(pieces), np.concatenate(parents)


def owners(
    places: np.ndarray, normals: np.ndarray, points: np.ndarray, facing: np.ndarray, radius: float
) -> np.ndarray:
    """The nearest point on the same side of the surface, for each of many places.

    Parameters
    ----------
    places, normals : (m, 3) float64
        Places [mm] and outward normals.
    points, facing : (n, 3) float64
        Points [mm] and outward normals; of several at one place, the first owns its surroundings.
    radius : float
        How far from its point a place may lie [mm].

    Returns
    -------
    (m,) int64
        The point each place belongs to, -1 where none is near.
    """
    from scipy.spatial import cKDTree

    _, first = np.unique(np.concatenate([points, facing], axis=1), axis=0, return_index=True)
    near = min(NEIGHBOURS, len(first))
    distance, index = cKDTree(points[first]).query(places, [*range(1, near + 1)], distance_upper_bound=radius)
    found = np.isfinite(distance)
    index = first[np.where(found, index, 0)]
    agrees = found & (np.einsum("mkc,mc->mk", facing[index], normals) > 0.5)
    chosen = np.argmax(agrees, axis=1)[:, None]
    owner = np.where(agrees, index, -1)
    return np.take_along_axis(owner, chosen, axis=1)[:, 0]


def outward_normals(triangles: np.ndarray) -> np.ndarray:
    """Unit normals (m, 3) of triangles (m, 3, 3); 0 where they have no area."""
    normals = np.cross(*np.diff(triangles, axis=1).transpose(1, 0, 2))
    return normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), np.finfo(float).tiny)


def _pattern(k: int) -> np.ndarray:
    """Barycentric corners (k^2, 3, 3) of the pieces of one triangle."""
    i, j, inverted = (v.ravel() for v in np.indices((k, k, 2)))
    first, second, third = [i + inverted, j], [i + 1, j + inverted], [i, j + 1]
    ij = np.array([first, second, third]).transpose(2, 0, 1)[i + j + inverted < k] / k
    return np.concatenate([1 - ij.sum(axis=2, keepdims=True), ij], axis=2)
