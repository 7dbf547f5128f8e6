"""Load a triangle mesh, make it bound a solid, scale it to millimetres.

Input: a file or a `trimesh.Trimesh`. Output: a `Mesh`. A point is inside where the winding number of the
mesh's `triangles` exceeds 1/2 in magnitude: overlapping bodies are one body, and a shell that winds inward
inside another is a cavity.
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any

import numpy as np

from clsss import meshfile
from clsss.errors import InputError
from clsss.halfedges import cross, sides
from clsss.rays import RayCaster, contains
from clsss.repair import Repaired, repair

if TYPE_CHECKING:
    import trimesh

__all__ = ["Mesh", "RayCaster", "contains", "load_mesh", "opaque_triangles"]

MOST_CAPS = 0.25  # share of the surface that holes' caps may be until that is said
SOME = 1 << 16  # triangles at a time, so that sums over them take little memory
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
        ``faces``, ``vertices``, ``closed`` (whether the input was), ``repairs`` (sentences), ``size_mm``,
        ``scale`` (mm per unit of the input), ``seconds`` (to load).
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

    @cached_property
    def bounds(self) -> np.ndarray:
        """Lower and upper corner (2, 3) of the solid's bounding box [mm]."""
        columns = self.triangles.reshape(-1, 3).T
        return np.array([[x.min() for x in columns], [x.max() for x in columns]])

    @cached_property
    def size(self) -> float:
        """Longest side of the solid's bounding box [mm]."""
        return float(np.ptp(self.bounds, axis=0).max())

    @cached_property
    def area_and_volume(self) -> tuple[float, float]:
        """Area [mm^2] of the surface that bounds the solid, and the volume [mm^3] in it."""
        area = volume = 0.0
        for first in range(0, len(self.triangles), SOME):
            some = self.triangles[first : first + SOME] - self.bounds.mean(axis=0)
            a, b, c = np.moveaxis(some, 0, 2).copy()
            normal = cross(b - a, c - a)
            area += np.sqrt(np.einsum("ij,ij->j", normal, normal)).sum() / 2
            volume += np.einsum("ij,ij->", a, normal) / 6
        return float(area), float(abs(volume))


def opaque_triangles(blockers: Sequence[Mesh]) -> np.ndarray | None:
    """Triangles (m, 3, 3) of surfaces that block light, closed or open, None where there are none.

    Raises
    ------
    InputError
        They are no list of meshes.
    """
    if not isinstance(blockers, (list, tuple)) or not all(isinstance(body, Mesh) for body in blockers):
        raise InputError("blockers: needs a list of meshes from clsss.load_mesh")
    return np.concatenate([body.vertices[body.faces] for body in blockers]) if blockers else None


def load_mesh(
    source: str | os.PathLike[str] | trimesh.Trimesh, size: float | None = None, solid: bool = True
) -> Mesh:
    """Load a triangle mesh and repair it until it bounds a solid.

    Parameters
    ----------
    source : path or trimesh.Trimesh
        PLY, OBJ, or anything trimesh reads; also compressed with gzip.
    size : float, optional
        Longest side of the bounding box of the vertices in use [mm]; by default the file's units are mm.
    solid : bool
        False leaves the surface as it is, open or flat: enough for what only casts shadows.

    Returns
    -------
    Mesh

    Raises
    ------
    InputError
        The file cannot be read, makes no sense or bounds no volume, or `size` is not a length.
    """
    start = perf_counter()
    try:
        length = None if size is None else float(size)
    except (TypeError, ValueError):
        length = np.nan
    if length is not None and not 0 < length < np.inf:
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
        repaired = repair((vertices - centre) / longest, faces) if solid else _as_is(vertices, faces)
    except InputError as error:
        raise InputError(f"{name}: {error}") from None
    mesh = _scaled(vertices, faces, repaired, centre, longest, length, name)
    if solid:
        require_volume(mesh)
        _warn_of_caps(mesh, np.any(repaired.solid >= len(repaired.first), axis=1))
    mesh.report["seconds"] = perf_counter() - start
    return mesh


def _as_is(vertices: np.ndarray, faces: np.ndarray) -> Repaired:
    """Nothing repaired."""
    every, faces_kept = np.arange(len(vertices)), np.arange(len(faces))
    untouched = np.zeros(len(faces), bool)
    return Repaired(faces_kept, untouched, every, every, faces, np.zeros((0, 3)), False, False, [])


def _used(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Which vertices (v,) a face uses."""
    used = np.zeros(len(vertices), bool)
    used[faces.ravel()] = True
    return used


def _bounding_box(vertices: np.ndarray, faces: np.ndarray, name: str) -> tuple[np.ndarray, float]:
    """Corners (2, 3) of the box of the vertices faces use, and its longest side."""
    bad = np.flatnonzero(~np.isfinite(vertices).all(axis=1))
    if len(bad):
        raise InputError(f"{name}: vertex {bad[0]} has a coordinate that is not a finite number")
    used = vertices[_used(vertices, faces)].T
    box = np.array([[x.min() for x in used], [x.max() for x in used]])
    with np.errstate(over="ignore"):
        longest = float(np.ptp(box, axis=0).max())
    if not 1e-290 < longest < 1e290:  # scaling must not overflow
        raise InputError(f"{name}: all vertices lie at one point or too far apart; there is no solid")
    return box, longest


def _scaled(
    vertices: np.ndarray,
    faces: np.ndarray,
    repaired: Repaired,
    centre: np.ndarray,
    longest: float,
    length: float | None,
    name: str,
) -> Mesh:
    """The repaired mesh in millimetres."""
    drawn = faces[repaired.kept]
    drawn = np.where(repaired.turned[:, None], drawn[:, ::-1], drawn).astype(np.int32)
    used = _used(vertices, drawn)
    extent = float(np.ptp(vertices[used], axis=0).max()) if len(drawn) else longest
    scale = 1.0 if length is None else length / extent
    points = vertices * scale
    corners = np.concatenate([points[repaired.first], (repaired.centroids * longest + centre) * scale])
    triangles = corners[repaired.solid]
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
        "scale": scale,
    }
    normals = _normals((vertices - centre) / longest, drawn, used, repaired.welded)
    return Mesh(points, drawn, normals, triangles, repaired.closed, report, name)


def require_volume(mesh: Mesh) -> None:
    """Refuse what has no inside.

    Raises
    ------
    InputError
    """
    area, volume = mesh.area_and_volume if len(mesh.triangles) else (0.0, 0.0)
    if not (volume > 0 and volume > _FLAT * area * mesh.size):
        raise InputError(f"{mesh.name}: its surface holds no volume; clsss needs a solid with an inside")


def _warn_of_caps(mesh: Mesh, is_cap: np.ndarray) -> None:
    """Say so where much of the surface (m,) was made up: a sheet, or the half of an object."""
    if not is_cap.any():
        return
    a, b, c = np.moveaxis(mesh.triangles, 1, 0)
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    if (share := area[is_cap].sum() / area.sum()) > MOST_CAPS:
        found = f"{100 * share:.0f} % of its surface are caps over holes"
        mesh.report["repairs"].append(found)
        advice = "close it, or give a sheet a thickness, unless it is solid up to there"
        warnings.warn(f"{mesh.name}: {found}: {advice}", stacklevel=3)


def _normals(points: np.ndarray, faces: np.ndarray, used: np.ndarray, welded: np.ndarray) -> np.ndarray:
    """Vertex normals (v, 3): the sum over the faces at a position, each times its angle there."""
    ab, bc, ca = sides(points, faces)
    normal = cross(ca, ab)
    length = np.sqrt(np.einsum("ij,ij->j", normal, normal))
    normal /= np.maximum(length, np.finfo(float).tiny)
    n = int(welded.max()) + 1
    total = np.zeros((n, 3))
    for k, (to, back) in enumerate(((ab, ca), (bc, ab), (ca, bc))):
        angle = np.arctan2(length, -np.einsum("ij,ij->j", to, back))
        corner = welded[faces[:, k]]
        for axis in range(3):
            total[:, axis] += np.bincount(corner, angle * normal[axis], minlength=n)
    total /= np.maximum(np.linalg.norm(total, axis=1), np.finfo(float).tiny)[:, None]
    out = np.zeros_like(points)
    out[used] = total[welded[used]]
    return out
