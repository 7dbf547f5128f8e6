"""Maps from the cells of the finest grid: to the leaves that hold them, and to what surrounds them."""

from __future__ import annotations

import numpy as np

from clsss.cutcell import Grid
from clsss.device import Buffer, Device


def leaf_map(grid: Grid, cells: list[np.ndarray], leaf: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """The two-level map of leaf codes (tree.h)."""
    bz, by, bx = grid.blocks
    block = np.full((bz, by, bx), -1, np.int32)
    n_levels = len(cells)
    small, codes = [], []
    for level in range(n_levels):
        depth = n_levels - 1 - level
        where = np.flatnonzero(leaf[level])
        ijk, code = cells[level][where], (where * 16 + depth).astype(np.int32)
        if depth >= 3:
            width = 1 << (depth - 3)
            for dz, dy, dx in np.ndindex(width, width, width):
                x, y, z = (ijk * width + [dx, dy, dz]).T
                ok = (x < bx) & (y < by) & (z < bz)
                block[z[ok], y[ok], x[ok]] = -2 - code[ok]
        else:
            small.append((ijk << depth, depth))
            codes.append(code)
    mark = np.zeros((bz, by, bx), bool)
    for ijk, _ in small:
        x, y, z = (ijk >> 3).T
        mark[z, y, x] = True
    block[mark] = np.arange(int(mark.sum()), dtype=np.int32)
    brick = np.full(512 * max(1, int(mark.sum())), -1, np.int32)
    for (ijk, depth), code in zip(small, codes, strict=True):
        x, y, z = ijk.T
        base = block[z >> 3, y >> 3, x >> 3] * 512 + ((z & 7) * 8 + (y & 7)) * 8 + (x & 7)
        for dz, dy, dx in np.ndindex(1 << depth, 1 << depth, 1 << depth):
            brick[base + (dz * 8 + dy) * 8 + dx] = code
    return block.ravel(), brick


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
