"""Cells of one width and what is beyond their faces, as arrays on the device.

A level holds leaves, and covered cells that finer ones replace (they carry the corrections of multigrid). Cells are
sorted by colour, then z, y, x, so that one colour is contiguous.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from clsss.coarsening import Cells, first_children, octants
from clsss.cutcell import Grid
from clsss.device import Buffer, Device


@dataclass(frozen=True, eq=False)
class Level:
    """Cells of one width. A ghost stands for a cell twice as wide beyond a face, one for each such face.

    Attributes
    ----------
    h : float
        Width [mm].
    depth : int
        How many levels above the finest.
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
        return self.colour_start[2]

    @property
    def n_rows(self) -> int:
        """Number of cells, ghosts and junctions, as `nbr` counts them."""
        return self.n + self.n_ghost + self.junction_face.shape[0]

    @property
    def leaf(self) -> np.ndarray:
        """Whether no finer cells replace each one (n,)."""
        return self.is_leaf.get().astype(bool) if self.child else np.ones(self.n, bool)


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
    level = Level(grid.h * 2**depth, depth, cells.colour_start, device.array(cells.nbr), to_parent,
                  device.array(covered), None if child is None else device.array(child[covered]), device.array(chain),
                  device.array(cells.leaf.astype(np.uint8) if finer else np.empty(0, np.uint8)), len(face),
                  device.array(face), device.array(octants(cells.ijk[face // 6])), device.empty(0, np.int32),
                  device.empty(0, np.int32),
                  device.array(slot.astype(np.int32)), device.array(start),
                  device.array(beyond.astype(np.int32)))  # fmt: skip
    return level, source


def make_levels(device: Device, grid: Grid, cells: list[Cells], parents: list[np.ndarray]) -> tuple[Level, ...]:
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
