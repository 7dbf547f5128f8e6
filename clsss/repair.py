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
from clsss.halfedges import HalfEdges, areas, half_edges, join, own_boundary, patches, thick, weld
from clsss.orientation import inward, volumes

FEW_HOLES = (20, 0.1)  # open edges, and share of all: with more, holes cannot be told from what is missing
_COLLINEAR = 1e-7  # height of a triangle over its longest side: what rounding to float32 leaves of zero
_NOTHING = 1e-12  # the same, where even double precision finds no normal


@dataclass(frozen=True)
class Repaired:
    """A repaired mesh in indices.

    Attributes
    ----------
    faces : (f', 3) int32
        Faces of the input that remain, to be drawn, wound as the solid is.
    welded : (v,) int32
        Position that each vertex lies at; -1 for vertices no face uses.
    solid : (m, 3) int32
        Closed surface, as vertices; from v on they are `centroids`.
    centroids : (c, 3) float64
        Points the caps meet at, in the frame of the vertices.
    was_closed, closed : bool
        Whether the input, and `solid`, have no open edge.
    repairs : list of str
        What was done, one short sentence each.
    """

    faces: np.ndarray
    welded: np.ndarray
    solid: np.ndarray
    centroids: np.ndarray
    was_closed: bool
    closed: bool
    repairs: list[str]


def repair(vertices: np.ndarray, faces: np.ndarray, centre: np.ndarray, longest: float) -> Repaired:
    """Weld, drop, orient and cap triangles until they bound a solid.

    Parameters
    ----------
    vertices : (v, 3) float64
        Any points.
    faces : (f, 3) int32
        Triangles.
    centre, longest : (3,) float64, float
        Of the bounding box of the vertices in use: its centre, its longest side.

    Returns
    -------
    Repaired

    Raises
    ------
    InputError
        The surface is one-sided.
    """
    repairs: list[str] = []
    welded, first, kept, edges = weld(vertices, faces, centre, longest)
    n_used = int(np.count_nonzero(welded >= 0))
    if len(first) < n_used:
        repairs.append(f"welded {n_used} vertices into {len(first)} positions")
    corners = edges.corners
    was_closed = edges.n_odd == 0
    at = np.subtract(vertices[first], centre, order="F")  # coordinates in rows are read fastest
    at /= longest
    if len(corners) < len(faces):
        collapsed = _count(len(faces) - len(corners), "triangle")
        repairs.append(f"dropped {collapsed} that had shrunk to an edge or a point")
    if edges.count.max(initial=0) > 2 or edges.n_odd:
        stay = _drop(at, edges, repairs)
        kept[kept], corners = stay, corners[stay]
        edges = half_edges(corners)
    if (edges.net[edges.count == 2] != 0).any():
        edges = half_edges(_consistent(at, edges, repairs))
    drawn, solid, centroids, closed = _enclose(at, edges, repairs)
    del edges
    turned, visible = drawn[:, 0] != corners[:, 0], thick(at, drawn, _NOTHING)
    as_drawn = len(solid) == len(drawn) and not len(centroids)
    shown = visible if as_drawn else thick(np.concatenate([at, centroids]), solid, _NOTHING)
    vertex = np.concatenate([first, len(vertices) + np.arange(len(centroids))]).astype(np.int32)
    solid = vertex[solid if shown.all() else solid[shown]]
    kept[kept] = visible
    faces = faces if kept.all() else faces[kept]
    if turned.any():
        faces = np.where(turned[visible, None], faces[:, ::-1], faces)
    return Repaired(faces, welded, solid, centroids * longest + centre, was_closed, closed, repairs)


def _enclose(
    at: np.ndarray, edges: HalfEdges, repairs: list[str]
) -> tuple[np.ndarray, np.ndarray, np.ndarray, bool]:
    """Faces turned outward, the surface they and their caps make, the caps' centroids, whether it is closed."""
    drawn, n_open, points, centroids, n_caps = edges.corners, edges.n_open, at, np.zeros((0, 3)), 0
    loose, soup = np.zeros(len(drawn), bool), n_open > FEW_HOLES[0] + FEW_HOLES[1] * 3 * len(drawn)
    if n_open and not soup:
        loose, soup = _sheets(at, edges)
    if soup:
        repairs.append("too many edges are open to cap holes; the inside is where the surface winds round")
        drawn = drawn if volumes(at, drawn).sum() >= 0 else drawn[:, ::-1]
        return drawn, drawn, centroids, False
    if loose.any():
        repairs.append(f"left {_count(np.count_nonzero(loose), 'loose triangle')} out of the solid")
    if n_open:
        caps, centroids = _caps(at, half_edges(drawn[~loose]), repairs)
        edges, n_caps = half_edges(np.concatenate([drawn[~loose], caps])), len(caps)
        points = np.concatenate([at, centroids])
    solid, turn = edges.corners, inward(points, edges, repairs)
    if turn.any():
        solid = np.where(turn[:, None], solid[:, ::-1], solid)
        drawn = drawn.copy()
        drawn[~loose] = solid[: len(solid) - n_caps]
    return drawn, solid, centroids, True


def _count(n: int | np.integer, noun: str) -> str:
    return f"{n} {noun}" if n == 1 else f"{n} {noun}s"


def _drop(at: np.ndarray, edges: HalfEdges, repairs: list[str]) -> np.ndarray:
    """Which faces (f,) stay: no loose slivers, no copies."""
    stay = np.ones(len(edges.corners), bool)
    high = thick(at, edges.corners, _COLLINEAR)
    if not high.all() and half_edges(edges.corners[high]).n_odd < edges.n_odd:
        repairs.append(f"dropped {_count(np.count_nonzero(~high), 'triangle')} without area")
        stay = high
    copies = _copies(edges, stay)
    if len(copies):
        repairs.append(f"dropped {_count(len(copies), 'duplicate triangle')}")
    stay[copies] = False
    return stay


def _copies(edges: HalfEdges, stay: np.ndarray) -> np.ndarray:
    """Triangles (k,), of those that stay, that repeat another: all but one, or both of two opposite ones."""
    corners, crowded = edges.corners, np.zeros(len(stay), bool)
    crowded[edges.face(edges.of(edges.count > 2)[0])] = True
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
    closes_better = half_edges(corners[none]).n_odd < half_edges(corners[one]).n_odd
    if closes_better and 2 * np.count_nonzero(none) > len(corners):
        one = none
    return np.flatnonzero(stay & ~one)


def _consistent(at: np.ndarray, edges: HalfEdges, repairs: list[str]) -> np.ndarray:
    """Turn triangles (f, 3) so that neighbours agree, as few as possible in each component.

    Each face has two nodes, itself and itself turned; neighbours are linked in the way that agrees. The
    surface is one-sided where a face is connected with itself turned.
    """
    corners, n = edges.corners, len(edges.corners)
    pair = edges.start[edges.count == 2]
    f, g = edges.face(pair), edges.face(pair + 1)
    clash = edges.sign(pair) == edges.sign(pair + 1)
    label = join(np.concatenate([f, f + n]), np.concatenate([g + n * clash, g + n * ~clash]), 2 * n)
    as_is, turned = label[:n], label[n:]
    one_sided = as_is == turned
    area = areas(at, corners)
    if area[one_sided].sum() > 0.1 * area.sum():
        raise InputError("the surface is one-sided like a Moebius strip or a Klein bottle and has no inside")
    component, side = np.minimum(as_is, turned), as_is > turned
    votes = np.bincount(component, np.where(side, 1, -1), minlength=2 * n)
    turn = (side == (votes[component] <= 0)) & ~one_sided
    repairs.append(f"turned {_count(np.count_nonzero(turn), 'triangle')} to agree with the neighbours")
    return np.where(turn[:, None], corners[:, ::-1], corners)


def _sheets(at: np.ndarray, edges: HalfEdges) -> tuple[np.ndarray, bool]:
    """Faces (f,) of open sheets beside a body, and whether instead many sheets patch up the surface.

    A sheet could be flat: the perimeters L of its loops and its area A satisfy the plane's
    sum L^2 >= 4 pi A. Beside a body it bounds nothing, unless it closes with others: then more of the
    surface is open without it.
    """
    patch = patches(edges)
    owner, edge, net = own_boundary(patch, edges)
    n, m = int(patch.max()) + 1, len(owner)
    low, high = edges.ends(edge).T
    ends, at_end = np.unique(owner * len(at) + [low, high], return_inverse=True)
    loop = join(np.tile(np.arange(m), 2), m + at_end.ravel(), m + len(ends))[:m]
    length = np.linalg.norm(at[high] - at[low], axis=1) * np.abs(net)
    perimeter = np.bincount(loop, length)[loop]
    squares = np.bincount(owner, length * perimeter, minlength=n)
    area = np.bincount(patch, areas(at, edges.corners), minlength=n)
    sheet = squares > 0.999 * 4 * np.pi * area
    if 2 * area[sheet].sum() > area.sum():
        return np.zeros(len(patch), bool), bool(2 * area[sheet].max() < area.sum())
    of_all = edges.net[edge]
    gain = np.bincount(owner, np.abs(of_all) - np.abs(of_all - net), minlength=n)
    return (sheet & (gain > 0))[patch], False


def _caps(at: np.ndarray, edges: HalfEdges, repairs: list[str]) -> tuple[np.ndarray, np.ndarray]:
    """Fans (k, 3) over the directed boundary loops, and the centroids (c, 3) they meet at."""
    net = edges.net
    hole = np.flatnonzero(net)
    if not len(hole):
        return np.zeros((0, 3), np.int32), np.zeros((0, 3))
    patch, net = patches(edges)[edges.face(edges.start[hole])], net[hole]
    low, high = edges.ends(hole).T
    # the caps' own edges run against the boundary
    tail, head = (np.repeat(np.where(s, high, low), np.abs(net)) for s in (net > 0, net < 0))
    patch = np.repeat(patch, np.abs(net))
    into, out = np.lexsort((patch, head)), np.lexsort((patch, tail))
    following = np.empty(len(tail), np.int64)
    following[into] = out
    loop = join(np.arange(len(tail)), following, len(tail))
    weight = np.linalg.norm(at[head] - at[tail], axis=1)
    middle = (at[head] + at[tail]) / 2 * weight[:, None]
    total = np.bincount(loop, weight)
    centroids = np.stack([np.bincount(loop, middle[:, k]) / total for k in range(3)], axis=1)
    repairs.append(f"capped {_count(len(total), 'hole')} of {_count(len(tail), 'open edge')}")
    return np.stack([tail, head, len(at) + loop], axis=1), centroids
