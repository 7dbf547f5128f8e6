"""Fluence at points of the surface, from its values at the boundary of the cut cells.

    phi_B(v): weighted linear fit in the tangent plane;   radiosity M = phi_B / (2A)

Only phi_B carries the drop at the boundary; values of whole cells must not stand in for it.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from clsss.device import Buffer, Device
from clsss.octree import Octree

RADII = (1.5, 2.5)  # in cells; the wider where the narrower finds too few cut cells
ENOUGH = 3


def boundary_points(octree: Octree) -> tuple[np.ndarray, np.ndarray]:
    """Boundary centroids (n_cut, 3) [mm] and unit outward normals (n_cut, 3) of the cut cells."""
    cut, ijk = octree.cut, octree.finest.ijk
    points = octree.grid.to_mm(ijk[cut.cell.get()] + cut.boundary.get()[:, :3].astype(float))
    normal = cut.normal.get()[:, :3].astype(float)
    size = np.linalg.norm(normal, axis=1, keepdims=True)
    return points, normal / np.where(size > 0, size, 1)


def tangent_frame(normals: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Two unit vectors (n, 3) that make a right-handed frame with unit normals (n, 3)."""
    seed = np.where(np.abs(normals[:, :1]) < 0.6, [1.0, 0, 0], [0, 1.0, 0])
    s = np.cross(normals, seed)
    s /= np.maximum(np.linalg.norm(s, axis=1, keepdims=True), 1e-300)
    return s, np.cross(normals, s)


def fluence_at(device: Device, octree: Octree, phi_B: Buffer, points: np.ndarray,
               normals: np.ndarray | None = None) -> np.ndarray:  # fmt: skip
    """Boundary fluence at points on or near the surface.

    Parameters
    ----------
    phi_B : (n_cut, 4) real, device
        Fluence at the boundary of the cut cells [W/mm^2].
    points : (n, 3) float
        Points [mm].
    normals : (n, 3) float, optional
        Outward normals; by default (and where zero) that of the nearest cut cell. They keep the two sides of
        a thin sheet apart.

    Returns
    -------
    (n, 3) float64
        Fluence [W/mm^2]. Points too far from any cut cell get the nearest one's.
    """
    n = len(points)
    value = np.zeros((n, 3))
    if n == 0:
        return value
    normals = np.zeros((n, 3)) if normals is None else np.array(normals, float)
    unknown = np.flatnonzero(np.linalg.norm(normals, axis=1) < 0.5)
    centre, direction = None, None
    if len(unknown):
        centre, direction = boundary_points(octree)
        normals[unknown] = direction[cKDTree(centre).query(points[unknown])[1]]
    remaining = np.arange(n)
    for radius in RADII:
        fitted, used = _fit(device, octree, phi_B, points[remaining], normals[remaining], radius)
        good = used >= (ENOUGH if radius < RADII[-1] else 1)
        value[remaining[good]] = fitted[good]
        remaining = remaining[~good]
        if not len(remaining):
            return value
    if centre is None:
        centre, _ = boundary_points(octree)
    nearest = cKDTree(centre).query(points[remaining])[1]
    value[remaining] = phi_B.get()[nearest, :3]
    return value


def _fit(device: Device, octree: Octree, phi_B: Buffer, points: np.ndarray, normals: np.ndarray,
         radius: float) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    n, cut = len(points), octree.cut
    spare = np.zeros((n, 1))
    where = device.array(np.concatenate([octree.grid.to_cells(points), spare], axis=1))
    value, used = device.zeros((n, 4)), device.empty(n, np.int32)
    device.run(device.kernel("surface", "fit_at_points"), n, n, float(radius), octree.grid.dims, octree.block,
               octree.brick, octree.cut_index, cut.boundary, cut.normal, where,
               device.array(np.concatenate([normals, spare], axis=1)), phi_B, value, used)  # fmt: skip
    return value.get()[:, :3].astype(float), used.get()
