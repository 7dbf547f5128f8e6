"""Places along a Morton curve: what is near in space is near in memory."""

from __future__ import annotations

import numpy as np

BITS = 10  # of each coordinate


def morton(cells: np.ndarray) -> np.ndarray:
    """Places (n,) int64 of cells (n, 3), from 0 to 2^`BITS` - 1 each, along a Morton curve; x changes fastest."""
    code = np.zeros(len(cells), np.int64)
    for bit in range(BITS):
        for axis in range(3):
            code |= ((cells[:, axis] >> bit) & 1) << (3 * bit + axis)
    return code
