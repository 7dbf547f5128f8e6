"""The 27 finest cells around each cut cell, which its gradient is fitted to (kernels/around.h)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clsss.device import Buffer, Device
from clsss.octree import Octree

ENTRIES, NUMBERS = 15, 18  # of 16 bits a cut cell; of what these stand for


@dataclass(frozen=True, eq=False)
class Around:
    """Places of the cells around cut cells, told from their order.

    Attributes
    ----------
    n_red, n : int
        Red cells and all cells of the finest level.
    near : (n_cut, 15) uint16, device
        Where rows begin, and which cells there are.
    far : (n_cut, 18) int32, device, or None
        What numbers of rows lack, on grids so wide that these bits do not do.
    """

    n_red: int
    n: int
    near: Buffer
    far: Buffer | None

    @property
    def arguments(self) -> tuple[int, int, Buffer, Buffer | None]:
        """As kernels take them."""
        return self.n_red, self.n, self.near, self.far


def list_around(device: Device, octree: Octree) -> Around:
    """The cells around each cut cell of an octree."""
    near, too_far = _list(device, octree, None)
    if not too_far:
        return near
    return _list(device, octree, device.empty((octree.cut.n, NUMBERS), np.int32))[0]


def _list(device: Device, octree: Octree, far: Buffer | None) -> tuple[Around, bool]:
    """With all it takes, or else whether it takes more bits."""
    n, finest, too_far = octree.cut.n, octree.finest, device.zeros(1, np.int32)
    around = Around(finest.colour_start[1], finest.n, device.empty((n, ENTRIES), np.uint16), far)
    device.run(device.kernel("around", "list_around"), n, n, around.n_red, finest.n, *octree.lend_map(),
               octree.lend_positions()[-1], octree.cut.cell, around.near, far, too_far)  # fmt: skip
    return around, bool(too_far.get()[0])
