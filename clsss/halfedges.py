"""Which triangles share which edges, and the components that sharing makes.

Corners are (f, 3) indices of positions; a half-edge is one side of one triangle, with its direction.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

WELD_CELLS = 2**20  # along the longest side: positions closer than one cell may be one vertex


@dataclass(frozen=True)
class HalfEdges:
    """Half-edges of f triangles, sorted by the undirected edge they lie on."""

    face: np.ndarray  # (3f,) int, face of each half-edge, sorted by edge
    sign: np.ndarray  # (3f,) +1 where it runs from the lower vertex to the higher
    edge: np.ndarray  # (3f,) int, edge of each half-edge
    start: np.ndarray  # (e,) first half-edge of each edge
    count: np.ndarray  # (e,) number of half-edges
    net: np.ndarray  # (e,) sum of signs: the boundary of the surface
    ends: np.ndarray  # (e, 2) lower and higher vertex

    @property
    def n_open(self) -> int:
        """Number of directed boundary edges."""
        return int(np.abs(self.net).sum())

    @property
    def n_odd(self) -> int:
        """Number of edges with an odd number of triangles: the boundary whatever the winding."""
        return int((self.count & 1).sum())


def half_edges(corners: np.ndarray) -> HalfEdges:
    """Half-edges of triangles given as corners (f, 3), grouped by edge."""
    tail, head = corners.ravel(), np.roll(corners, -1, axis=1).ravel()
    n = int(corners.max(initial=0)) + 1
    key = np.minimum(tail, head).astype(np.int64)
    key *= n
    key += np.maximum(tail, head)
    sign = np.where(tail < head, np.int8(1), np.int8(-1))
    del tail, head
    order = np.argsort(key).astype(np.int32)
    key, sign = key[order], sign[order]
    order //= 3
    new = np.concatenate([[True], key[1:] != key[:-1]]) if len(key) else np.zeros(0, bool)
    start = np.flatnonzero(new).astype(np.int32)
    net = np.add.reduceat(sign, start, dtype=np.int32) if len(start) else np.zeros(0, np.int32)
    ends = np.stack([key[start] // n, key[start] % n], axis=1, dtype=np.int32, casting="unsafe")
    edge, count = np.cumsum(new, dtype=np.int32) - 1, np.diff(start, append=np.int32(len(key)))
    return HalfEdges(order, sign, edge, start, count, net, ends)


def join(a: np.ndarray, b: np.ndarray, n: int) -> np.ndarray:
    """Component (n,) of each of n nodes under the links a-b."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    links = coo_matrix((np.ones(len(a), np.int8), (a, b)), shape=(n, n))
    return connected_components(links, directed=False)[1]


def areas(points: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Areas (f,) of triangles."""
    a, b, c = (points[corners[:, k]] for k in range(3))
    return np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2


def sides(points: np.ndarray, corners: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Vectors (3, f) from each corner of triangles to the next; a row an axis, which numpy is fastest at."""
    columns = np.ascontiguousarray(points.T)
    a, b, c = (columns.take(corners[:, k], axis=1) for k in range(3))
    return b - a, c - b, a - c


def cross(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Vector products (3, f) of vectors (3, f)."""
    return np.stack([u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]])


def thick(points: np.ndarray, corners: np.ndarray, aspect: float) -> np.ndarray:
    """Which triangles (f,) are higher than `aspect` times their longest side."""
    ab, bc, ca = sides(points, corners)
    longest = np.maximum.reduce([np.einsum("ij,ij->j", side, side) for side in (ab, bc, ca)])
    normal = cross(ca, ab)
    return np.einsum("ij,ij->j", normal, normal) > (aspect * longest) ** 2


def patches(n: int, edges: HalfEdges) -> np.ndarray:
    """Component (n,) of each face, across edges of exactly two triangles."""
    pair = edges.start[edges.count == 2]
    return join(edges.face[pair], edges.face[pair + 1], n)


def own_boundary(patch: np.ndarray, edges: HalfEdges) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Directed boundary of each patch apart: patch, edge and net sign (k,) where it is not zero."""
    loose = np.flatnonzero((edges.count != 2)[edges.edge])
    key = patch[edges.face[loose]] * np.int64(len(edges.net)) + edges.edge[loose]
    unique, inverse = np.unique(key, return_inverse=True)
    net = np.bincount(inverse, edges.sign[loose], minlength=len(unique)).astype(np.int64)
    unique, net = unique[net != 0], net[net != 0]
    return unique // len(edges.net), unique % len(edges.net), net


def distinct(corners: np.ndarray) -> np.ndarray:
    """Which triangles (f,) have three different corners."""
    a, b, c = corners.T
    return (a != b) & (b != c) & (c != a)


def weld(points: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray, HalfEdges]:
    """Give vertices at one position one index: by grid cell, then across cells where edges are open.

    Parameters
    ----------
    points : (v, 3) float64
        Vertices in [-1/2, 1/2]^3, apart from those no face uses.
    faces : (f, 3) int
        Triangles.

    Returns
    -------
    welded : (v,) int32
        Position that each vertex lies at, -1 for vertices no face uses.
    first : (p,) int
        First vertex at each position.
    edges : HalfEdges
        Of the triangles that still have three corners.
    """
    used = np.zeros(len(points), bool)
    used[faces.ravel()] = True
    cell = np.floor((points[used] + 0.5) * WELD_CELLS).astype(np.int64).clip(0, 2**21 - 1)
    key = (cell[:, 0] << 42) | (cell[:, 1] << 21) | cell[:, 2]
    _, first, inverse = np.unique(key, return_index=True, return_inverse=True)
    welded = np.full(len(points), -1, np.int32)
    welded[used] = inverse
    first = np.flatnonzero(used)[first]
    corners = welded[faces]
    edges = half_edges(corners[distinct(corners)])
    if edges.n_odd:
        from scipy.spatial import cKDTree

        loose = np.unique(edges.ends[edges.count % 2 == 1])
        pairs = loose[cKDTree(points[first[loose]]).query_pairs(1.0 / WELD_CELLS, output_type="ndarray")]
        if len(pairs):
            merged = join(pairs[:, 0], pairs[:, 1], len(first))
            first = first[np.unique(merged, return_index=True)[1]]
            welded[used] = merged[welded[used]]
            corners = welded[faces]
            edges = half_edges(corners[distinct(corners)])
    return welded, first, edges
