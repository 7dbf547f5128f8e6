"""Which components of a closed surface wind the wrong way: bodies wind outward, the cavities in them inward."""

from __future__ import annotations

import numpy as np

from clsss.halfedges import HalfEdges, cross, join, own_boundary, patches, runs
from clsss.rays import winding


def volumes(points: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Signed volumes (m,) of the tetrahedra between the origin and each triangle."""
    columns, out = np.ascontiguousarray(points.T), np.empty(len(corners))
    for some in runs(len(corners)):
        a, b, c = (columns.take(corners[some, k], axis=1) for k in range(3))
        out[some] = np.einsum("ij,ij->j", a, cross(b, c)) / 6
    return out


def inward(points: np.ndarray, edges: HalfEdges, repairs: list[str]) -> np.ndarray:
    """Which triangles (m,) of a closed surface to turn: bodies wind outward, their cavities inward.

    A component that winds inward and lies in no other is a body inside out: it is turned, with all it
    holds. One inside another is that one's cavity, and stays.
    """
    patch = patches(edges)
    owner, edge, _ = own_boundary(patch, edges)
    if len(owner):  # patches that close one another along shared edges turn together
        order = np.argsort(edge, kind="stable")
        same = edge[order][1:] == edge[order][:-1]
        patch = join(owner[order][:-1][same], owner[order][1:][same], int(patch.max()) + 1)[patch]
    volume = np.bincount(patch, volumes(points, edges.corners))
    turn = np.zeros(len(volume), bool)
    if (volume < 0).any():
        turn = (volume < 0)[_holders(points, edges.corners, patch, volume)]
    if turn.any():
        what = "the whole surface" if turn.all() else f"{np.count_nonzero(turn)} of {len(turn)} components"
        repairs.append(f"turned {what} inside out")
    return turn[patch]


def _holders(points: np.ndarray, corners: np.ndarray, patch: np.ndarray, volume: np.ndarray) -> np.ndarray:
    """For each component of triangles, the outermost that it lies in, if it or that one winds inward; else itself."""
    members = np.split(np.argsort(patch, kind="stable"), np.cumsum(np.bincount(patch))[:-1])
    box = np.empty((len(volume), 2, 3))
    for k, own in enumerate(members):
        used = points[np.unique(corners[own])]
        box[k] = used.min(axis=0), used.max(axis=0)
    probe = points[[corners[own[0], 0] for own in members]]
    root = np.arange(len(volume))
    for k in np.argsort(np.abs(volume)):  # the largest that holds a component has the last word
        inside = (probe > box[k, 0]).all(axis=1) & (probe < box[k, 1]).all(axis=1)
        inside &= (np.abs(volume) < np.abs(volume[k])) & ((volume < 0) | (volume[k] < 0))
        inside = np.flatnonzero(inside)
        number = np.zeros(len(inside))
        for some in runs(len(members[k])):
            number += winding(probe[inside], points[corners[members[k][some]]])
        root[inside[np.abs(number) > 0.5]] = k
    return root[root]
