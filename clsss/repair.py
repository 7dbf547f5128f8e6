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
from clsss.halfedges import (
    HalfEdges,
    areas,
    distinct,
    half_edges,
    join,
    own_boundary,
    patches,
    thick,
    weld,
)
from clsss.rays import winding

FEW_HOLES = (20, 0.1)  # open edges, and share of all: with more, holes cannot be told from what is missing
_COLLINEAR = 1e-7  # height of a triangle over its longest side: what rounding to float32 leaves of zero
_NOTHING = 1e-12  # the same, where even double precision finds no normal


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
    welded, first, edges = weld(points, faces)
    n_used = int(np.count_nonzero(welded >= 0))
    if len(first) < n_used:
        repairs.append(f"welded {n_used} vertices into {len(first)} positions")
    corners = welded[faces]
    was_closed = edges.n_odd == 0
    at = points[first]
    kept = np.flatnonzero(distinct(corners))
    if len(kept) < len(corners):
        collapsed = _count(len(corners) - len(kept), "triangle")
        repairs.append(f"dropped {collapsed} that had shrunk to an edge or a point")
        corners = corners[kept]
    if edges.count.max(initial=0) > 2 or edges.n_odd:
        stay = _drop(at, corners, edges, repairs)
        kept, corners = kept[stay], corners[stay]
        edges = half_edges(corners)
    drawn = corners
    if (edges.net[edges.count == 2] != 0).any():
        drawn = _consistent(at, drawn, edges, repairs)
        edges = half_edges(drawn)
    loose, soup = np.zeros(len(drawn), bool), edges.n_open > FEW_HOLES[0] + FEW_HOLES[1] * 3 * len(drawn)
    if edges.n_open and not soup:
        loose, soup = _sheets(at, drawn, edges)
    if soup:
        repairs.append("too many edges are open to cap holes; the inside is where the surface winds round")
        solid, centroids = drawn, np.zeros((0, 3))
        if _volumes(at, drawn).sum() < 0:
            drawn = solid = drawn[:, ::-1]
    else:
        drawn, solid, centroids = _enclose(at, drawn, loose, edges, repairs)
    turned, visible = drawn[:, 0] != corners[:, 0], thick(at, drawn, _NOTHING)
    as_drawn = soup or not (loose.any() or len(centroids))
    solid = solid[visible if as_drawn else thick(np.concatenate([at, centroids]), solid, _NOTHING)]
    return Repaired(
        kept[visible], turned[visible], welded, first, solid, centroids, was_closed, not soup, repairs
    )


def _enclose(
    at: np.ndarray, drawn: np.ndarray, loose: np.ndarray, edges: HalfEdges, repairs: list[str]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Faces turned outward, the closed surface they and their caps make, and the caps' centroids."""
    solid, centroids, n_caps = drawn, np.zeros((0, 3)), 0
    if loose.any():
        repairs.append(f"left {_count(np.count_nonzero(loose), 'loose triangle')} out of the solid")
    if edges.n_open:
        caps, centroids = _caps(at, drawn[~loose], repairs)
        solid, n_caps = np.concatenate([drawn[~loose], caps]), len(caps)
        edges = half_edges(solid)
    turn = _inward(np.concatenate([at, centroids]), solid, edges, repairs)
    solid = np.where(turn[:, None], solid[:, ::-1], solid)
    drawn = drawn.copy()
    drawn[~loose] = solid[: len(solid) - n_caps]
    return drawn, solid, centroids


def _count(n: int | np.integer, noun: str) -> str:
    return f"{n} {noun}" if n == 1 else f"{n} {noun}s"


def _drop(at: np.ndarray, corners: np.ndarray, edges: HalfEdges, repairs: list[str]) -> np.ndarray:
    """Which faces (f,) stay: no loose slivers, no copies."""
    stay = np.ones(len(corners), bool)
    high = thick(at, corners, _COLLINEAR)
    if not high.all() and half_edges(corners[high]).n_odd < edges.n_odd:
        repairs.append(f"dropped {_count(np.count_nonzero(~high), 'triangle')} without area")
        stay = high
    copies = _copies(corners, edges, stay)
    if len(copies):
        repairs.append(f"dropped {_count(len(copies), 'duplicate triangle')}")
    stay[copies] = False
    return stay


def _copies(corners: np.ndarray, edges: HalfEdges, stay: np.ndarray) -> np.ndarray:
    """Triangles (k,), of those that stay, that repeat another: all but one, or both of two opposite ones."""
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
    closes_better = half_edges(corners[none]).n_odd < half_edges(corners[one]).n_odd
    if closes_better and 2 * np.count_nonzero(none) > len(corners):
        one = none
    return np.flatnonzero(stay & ~one)


def _consistent(at: np.ndarray, corners: np.ndarray, edges: HalfEdges, repairs: list[str]) -> np.ndarray:
    """Turn triangles so that neighbours agree, as few as possible in each component.

    Each face has two nodes, itself and itself turned; neighbours are linked in the way that agrees. The
    surface is one-sided where a face is connected with itself turned.
    """
    n = len(corners)
    pair = edges.start[edges.count == 2]
    f, g = edges.face[pair], edges.face[pair + 1]
    clash = edges.sign[pair] == edges.sign[pair + 1]
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


def _sheets(at: np.ndarray, corners: np.ndarray, edges: HalfEdges) -> tuple[np.ndarray, bool]:
    """Faces (f,) of open sheets beside a body, and whether instead many sheets patch up the surface.

    A sheet could be flat: the perimeters L of its loops and its area A satisfy the plane's
    sum L^2 >= 4 pi A. Beside a body it bounds nothing, unless it closes with others: then more of the
    surface is open without it.
    """
    patch = patches(len(corners), edges)
    owner, edge, net = own_boundary(patch, edges)
    n, m = int(patch.max()) + 1, len(owner)
    ends, at_end = np.unique(owner[:, None] * len(at) + edges.ends[edge], return_inverse=True)
    twice = np.tile(np.arange(m), 2)
    loop = join(twice, m + at_end.reshape(m, 2).T.ravel(), m + len(ends))[:m]
    length = np.linalg.norm(at[edges.ends[edge, 1]] - at[edges.ends[edge, 0]], axis=1) * np.abs(net)
    perimeter = np.bincount(loop, length)[loop]
    squares = np.bincount(owner, length * perimeter, minlength=n)
    area = np.bincount(patch, areas(at, corners), minlength=n)
    sheet = squares > 0.999 * 4 * np.pi * area
    if 2 * area[sheet].sum() > area.sum():
        return np.zeros(len(corners), bool), bool(2 * area[sheet].max() < area.sum())
    gain = np.bincount(owner, np.abs(edges.net[edge]) - np.abs(edges.net[edge] - net), minlength=n)
    return (sheet & (gain > 0))[patch], False


def _caps(at: np.ndarray, corners: np.ndarray, repairs: list[str]) -> tuple[np.ndarray, np.ndarray]:
    """Fans (k, 3) over the directed boundary loops, and the centroids (c, 3) they meet at."""
    edges = half_edges(corners)
    hole = np.flatnonzero(edges.net)
    if not len(hole):
        return np.zeros((0, 3), corners.dtype), np.zeros((0, 3))
    patch = patches(len(corners), edges)[edges.face[edges.start[hole]]]
    low, high, net = edges.ends[hole, 0], edges.ends[hole, 1], edges.net[hole]
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


def _volumes(points: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Signed volumes (m,) of the tetrahedra between the origin and each triangle."""
    a, b, c = (points[corners[:, k]] for k in range(3))
    return np.einsum("ij,ij->i", a, np.cross(b, c)) / 6


def _inward(points: np.ndarray, corners: np.ndarray, edges: HalfEdges, repairs: list[str]) -> np.ndarray:
    """Which triangles (m,) of a closed surface to turn: bodies wind outward, their cavities inward.

    A component that winds inward and lies in no other is a body inside out: it is turned, with all it
    holds. One inside another is that one's cavity, and stays.
    """
    patch = patches(len(corners), edges)
    owner, edge, _ = own_boundary(patch, edges)
    if len(owner):  # patches that close one another along shared edges turn together
        order = np.argsort(edge, kind="stable")
        same = edge[order][1:] == edge[order][:-1]
        patch = join(owner[order][:-1][same], owner[order][1:][same], int(patch.max()) + 1)[patch]
    volume = np.bincount(patch, _volumes(points, corners))
    turn = np.zeros(len(volume), bool)
    if (volume < 0).any():
        order = np.argsort(patch, kind="stable")
        members = np.split(order, np.cumsum(np.bincount(patch))[:-1])
        corner_sets = [points[corners[m]] for m in members]
        box = np.array([(c.min(axis=(0, 1)), c.max(axis=(0, 1))) for c in corner_sets])
        probe = np.array([c[0, 0] for c in corner_sets])
        root = np.arange(len(volume))
        for k in np.argsort(np.abs(volume)):  # the largest that holds a component has the last word
            inside = (probe > box[k, 0]).all(axis=1) & (probe < box[k, 1]).all(axis=1)
            inside &= (np.abs(volume) < np.abs(volume[k])) & ((volume < 0) | (volume[k] < 0))
            inside = np.flatnonzero(inside)
            held = np.abs(winding(probe[inside], corner_sets[k])) > 0.5
            root[inside[held]] = k
        turn = (volume < 0)[root[root]]
    if turn.any():
        what = "the whole surface" if turn.all() else f"{np.count_nonzero(turn)} of {len(turn)} components"
        repairs.append(f"turned {what} inside out")
    return turn[patch]
