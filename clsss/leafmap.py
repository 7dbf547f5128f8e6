"""Maps from the cells of the finest grid: to the leaves that hold them, and to what surrounds them."""

from __future__ import annotations

import numpy as np

from clsss.cutcell import Grid
from clsss.device import Buffer, Device


def empty_map(grid: Grid, cells: list[np.ndarray], leaf: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """The two-level map (tree.h), without codes: `cells` (n, 3) of each level, coarsest first, and which are leaves."""
    bz, by, bx = grid.blocks
    mark = np.zeros((bz, by, bx), bool)
    for depth, (ijk, is_leaf) in enumerate(zip(cells[:-4:-1], leaf[:-4:-1], strict=True)):
        x, y, z = (ijk[is_leaf] << depth >> 3).T
        mark[z, y, x] = True
    block = np.full((bz, by, bx), -1, np.int32)
    block[mark] = np.arange(int(mark.sum()), dtype=np.int32)
    return block, np.full(512 * max(1, int(mark.sum())), -1, np.int32)


def write_leaves(block: np.ndarray, brick: np.ndarray, depth: int, ijk: np.ndarray, leaf: np.ndarray) -> None:
    """Enter the codes of the leaves of one level."""
    where = np.flatnonzero(leaf)
    ijk, code = ijk[where], (where * 16 + depth).astype(np.int32)
    if depth >= 3:
        width = 1 << (depth - 3)
        for dz, dy, dx in np.ndindex(width, width, width):
            x, y, z = (ijk * width + [dx, dy, dz]).T
            ok = (x < block.shape[2]) & (y < block.shape[1]) & (z < block.shape[0])
            block[z[ok], y[ok], x[ok]] = -2 - code[ok]
        return
    x, y, z = (ijk << depth).T
    base = block[z >> 3, y >> 3, x >> 3] * 512 + ((z & 7) * 8 + (y & 7)) * 8 + (x & 7)
    for dz, dy, dx in np.ndindex(1 << depth, 1 << depth, 1 << depth):
        brick[base + (dz * 8 + dy) * 8 + dx] = code


def clearance_map(device: Device, grid: Grid, solid: np.ndarray, is_cut: np.ndarray) -> Buffer:
    """How far each cell of the finest grid is from one of another kind (clearance.cl)."""
    kind = np.where(is_cut, 0, np.where(solid, 129, 1)).astype(np.uint8).ravel()
    rows = grid.dims[1] * grid.dims[2]
    first, second = device.array(kind), device.empty(len(kind), np.uint8)
    device.run(device.kernel("clearance", "clear_along"), rows, rows, grid.dims, first, second)
    across, n = device.kernel("clearance", "clear_across"), len(kind) // 8
    device.run(across, n, n, grid.dims, 1, second, first)
    device.run(across, n, n, grid.dims, 2, first, second)
    return second
