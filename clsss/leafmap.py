"""Maps from the cells of the finest grid: to the leaves that hold them, and to what surrounds them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from clsss.cutcell import Grid
from clsss.device import Device

ROWS = 1 << 15  # of eight cells at a time
FINE = -2  # entry of a brick where there are finest cells, as in kernels/tree.h
BITS = np.array([bin(byte).count("1") for byte in range(256)], np.int32)


def _octant(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
    """Place in its brick of the 2x2x2 cells that hold each cell."""
    return ((z >> 1 & 3) * 4 + (y >> 1 & 3)) * 4 + (x >> 1 & 3)


@dataclass(frozen=True, eq=False)
class LeafMap:
    """Which leaf holds a cell of the finest grid (tree.h).

    Attributes
    ----------
    block : (nz / 8, ny / 8, nx / 8) int32
    brick : (64 n_bricks,) int32
    first : (64 n, 2) int32
        First red and first black cell of each row of the bricks with finest cells, which come first.
    filled : (64 n,) uint8
        Which cells of those rows exist.
    """

    block: np.ndarray
    brick: np.ndarray
    first: np.ndarray
    filled: np.ndarray

    @classmethod
    def of_finest(cls, grid: Grid, exists: np.ndarray, cells: list[np.ndarray], leaf: list[np.ndarray],
                  n_red: int) -> LeafMap:  # fmt: skip
        """The map as far as the finest level goes.

        Parameters
        ----------
        grid : Grid
        exists : (nz, ny, nx) bool
            The finest level's cells.
        cells, leaf : lists of (n, 3) int32 and (n,) bool
            Cells of each level, coarsest first, and which are leaves.
        n_red : int
            Red ones among the finest.
        """
        bz, by, bx = grid.blocks
        fine, mark = np.zeros((2, bz, by, bx), bool)
        for depth, (ijk, is_leaf) in enumerate(zip(cells[:-4:-1], leaf[:-4:-1], strict=True)):
            x, y, z = (ijk[is_leaf] << depth >> 3).T
            (mark if depth else fine)[z, y, x] = True
        mark &= ~fine
        n, n_bricks = int(fine.sum()), int(fine.sum() + mark.sum())
        block = np.full((bz, by, bx), -1, np.int32)
        block[fine], block[mark] = np.arange(n), np.arange(n, n_bricks)
        places = np.full(64 * max(1, n_bricks), -1, np.int32)
        rows = np.packbits(exists, axis=2, bitorder="little").reshape(bz, 8, by, 8, bx).transpose(0, 2, 4, 1, 3)
        first = np.zeros((64 * n, 2), np.int32)
        for colour, part in enumerate((slice(0, n_red), slice(n_red, None))):
            x, y, z = cells[-1][part].T
            brick = block[z >> 3, y >> 3, x >> 3] * 64
            row = brick + (z & 7) * 8 + (y & 7)
            starts = np.flatnonzero(np.diff(row, prepend=-1))
            first[row[starts], colour] = colour * n_red + starts
            places[brick + _octant(x, y, z)] = FINE
        return cls(block, places, first, rows[fine].ravel())

    def write_leaves(self, depth: int, ijk: np.ndarray, leaf: np.ndarray) -> None:
        """Enter the codes of the leaves of a level above the finest."""
        where, block = np.flatnonzero(leaf), self.block
        ijk, code = ijk[where], (where * 16 + depth).astype(np.int32)
        if depth >= 3:
            width = 1 << (depth - 3)
            for dz, dy, dx in np.ndindex(width, width, width):
                x, y, z = (ijk * width + [dx, dy, dz]).T
                ok = (x < block.shape[2]) & (y < block.shape[1]) & (z < block.shape[0])
                block[z[ok], y[ok], x[ok]] = -2 - code[ok]
            return
        x, y, z = (ijk << depth).T
        base, width = block[z >> 3, y >> 3, x >> 3] * 64 + _octant(x, y, z), 1 << (depth - 1)
        for dz, dy, dx in np.ndindex(width, width, width):
            self.brick[base + (dz * 4 + dy) * 4 + dx] = code

    @property
    def arrays(self) -> tuple[np.ndarray, ...]:
        """What kernels take."""
        return self.block, self.brick, self.first, self.filled

    def finest(self, cells: np.ndarray) -> np.ndarray:
        """Index of finest cells (n, 3) that exist."""
        x, y, z = cells.T
        row = self.block[z >> 3, y >> 3, x >> 3] * 64 + (z & 7) * 8 + (y & 7)
        before = self.filled[row] & np.where(x & 1, 0xAA, 0x55) & ((1 << (x & 7)) - 1)
        return self.first[row, (x ^ y ^ z) & 1] + BITS[before]

    def codes(self, cells: np.ndarray) -> np.ndarray:
        """Codes (n,) of the leaves at cells (n, 3) of the grid."""
        x, y, z = cells.T
        block = self.block[z >> 3, y >> 3, x >> 3]
        code = np.where(block < -1, -2 - block, -1)
        code[block >= 0] = self.brick[(block * 64 + _octant(x, y, z))[block >= 0]]
        fine = np.flatnonzero(code == FINE)
        code[code == FINE] = -1
        row = (block * 64 + (z & 7) * 8 + (y & 7))[fine]
        fine = fine[self.filled[row] >> (x[fine] & 7) & 1 > 0]
        code[fine] = 16 * self.finest(cells[fine])
        return code


def finest_by_bricks(first: np.ndarray, filled: np.ndarray) -> Iterator[np.ndarray]:
    """All finest cells of a `LeafMap`, brick by brick, some at a time."""
    for start in range(0, len(filled), ROWS):
        exist = np.unpackbits(filled[start : start + ROWS, None], axis=1, bitorder="little")
        row, index = np.arange(start, start + len(exist)), np.empty(exist.shape, np.int32)
        parity = (row ^ row >> 3) & 1
        for side in (0, 1):
            there = exist[:, side::2]
            before = np.cumsum(there, axis=1, dtype=np.int32) - there
            index[:, side::2] = first[row, parity ^ side][:, None] + before
        yield index[exist > 0]


def clearance_map(device: Device, grid: Grid, solid: np.ndarray, is_cut: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """How far each cell of the finest grid is from one of another kind: `near` and `clearance` of body.h."""
    kind = np.where(solid, np.uint8(129), np.uint8(1))
    kind[is_cut] = 0
    rows = grid.dims[1] * grid.dims[2]
    first, second, n = device.array(kind), device.empty(kind.shape, np.uint8), kind.size // 8
    del kind
    device.run(device.kernel("clearance", "clear_along"), rows, rows, grid.dims, first, second)
    across = device.kernel("clearance", "clear_across")
    device.run(across, n, n, grid.dims, 1, second, first)
    device.run(across, n, n, grid.dims, 2, first, second)
    clear = second.get().reshape(-1, 512)
    least = clear.min(axis=1).astype(np.int32)
    mixed = (least == 0) | ((clear.max(axis=1) ^ least) & 128 > 0)
    near = np.where(mixed, np.cumsum(mixed) - 1, -1 - least)
    return near.astype(np.int32), clear[mixed]
