"""Coarse cells: the connected parts of 2x2x2 blocks of finer ones, and the open faces between them.

A block whose finer cells hang together is one coarse cell; one that holds parts of bodies, fins or folds that do not
touch within it is several, all of the block's colour. Such a part may then touch several others across one face.

References
----------
docs/numerics.md, "Multigrid".
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse import csgraph

STEP = [(-1, 0, 0), (1, 0, 0), (0, -1, 0), (0, 1, 0), (0, 0, -1), (0, 0, 1)]
LOOSE = np.array([-1, -1, 0, 1, 2, 4, 5, 7, 9])  # most open faces inside a block of so many cells in two parts
SLAB = 8  # layers of a grid at a time, so that lists of places take little memory
CHUNK = 1 << 14  # cells whose neighbours are sought at a time
DENSE = 64  # most cells of the coarsest level, whose inverse is dense


@dataclass(frozen=True, eq=False)
class Cells:
    """Cells of one width, by colour, and the open faces between them.

    Attributes
    ----------
    ijk : (n, 3) int32
    leaf : (n,) bool
    colour_start : (3,) int
        First red, first black, end.
    index : (nz + 2, ny + 2, nx + 2) int32 or None
        Cell at each position, with a margin of one; -1: none. The first of several in one block.
    nbr : (n, 6) int32
        A neighbour of the same width behind each face; -1: none, or the face is closed.
    more : (m, 3) int32
        Further neighbours: cell, face, neighbour; sorted.
    surface : (n,) bool
        Whether a cell holds part of the surface. Such cells are never next to leaves of coarser levels; next to leaves
        of their own width a block of them has one part only, since no child there is cut.
    shares : (n,) bool
        Whether other cells lie in the same block.
    """

    ijk: np.ndarray
    leaf: np.ndarray
    colour_start: tuple[int, int, int]
    index: np.ndarray | None
    nbr: np.ndarray
    more: np.ndarray
    surface: np.ndarray
    shares: np.ndarray


def ordered(mask: np.ndarray) -> tuple[np.ndarray, tuple[int, int, int]]:
    """Cells (n, 3) of a mask by colour, then z, y, x."""
    parts: tuple[list[np.ndarray], list[np.ndarray]] = [], []
    for first in range(0, len(mask), SLAB):
        ijk = np.argwhere(mask[first : first + SLAB])[:, ::-1].astype(np.int32) + np.array([0, 0, first], np.int32)
        black = ijk.sum(axis=1) & 1
        for colour in (0, 1):
            parts[colour].append(ijk[black == colour])
    n_red = sum(map(len, parts[0]))
    ijk = np.concatenate(parts[0] + parts[1])
    return ijk, (0, n_red, len(ijk))


def index_map(shape: tuple[int, ...], ijk: np.ndarray) -> np.ndarray:
    """Dense map from position to index, padded by one cell of -1 on every side."""
    out = np.full([n + 2 for n in shape], -1, np.int32)
    out[ijk[:, 2] + 1, ijk[:, 1] + 1, ijk[:, 0] + 1] = np.arange(len(ijk), dtype=np.int32)
    return out


def finest_cells(ijk: np.ndarray, colour_start: tuple[int, int, int], nbr: np.ndarray, cut: np.ndarray,
                 aperture: np.ndarray) -> Cells:  # fmt: skip
    """The finest level: `nbr` (n, 6) by position is closed where cut cells' `aperture` (n_cut, 3) is nothing."""
    row, axis = np.nonzero((aperture <= 0) & (nbr[cut, 1::2] >= 0))
    face = 2 * axis + 1
    beyond = nbr[cut[row], face]
    nbr[cut[row], face] = nbr[beyond, face ^ 1] = -1
    n = len(ijk)
    surface = np.zeros(n, bool)
    surface[cut] = True
    return Cells(ijk, np.ones(n, bool), colour_start, None, nbr, np.empty((0, 3), np.int32), surface,
                 np.zeros(n, bool))  # fmt: skip


def coarsen(fine: Cells, shape: tuple[int, ...], ijk: np.ndarray, leaf: np.ndarray, n_red: int,
            whole: bool = False) -> tuple[Cells, np.ndarray]:  # fmt: skip
    """The next coarser level.

    Parameters
    ----------
    fine : Cells
    shape : (3,) int
        Size of the coarse grid (z, y, x).
    ijk, leaf, n_red : arrays (n, 3), (n,), int
        Positions of the coarse level, the red ones first, and which of them no finer cells replace.
    whole : bool
        Whether blocks stay one cell each, whatever parts they have.

    Returns
    -------
    Cells
    parent : (n_fine,) int32
    """
    n = len(ijk)
    index = index_map(shape, ijk)
    parent = _around(fine.ijk, index, [(0, 0, 0)], 1)[:, 0]
    parent, block = _split(fine, parent, n)
    if whole:
        parent, block = np.append(np.arange(n), block).astype(np.int32)[parent], block[:0]
    order = np.argsort(np.append(np.arange(n), block), kind="stable")
    rank = np.empty(len(order), np.int32)
    rank[order] = np.arange(len(order), dtype=np.int32)
    if len(block):
        parent, index = rank[parent], np.where(index >= 0, rank[index], -1)
    shares = np.zeros(len(order), bool)
    shares[block] = shares[n:] = True
    ijk = np.concatenate([ijk, ijk[block]])[order]
    leaf = np.concatenate([leaf, np.zeros(len(block), bool)])[order]
    surface = np.zeros(len(order), bool)
    surface[parent[fine.surface]] = True
    nbr, more = _link(fine, parent, surface, leaf, _around(ijk, index, STEP))
    start = (0, n_red + int((block < n_red).sum()), len(order))
    return Cells(ijk, leaf, start, index, nbr, more, surface, shares[order]), parent


def coarsen_further(fine: Cells) -> tuple[Cells, np.ndarray]:
    """A level without leaves over what was the coarsest, as `coarsen`; of whole blocks if their parts are no fewer."""
    block = fine.ijk >> 1
    mask = np.zeros(block.max(axis=0)[::-1] + 1, bool)
    mask[tuple(block.T[::-1])] = True
    ijk, (_, n_red, n) = ordered(mask)
    coarse, parent = coarsen(fine, mask.shape, ijk, np.zeros(n, bool), n_red)
    if len(coarse.ijk) == len(fine.ijk):
        coarse, parent = coarsen(fine, mask.shape, ijk, np.zeros(n, bool), n_red, whole=True)
    return coarse, parent


def _split(fine: Cells, parent: np.ndarray, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Parents by connected part: the first of each block keeps its number, the others follow n; and their blocks."""
    near = np.zeros(n, bool)
    near[parent[fine.surface]] = True
    rows = np.flatnonzero(near[parent])
    upper = fine.ijk[rows] & 1
    open_faces = sum(fine.nbr[rows, 2 * d + 1 - upper[:, d]] >= 0 for d in range(3))
    size = np.bincount(parent[rows], minlength=n)
    joints = np.bincount(parent[rows], open_faces, minlength=n) / 2
    suspect = joints <= LOOSE[np.minimum(size, 8)]
    suspect[parent[fine.shares]] = True
    rows = rows[suspect[parent[rows]]]
    number = np.full(len(fine.ijk), -1, np.int32)
    number[rows] = np.arange(len(rows), dtype=np.int32)
    face, more = fine.nbr[rows], fine.more
    i = np.concatenate([np.repeat(rows, 6), more[:, 0]])
    j = np.concatenate([face.ravel(), more[:, 2]])
    inside = (j >= 0) & (number[i] >= 0) & (parent[i] == parent[j])
    pairs = number[i[inside]], number[j[inside]]
    graph = sparse.coo_matrix((np.ones(len(pairs[0]), np.int8), pairs), shape=(len(rows), len(rows)))
    n_parts, part = csgraph.connected_components(graph, directed=False)
    first = np.full(n_parts, len(rows), np.int64)
    np.minimum.at(first, part, np.arange(len(rows)))
    block = parent[rows[first]]
    order = np.lexsort((first, block))
    again = np.concatenate([[False], block[order][1:] == block[order][:-1]]) if n_parts else np.zeros(0, bool)
    of_part = np.empty(n_parts, np.int32)
    of_part[order] = np.where(again, n + np.cumsum(again) - 1, block[order])
    parent = parent.copy()
    parent[rows] = of_part[part]
    return parent, block[order][again]


def _around(ijk: np.ndarray, index: np.ndarray, steps: list[tuple[int, int, int]], above: int = 0) -> np.ndarray:
    """Cells (n, k) at positions (n, 3), or of those that hold them some levels `above`, and k steps on; -1: none."""
    found = np.empty((len(ijk), len(steps)), np.int32)
    flat, (_, ny, nx) = index.ravel(), index.shape
    for first in range(0, len(ijk), CHUNK):
        x, y, z = (ijk[first : first + CHUNK] >> above).astype(np.int64).T + 1
        place = (z * ny + y) * nx + x
        for k, (dx, dy, dz) in enumerate(steps):
            found[first : first + CHUNK, k] = flat[place + (dz * ny + dy) * nx + dx]
    return found


def _link(fine: Cells, parent: np.ndarray, surface: np.ndarray, leaf: np.ndarray,
          nbr: np.ndarray) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """Neighbours of coarse cells, where they hold surface those that finer open faces lead to; and further ones.

    Finer cells that miss a neighbour where a leaf of the coarse level is face that leaf.
    """
    rows = np.flatnonzero(surface[parent])
    upper = (fine.ijk[rows] & 1).astype(bool)
    links: list[tuple[np.ndarray, np.ndarray]] = []  # 6 cell + face, neighbour
    for face in range(6):
        i = rows[upper[:, face >> 1] == (face & 1)]
        j, by_position = fine.nbr[i, face], nbr[parent[i], face]
        beyond = np.where(j >= 0, parent[j], np.where((by_position >= 0) & leaf[by_position], by_position, -1))
        i, beyond = i[beyond >= 0], beyond[beyond >= 0]
        links.append((6 * parent[i] + face, beyond))
    i, face, j = fine.more[parent[fine.more[:, 0]] != parent[fine.more[:, 2]]].T
    links.append((6 * parent[i] + face, parent[j]))
    for link, beyond in links[:]:
        inner = ~surface[beyond]
        links.append((6 * beyond[inner] + (link[inner] % 6 ^ 1), link[inner] // 6))
    nbr[surface] = -1
    flat, others = nbr.ravel(), []
    for link, beyond in links:
        flat[link] = beyond
    for link, beyond in links:
        lost = flat[link] != beyond
        others.append(np.stack([link[lost] // 6, link[lost] % 6, beyond[lost]], axis=1))
    return nbr, np.unique(np.concatenate(others), axis=0)


def octants(ijk: np.ndarray) -> np.ndarray:
    """Which octant of its parent each cell (n, 3) is (n,) uint8, x fastest."""
    x, y, z = (ijk & 1).astype(np.uint8).T
    return x | y << 1 | z << 2


def first_children(fine: Cells, parent: np.ndarray, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Finer cells (n, 8) of each coarse one, x fastest, and the chain of those that share an octant (child.h)."""
    octant = octants(fine.ijk)
    child = np.full((n, 8), -1, np.int32)
    child[parent, octant] = np.arange(len(parent), dtype=np.int32)
    rest = np.flatnonzero(child[parent, octant] != np.arange(len(parent)))
    chain = np.empty((len(rest), 2), np.int32)
    for k, i in enumerate(rest):
        chain[k] = i, child[parent[i], octant[i]]
        child[parent[i], octant[i]] = -2 - k
    return child, chain
