"""Load a triangle mesh, make it bound a solid, scale it to millimetres; cast rays at it.

Input: a file or a `trimesh.Trimesh`. Output: a `Mesh`. A point is inside where the winding number of the
mesh's `triangles` exceeds 1/2 in magnitude: overlapping bodies are one body, and a shell that winds inward
inside another is a cavity.
"""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from clsss import meshfile
from clsss.errors import InputError
from clsss.repair import Repaired, repair, winding

if TYPE_CHECKING:
    import trimesh

_FLAT = 1e-7  # volume over area times length: what rounding to float32 leaves of zero


@dataclass(frozen=True, eq=False)
class Mesh:
    """A solid bounded by triangles, and the vertices and faces it is drawn with.

    Attributes
    ----------
    vertices : (v, 3) float64
        Every vertex of the input in its order, also those no face uses [mm].
    faces : (f, 3) int32
        What to draw, wound outward; indices into `vertices`.
    normals : (v, 3) float64
        Unit outward normals, weighted by angle over the welded surface; 0 where no face uses the vertex.
    triangles : (m, 3, 3) float64
        Oriented surface that bounds the solid: welded faces and caps over holes [mm].
    closed : bool
        Whether every directed edge of `triangles` is matched by its reverse. Where it is not, the winding
        number is not an integer.
    report : dict
        ``faces``, ``vertices``, ``closed`` (whether the input was), ``repairs`` (sentences), ``size_mm``.
    name : str
        File name, or "mesh".
    """

    vertices: np.ndarray
    faces: np.ndarray
    normals: np.ndarray
    triangles: np.ndarray
    closed: bool
    report: dict[str, Any] = field(default_factory=dict)
    name: str = "mesh"

    @property
    def bounds(self) -> np.ndarray:
        """Lower and upper corner (2, 3) of the solid's bounding box [mm]."""
        corners = self.triangles.reshape(-1, 3)
        return np.array([corners.min(axis=0), corners.max(axis=0)])

    @property
    def size(self) -> float:
        """Longest side of the solid's bounding box [mm]."""
        return float(np.ptp(self.bounds, axis=0).max())


def load_mesh(source: str | os.PathLike[str] | trimesh.Trimesh, size: float | None = None) -> Mesh:
    """Load a triangle mesh and repair it until it bounds a solid.

    Parameters
    ----------
    source : path or trimesh.Trimesh
        PLY, OBJ, or anything trimesh reads; also compressed with gzip.
    size : float, optional
        Longest side of the bounding box of the vertices in use [mm]; by default the file's units are mm.

    Returns
    -------
    Mesh

    Raises
    ------
    InputError
        The file cannot be read, makes no sense or bounds no volume, or `size` is not a length.
    """
    if size is not None and not (np.isscalar(size) and np.isreal(size) and 0 < size < np.inf):
        raise InputError(f"size: {size!r} is not a length; give the longest side in mm, more than 0")
    if isinstance(source, (str, os.PathLike)):
        path = Path(source)
        name = path.name
        vertices, faces = meshfile.read(path)
    else:
        name = "mesh"
        vertices, faces = meshfile.from_trimesh(source, name)
    box, longest = _bounding_box(vertices, faces, name)
    centre = box.mean(axis=0)
    try:
        repaired = repair((vertices - centre) / longest, faces)
    except InputError as error:
        raise InputError(f"{name}: {error}") from None
    return _scaled(vertices, faces, repaired, centre, longest, size, name)


def _bounding_box(vertices: np.ndarray, faces: np.ndarray, name: str) -> tuple[np.ndarray, float]:
    """Corners (2, 3) of the box of the vertices faces use, and its longest side."""
    bad = np.flatnonzero(~np.isfinite(vertices).all(axis=1))
    if len(bad):
        raise InputError(f"{name}: vertex {bad[0]} has a coordinate that is not a finite number")
    used = vertices[faces.ravel()]
    box = np.array([used.min(axis=0), used.max(axis=0)])
    longest = float(np.ptp(box, axis=0).max())
    if not 0 < longest < np.inf:
        raise InputError(f"{name}: all vertices lie at one point or too far apart; there is no solid to light")
    return box, longest


def _scaled(
    vertices: np.ndarray,
    faces: np.ndarray,
    repaired: Repaired,
    centre: np.ndarray,
    longest: float,
    size: float | None,
    name: str,
) -> Mesh:
    """The repaired mesh in millimetres."""
    used = vertices[faces[repaired.kept].ravel()]
    extent = float(np.ptp(used, axis=0).max()) if len(used) else longest
    scale = 1.0 if size is None else float(size) / extent
    points = vertices * scale
    corners = np.concatenate([points[repaired.first], (repaired.centroids * longest + centre) * scale])
    triangles = corners[repaired.solid]
    _require_volume(triangles, longest * scale, repaired.closed, name)
    drawn = faces[repaired.kept]
    drawn = np.where(repaired.turned[:, None], drawn[:, ::-1], drawn).astype(np.int32)
    repairs = list(repaired.repairs)
    reach = float(np.abs(centre).max())
    if longest < 1e-5 * reach and (vertices == vertices.astype(np.float32)).all():
        repairs.append("the mesh lies so far from its origin that single precision has rounded its shape")
    report = {
        "faces": len(drawn),
        "vertices": len(vertices),
        "closed": repaired.was_closed,
        "repairs": repairs,
        "size_mm": extent * scale,
    }
    normals = _normals((vertices - centre) / longest, drawn, repaired.welded)
    return Mesh(points, drawn, normals, triangles, repaired.closed, report, name)


def _require_volume(triangles: np.ndarray, length: float, closed: bool, name: str) -> None:
    a, b, c = np.moveaxis((triangles - triangles[:1, :1]) / length, 1, 0)
    volume = np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2
    if not abs(volume) > _FLAT * area:
        what = "closed surface" if closed else "surface"
        raise InputError(f"{name}: its {what} holds no volume; clsss needs a solid with an inside")


def _normals(points: np.ndarray, faces: np.ndarray, welded: np.ndarray) -> np.ndarray:
    """Vertex normals (v, 3): the sum over the faces at a position, each times its angle there."""
    a, b, c = (points[faces[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    length = np.linalg.norm(normal, axis=1)
    normal /= np.maximum(length, np.finfo(float).tiny)[:, None]
    n = int(welded.max()) + 1
    total = np.zeros((n, 3))
    for k, (p, q, r) in enumerate(((a, b, c), (b, c, a), (c, a, b))):
        angle = np.arctan2(length, np.einsum("ij,ij->i", q - p, r - p))
        corner = welded[faces[:, k]]
        for axis in range(3):
            total[:, axis] += np.bincount(corner, angle * normal[:, axis], minlength=n)
    total /= np.maximum(np.linalg.norm(total, axis=1), np.finfo(float).tiny)[:, None]
    out = np.zeros_like(points)
    drawn = np.unique(faces)
    out[drawn] = total[welded[drawn]]
    return out


class RayCaster:
    """Nearest hits and shadow tests against triangles, with Embree.

    Embree computes in single precision, so coordinates are normalised to the bounding box, far origins are
    moved along their rays to it, and distances are computed again in double precision.

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
        self, origins: np.ndarray, directions: np.ndarray, reach: Any, **query: Any
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
        reach = np.clip(np.asarray(reach) / self._half - start, -1.0, 1e30)
        single = [np.ascontiguousarray(x, np.float32) for x in (origins + start[:, None] * directions, directions)]
        reach = np.ascontiguousarray(np.broadcast_to(reach, len(start)), np.float32)
        return self._scene.run(*single, dists=np.maximum(reach, 0), **query), start * self._half

    def hit(self, origins: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """First triangle each ray hits.

        Parameters
        ----------
        origins, directions : (n, 3) float64
            Rays; either may be one row for all.

        Returns
        -------
        t : (n,) float64
            Distance in lengths of the direction; inf where nothing is hit.
        index : (n,) int64
            Triangle, -1 where none.
        """
        found, start = self._run(origins, directions, np.inf, output=True)
        index = found["primID"].astype(np.int64)
        rough = start + found["tfar"].astype(np.float64) * self._half
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
        return self._run(origins, directions, distance, query="OCCLUDED")[0] >= 0


_DIRECTIONS = np.array([[0.8165, 0.4082, 0.4084], [-0.3291, 0.7713, -0.5449]])  # along no axis or diagonal


def contains(mesh: Mesh, points: np.ndarray) -> np.ndarray:
    """Whether points lie inside the solid, |winding number| > 1/2.

    Signed crossings along two rays count the winding number; where they differ, because a ray met an edge,
    or the surface is open, solid angles are summed, which takes time in proportion to the triangles.

    Parameters
    ----------
    mesh : Mesh
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
