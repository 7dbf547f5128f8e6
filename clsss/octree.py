"""The adaptive octree, flattened: one frozen `Level` of arrays per level, level 0 the coarsest.

Cut cells and some layers around them lie on the finest level; inside, cells merge where the light varies
slowly. Every level holds the cells of its width: leaves, and covered cells that finer ones replace (they carry
the corrections of multigrid). Cells are sorted by colour, then z, y, x, so that one colour is contiguous.

References
----------
Haber et al. 2005, section 3.2.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from clsss.cutcell import CutCells, Grid, Samples, cut_moments
from clsss.device import Buffer, Device
from clsss.leafmap import clearance_map, leaf_map
from clsss.refinement import Refine, pool, split_masks, spread


@dataclass(frozen=True, eq=False)
class Level:
    """Cells of one width. A ghost stands for a cell twice as wide beyond a face, one for each such face.

    Attributes
    ----------
    h : float
        Width [mm].
    depth : int
        How many levels above the finest.
    ijk : (n, 3) int32
        Position in widths of this level.
    leaf : (n,) bool
        Whether no finer cells replace it.
    colour_start : (3,) int
        First red, first black, end.
    nbr : (n, 6) int32, device
        Neighbours -x +x -y +y -z +z: a cell, n + ghost, or the cell itself where there is none.
    parent : (n + n_ghost,) int32, device
        The next coarser level's cell that contains the cell, or that the ghost stands for.
    child : (n, 8) int32, device
        Finer cells, x fastest; -1: none. (Not on the finest level.)
    is_leaf : (n,) uint8, device
    ghost_face : (n_ghost,) int32, device
        6 cell + face, for each ghost.
    interface : (m,) int32, device
        Leaves with finer neighbours.
    interface_start : (m + 1,) int32, device
        First of each one's ghosts among those of the next finer level.
    """

    h: float
    depth: int
    ijk: np.ndarray
    leaf: np.ndarray
    colour_start: tuple[int, int, int]
    nbr: Buffer
    parent: Buffer | None
    child: Buffer | None
    is_leaf: Buffer
    position: Buffer
    n_ghost: int
    ghost_face: Buffer
    interface: Buffer
    interface_start: Buffer

    @property
    def n(self) -> int:
        """Number of cells."""
        return len(self.ijk)


@dataclass(frozen=True, eq=False)
class Octree:
    """Levels from coarsest to finest, the cut cells, and the map from finest grid to leaves (tree.h).

    Attributes
    ----------
    cut_index : (n,) int32, device
        For each finest cell its place among `cut`, or -1 where it is full.
    block, brick : int32, device
        The two-level map of leaf codes.
    clearance : (n_blocks, 512) uint8, device
        How far each cell of the finest grid is from one of another kind (clearance.cl).
    """

    grid: Grid
    levels: tuple[Level, ...]
    cut: CutCells
    cut_index: Buffer
    block: Buffer
    brick: Buffer
    clearance: Buffer

    @property
    def finest(self) -> Level:
        """The level of the cut cells."""
        return self.levels[-1]

    @property
    def body(self) -> tuple[Any, ...]:
        """What rays run through, as kernels take it (body.h), but for the medium's extinction."""
        cut = self.cut
        return (self.grid.dims, self.block, self.brick, self.clearance, self.cut_index, cut.boundary, cut.normal,
                cut.centroid)  # fmt: skip

    @property
    def n_cells(self) -> int:
        """Cells of all levels."""
        return sum(level.n for level in self.levels)

    def volumes(self) -> list[np.ndarray]:
        """Volume inside the object of the cells (n,) of each level [mm^3]."""
        volumes = [np.full(level.n, level.h**3) for level in self.levels]
        volumes[-1][self.cut.cell.get()] *= self.cut.centroid.get()[:, 3]
        return volumes

    def find(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The leaf at points (n, 3) [mm]: how many levels above the finest, and its index there; -1: none."""
        ijk = np.floor(self.grid.to_cells(points)).astype(np.int64)
        outside = ((ijk < 0) | (ijk >= self.grid.dims)).any(axis=1)
        x, y, z = np.where(outside[:, None], 0, ijk).T
        _, by, bx = self.grid.blocks
        block = self.block.get()[((z >> 3) * by + (y >> 3)) * bx + (x >> 3)]
        local = ((z & 7) * 8 + (y & 7)) * 8 + (x & 7)
        in_brick = self.brick.get()[np.maximum(block, 0) * 512 + local]
        code = np.where(block >= 0, in_brick, np.where(block == -1, -1, -2 - block))
        code = np.where(outside, -1, code)
        return np.where(code < 0, -1, code & 15), np.where(code < 0, -1, code >> 4)

    @property
    def n_leaves(self) -> int:
        """Cells that no finer ones replace."""
        return sum(int(level.leaf.sum()) for level in self.levels)


def _ordered(mask: np.ndarray) -> tuple[np.ndarray, tuple[int, int, int]]:
    """Cells (n, 3) of a mask by colour, then z, y, x."""
    z, y, x = np.nonzero(mask)
    ijk = np.stack([x, y, z], axis=1).astype(np.int32)
    black = (ijk.sum(axis=1) & 1).astype(bool)
    n_red = int((~black).sum())
    return np.concatenate([ijk[~black], ijk[black]]), (0, n_red, len(ijk))


def _index_map(shape: tuple[int, ...], ijk: np.ndarray) -> np.ndarray:
    """Dense map from position to index, padded by one cell of -1 on every side."""
    out = np.full([n + 2 for n in shape], -1, np.int32)
    out[ijk[:, 2] + 1, ijk[:, 1] + 1, ijk[:, 0] + 1] = np.arange(len(ijk), dtype=np.int32)
    return out


_STEP = [(-1, 0, 0), (1, 0, 0), (0, -1, 0), (0, 1, 0), (0, 0, -1), (0, 0, 1)]


def _coarse_neighbours(ijk: np.ndarray, own: np.ndarray, coarser: np.ndarray | None) -> np.ndarray:
    """Neighbours of cells of one level as in octree.cl, by dense maps of it and of the next coarser one's leaves."""
    nbr = np.empty((len(ijk), 6), np.int32)
    for face, step in enumerate(_STEP):
        x, y, z = (ijk + step + 1).T
        nbr[:, face] = own[z, y, x]
        if coarser is not None:
            lost = np.flatnonzero(nbr[:, face] < 0)
            x, y, z = ((ijk[lost] + step) // 2).T + 1
            nbr[lost, face] = np.where(coarser[z, y, x] >= 0, -2 - coarser[z, y, x], -1)
    return nbr


def _make_level(device: Device, grid: Grid, depth: int, ijk: np.ndarray, leaf: np.ndarray,
                colour_start: tuple[int, int, int], nbr: np.ndarray, parent: np.ndarray | None,
                child: np.ndarray | None) -> tuple[Level, np.ndarray]:  # fmt: skip
    """Number the ghosts by the coarse cell they stand for; the level, and those cells."""
    n = len(ijk)
    flat = nbr.ravel()
    face = np.flatnonzero(flat < -1)
    source = -2 - flat[face]
    order = np.argsort(source, kind="stable")
    face, source = face[order].astype(np.int32), source[order]
    flat[face] = n + np.arange(len(face), dtype=np.int32)
    none = np.flatnonzero(flat == -1)
    flat[none] = none // 6
    to_parent = None if parent is None else device.array(np.concatenate([parent, source]).astype(np.int32))
    position = np.concatenate([ijk, np.zeros((n, 1), np.int32)], axis=1)
    level = Level(grid.h * 2**depth, depth, ijk, leaf, colour_start, device.array(nbr), to_parent,
                  None if child is None else device.array(child), device.array(leaf.astype(np.uint8)),
                  device.array(position), len(face), device.array(face),
                  device.empty(0, np.int32), device.empty(0, np.int32))  # fmt: skip
    return level, source


def build(device: Device, grid: Grid, samples: Samples, refine: Refine | None = None) -> Octree:
    """The octree of an object.

    Parameters
    ----------
    device, grid, samples
        From `clsss.cutcell`.
    refine : callable, optional
        Which cells away from the surface are too wide, see `varies`. By default every leaf is on the finest level.

    Returns
    -------
    Octree
    """
    touched = samples.cells
    solid = samples.inside.astype(bool)
    solid[touched[:, 2], touched[:, 1], touched[:, 0]] = samples.state > 0
    is_cut = np.zeros(solid.shape, bool)
    cut_rows = np.flatnonzero(samples.state == 2)
    is_cut[tuple(touched[cut_rows, ::-1].T)] = True
    has = [solid]
    while max(has[0].shape) > 4:
        has.insert(0, pool(has[0]))
    split = split_masks(grid, has, is_cut, refine) if refine else [mask.copy() for mask in has[:-1]]
    exists = [has[0]] + [h & spread(s, h.shape) for h, s in zip(has[1:], split, strict=True)]
    cells, colour_start = zip(*[_ordered(mask) for mask in exists], strict=True)
    leaf = [~s[c[:, 2], c[:, 1], c[:, 0]] for s, c in zip(split, cells[:-1], strict=True)]
    leaf.append(np.ones(len(cells[-1]), bool))
    block, brick = leaf_map(grid, list(cells), leaf)
    block_buffer, brick_buffer = device.array(block), device.array(brick)
    levels: list[Level] = []
    sources: list[np.ndarray] = []
    coarser_map: np.ndarray | None = None
    coarser_leaves: np.ndarray | None = None
    for depth, ijk in zip(range(len(cells) - 1, -1, -1), cells, strict=True):
        n, number = len(ijk), len(levels)
        parent = None
        if coarser_map is not None:
            x, y, z = (ijk >> 1).T + 1
            parent = coarser_map[z, y, x]
        if depth == 0:
            packed, nbr_buffer = device.array(ijk), device.empty((n, 6), np.int32)
            kernel = device.kernel("octree", "neighbours")
            device.run(kernel, n, n, grid.dims, block_buffer, brick_buffer, packed, nbr_buffer)
            nbr, child = nbr_buffer.get(), None
        else:
            own_map = _index_map(has[number].shape, ijk)
            nbr = _coarse_neighbours(ijk, own_map, coarser_leaves)
            finer, coarser_map = cells[number + 1], own_map
            coarser_leaves = np.where(np.append(leaf[number], False)[own_map], own_map, -1)
            x, y, z = (finer >> 1).T + 1
            child = np.full((n, 8), -1, np.int32)
            octant = (finer & 1) @ np.array([1, 2, 4])
            child[own_map[z, y, x], octant] = np.arange(len(finer), dtype=np.int32)
        level, source = _make_level(device, grid, depth, ijk, leaf[number], colour_start[number], nbr, parent, child)
        levels.append(level)
        sources.append(source)
    for number, source in enumerate(sources[1:]):
        interface, first = np.unique(source, return_index=True)
        start = np.concatenate([first, [len(source)]]).astype(np.int32)
        levels[number] = replace(
            levels[number], interface=device.array(interface.astype(np.int32)), interface_start=device.array(start)
        )
    cut, cut_index = _cut_cells(device, samples, cut_rows, cells[-1], grid, block, brick)
    clearance = clearance_map(device, grid, solid, is_cut)
    return Octree(grid, tuple(levels), cut, cut_index, block_buffer, brick_buffer, clearance)


def _cut_cells(device: Device, samples: Samples, rows: np.ndarray, ijk: np.ndarray, grid: Grid, block: np.ndarray,
               brick: np.ndarray) -> tuple[CutCells, Buffer]:  # fmt: skip
    """Moments of the cut cells in the order of the finest level, and each finest cell's place among them."""
    _, by, bx = grid.blocks
    x, y, z = samples.cells[rows].T
    base = block[((z >> 3) * by + (y >> 3)) * bx + (x >> 3)] * 512
    index = brick[base + ((z & 7) * 8 + (y & 7)) * 8 + (x & 7)] >> 4
    order = np.argsort(index)
    cut_index = np.full(len(ijk), -1, np.int32)
    cut_index[index[order]] = np.arange(len(order), dtype=np.int32)
    return cut_moments(device, samples, rows[order], index[order]), device.array(cut_index)
