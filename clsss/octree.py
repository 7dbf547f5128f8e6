"""The adaptive octree, flattened: one `Level` of arrays for each width of cells, level 0 the coarsest.

Cut cells and all around them lie on the finest level; inside, cells merge where the light varies slowly.

References
----------
Haber et al. 2005, section 3.2.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from clsss.coarsening import DENSE, STEP, Cells, coarsen, coarsen_further, finest_cells, ordered
from clsss.cutcell import CutCells, Grid, Samples, cut_moments
from clsss.device import Buffer, Device
from clsss.kept import kept
from clsss.leafmap import LeafMap, clearance_map, finest_by_bricks
from clsss.level import Level, make_levels
from clsss.refinement import Refine, pool, split_masks, spread
from clsss.room import Room
from clsss.stowed import Stowed, stow


@dataclass(frozen=True, eq=False)
class Octree:
    """Levels from coarsest to finest, the cut cells, and the map from finest grid to leaves (tree.h).

    Attributes
    ----------
    coarsest : (n, 3) uint16, on the host
        Where the cells of the coarsest level are, in its widths; where others are follows from `Level.child`.
    cut_index : (n,) int32, device
        For each finest cell its place among `cut`, or -1 where it is full.
    near, clearance : Stowed int32 and uint8
        How far each cell of the finest grid is from one of another kind (body.h).
    thickness : (k,) float64
        As in `Samples`.
    """

    grid: Grid
    levels: tuple[Level, ...]
    coarsest: np.ndarray
    cut: CutCells
    cut_index: Buffer
    near: Stowed
    clearance: Stowed
    thickness: np.ndarray
    _map: tuple[Stowed, ...]

    @property
    def finest(self) -> Level:
        """The level of the cut cells."""
        return self.levels[-1]

    @property
    def device(self) -> Device:
        """Where its arrays are."""
        return self.cut_index.device

    def lend_positions(self, room: Room | None = None) -> list[Buffer]:
        """Where cells (n, 3) of each level are, in its widths, uint16 on the device (in `room`) while that is held."""
        room, kernel = room or Room(self.device), self.device.kernel("octree", "place_children")
        found = [room.array(self.coarsest)]
        for coarse, fine in zip(self.levels, self.levels[1:], strict=False):
            found.append(room.empty((fine.n, 3), np.uint16))
            m = coarse.covered.shape[0]
            self.device.run(kernel, m, m, coarse.covered, coarse.child, coarse.chain, *found[-2:])
        return found

    def positions(self) -> list[np.ndarray]:
        """The same on the host, int32 to reckon with."""
        return [position.get().astype(np.int32) for position in self.lend_positions()]

    def cut_positions(self) -> np.ndarray:
        """Where the cut cells are (n_cut, 3) int32 in the finest grid."""
        return self.lend_positions()[-1].get()[self.cut.cell.get()].astype(np.int32)

    def lend_map(self) -> tuple[Any, ...]:
        """The leaf map as kernels take it (tree.h), on the device for as long as that is held: no solve needs it."""
        return (self.grid.dims, *(values.on_device(self.device) for values in self._map))

    @property
    def leaf_map(self) -> LeafMap:
        """The same on the host."""
        return LeafMap(*(values.get() for values in self._map))

    def finest_by_bricks(self) -> list[np.ndarray]:
        """All finest cells in an order in which neighbours are close, in some parts."""
        _, _, first, filled = self._map
        return list(finest_by_bricks(first.get(), filled.get()))

    def lend_cells(self, room: Room | None = None) -> tuple[Any, ...]:
        """The leaf map and, in `room` if given, the clearance, likewise; the cut cells' places and boundaries."""
        room, cut = room or Room(self.device), self.cut
        clearance = self.near.on_device(room), self.clearance.on_device(room)
        return (*self.lend_map(), *clearance, self.cut_index, cut.boundary, cut.normal)

    def lend_body(self, leaves: bool = True, room: Room | None = None) -> tuple[Any, ...]:
        """What rays run through, likewise (body.h), but for the extinction; `leaves`: whether they ask for leaves."""
        device, room, n, n_cut = self.device, room or Room(self.device), self.near.shape[0], self.cut.n
        cells, plane = (*self.lend_cells(room), self.cut.centroid), room.empty((n_cut, 4))
        planes = room.empty((8 * self.clearance.shape[0],), np.int32), plane, room.empty((n_cut,), np.int32)
        device.run(device.kernel("planes", "list_planes"), n, n, *cells, device.array(first_planes(self)), *planes)
        return (self.grid.dims, *(cells[1:5] if leaves else [None] * 4), *cells[5:], *planes)

    @property
    def n_cells(self) -> int:
        """Cells of all levels."""
        return sum(level.n for level in self.levels)

    def volume(self, level: Level, first: int = 0, n: int | None = None) -> np.ndarray:
        """Volume inside the object of the cells (n,) of a level, all or `n` from `first` on [mm^3]."""
        n = level.n - first if n is None else n
        volume = np.full(n, level.h**3)
        if level is self.finest:
            cut = self.cut_index.get(first, n)
            is_cut = cut >= 0
            rows = cut[is_cut]  # one after the other
            if len(rows):
                volume[is_cut] *= self.cut.centroid.get(int(rows[0]), len(rows))[:, 3]
        return volume

    def volumes(self) -> list[np.ndarray]:
        """The same of each level."""
        return [self.volume(level) for level in self.levels]

    def apertures(self) -> np.ndarray:
        """Open part (n_cut, 6) of each face of the cut cells, -x +x -y +y -z +z."""
        upper, cell, cut_index = self.cut.aperture.get().astype(float), self.cut.cell.get(), self.cut_index.get()
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
        return self.n_cells - sum(level.covered.shape[0] for level in self.levels)


@kept
def first_planes(octree: Octree) -> np.ndarray:
    """Number of the first plane of each block that `near` gives a number (kernels/planes.cl)."""
    count = np.concatenate([np.count_nonzero(some == 0, axis=1) for _, some in octree.clearance.parts()])
    return (np.cumsum(count) - count).astype(np.int32)


def _find_coarser(cells: Cells, coarser: Cells) -> None:
    """Set missing neighbours to -2 - index where a leaf of the next coarser level is there."""
    assert coarser.index is not None
    code = np.where(np.append(coarser.leaf, False), -2 - np.arange(len(coarser.leaf) + 1, dtype=np.int32), -1)
    for face, step in enumerate(STEP):
        lost = np.flatnonzero(cells.nbr[:, face] < 0)
        x, y, z = ((cells.ijk[lost] + np.array(step, np.int32)) >> 1).T + 1
        cells.nbr[lost, face] = code[coarser.index[z, y, x]]


def build(device: Device, grid: Grid, samples: Samples, refine: Refine | None = None) -> Octree:
    """The octree of an object.

    Parameters
    ----------
    device, grid, samples
        From `clsss.cutcell`; the samples are used up.
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
    leaf_map = LeafMap.of_finest(grid, exists, positions, leaf, colour_start[-1][1])
    del exists, split
    nbr = _neighbours(device, grid, leaf_map, positions[-1])
    cut, cut_index = _cut_cells(device, samples, cut_rows, leaf_map, len(nbr))
    samples.use_up()
    cells = [finest_cells(positions.pop(), colour_start[-1], nbr, cut.cell.get(), cut.aperture.get())]
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
    coarsest = cells[0].ijk.astype(np.uint16)
    levels = make_levels(device, grid, cells, parents)
    stowed = tuple(stow(values) for values in leaf_map.arrays)
    return Octree(grid, levels, coarsest, cut, cut_index, stow(near), stow(clearance), samples.thickness, stowed)


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
    tree = (grid.dims, *(device.array(values) for values in leaf_map.arrays))
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
