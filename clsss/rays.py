"""Rays against triangles, and whether points lie inside them.

Embree computes in single precision: coordinates are normalised to the bounding box, far origins are moved
along their rays to it, and distances are computed again in double precision.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from clsss.mesh import Mesh

LINING = 0.1  # cells: how near to the surface a blocker counts as lying on it


class RayCaster:
    """Nearest hits and shadow tests against triangles, with Embree.

    Parameters
    ----------
    triangles : (m, 3, 3) float64
        Triangles in any units.
    """

    def __init__(self, triangles: np.ndarray):
        self.triangles = np.asarray(triangles, np.float64)
        corners = self.triangles.reshape(-1, 3)
        low, high = corners.min(axis=0), corners.max(axis=0)
        self._centre, self._half = (low + high) / 2, float((high - low).max()) / 2
        self._scene: Any = None

    def _run(
        self, origins: np.ndarray, directions: np.ndarray, reach: Any, shadow: bool
    ) -> tuple[Any, np.ndarray]:
        """Embree's answer for normalised rays, and how many directions along them they were started."""
        if self._scene is None:
            from embreex.mesh_construction import TriangleMesh
            from embreex.rtcore_scene import EmbreeScene

            self._scene = EmbreeScene(robust=True)
            TriangleMesh(self._scene, ((self.triangles - self._centre) / self._half).astype(np.float32))
        origins = (np.asarray(origins, np.float64).reshape(-1, 3) - self._centre) / self._half
        directions = np.asarray(directions, np.float64).reshape(-1, 3)
        origins, directions = np.broadcast_arrays(origins, directions)
        squared = np.einsum("ij,ij->i", directions, directions)
        # the box lies within a sphere of radius sqrt(3) about 0
        nearest = -np.einsum("ij,ij->i", origins, directions) / squared - 1.75 / np.sqrt(squared)
        start = np.maximum(nearest, 0.0)
        reach = np.clip(np.asarray(reach) / self._half - start, 0.0, 1e30)
        origins = np.ascontiguousarray(origins + start[:, None] * directions, np.float32)
        directions = np.ascontiguousarray(directions, np.float32)
        reach = np.ascontiguousarray(np.broadcast_to(reach, len(start)), np.float32)
        if shadow:
            answer = self._scene.run(origins, directions, dists=reach, query="OCCLUDED")
        else:
            answer = self._scene.run(origins, directions, dists=reach, output=True)
        return answer, start * self._half

    def hit(
        self, origins: np.ndarray, directions: np.ndarray, exact: bool = True
    ) -> tuple[np.ndarray, np.ndarray]:
        """First triangle each ray hits.

        Parameters
        ----------
        origins, directions : (n, 3) float64
            Rays; either may be one row for all.
        exact : bool
            Compute distances again in double precision; single's are off by some 1e-6 of the object.

        Returns
        -------
        t : (n,) float64
            Distance in lengths of the direction; inf where nothing is hit.
        index : (n,) int64
            Triangle, -1 where none.
        """
        found, start = self._run(origins, directions, np.inf, shadow=False)
        index = found["primID"].astype(np.int64)
        rough = start + found["tfar"].astype(np.float64) * self._half
        if not exact:
            return np.where(index >= 0, rough, np.inf), index
        a, b, c = np.moveaxis(self.triangles[index], 1, 0)
        normal = np.cross(b - a, c - a)
        with np.errstate(divide="ignore", invalid="ignore"):
            exact = np.einsum("ij,ij->i", normal, a - origins)
            exact /= np.einsum("ij,ij->i", normal, np.broadcast_to(directions, normal.shape))
        # the plane says nothing where the ray grazes it or the triangle is a sliver
        agrees = np.abs(exact - rough) * np.linalg.norm(directions, axis=-1) < 1e-4 * self._half
        t = np.maximum(np.where(agrees, exact, rough), 0.0)
        return np.where(index >= 0, t, np.inf), index

    def occluded(self, origins: np.ndarray, directions: np.ndarray, distance: Any = np.inf) -> np.ndarray:
        """Whether anything lies on the ray within a distance.

        Parameters
        ----------
        origins, directions : (n, 3) float64
            Rays; either may be one row for all.
        distance : float or (n,) float64
            How far to look, in lengths of the direction.

        Returns
        -------
        (n,) bool
        """
        return self._run(origins, directions, distance, shadow=True)[0] >= 0


def winding(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Winding number (n,) of triangles (m, 3, 3) about points (n, 3), by summing every solid angle.

    References
    ----------
    Van Oosterom and Strackee 1983, eq. (8).
    """
    out = np.empty(len(points))
    for i, point in enumerate(points):
        a, b, c = (triangles[:, k] - point for k in range(3))
        la, lb, lc = (np.sqrt(np.einsum("ij,ij->i", x, x)) for x in (a, b, c))
        triple = np.einsum("ij,ij->i", a, np.cross(b, c))
        dots = [np.einsum("ij,ij->i", x, y) * length for x, y, length in ((a, b, lc), (b, c, la), (c, a, lb))]
        out[i] = np.arctan2(triple, la * lb * lc + sum(dots)).sum() / (2 * np.pi)
    return out


_DIRECTIONS = np.array([[0.8165, 0.4082, 0.4084], [-0.3291, 0.7713, -0.5449]])  # along no axis or diagonal


def contains(mesh: Mesh, points: np.ndarray) -> np.ndarray:
    """Whether points lie inside the solid, |winding number| > 1/2.

    Signed crossings along two rays count the winding number; where they differ, because a ray met an edge,
    or the surface is open, solid angles are summed, which takes time in proportion to the triangles.

    Parameters
    ----------
    mesh : Mesh
        The solid.
    points : (n, 3) float64
        Points [mm].

    Returns
    -------
    (n,) bool
    """
    points = np.asarray(points, np.float64).reshape(-1, 3)
    numbers = np.zeros(len(points))
    doubtful = np.ones(len(points), bool)
    if mesh.closed:
        caster = RayCaster(mesh.triangles)
        numbers, other = (_crossings(caster, points, direction) for direction in _DIRECTIONS)
        doubtful = numbers != other
    numbers[doubtful] = winding(points[doubtful], mesh.triangles)
    return np.abs(numbers) > 0.5


def _crossings(caster: RayCaster, points: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """Winding numbers (n,): triangles crossed from behind less those crossed from the front."""
    out = np.zeros(len(points))
    alive, origins, last = np.arange(len(points)), points, np.full(len(points), -1)
    step = 4e-6 * np.ptp(caster.triangles, axis=(0, 1)).max()
    while len(alive):
        t, index = caster.hit(origins, direction)
        a, b, c = np.moveaxis(caster.triangles[index], 1, 0)
        sign = np.sign(np.cross(b - a, c - a) @ direction)
        again = (index == last) & (t < 2 * step)  # rounding put the new origin in front of the triangle left
        out[alive] += np.where((index >= 0) & ~again, sign, 0)
        hit = index >= 0
        origins = origins[hit] + (t[hit, None] + step) * direction
        alive, last = alive[hit], index[hit]
    return out
