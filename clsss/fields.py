"""Numbers in the cells of all levels of an octree, by colour channel, in one buffer."""

from __future__ import annotations

import numpy as np

from clsss.device import Buffer, Device
from clsss.octree import Octree

CHANNELS = 4


class PerLevel(list[Buffer]):
    """Numbers on each level: a buffer (n, width) per level, all in one (`whole`), with rows of zeros in between."""

    def __init__(self, device: Device, sizes: list[int], width: int, least: int = 0):
        starts = np.concatenate([[0], np.cumsum([-(-n // device.row_alignment) * device.row_alignment for n in sizes])])
        rows = int(starts[-1])
        self._memory = device.zeros((max(rows, int(starts[1]) + least), width))
        self.whole = Buffer(device, (rows, width), device.real, self._memory.data)
        self.start = starts.tolist()
        super().__init__(self.whole.rows(first, n) for first, n in zip(self.start[:-1], sizes, strict=True))

    def clear_from(self, k: int, n: int) -> None:
        """Enqueue to fill what follows the first `n` rows of level `k`, up to the next level, with zeros."""
        self.whole.fill(0, self.start[k] + n, self.start[k + 1])

    def lent(self) -> tuple[Buffer, int, int]:
        """Its memory from the second level on, as a part of a `Room`."""
        return self._memory, self.start[1], self._memory.shape[0]

    def lent_beyond(self) -> tuple[Buffer, int, int]:
        """Its memory beyond the last level, likewise."""
        return self._memory, self.start[-1], self._memory.shape[0]

    def coarsest(self, n: int) -> Buffer:
        """The first `n` levels, in one, and what follows each."""
        return self.whole.rows(0, self.start[n])


class Field(PerLevel):
    """One value per cell, ghost and junction (n + n_ghost + n_junction, 4), as cells gather from their neighbours.

    Its memory holds at least so many rows from the second level on.
    """

    def __init__(self, device: Device, octree: Octree, least: int = 0):
        super().__init__(device, [level.n_rows for level in octree.levels], CHANNELS, least)


class Load(PerLevel):
    """One value per cell (n, 3), packed: a right-hand side or a residual, which no neighbour takes."""

    def __init__(self, device: Device, octree: Octree):
        super().__init__(device, [level.n for level in octree.levels], 3)


def channels(values: np.ndarray) -> np.ndarray:
    """RGB (..., 3) with a spare fourth channel that repeats the third."""
    return np.concatenate([values, values[..., 2:]], axis=-1)
