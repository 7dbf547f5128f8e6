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
    """Boundary fluence (n, 3) at points on or near the surface, as `values_at` has it."""
    return values_at(device, octree, phi_B, phi_B, points, normals)[0]


def values_at(device: Device, octree: Octree, first: Buffer, second: Buffer, points: np.ndarray,
              normals: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """Two fields of the boundary at points on or near the surface.

    Parameters
    ----------
    first, second : (n_cut, 4) real, device
        Values at the boundary of the cut cells, such as fluence [W/mm^2].
    points : (n, 3) float
        Points [mm].
    normals : (n, 3) float, optional
        Outward normals; by default (and where zero) that of the nearest cut cell. They keep the two sides of
        a thin sheet apart.

    Returns
    -------
    (n, 3), (n, 3) float64
        In the unit of the fields. Points too far from any cut cell get the nearest one's.
    """
    if not len(points):
        return np.zeros((0, 3)), np.zeros((0, 3))
    normals = np.zeros((len(points), 3)) if normals is None else np.asarray(normals, float)
    unknown = np.flatnonzero((normals**2).sum(axis=1) < 0.25)
    if len(unknown):
        centre, direction = boundary_points(octree)
        normals = normals.copy()
        normals[unknown] = direction[cKDTree(centre).query(points[unknown])[1]]
    values, used = _fit(device, octree, first, second, points, normals, RADII[0])
    few = np.flatnonzero(used < ENOUGH)
    if len(few):
        values[:, few], used = _fit(device, octree, first, second, points[few], normals[few], RADII[1])
        none = few[used == 0]
        if len(none):
            nearest = cKDTree(boundary_points(octree)[0]).query(points[none])[1]
            for value, field in zip(values, (first, second), strict=True):
                value[none] = field.get()[nearest, :3]
    return values[0], values[1]


def _fit(device: Device, octree: Octree, first: Buffer, second: Buffer, points: np.ndarray, normals: np.ndarray,
         radius: float) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """Both fields at points (2, n, 3), and how many cut cells each fit counts (n,)."""
    n, cut = len(points), octree.cut
    value, used = device.empty((n, 2, 4)), device.empty(n, np.int32)
    device.run(device.kernel("surface", "fit_at_points"), n, n, radius, octree.grid.dims, octree.block, octree.brick,
               octree.clearance, octree.cut_index, cut.boundary, cut.normal, device.array(octree.grid.to_cells(points)),
               device.array(normals), first, second, value, used)  # fmt: skip
    return value.get()[:, :, :3].swapaxes(0, 1).astype(float), used.get()
