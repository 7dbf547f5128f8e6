"""How thick the object is below its surface, where that is little: short rays from the surface inwards.

Input: triangles and the cells near them; output: how far rays that start at random places of the surface, even by
area, go against its normal until they leave the object.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from clsss.device import Buffer, Device
from clsss.subdivision import areas, outward_normals
from clsss.triangles import Triangles

REACH = 1.0  # cells
RAYS = 4096
SOME = 1 << 13  # triangles at a time
LOOKED_AT = 50_000  # triangles that rays may start from
STEP = np.array([0.7548776662466927, 0.5698402909980532])  # of the sequence R2, whose points lie evenly in a square


def _starts(triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Places (n, 3) on triangles (m, 3, 3), even by area, and directions (n, 3) inwards."""
    total = np.cumsum(np.concatenate([areas(triangles[k : k + SOME]) for k in range(0, len(triangles), SOME)]))
    chosen = np.minimum(np.searchsorted(total, (np.arange(RAYS) + 0.5) / RAYS * total[-1]), len(triangles) - 1)
    u, v = (np.arange(RAYS)[:, None] * STEP % 1).T
    u, v = np.where(u + v > 1, [1 - u, 1 - v], [u, v])
    a, b, c = triangles[chosen].transpose(1, 0, 2)
    return a + u[:, None] * (b - a) + v[:, None] * (c - a), -outward_normals(triangles[chosen])


def thickness_below(device: Device, dims: tuple[int, int, int], block: Buffer, n_cells: int,
                    entry: Callable[[np.ndarray], np.ndarray], triangles: np.ndarray,
                    pieces: Triangles) -> np.ndarray:  # fmt: skip
    """Lengths (n,) [cells] of rays inwards; infinite from `REACH` on.

    Parameters
    ----------
    device, dims
        The device, and the size of the finest grid.
    block, n_cells, entry
        The blocks of cells near the surface, how many cells those have, and the places of cells (n, 3) among them.
    triangles : (m, 3, 3) float64
        [cells]; `LOOKED_AT` of the surface's will do.
    pieces : Triangles
        All of them, none large.
    """
    start, direction = _starts(triangles)
    place, first = np.unique(entry(np.floor(start).astype(np.int64)), return_index=True)
    ray = np.full(n_cells, -1, np.int32)
    ray[place] = np.arange(len(first), dtype=np.int32)
    length = device.empty(len(first))
    length.fill(REACH)
    rays = device.array(np.concatenate([start[first], direction[first]], axis=1))
    pieces.run(device.kernel("thickness", "shorten_rays"), (dims, REACH, block, device.array(ray), rays), (length,))
    found = length.get().astype(float)
    return np.where(found < REACH, found, np.inf)
