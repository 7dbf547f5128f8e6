"""Which triangles share which edges, and the components that sharing makes.

Corners are (f, 3) indices of positions; a half-edge is one side of one triangle, with its direction.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

WELD_CELLS = 2**20  # along the longest side: positions closer than one cell may be one vertex
SOME = 1 << 14  # triangles at a time, so that what is computed of each takes little memory


@dataclass(frozen=True)
class HalfEdges:
    """Half-edges of f triangles, sorted by the undirected edge they lie on.

    What follows from these arrays is computed anew at each use: kept, it would be as large again.
    """

    corners: np.ndarray  # (f, 3) int, the triangles; half-edge 3 i + k starts at corner k of triangle i
    order: np.ndarray  # (3f,) int32, half-edges, sorted by edge
    start: np.ndarray  # (e,) int32, first of each edge in `order`

    @property
    def count(self) -> np.ndarray:
        """Number of half-edges (e,)."""
        return np.diff(self.start, append=np.int32(len(self.order)))

    @property
    def net(self) -> np.ndarray:
        """Sum of signs (e,): the boundary of the surface."""
        if not len(self.start):
            return np.zeros(0, np.int32)
        return np.add.reduceat(self.sign(slice(None)), self.start, dtype=np.int32)

    @property
    def n_open(self) -> int:
        """Number of directed boundary edges."""
        return int(np.abs(self.net).sum())

    @property
    def n_odd(self) -> int:
        """Number of edges with an odd number of triangles: the boundary whatever the winding."""
        return int((self.count & 1).sum())

    def face(self, at: Any) -> np.ndarray:
        """Triangles of the half-edges at places in `order`."""
        return self.order[at] // 3

    def sign(self, at: Any) -> np.ndarray:
        """+1 for half-edges at places in `order` that run from the lower vertex to the higher, else -1."""
        rises = np.stack([self.corners[:, k] < self.corners[:, (k + 1) % 3] for k in range(3)], axis=1)
        return np.where(rises.ravel()[self.order[at]], np.int8(1), np.int8(-1))

    def ends(self, edge: np.ndarray) -> np.ndarray:
        """Lower and higher vertex (k, 2) of edges (k,)."""
        face, k = np.divmod(self.order[self.start[edge]], 3)
        return np.sort(np.stack([self.corners[face, k], self.corners[face, (k + 1) % 3]], axis=1), axis=1)

    def of(self, chosen: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Places in `order` of the half-edges of chosen edges (e,) bool, and the edge of each."""
        edge, count = np.flatnonzero(chosen), self.count[chosen]
        first = self.start[edge] - (np.cumsum(count) - count)
        return np.repeat(first, count) + np.arange(count.sum()), np.repeat(edge, count)


def half_edges(corners: np.ndarray) -> HalfEdges:
    """Half-edges of triangles given as corners (f, 3), grouped by edge."""
    key, n = np.empty(corners.size, np.int64), int(corners.max(initial=0)) + 1
    for k in range(3):
        tail, head = corners[:, k], corners[:, (k + 1) % 3]
        key[k::3] = np.minimum(tail, head)
        key[k::3] *= n
        key[k::3] += np.maximum(tail, head)
    bits = len(key).bit_length()
    if n * n << bits < 2**63:  # numbers are sorted in place, in a quarter of the time that sorting their places takes
        key <<= bits
        key |= np.arange(len(key), dtype=np.int32)
        key.sort()
        order = np.bitwise_and(key, (1 << bits) - 1, dtype=np.int32, casting="unsafe")
        key >>= bits
    else:
        order = np.argsort(key, kind="stable").astype(np.int32)
        key = key[order]
    new = np.ones(len(key), bool)
    np.not_equal(key[1:], key[:-1], out=new[1:])
    del key
    return HalfEdges(corners, order, np.flatnonzero(new).astype(np.int32))


def join(a: np.ndarray, b: np.ndarray, n: int) -> np.ndarray:
    """Component (n,) of each of n nodes under the links a-b, in the order of their first nodes.

    All nodes go with their lowest neighbours at once; the trees that this makes are the nodes of the next round.
    """
    label = np.arange(n, dtype=np.int32)
    a, b = a.astype(np.int32), b.astype(np.int32)
    while len(a):
        root = np.arange(n, dtype=np.int32)
        np.minimum.at(root, a, b)
        np.minimum.at(root, b, a)
        is_root = root == np.arange(n, dtype=np.int32)
        while not is_root[root].all():
            root = root[root]
        tree = (np.cumsum(is_root, dtype=np.int32) - 1)[root]
        label, n = tree[label], int(np.count_nonzero(is_root))
        for some in runs(len(a)):  # indices are made 64 bits wide
            a[some], b[some] = tree[a[some]], tree[b[some]]
        apart = a != b
        a, b = a[apart], b[apart]
    return label


def runs(n: int) -> Iterator[slice]:
    """Slices of n triangles, `SOME` at a time."""
    return (slice(first, first + SOME) for first in range(0, n, SOME))


def sides(columns: np.ndarray, corners: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Vectors (3, f) from each corner of triangles to the next, of points (3, p); numpy is fastest at rows."""
    a, b, c = (columns.take(corners[:, k], axis=1) for k in range(3))
    return b - a, c - b, a - c


def cross(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Vector products (3, f) of vectors (3, f)."""
    return np.stack([u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]])


def areas(points: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Areas (f,) of triangles."""
    columns, out = np.ascontiguousarray(points.T), np.empty(len(corners))
    for some in runs(len(corners)):
        ab, _, ca = sides(columns, corners[some])
        out[some] = np.linalg.norm(cross(ca, ab), axis=0) / 2
    return out


def thick(points: np.ndarray, corners: np.ndarray, aspect: float) -> np.ndarray:
    """Which triangles (f,) are higher than `aspect` times their longest side."""
    columns, out = np.ascontiguousarray(points.T), np.empty(len(corners), bool)
    for some in runs(len(corners)):
        ab, bc, ca = sides(columns, corners[some])
        longest = np.maximum.reduce([np.einsum("ij,ij->j", side, side) for side in (ab, bc, ca)])
        normal = cross(ca, ab)
        out[some] = np.einsum("ij,ij->j", normal, normal) > (aspect * longest) ** 2
    return out


def patches(edges: HalfEdges) -> np.ndarray:
    """Component (f,) of each face, across edges of exactly two triangles."""
    pair = edges.start[edges.count == 2]
    return join(edges.face(pair), edges.face(pair + 1), len(edges.corners))


def own_boundary(patch: np.ndarray, edges: HalfEdges) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Directed boundary of each patch apart: patch, edge and net sign (k,) where it is not zero."""
    loose, edge = edges.of(edges.count != 2)
    n = len(edges.start)
    unique, inverse = np.unique(patch[edges.face(loose)] * np.int64(n) + edge, return_inverse=True)
    net = np.bincount(inverse, edges.sign(loose), minlength=len(unique)).astype(np.int64)
    unique, net = unique[net != 0], net[net != 0]
    return unique // n, unique % n, net


def weld(
    vertices: np.ndarray, faces: np.ndarray, centre: np.ndarray, longest: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, HalfEdges]:
    """Give vertices at one position one index: by grid cell, then across cells where edges are open.

    Parameters
    ----------
    vertices : (v, 3) float64
        Any points.
    faces : (f, 3) int
        Triangles.
    centre, longest : (3,) float64, float
        Of the bounding box of the vertices in use: its centre, its longest side.

    Returns
    -------
    welded : (v,) int32
        Position that each vertex lies at, -1 for vertices no face uses.
    first : (p,) int
        First vertex at each position.
    kept : (f,) bool
        Which triangles still have three corners.
    edges : HalfEdges
        Of those.
    """
    used = np.zeros(len(vertices), bool)
    used[faces.ravel()] = True
    key = np.zeros(np.count_nonzero(used), np.int64)
    for k in range(3):
        cells = ((vertices[used, k] - centre[k]) / longest + 0.5) * WELD_CELLS
        key = key << 21 | np.floor(cells).astype(np.int64).clip(0, 2**21 - 1)
    first, inverse = np.unique(key, return_index=True, return_inverse=True)[1:]
    welded = np.full(len(vertices), -1, np.int32)
    welded[used] = inverse
    first = np.flatnonzero(used)[first]
    del cells, key, inverse
    kept, edges = _with_three_corners(welded, faces)
    if edges.n_odd:
        from scipy.spatial import cKDTree

        loose = np.unique(edges.ends(np.flatnonzero(edges.count & 1)))
        tree = cKDTree((vertices[first[loose]] - centre) / longest)
        pairs = loose[tree.query_pairs(1.0 / WELD_CELLS, output_type="ndarray")]
        if len(pairs):
            merged = join(pairs[:, 0], pairs[:, 1], len(first))
            first = first[np.unique(merged, return_index=True)[1]]
            welded[used] = merged[welded[used]]
            kept, edges = _with_three_corners(welded, faces)
    return welded, first, kept, edges


def _with_three_corners(welded: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, HalfEdges]:
    """Which triangles (f,) have three different corners once welded, and their half-edges."""
    corners = welded[faces]
    kept = np.logical_and.reduce([corners[:, k] != corners[:, k - 1] for k in range(3)])
    if not kept.all():
        corners = corners[kept]
    return kept, half_edges(corners)
