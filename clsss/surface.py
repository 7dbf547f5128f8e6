"""Fluence at points of the surface, from its values at the boundary of the cut cells.

    phi_B(v): weighted linear fit in the tangent plane;   radiosity M = phi_B / (2A)

Only phi_B carries the drop at the boundary; values of whole cells must not stand in for it.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy import sparse
from scipy.spatial import cKDTree

from clsss.device import Buffer, Device
from clsss.octree import Octree
from clsss.stowed import stow

RADII = (1.5, 2.5)  # in cells; the wider where the narrower finds too few cut cells
WIDTH = 24  # cut cells that most fits do with
CHUNK = 1 << 13  # points at a time, so that the device need not hold much


def boundary_normals(octree: Octree, first: int = 0, n: int | None = None) -> np.ndarray:
    """Unit outward normals (n_cut, 3) of the cut cells, or of the `n` from `first` on."""
    normal = octree.cut.normal.get(first, n)[:, :3].astype(float)
    size = np.linalg.norm(normal, axis=1, keepdims=True)
    normal /= np.where(size > 0, size, 1)
    return normal


def boundary_points(octree: Octree) -> tuple[np.ndarray, np.ndarray]:
    """Boundary centroids (n_cut, 3) [mm] and unit outward normals (n_cut, 3) of the cut cells."""
    cut = octree.cut
    points = octree.grid.to_mm(octree.cut_positions() + cut.boundary.get()[:, :3].astype(float))
    return points, boundary_normals(octree)


def tangent_frame(normals: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Two unit vectors (n, 3) that make a right-handed frame with unit normals (n, 3)."""
    seed = np.where(np.abs(normals[:, :1]) < 0.6, [1.0, 0, 0], [0, 1.0, 0])
    s = np.cross(normals, seed)
    s /= np.maximum(np.linalg.norm(s, axis=1, keepdims=True), 1e-300)
    return s, np.cross(normals, s)


def fluence_at(device: Device, octree: Octree, phi_B: Buffer, points: np.ndarray,
               normals: np.ndarray | None = None) -> np.ndarray:  # fmt: skip
    """Boundary fluence (n, 3) at points on or near the surface, from `phi_B` (n_cut, 3); see `shares_at`."""
    return (shares_at(device, octree, points, normals) @ phi_B.get()).astype(float)


class Shares:
    """What carries values at the boundary of the cut cells to points: rows of a sparse matrix, some together.

    Parameters
    ----------
    parts : list of (k,) real, (k,) int and (m + 1,) int32
        Of m rows each: entries, their columns, and where rows start.
    n_cut : int
        Number of columns.
    """

    def __init__(self, parts: list[tuple[np.ndarray, np.ndarray, np.ndarray]], n_cut: int):
        shares, columns, starts = zip(*parts, strict=True)
        self._shares, self._columns, self._n_cut = stow(*shares), stow(*columns), n_cut
        count = np.concatenate([np.diff(start) for start in starts])
        self._start = stow(np.concatenate([[0], np.cumsum(count)]).astype(np.int32))

    def __matmul__(self, values: np.ndarray) -> np.ndarray:
        """Values (n, ...) at the points, of values (n_cut, ...)."""
        n = self._start.shape[0] - 1
        out = np.empty((n, *values.shape[1:]), values.dtype)
        for first in range(0, n, CHUNK):
            start = self._start.rows(first, min(CHUNK, n - first) + 1)
            low, high = int(start[0]), int(start[-1])
            entries = self._shares.rows(low, high - low), self._columns.rows(low, high - low).astype(np.int32)
            matrix = sparse.csr_matrix((*entries, start - low), (len(start) - 1, self._n_cut))
            out[first : first + CHUNK] = matrix @ values
        return out

    def carry(self, fields: np.ndarray) -> np.ndarray:
        """Fields (n_cut, k) at the points; next to a shadow a fit may run below zero."""
        values = self @ fields
        return np.maximum(values, 0, out=values)


def shares_at(device: Device, octree: Octree, points: np.ndarray, normals: np.ndarray | None = None) -> Shares:
    """What carries values at the boundary of the cut cells, such as fluence, to points on or near the surface.

    Parameters
    ----------
    points : (n, 3) float
        Points [mm].
    normals : (n, 3) float, optional
        Outward normals; by default (and where zero) that of the nearest cut cell. They keep the two sides of
        a thin sheet apart.

    Returns
    -------
    Shares
        Points too far from any cut cell get the nearest one's value.
    """
    n = len(points)
    normals = np.zeros((n, 3)) if normals is None else np.asarray(normals, float)
    unknown = np.flatnonzero((normals**2).sum(axis=1) < 0.25)
    if len(unknown):
        centre, direction = boundary_points(octree)
        normals = normals.copy()
        normals[unknown] = direction[cKDTree(centre).query(points[unknown])[1]]
    cells, nearest = octree.lend_cells(), None
    place = np.uint16 if octree.cut.n <= 1 << 16 else np.int32
    parts = [(np.empty(0, device.real), np.empty(0, place), np.zeros(1, np.int32))]  # there may be no points
    for first in range(0, n, CHUNK):
        some = points[first : first + CHUNK]
        used, cuts, shares = _fit(device, octree, cells, some, normals[first : first + CHUNK])
        far = np.flatnonzero(used == 0)
        if len(far):
            nearest = nearest or cKDTree(boundary_points(octree)[0])
            cuts[far, 0], shares[far, 0], used[far] = nearest.query(some[far])[1], 1, 1
        kept = np.arange(cuts.shape[1]) < used[:, None]
        parts.append((shares[kept], cuts[kept].astype(place), np.concatenate([[0], np.cumsum(used)]).astype(np.int32)))
    return Shares(parts, octree.cut.n)


def _fit(device: Device, octree: Octree, cells: tuple[Any, ...], points: np.ndarray,
         normals: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:  # fmt: skip
    """How many cut cells each point's fit counts (n,), which (n, m) and their shares (n, m), first of m."""
    n, kernel = len(points), device.kernel("surface", "share_at_points")
    where, facing, used = device.array(octree.grid.to_cells(points)), device.array(normals), device.empty(n, np.int32)
    most, width = WIDTH, 0
    while most > width:
        width = most
        cuts, shares = device.empty((n, width), np.int32), device.empty((n, width))
        device.run(kernel, n, n, width, *RADII, *cells, where, facing, cuts, shares, used)
        count = used.get()
        most = int(count.max())
    return count, cuts.get(), shares.get()
