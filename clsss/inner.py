"""Where light starts inside the object: at lamps in it, and where emission varies.

Around a lamp phi falls as 1 / r, and layers of phi start where the emission changes: leaves must be fine there, however
deep they lie. Input: the finest grid and the lights. Output: a criterion of refinement.py.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from scipy import ndimage

from clsss.cutcell import Grid
from clsss.lights import Emission, PointLight
from clsss.octree import Octree
from clsss.refinement import Refine, pool

LAMPS_APART, EDGES_APART = 8.0, 4.0  # widths of a leaf that it is at least away from lamps and from emission's edges
VARIATION = 0.3  # greatest change of the emission over a leaf, relative to its greatest value there
FAINT = 1e-3  # emission under this part of the strongest counts as none
SAMPLES = 160  # cells along a side where emission is looked at: finer grids are looked at in every other cell


class Inner:
    """Light that starts inside, as the octree sees it.

    Parameters
    ----------
    grid : Grid
        The finest.
    lights : sequence
        Of which lamps in the grid's box count, and emission that varies.
    inside : callable
        Which points (n, 3) [mm] are in the object; emission is asked for at no others.
    """

    def __init__(self, grid: Grid, lights: Sequence[Any], inside: Callable[[np.ndarray], np.ndarray]):
        self._grid, self._step = grid, 1
        self._extremes: list[tuple[np.ndarray, np.ndarray]] = []
        self._apart: np.ndarray | None = None
        self._edges = np.zeros((0, 3))
        lamps = np.reshape([light.position for light in lights if isinstance(light, PointLight)], (-1, 3))
        cells = grid.to_cells(lamps)
        self._lamps = lamps[((cells >= 0) & (cells < grid.dims)).all(axis=1)]
        if emission := [light for light in lights if isinstance(light, Emission) and callable(light.q0)]:
            self._look_at(emission, inside)

    def _look_at(self, emission: list[Emission], inside: Callable[[np.ndarray], np.ndarray]) -> None:
        """Emission's extremes over the cells of every level, and how far each of them is from an edge of it.

        It is looked at in the middle and in a corner of each: balls of more than .56 widths cannot hide between.
        """
        while max(self._grid.dims) > SAMPLES * self._step:
            self._step *= 2
        shape = tuple(-(-n // self._step) for n in reversed(self._grid.dims))
        high, low = np.full(shape, -np.inf, np.float32), np.full(shape, np.inf, np.float32)
        z, *across = (self._step * np.arange(n) + self._step // 2 + 0.5 for n in shape)
        y, x = np.meshgrid(*across, indexing="ij")
        for k, height in enumerate(z):
            middles = np.stack([x, y, np.full_like(x, height)], axis=-1).reshape(-1, 3)
            for points in (self._grid.to_mm(middles), self._grid.to_mm(middles + self._step / 2)):
                among = np.flatnonzero(inside(points))
                q0 = sum(light.density(points[among]).max(axis=1) for light in emission)
                high[k].ravel()[among] = np.maximum(high[k].ravel()[among], q0)
                low[k].ravel()[among] = np.minimum(low[k].ravel()[among], q0)
        outside, faint = high < low, FAINT * high.max(initial=0)
        high[(high < faint) & ~outside], low[low < faint] = 0, 0
        self._extremes = [(high, low)]
        while max(self._extremes[-1][0].shape) > 1:
            self._extremes.append((pool(self._extremes[-1][0]), -pool(-self._extremes[-1][1])))
        high, low = ndimage.maximum_filter(high, 3, mode="nearest"), ndimage.minimum_filter(low, 3, mode="nearest")
        edge = (high - low > VARIATION * high) & ~outside
        if edge.any():
            self._edges = self._grid.to_mm((np.argwhere(edge)[:, ::-1] + 0.5) * self._step)
            self._apart = self._step * self._grid.h * ndimage.distance_transform_cdt(~edge, "chessboard")

    @property
    def places(self) -> np.ndarray:
        """Where leaves must be on the finest level: lamps, and edges of the emission (n, 3) [mm]."""
        return np.concatenate([self._lamps, self._edges])

    def around(self, refine: Refine) -> Refine:
        """Split where `refine` says, with depth counted from these lights too, and where they vary over a cell."""

        def both(centres: np.ndarray, h: float, depth: np.ndarray) -> np.ndarray:
            lamps, edges = self._to_lamps(centres), self._to_edges(centres)
            split = refine(centres, h, np.minimum(depth, np.minimum(lamps, edges)))
            split |= (h * LAMPS_APART > lamps) | (h * EDGES_APART > edges)
            width = round(h / self._grid.h)
            if self._extremes and width >= self._step:
                extremes = self._extremes[int(np.log2(width / self._step))]
                high, low = (part[self._cells(centres, width)] for part in extremes)
                split |= high - low > VARIATION * high
            return split

        return both if len(self._lamps) or self._extremes else refine

    def _to_lamps(self, points: np.ndarray) -> np.ndarray:
        """How far points (n, 3) are from the nearest lamp [mm]."""
        nearest = np.full(len(points), np.inf)
        for lamp in self._lamps:
            nearest = np.minimum(nearest, np.linalg.norm(points - lamp, axis=1))
        return nearest

    def _to_edges(self, points: np.ndarray) -> np.ndarray:
        """How far points (n, 3) are from the nearest edge of the emission [mm]."""
        if self._apart is None:
            return np.full(len(points), np.inf)
        return self._apart[self._cells(points, self._step)]

    def _cells(self, points: np.ndarray, width: int) -> tuple[np.ndarray, ...]:
        """Where points lie in an array (z, y, x) of cells that are `width` finest cells wide."""
        cells = np.floor(self._grid.to_cells(points) / width).astype(int)
        return tuple(np.clip(cells, 0, -(-np.array(self._grid.dims) // width) - 1).T[::-1])


def within(grid: Grid, inside: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
    """Which points (n, 3) [mm] lie in cells of the finest grid that are `inside`, as in `Samples`."""

    def find(points: np.ndarray) -> np.ndarray:
        x, y, z = np.clip(np.floor(grid.to_cells(points)).astype(int), 0, np.array(grid.dims) - 1).T
        return (inside[z, y, x >> 3] >> (x & 7) & 1).astype(bool)

    return find


def in_wide_cells(tree: Octree, lights: Sequence[Any]) -> bool:
    """Whether light starts inside an octree that was made for other lights, where it is not fine."""

    def wide(points: np.ndarray) -> np.ndarray:
        depth, leaf = tree.find(points)
        return (depth > 0) & (leaf >= 0)

    places = Inner(tree.grid, lights, wide).places
    return len(places) > 0 and bool(wide(places).any())
