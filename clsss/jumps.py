"""Jumps of a medium between neighbouring cells: what light meets along the way from one centroid to the next.

    T_f = A_f / int ds / D     along the link, where two halves of one D each would miss where the jump is

Input: the finest cells' centroids and the medium; output: what to multiply transmissibilities by.

References
----------
docs/numerics.md, "Discretisation".
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from clsss.device import Buffer, Device
from clsss.octree import Octree

LEAST = 1.2  # ratio of two neighbours' sigma_tr from which on the link is looked at closely
PLACES = 8  # along a link


@dataclass(frozen=True, eq=False)
class Jumps:
    """Links of the finest level across which sigma_tr jumps.

    Attributes
    ----------
    face : (m, 2) int32, device
        6 cell + face of each, from its two ends.
    share : (m, 4) real, device
        Its T over that of two halves.
    """

    face: Buffer
    share: Buffer


def jumping(octree: Octree, values: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Pairs of neighbours of the finest level between which values (n, 3) jump: low cell, high cell, axis."""
    nbr, cells = octree.finest.nbr.get(), np.arange(octree.finest.n)
    found = []
    for axis in range(3):
        beyond = nbr[:, 2 * axis + 1]
        low = np.flatnonzero((beyond < len(cells)) & (beyond != cells))
        high = beyond[low]
        a, b = values[low], values[high]
        jump = (np.maximum(a, b) > LEAST * np.minimum(a, b)).any(axis=1)
        found.append((low[jump], high[jump], np.full(np.count_nonzero(jump), axis)))
    lows, highs, axes = (np.concatenate(parts) for parts in zip(*found, strict=True))
    return lows, highs, axes


def find_jumps(device: Device, octree: Octree, points: np.ndarray, sigma_tr: np.ndarray,
               at: Callable[[np.ndarray], np.ndarray]) -> Jumps:  # fmt: skip
    """Look along the links across which sigma_tr jumps.

    Parameters
    ----------
    device, octree
        Where.
    points : (n, 3) float64
        Centroids of the finest level [mm].
    sigma_tr : (n, 3) float64
        There [1/mm].
    at : callable
        sigma_tr (m, 3) at points (m, 3).
    """
    low, high, axis = jumping(octree, sigma_tr)
    way = points[high] - points[low]
    along = np.zeros((len(low), 3))
    for place in (np.arange(PLACES) + 0.5) / PLACES:
        along += at(points[low] + place * way) / PLACES
    share = (sigma_tr[low] + sigma_tr[high]) / 2 / along
    face = np.stack([6 * low + 2 * axis + 1, 6 * high + 2 * axis], axis=1)
    return Jumps(device.array(face.astype(np.int32)), device.array(share[:, [0, 1, 2, 2]]))
