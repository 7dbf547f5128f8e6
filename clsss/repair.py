"""Make the closed, outward-oriented surface of a solid out of the triangles of a mesh file.

A set of oriented triangles bounds a solid where its boundary is empty, that is where every directed edge
a -> b is matched by b -> a; then the winding number is an integer at every point, whatever intersects what.
Welding vertices keeps an empty boundary empty, turning a whole component keeps it empty, and a fan over each
loop of directed boundary edges makes it empty: these are the only repairs that touch the solid.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clsss.errors import InputError

WELD_CELLS = 2**20  # along the longest side: positions closer than one cell may be one vertex
SOUP_SHARE = 0.5  # of all edges open: no surface to speak of, holes cannot be told from edges
_COLLINEAR = 1e-7  # height of a triangle over its longest side: what rounding to float32 leaves of zero


@dataclass(frozen=True)
class Repaired:
    """A repaired mesh in indices.

    Attributes
    ----------
    kept : (f',) int
        Faces of the input that remain, to be drawn.
    turned : (f',) bool
        Which of them change their winding.
    welded : (v,) int
        Position that each vertex lies at; -1 for vertices no face uses.
    first : (p,) int
        First vertex at each position.
    solid : (m, 3) int
        Closed surface, as positions; from p on they are `centroids`.
    centroids : (c, 3) float64
        Points the caps meet at, in the frame of the input points.
    was_closed, closed : bool
        Whether the input, and `solid`, have no open edge.
    repairs : list of str
        What was done, one short sentence each.
    """

    kept: np.ndarray
    turned: np.ndarray
    welded: np.ndarray
    first: np.ndarray
    solid: np.ndarray
    centroids: np.ndarray
    was_closed: bool
    closed: bool
    repairs: list[str]


@dataclass(frozen=True)
class _Edges:
    """Half-edges of triangles grouped by undirected edge."""

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


def _edges(corners: np.ndarray) -> _Edges:
    tail, head = corners.ravel(), np.roll(corners, -1, axis=1).ravel()
    low, high = np.minimum(tail, head), np.maximum(tail, head)
    n = int(corners.max(initial=0)) + 1
    key = low.astype(np.int64) * n + high
    order = np.argsort(key)
    key = key[order]
    new = np.concatenate([[True], key[1:] != key[:-1]]) if len(key) else np.zeros(0, bool)
    start = np.flatnonzero(new)
    sign = np.where(tail < head, 1, -1)[order]
    net = np.add.reduceat(sign, start) if len(start) else np.zeros(0, np.int64)
    ends = np.stack([key[start] // n, key[start] % n], axis=1)
    return _Edges(order // 3, sign, np.cumsum(new) - 1, start, np.diff(start, append=len(key)), net, ends)


def _join(a: np.ndarray, b: np.ndarray, n: int) -> np.ndarray:
    """Component (n,) of each of n nodes under the links a-b."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    links = coo_matrix((np.ones(len(a), np.int8), (a, b)), shape=(n, n))
    return connected_components(links, directed=False)[1]


def _areas(points: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Areas (f,) of triangles."""
    a, b, c = (points[corners[:, k]] for k in range(3))
    return np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2


def _thick(points: np.ndarray, corners: np.ndarray, aspect: float) -> np.ndarray:
    """Which triangles (f,) are higher than `aspect` times their longest side."""
    a, b, c = (points[corners[:, k]] for k in range(3))
    longest = np.max([((q - p) ** 2).sum(axis=1) for p, q in ((a, b), (b, c), (c, a))], axis=0, initial=0)
    return 2 * _areas(points, corners) > aspect * longest


def repair(points: np.ndarray, faces: np.ndarray) -> Repaired:
    """Weld, drop, orient and cap triangles until they bound a solid.

    Parameters
    ----------
    points : (v, 3) float64
        Vertices scaled so that the bounding box of those in use is centred on 0, its longest side 1.
    faces : (f, 3) int
        Triangles.

    Returns
    -------
    Repaired

    Raises
    ------
    InputError
        The surface is one-sided.
    """
    repairs: list[str] = []
    welded, first, corners, edges = _weld(points, faces, repairs)
    was_closed = edges.n_odd == 0
    at = points[first]
    kept = np.flatnonzero(_distinct(corners))
    if len(kept) < len(corners):
        repairs.append(f"dropped {len(corners) - len(kept)} triangles that have collapsed to an edge or a point")
        corners = corners[kept]
    if edges.count.max(initial=0) > 2 or edges.n_odd:
        stay = _drop(at, corners, edges, repairs)
        kept, corners = kept[stay], corners[stay]
        edges = _edges(corners)
    drawn = corners
    if (edges.net[edges.count == 2] != 0).any():
        drawn = _consistent(at, drawn, edges, repairs)
        edges = _edges(drawn)
    if edges.n_open > SOUP_SHARE * 3 * len(drawn):
        repairs.append("almost no two triangles share an edge: left open, the inside is where it winds round")
        solid, centroids, closed = drawn, np.zeros((0, 3)), False
        if _volumes(at, drawn).sum() < 0:
            drawn = solid = drawn[:, ::-1]
    else:
        sheets = np.zeros(len(drawn), bool)
        caps, centroids, closed = np.zeros((0, 3), drawn.dtype), np.zeros((0, 3)), True
        if edges.n_open:
            sheets = _sheets(at, drawn, edges, repairs)
            caps, centroids = _caps(at, drawn[~sheets], repairs)
        solid = np.concatenate([drawn[~sheets], caps])
        if len(solid) != len(drawn) or len(caps):
            edges = _edges(solid)
        turn = _inward(np.concatenate([at, centroids]), solid, edges, repairs)
        solid = np.where(turn[:, None], solid[:, ::-1], solid)
        drawn = drawn.copy()
        drawn[~sheets] = solid[: len(solid) - len(caps)]
    every = np.concatenate([at, centroids])
    solid = solid[_thick(every, solid, 1e-12)]
    turned = (drawn[:, 0] != corners[:, 0]) | (drawn[:, 1] != corners[:, 1])
    return Repaired(kept, turned, welded, first, solid, centroids, was_closed, closed, repairs)


def _distinct(corners: np.ndarray) -> np.ndarray:
    a, b, c = corners.T
    return (a != b) & (b != c) & (c != a)


def _weld(points: np.ndarray, faces: np.ndarray, repairs: list[str]) -> tuple:
    """Give vertices at one position one index; first by grid cell, then across cells where edges are open."""
    used = np.zeros(len(points), bool)
    used[faces.ravel()] = True
    cell = np.floor((points[used] + 0.5) * WELD_CELLS).astype(np.int64).clip(0, 2**21 - 1)
    key = (cell[:, 0] << 42) | (cell[:, 1] << 21) | cell[:, 2]
    _, first, inverse = np.unique(key, return_index=True, return_inverse=True)
    welded = np.full(len(points), -1)
    welded[used] = inverse
    first = np.flatnonzero(used)[first]
    corners = welded[faces]
    edges = _edges(corners[_distinct(corners)])
    if edges.n_odd:
        from scipy.spatial import cKDTree

        loose = np.unique(edges.ends[edges.count % 2 == 1])
        pairs = loose[cKDTree(points[first[loose]]).query_pairs(2.0 / WELD_CELLS, output_type="ndarray")]
        if len(pairs):
            merged = _join(pairs[:, 0], pairs[:, 1], len(first))
            first = first[np.unique(merged, return_index=True)[1]]
            welded[used] = merged[welded[used]]
            corners = welded[faces]
            edges = _edges(corners[_distinct(corners)])
    n_used = int(used.sum())
    if len(first) < n_used:
        repairs.append(f"welded {n_used} vertices into {len(first)} positions")
    return welded, first, corners, edges


def _drop(at: np.ndarray, corners: np.ndarray, edges: _Edges, repairs: list[str]) -> np.ndarray:
    """Which faces (f,) stay: no loose slivers, no copies."""
    stay = np.ones(len(corners), bool)
    thick = _thick(at, corners, _COLLINEAR)
    if not thick.all() and _edges(corners[thick]).n_odd < edges.n_odd:
        repairs.append(f"dropped {np.count_nonzero(~thick)} triangles without area")
        stay = thick
    crowded = np.zeros(len(corners), bool)
    crowded[edges.face[edges.count[edges.edge] > 2]] = True
    crowded = np.flatnonzero(crowded & stay)
    ranks = np.argsort(corners[crowded], axis=1)
    rows = np.take_along_axis(corners[crowded], ranks, axis=1)
    winding = np.where((ranks[:, 1] - ranks[:, 0]) % 3 == 1, 1, -1)
    _, group, size = np.unique(rows, axis=0, return_inverse=True, return_counts=True)
    net = np.bincount(group, winding)
    # the copy to keep is the first with the winding that prevails, or the first of all where none does
    fits = np.flatnonzero((winding * net[group] > 0) | (net[group] == 0))
    keeper = np.full(len(size), -1)
    keeper[group[fits[::-1]]] = fits[::-1]
    one = stay.copy()
    one[np.delete(crowded, keeper)] = False
    # two opposite copies are a wall between two solids, or a copy gone wrong: the one that closes better
    none = one.copy()
    none[crowded[keeper[(net == 0) & (size > 1)]]] = False
    if 2 * np.count_nonzero(none) > len(corners) and _edges(corners[none]).n_odd < _edges(corners[one]).n_odd:
        one = none
    if np.count_nonzero(one) < np.count_nonzero(stay):
        repairs.append(f"dropped {np.count_nonzero(stay) - np.count_nonzero(one)} duplicate triangles")
    return one


def _consistent(at: np.ndarray, corners: np.ndarray, edges: _Edges, repairs: list[str]) -> np.ndarray:
    """Turn triangles so that neighbours agree, as few as possible in each component.

    Each face has two nodes, itself and itself turned; neighbours are linked in the way that agrees. The
    surface is one-sided where a face is connected with itself turned.
    """
    n = len(corners)
    pair = edges.start[edges.count == 2]
    f, g = edges.face[pair], edges.face[pair + 1]
    clash = edges.sign[pair] == edges.sign[pair + 1]
    label = _join(np.concatenate([f, f + n]), np.concatenate([g + n * clash, g + n * ~clash]), 2 * n)
    as_is, turned = label[:n], label[n:]
    one_sided = as_is == turned
    area = _areas(at, corners)
    if area[one_sided].sum() > 0.1 * area.sum():
        raise InputError("the surface is one-sided like a Moebius strip or a Klein bottle and has no inside")
    component, side = np.minimum(as_is, turned), as_is > turned
    votes = np.bincount(component, np.where(side, 1, -1), minlength=2 * n)
    turn = (side == (votes[component] <= 0)) & ~one_sided
    repairs.append(f"turned {np.count_nonzero(turn)} triangles that disagreed with their neighbours")
    return np.where(turn[:, None], corners[:, ::-1], corners)


def _patches(n: int, edges: _Edges) -> np.ndarray:
    """Component (n,) of each face, across edges of exactly two triangles."""
    pair = edges.start[edges.count == 2]
    return _join(edges.face[pair], edges.face[pair + 1], n)


def _own_boundary(patch: np.ndarray, edges: _Edges) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Directed boundary of each patch apart: patch, edge and net sign (k,) where it is not zero."""
    loose = np.flatnonzero((edges.count != 2)[edges.edge])
    key = patch[edges.face[loose]] * np.int64(len(edges.net)) + edges.edge[loose]
    unique, inverse = np.unique(key, return_inverse=True)
    net = np.bincount(inverse, edges.sign[loose], minlength=len(unique)).astype(np.int64)
    unique, net = unique[net != 0], net[net != 0]
    return unique // len(edges.net), unique % len(edges.net), net


def _sheets(at: np.ndarray, corners: np.ndarray, edges: _Edges, repairs: list[str]) -> np.ndarray:
    """Faces (f,) of open sheets that bound nothing beside a body that does: fins, loose triangles.

    A sheet could be flat: its perimeter L and area A satisfy the plane's L^2 >= 4 pi A. And it is not part
    of a closed assembly: without it, less of the surface is open. Where sheets are most of the surface, they
    are what the user wants lit.
    """
    patch = _patches(len(corners), edges)
    owner, edge, net = _own_boundary(patch, edges)
    n = int(patch.max()) + 1
    length = np.linalg.norm(at[edges.ends[edge, 1]] - at[edges.ends[edge, 0]], axis=1)
    perimeter = np.bincount(owner, length * np.abs(net), minlength=n)
    area = np.bincount(patch, _areas(at, corners), minlength=n)
    gain = np.bincount(owner, np.abs(edges.net[edge]) - np.abs(edges.net[edge] - net), minlength=n)
    sheet = (perimeter**2 > 0.999 * 4 * np.pi * area) & (gain > 0)
    if not sheet.any() or 2 * area[sheet].sum() > area.sum():
        return np.zeros(len(corners), bool)
    loose = sheet[patch]
    repairs.append(f"left {np.count_nonzero(loose)} loose triangles out of the solid")
    return loose


def _caps(at: np.ndarray, corners: np.ndarray, repairs: list[str]) -> tuple[np.ndarray, np.ndarray]:
    """Fans (k, 3) over the directed boundary loops, and the centroids (c, 3) they meet at."""
    edges = _edges(corners)
    hole = np.flatnonzero(edges.net)
    if not len(hole):
        return np.zeros((0, 3), corners.dtype), np.zeros((0, 3))
    patch = _patches(len(corners), edges)[edges.face[edges.start[hole]]]
    low, high, net = edges.ends[hole, 0], edges.ends[hole, 1], edges.net[hole]
    # the caps' own edges run against the boundary
    tail, head = (np.repeat(np.where(s, high, low), np.abs(net)) for s in (net > 0, net < 0))
    patch = np.repeat(patch, np.abs(net))
    into, out = np.lexsort((patch, head)), np.lexsort((patch, tail))
    following = np.empty(len(tail), np.int64)
    following[into] = out
    loop = _join(np.arange(len(tail)), following, len(tail))
    weight = np.linalg.norm(at[head] - at[tail], axis=1)
    middle = (at[head] + at[tail]) / 2 * weight[:, None]
    total = np.bincount(loop, weight)
    centroids = np.stack([np.bincount(loop, middle[:, k]) / total for k in range(3)], axis=1)
    holes = "1 hole" if len(total) == 1 else f"{len(total)} holes"
    repairs.append(f"capped {holes} of {len(tail)} open edges")
    return np.stack([tail, head, len(at) + loop], axis=1), centroids


def _volumes(points: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Signed volumes (m,) of the tetrahedra between the origin and each triangle."""
    a, b, c = (points[corners[:, k]] for k in range(3))
    return np.einsum("ij,ij->i", a, np.cross(b, c)) / 6


def winding(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Winding number (n,) of triangles (m, 3, 3) about points (n, 3), by summing every solid angle.

    References
    ----------
    Van Oosterom and Strackee 1983, eq. (8).
    """
    out = np.empty(len(points))
    for i, point in enumerate(points):
        a, b, c = (triangles[:, k] - point for k in range(3))
        la, lb, lc = (np.sqrt(np.einsum("ij,ij->i", x, x)) for x in (a, b, c))
        triple = np.einsum("ij,ij->i", a, np.cross(b, c))
        dots = [np.einsum("ij,ij->i", x, y) * length for x, y, length in ((a, b, lc), (b, c, la), (c, a, lb))]
        out[i] = np.arctan2(triple, la * lb * lc + sum(dots)).sum() / (2 * np.pi)
    return out


def _inward(points: np.ndarray, corners: np.ndarray, edges: _Edges, repairs: list[str]) -> np.ndarray:
    """Which triangles (m,) of a closed surface to turn, so that bodies wind outward and their cavities inward.

    A component that winds inward and lies in no other is a body inside out: it is turned, with all it
    holds. One inside another is that one's cavity, and stays.
    """
    patch = _patches(len(corners), edges)
    owner, edge, _ = _own_boundary(patch, edges)
    if len(owner):  # patches that close one another along shared edges turn together
        order = np.argsort(edge, kind="stable")
        same = edge[order][1:] == edge[order][:-1]
        patch = _join(owner[order][:-1][same], owner[order][1:][same], int(patch.max()) + 1)[patch]
    volume = np.bincount(patch, _volumes(points, corners))
    turn = np.zeros(len(volume), bool)
    if (volume < 0).any():
        order = np.argsort(patch, kind="stable")
        members = np.split(order, np.cumsum(np.bincount(patch))[:-1])
        box = np.array([(points[corners[m]].min(axis=(0, 1)), points[corners[m]].max(axis=(0, 1))) for m in members])
        probe = np.array([points[corners[m[0], 0]] for m in members])
        root = np.arange(len(volume))
        for k in np.argsort(np.abs(volume)):  # the largest that holds a component has the last word
            inside = (probe > box[k, 0]).all(axis=1) & (probe < box[k, 1]).all(axis=1)
            inside = np.flatnonzero(inside & (np.abs(volume) < np.abs(volume[k])))
            held = np.abs(winding(probe[inside], points[corners[members[k]]])) > 0.5
            root[inside[held]] = k
        turn = (volume < 0)[root]
    if turn.any():
        what = "the whole surface" if turn.all() else f"{np.count_nonzero(turn)} of {len(turn)} components"
        repairs.append(f"turned {what} inside out")
    return turn[patch]
