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
from clsss.halfedges import areas, cross, runs, sides
from clsss.heap import give_back
from clsss.rays import RayCaster, contains
from clsss.repair import Repaired, repair

if TYPE_CHECKING:
    import trimesh

__all__ = ["Mesh", "RayCaster", "contains", "load_mesh", "opaque_triangles"]

MOST_CAPS = 0.25  # share of the surface that holes' caps may be until that is said
_SHORTEST, _LONGEST = 1e-6, 1e9  # mm: single precision does not hold the cubes of far smaller and larger ones
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
    solid : (m, 3) int32
        Oriented surface that bounds the solid: welded faces and caps over holes. Indices into `points`:
        the vertices, then the centroids.
    closed : bool
        Whether every directed edge of `triangles` is matched by its reverse. Where it is not, the winding
        number is not an integer.
    report : dict
        ``faces``, ``vertices``, ``closed`` (whether the input was), ``repairs`` (sentences), ``size_mm``,
        ``scale`` (mm per unit of the input), ``seconds`` (to load).
    name : str
        File name, or "mesh".
    centroids : (c, 3) float64
        Where the caps' triangles meet [mm].
    """

    vertices: np.ndarray
    faces: np.ndarray
    normals: np.ndarray
    solid: np.ndarray
    closed: bool
    report: dict[str, Any] = field(default_factory=dict)
    name: str = "mesh"
    centroids: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))

    @property
    def triangles(self) -> np.ndarray:
        """Triangles (m, 3, 3) of `solid` [mm], gathered at each use: they take several times what else is kept."""
        return self.points[self.solid]

    @property
    def points(self) -> np.ndarray:
        """What `solid` indexes (p, 3) [mm]."""
        return np.concatenate([self.vertices, self.centroids]) if len(self.centroids) else self.vertices

    @cached_property
    def bounds(self) -> np.ndarray:
        """Lower and upper corner (2, 3) of the solid's bounding box [mm]."""
        return _box(self.points, self.solid)

    @cached_property
    def size(self) -> float:
        """Longest side of the solid's bounding box [mm]."""
        return float(np.ptp(self.bounds, axis=0).max())

    @cached_property
    def area_and_volume(self) -> tuple[float, float]:
        """Area [mm^2] of the surface that bounds the solid, and the volume [mm^3] in it."""
        area = volume = 0.0
        columns = np.subtract(self.points, self.bounds.mean(axis=0), order="F").T
        for some in runs(len(self.solid)):
            ab, _, ca = sides(columns, self.solid[some])
            normal = cross(ca, ab)
            area += np.sqrt(np.einsum("ij,ij->j", normal, normal)).sum() / 2
            volume += np.einsum("ij,ij->", columns.take(self.solid[some, 0], axis=1), normal) / 6
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
    if length is not None and not _SHORTEST <= length <= _LONGEST:
        raise InputError(f"size: {size!r} is not a length; give the longest side, {_SHORTEST:g} to {_LONGEST:g} mm")
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
        repaired = repair(vertices, faces, centre, longest) if solid else _as_is(vertices, faces)
    except InputError as error:
        raise InputError(f"{name}: {error}") from None
    del faces
    mesh = _scaled(vertices, repaired, centre, longest, length, name)
    if solid:
        require_volume(mesh)
        _warn_of_caps(mesh)
    give_back()
    mesh.report["seconds"] = perf_counter() - start
    return mesh


def _as_is(vertices: np.ndarray, faces: np.ndarray) -> Repaired:
    """Nothing repaired."""
    every = np.arange(len(vertices))
    return Repaired(faces, every, faces, np.zeros((0, 3)), False, False, [])


def _used(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Which vertices (v,) a face uses."""
    used = np.zeros(len(vertices), bool)
    used[faces.ravel()] = True
    return used


def _box(points: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Lower and upper corner (2, 3) of the box of the points that faces use."""
    used = _used(points, faces)
    columns = (points if used.all() else points[used]).T
    return np.array([[x.min() for x in columns], [x.max() for x in columns]])


def _bounding_box(vertices: np.ndarray, faces: np.ndarray, name: str) -> tuple[np.ndarray, float]:
    """Corners (2, 3) of the box of the vertices faces use, and its longest side."""
    bad = np.flatnonzero(~np.isfinite(vertices).all(axis=1))
    if len(bad):
        raise InputError(f"{name}: vertex {bad[0]} has a coordinate that is not a finite number")
    box = _box(vertices, faces)
    with np.errstate(over="ignore"):
        longest = float(np.ptp(box, axis=0).max())
    if not 1e-290 < longest < 1e290:  # scaling must not overflow
        raise InputError(f"{name}: all vertices lie at one point or too far apart; there is no solid")
    return box, longest


def _scaled(
    vertices: np.ndarray, repaired: Repaired, centre: np.ndarray, longest: float, length: float | None, name: str
) -> Mesh:
    """The repaired mesh in millimetres; the vertices are scaled where they are."""
    faces, repairs = repaired.faces, list(repaired.repairs)
    extent = float(np.ptp(_box(vertices, faces), axis=0).max()) if len(faces) else longest
    scale = 1.0 if length is None else length / extent
    reach = float(np.abs(centre).max())
    if longest < 1e-5 * reach and (vertices == vertices.astype(np.float32)).all():
        repairs.append("the mesh lies so far from its origin that single precision has rounded its shape")
    report = {
        "faces": len(faces),
        "vertices": len(vertices),
        "closed": repaired.was_closed,
        "repairs": repairs,
        "size_mm": extent * scale,
        "scale": scale,
    }
    normals = _normals(vertices, faces, centre, longest, repaired.welded)
    vertices *= scale
    solid = faces if np.array_equal(faces, repaired.solid) else repaired.solid
    return Mesh(vertices, faces, normals, solid, repaired.closed, report, name, repaired.centroids * scale)


def require_volume(mesh: Mesh) -> None:
    """Refuse what has no inside.

    Raises
    ------
    InputError
    """
    area, volume = mesh.area_and_volume if len(mesh.solid) else (0.0, 0.0)
    if not (volume > 0 and volume > _FLAT * area * mesh.size):
        raise InputError(f"{mesh.name}: its surface holds no volume; clsss needs a solid with an inside")


def _warn_of_caps(mesh: Mesh) -> None:
    """Say so where much of the surface was made up: a sheet, or the half of an object."""
    if not len(mesh.centroids):
        return
    area = areas(mesh.points, mesh.solid)
    is_cap = (mesh.solid >= len(mesh.vertices)).any(axis=1)
    if (share := area[is_cap].sum() / area.sum()) > MOST_CAPS:
        found = f"{100 * share:.0f} % of its surface are caps over holes"
        mesh.report["repairs"].append(found)
        advice = "close it, or give a sheet a thickness, unless it is solid up to there"
        warnings.warn(f"{mesh.name}: {found}: {advice}", stacklevel=3)


def _normals(
    vertices: np.ndarray, faces: np.ndarray, centre: np.ndarray, longest: float, welded: np.ndarray
) -> np.ndarray:
    """Vertex normals (v, 3): the sum over the faces at a position, each times its angle there."""
    columns = np.subtract(vertices, centre, order="F").T
    columns /= longest
    total = np.zeros((3, 3, int(welded.max()) + 1))  # of each corner of the faces apart
    for some in runs(len(faces)):
        ab, bc, ca = sides(columns, faces[some])
        normal = cross(ca, ab)
        length = np.sqrt(np.einsum("ij,ij->j", normal, normal))
        normal /= np.maximum(length, np.finfo(float).tiny)
        for k, (to, back) in enumerate(((ab, ca), (bc, ab), (ca, bc))):
            angle = np.arctan2(length, -np.einsum("ij,ij->j", to, back))
            corner = welded[faces[some, k]]
            for axis in range(3):
                np.add.at(total[k, axis], corner, angle * normal[axis])
    del columns
    summed = total[0] + total[1]
    summed += total[2]
    del total
    summed /= np.maximum(np.linalg.norm(summed, axis=0), np.finfo(float).tiny)
    out, used = np.zeros_like(vertices), _used(vertices, faces)
    for axis in range(3):
        out[used, axis] = summed[axis, welded[used]]
    return out
