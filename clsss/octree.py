"""The adaptive octree, flattened: one frozen `Level` of arrays per level, level 0 the coarsest.

Cut cells and all around them lie on the finest level; inside, cells merge where the light varies slowly. Every
level holds the cells of its width: leaves, and covered cells that finer ones replace (they carry the corrections of
multigrid). Cells are sorted by colour, then z, y, x, so that one colour is contiguous.

References
----------
Haber et al. 2005, section 3.2.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from clsss.coarsening import DENSE, STEP, Cells, coarsen, coarsen_further, finest_cells, first_children, ordered
from clsss.cutcell import CutCells, Grid, Samples, cut_moments
from clsss.device import Buffer, Device
from clsss.leafmap import LeafMap, clearance_map
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
    position : (n, 3) uint16
        In widths of this level.
    leaf : (n,) bool
        Whether no finer cells replace it.
    colour_start : (3,) int
        First red, first black, end.
    nbr : (n, 6) int32, device
        Neighbours -x +x -y +y -z +z: a cell, n + ghost, n + n_ghost + junction, or the cell itself where there is
        none or the face is closed.
    parent : (n + n_ghost + n_junction,) int32, device
        The next coarser level's cell that contains the cell (of a junction its first), or that the ghost stands for.
    covered : (m,) int32, device
        Cells that finer ones replace.
    child : (m, 8) int32, device
        Their finer cells, x fastest; -1: none; else the first of several (child.h). (Not on the finest level.)
    chain : (m, 2) int32, device
        Finer cells that share an octant: one, and the next.
    is_leaf : (n,) uint8, device
        Empty on the finest level, where all are.
    ghost_face : (n_ghost,) int32, device
        6 cell + face, for each ghost.
    ghost_octant : (n_ghost,) uint8, device
        Which octant of its parent that cell is, x fastest.
    interface : (m,) int32, device
        Leaves with finer neighbours.
    interface_start : (m + 1,) int32, device
        First of each one's ghosts among those of the next finer level.
    junction_face : (n_junction,) int32, device
        6 cell + face, of each face with several cells of this level beyond (coarsening.py).
    junction_start : (n_junction + 1,) int32, device
        First of each one's cells in `junction_cell`.
    junction_cell : int32, device
    """

    h: float
    depth: int
    position: np.ndarray
    leaf: np.ndarray
    colour_start: tuple[int, int, int]
    nbr: Buffer
    parent: Buffer | None
    covered: Buffer
    child: Buffer | None
    chain: Buffer
    is_leaf: Buffer
    n_ghost: int
    ghost_face: Buffer
    ghost_octant: Buffer
    interface: Buffer
    interface_start: Buffer
    junction_face: Buffer
    junction_start: Buffer
    junction_cell: Buffer

    @property
    def n(self) -> int:
        """Number of cells."""
        return len(self.position)

    @property
    def ijk(self) -> np.ndarray:
        """`position` as int32, to reckon with."""
        return self.position.astype(np.int32)

    def lend_position(self, device: Device) -> Buffer:
        """`position` as kernels take it, on the device for as long as that is held."""
        return device.array(self.position)


@dataclass(frozen=True, eq=False)
class Octree:
    """Levels from coarsest to finest, the cut cells, and the map from finest grid to leaves (tree.h).

    Attributes
    ----------
    cut_index : (n,) int32, device
        For each finest cell its place among `cut`, or -1 where it is full.
    leaf_map : LeafMap
    near, clearance : int32 and uint8, on the host
        How far each cell of the finest grid is from one of another kind (body.h).
    thickness : (k,) float64
        As in `Samples`.
    """

    grid: Grid
    levels: tuple[Level, ...]
    cut: CutCells
    cut_index: Buffer
    leaf_map: LeafMap
    near: np.ndarray
    clearance: np.ndarray
    thickness: np.ndarray

    @property
    def finest(self) -> Level:
        """The level of the cut cells."""
        return self.levels[-1]

    @property
    def device(self) -> Device:
        """Where its arrays are."""
        return self.cut_index.device

    def lend_map(self) -> tuple[Any, ...]:
        """The leaf map as kernels take it (tree.h), on the device for as long as that is held: no solve needs it."""
        return self.leaf_map.on_device(self.device, self.grid)

    def lend_body(self) -> tuple[Any, ...]:
        """What rays run through, likewise (body.h), but for the medium's extinction."""
        near, clearance, cut = self.device.array(self.near), self.device.array(self.clearance), self.cut
        return (*self.lend_map(), near, clearance, self.cut_index, cut.boundary, cut.normal, cut.centroid)

    @property
    def n_cells(self) -> int:
        """Cells of all levels."""
        return sum(level.n for level in self.levels)

    def volume(self, level: Level) -> np.ndarray:
        """Volume inside the object of the cells (n,) of a level [mm^3]."""
        volume = np.full(level.n, level.h**3)
        if level is self.finest:
            volume[self.cut.cell.get()] *= self.cut.centroid.get()[:, 3]
        return volume

    def volumes(self) -> list[np.ndarray]:
        """The same of each level."""
        return [self.volume(level) for level in self.levels]

    def apertures(self) -> np.ndarray:
        """Open part (n_cut, 6) of each face of the cut cells, -x +x -y +y -z +z."""
        upper, cell, cut_index = self.cut.aperture.astype(float), self.cut.cell.get(), self.cut_index.get()
        below = self.finest.nbr.get()[cell, ::2]
        cut = cut_index[np.minimum(below, self.finest.n - 1)]
        lower = np.where(cut >= 0, np.take_along_axis(upper[cut], np.arange(3)[None, :, None], axis=2)[:, :, 0], 1.0)
        lower[below == cell[:, None]] = 0
        return np.stack([lower, upper], axis=2).reshape(-1, 6)

    def find(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The leaf at points (n, 3) [mm]: how many levels above the finest, and its index there; -1: none."""
        ijk = np.floor(self.grid.to_cells(points)).astype(np.int64)
        outside = ((ijk < 0) | (ijk >= self.grid.dims)).any(axis=1)
        code = np.where(outside, -1, self.leaf_map.codes(np.where(outside[:, None], 0, ijk)))
        return np.where(code < 0, -1, code & 15), np.where(code < 0, -1, code >> 4)

    @property
    def n_leaves(self) -> int:
        """Cells that no finer ones replace."""
        return sum(int(level.leaf.sum()) for level in self.levels)


def octants(ijk: np.ndarray) -> np.ndarray:
    """Which octant of its parent each cell (n, 3) is (n,) uint8, x fastest."""
    return ((ijk & 1) @ np.array([1, 2, 4])).astype(np.uint8)


def _find_coarser(cells: Cells, coarser: Cells) -> None:
    """Set missing neighbours to -2 - index where a leaf of the next coarser level is there."""
    assert coarser.index is not None
    leaves = np.where(np.append(coarser.leaf, False)[coarser.index], coarser.index, -1)
    for face, step in enumerate(STEP):
        lost = np.flatnonzero(cells.nbr[:, face] < 0)
        x, y, z = ((cells.ijk[lost] + step) // 2).T + 1
        cells.nbr[lost, face] = np.where(leaves[z, y, x] >= 0, -2 - leaves[z, y, x], -1)


def _make_level(device: Device, grid: Grid, depth: int, cells: Cells, parent: np.ndarray | None,
                finer: tuple[Cells, np.ndarray] | None) -> tuple[Level, np.ndarray]:  # fmt: skip
    """Number the ghosts by the coarse cell they stand for, then the junctions; the level, and the ghosts' cells."""
    n, flat = len(cells.ijk), cells.nbr.ravel()
    face = np.flatnonzero(flat < -1)
    source = -2 - flat[face]
    order = np.argsort(source, kind="stable")
    face, source = face[order].astype(np.int32), source[order]
    flat[face] = n + np.arange(len(face), dtype=np.int32)
    none = np.flatnonzero(flat == -1)
    flat[none] = none // 6
    slot, first = np.unique(cells.more[:, :2] @ np.array([6, 1]), return_index=True)
    beyond = np.insert(cells.more[:, 2], first, flat[slot])
    start = np.append(first + np.arange(len(slot)), len(beyond)).astype(np.int32)
    to_parent = None
    if parent is not None:
        to_parent = device.array(np.concatenate([parent, source, parent[flat[slot]]]).astype(np.int32))
    flat[slot] = n + len(face) + np.arange(len(slot), dtype=np.int32)
    covered = np.flatnonzero(~cells.leaf).astype(np.int32)
    child, chain = first_children(*finer, n) if finer else (None, np.empty((0, 2), np.int32))
    level = Level(grid.h * 2**depth, depth, cells.ijk.astype(np.uint16), cells.leaf, cells.colour_start,
                  device.array(cells.nbr), to_parent, device.array(covered),
                  None if child is None else device.array(child[covered]), device.array(chain),
                  device.array(cells.leaf.astype(np.uint8) if finer else np.empty(0, np.uint8)), len(face),
                  device.array(face), device.array(octants(cells.ijk[face // 6])), device.empty(0, np.int32),
                  device.empty(0, np.int32),
                  device.array(slot.astype(np.int32)), device.array(start),
                  device.array(beyond.astype(np.int32)))  # fmt: skip
    return level, source


def _make_levels(device: Device, grid: Grid, cells: list[Cells], parents: list[np.ndarray]) -> tuple[Level, ...]:
    """Levels from coarsest to finest, which use `cells` and `parents` (of all but the coarsest) up."""
    levels: list[Level] = []
    sources: list[np.ndarray] = []
    parent = None
    while cells:
        level_cells = cells.pop(0)
        finer = (cells[0], parents[0]) if cells else None
        level, source = _make_level(device, grid, len(cells), level_cells, parent, finer)
        parent = parents.pop(0) if parents else None
        levels.append(level)
        sources.append(source)
    for number, source in enumerate(sources[1:]):
        interface, first = np.unique(source, return_index=True)
        start = np.concatenate([first, [len(source)]]).astype(np.int32)
        levels[number] = replace(
            levels[number], interface=device.array(interface.astype(np.int32)), interface_start=device.array(start)
        )
    return tuple(levels)


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
    solid = np.unpackbits(samples.inside, axis=2, bitorder="little").view(bool)
    solid[touched[:, 2], touched[:, 1], touched[:, 0]] = samples.state > 0
    is_cut = np.zeros(solid.shape, bool)
    cut_rows = np.flatnonzero(samples.state == 2)
    is_cut[tuple(touched[cut_rows, ::-1].T)] = True
    has = [solid]
    while len(has) < 2 or np.count_nonzero(has[0]) > DENSE:
        has.insert(0, pool(has[0]))
    split = split_masks(grid, has, is_cut, refine) if refine else [mask.copy() for mask in has[:-1]]
    shapes = [mask.shape for mask in has]
    near, clearance = clearance_map(device, grid, solid, is_cut)
    del solid, is_cut
    positions, colour_start, leaf, exists = _place_cells(has, split)
    leaf_map = LeafMap(grid, exists, positions, leaf, colour_start[-1][1])
    del exists, split
    nbr = _neighbours(device, grid, leaf_map, positions[-1])
    cut, cut_index = _cut_cells(device, samples, cut_rows, leaf_map, len(nbr))
    cells = [finest_cells(positions.pop(), colour_start[-1], nbr, cut.cell.get(), cut.aperture)]
    del nbr
    parents: list[np.ndarray] = []
    while positions:
        number = len(positions) - 1
        coarse, parent = coarsen(cells[0], shapes[number], positions.pop(), leaf[number], colour_start[number][1])
        _find_coarser(cells[0], coarse)
        leaf_map.write_leaves(len(shapes) - 1 - number, coarse.ijk, coarse.leaf)
        cells.insert(0, replace(coarse, index=None))
        parents.insert(0, parent)
    while len(cells[0].ijk) > DENSE:
        coarse, parent = coarsen_further(cells[0])
        cells.insert(0, coarse)
        parents.insert(0, parent)
    levels = _make_levels(device, grid, cells, parents)
    return Octree(grid, levels, cut, cut_index, leaf_map, near, clearance, samples.thickness)


def _place_cells(has: list[np.ndarray], split: list[np.ndarray]) -> tuple[list[Any], list[Any], list[Any], np.ndarray]:
    """Positions, colours and leaves of the cells of all levels, and the finest's mask; uses `has` up."""
    exists = has.pop(0)
    found, leaf = [ordered(exists)], []
    for masks in split:
        x, y, z = found[-1][0].T
        leaf.append(~masks[z, y, x])
        exists = spread(masks, has[0].shape)
        exists &= has.pop(0)
        found.append(ordered(exists))
    leaf.append(np.ones(len(found[-1][0]), bool))
    return [ijk for ijk, _ in found], [start for _, start in found], leaf, exists


def _neighbours(device: Device, grid: Grid, leaf_map: LeafMap, ijk: np.ndarray) -> np.ndarray:
    """Cells (n, 6) of the finest level at the six positions around each; -1: none."""
    nbr, n = device.empty((len(ijk), 6), np.int32), len(ijk)
    tree = leaf_map.on_device(device, grid)
    device.run(device.kernel("octree", "neighbours"), n, n, *tree, device.array(ijk), nbr)
    return nbr.get()


def _cut_cells(device: Device, samples: Samples, rows: np.ndarray, leaf_map: LeafMap,
               n: int) -> tuple[CutCells, Buffer]:  # fmt: skip
    """Moments of the cut cells in the order of the finest level, and each of its n cells' place among them."""
    index = leaf_map.finest(samples.cells[rows])
    order = np.argsort(index)
    cut_index = np.full(n, -1, np.int32)
    cut_index[index[order]] = np.arange(len(order), dtype=np.int32)
    return cut_moments(device, samples, rows[order], index[order]), device.array(cut_index)
