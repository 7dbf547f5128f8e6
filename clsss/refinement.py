"""Which cells of the octree are split: near the surface, where the light or the medium varies, and 2:1 balanced.

Input and output are masks (z, y, x) of every level's grid, coarsest first.

References
----------
Haber et al. 2005, section 3.2.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from scipy import ndimage

from clsss.cutcell import Grid

BAND = 6  # width of every band of one level, in cells of the next coarser: glowing bodies need them inside
SOURCE_VARIATION = 0.3  # greatest change of the incident light over a leaf, relative to its value at the surface
DIFFUSION_LENGTHS = 0.25  # widest leaf at the surface; deeper, its square grows as phi decays
CHUNK = 1 << 16  # cells at a time, so that what is computed of each takes little memory
SIGMA_VARIATION = 0.1  # greatest (max - min) / (max + min) of sigma_tr over a leaf

Refine = Callable[[np.ndarray, float, np.ndarray], np.ndarray]


def pool(values: np.ndarray) -> np.ndarray:
    """Greatest value of the eight children of each cell of the next coarser grid; of a mask, whether any is set."""
    if any(n % 2 for n in values.shape):
        values = np.pad(values, [(0, n % 2) for n in values.shape], mode="edge")
    for axis in range(3):
        pairs = np.moveaxis(values, axis, 0)
        values = np.moveaxis(np.maximum(pairs[::2], pairs[1::2]), 0, axis)
    return values


def _pool_around(mask: np.ndarray) -> np.ndarray:
    """Whether any of the 64 cells within and around each cell of the next coarser grid is set."""
    if any(n % 2 for n in mask.shape):
        mask = np.pad(mask, [(0, n % 2) for n in mask.shape])
    for axis in range(3):
        pairs = np.moveaxis(mask, axis, 0)
        around = pairs[::2] | pairs[1::2]
        around[1:] |= pairs[1:-1:2]
        around[:-1] |= pairs[2::2]
        mask = np.moveaxis(around, 0, axis)
    return mask


def spread(mask: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """Each cell's value on its eight children."""
    for axis in range(3):
        mask = np.repeat(mask, 2, axis=axis)
    return mask[: shape[0], : shape[1], : shape[2]]


def _dilate(mask: np.ndarray, layers: int) -> np.ndarray:
    """Cells within `layers` of a set one, diagonals included."""
    for axis in range(3):
        mask = ndimage.maximum_filter1d(mask.view(np.uint8), 2 * layers + 1, axis=axis, mode="constant") > 0
    return mask


def split_masks(grid: Grid, has: list[np.ndarray], cut: np.ndarray, refine: Refine) -> list[np.ndarray]:
    """Which cells of each level are replaced by finer ones, 2:1 balanced with diagonals."""
    split: list[np.ndarray] = []
    near = _pool_around(cut)
    layers = ndimage.distance_transform_cdt(~pool(cut), "chessboard")
    for level in range(len(has) - 2, -1, -1):
        h = grid.h * 2 ** (len(has) - 1 - level)
        open_cells = np.flatnonzero(has[level] & ~near)
        for first in range(0, len(open_cells), CHUNK):
            some = np.unravel_index(open_cells[first : first + CHUNK], near.shape)
            centres = grid.origin + (np.stack(some[::-1], axis=1) + 0.5) * h
            near[some] = refine(centres, h, 2.0 * grid.h * layers[some])
        split.insert(0, has[level] & near)
        near = _dilate(pool(split[0]), BAND)
        layers = -pool(-layers)
    return split


def varies(medium: Any) -> Refine:
    """The criteria of the paper, and one of the diffusion: where a leaf is too wide.

    Where the source changes much over it: incident light from outside falls by sigma_tr h exp(-sigma_tr depth),
    relative to its value at the surface, whatever the lights: the octree outlives them. Where sigma_tr does. And where
    it is wide against the diffusion length 1 / k, k^2 = 3 sigma_a sigma_tr: second-order errors, (k h)^2 of what is
    left of phi's layer below the surface, exp(-k depth).

    Parameters
    ----------
    medium : Material, Mix or Grid
        By its coefficients [1/mm].

    Returns
    -------
    callable
        ``refine(centres (n, 3) [mm], h [mm], depth (n,) [mm]) -> (n,) bool``

    References
    ----------
    Haber et al. 2005, section 3.2.
    """
    corners = np.stack(np.meshgrid(*[(-0.25, 0.25)] * 3), axis=-1).reshape(-1, 3)

    def absorption_and_transport(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        sigma_a, sigma_s = medium.coefficients(points)
        return sigma_a, sigma_a + (1 - medium.g) * sigma_s

    def refine(centres: np.ndarray, h: float, depth: np.ndarray) -> np.ndarray:
        if not len(centres):
            return np.zeros(0, bool)
        sigma_a, sigma_tr = absorption_and_transport(centres[:1] if medium.homogeneous else centres)
        k, depth = np.sqrt(3 * sigma_a * sigma_tr), depth[:, None]
        split = (sigma_tr * h * np.exp(-sigma_tr * depth) > SOURCE_VARIATION).any(axis=1)
        split |= ((k * h) ** 2 * np.exp(-k * depth) > DIFFUSION_LENGTHS**2).any(axis=1)
        if not medium.homogeneous:
            samples = np.stack([absorption_and_transport(centres + h * corner)[1] for corner in corners])
            low, high = samples.min(axis=0), samples.max(axis=0)
            split |= (high - low > SIGMA_VARIATION * (high + low)).any(axis=1)
        return split

    return refine
