"""Sums over fields on the device, by colour channel: each tile's there, in single or double, of tiles here."""

from __future__ import annotations

import numpy as np

from clsss.device import Buffer, Device
from clsss.fields import CHANNELS, PerLevel

TILE, GROUP = 4096, 64  # cells and work-items of a partial sum, as in kernels/tile.h


def tiles(n: int) -> int:
    """Number of partial sums over `n` cells."""
    return -(-n // TILE)


def sum_of_parts(partial: Buffer) -> np.ndarray:
    """Sum (..., 3) of the tiles' sums (m, ..., 4)."""
    return partial.get()[..., :3].astype(float).sum(axis=0)


def inner_product(device: Device, x: PerLevel, y: PerLevel) -> np.ndarray:
    """Sum over all cells of x y (3,)."""
    partial = device.empty((tiles(x.whole.shape[0]), CHANNELS))
    take_products(device, x.whole, y.whole, partial)
    return sum_of_parts(partial)


def take_products(device: Device, x: Buffer, y: Buffer, partial: Buffer) -> None:
    """Enqueue the sums of x y, (n, 3) or (n, 4) each, tile by tile."""
    n, width = x.shape
    device.run(device.kernel("reduce", "inner_product"), GROUP * tiles(n), n, width, x, y, partial, group=GROUP)


def total(device: Device, values: Buffer) -> np.ndarray:
    """Sum of values (n, 3) or (n, 4) over their rows (3,)."""
    n, width = values.shape
    partial = device.empty((tiles(n), CHANNELS))
    device.run(device.kernel("reduce", "total"), GROUP * tiles(n), n, width, values, partial, group=GROUP)
    return sum_of_parts(partial)
