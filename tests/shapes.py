"""Solids with known measures, and what the solver makes of them: octree, operator, solution."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import trimesh

from clsss import cutcell, diffusion, octree, source
from clsss.device import Device
from clsss.fields import Field, Load
from clsss.fresnel import fresnel_A
from clsss.level import Level
from clsss.mesh import Mesh
from clsss.multigrid import Convergence, Multigrid
from clsss.refinement import Refine


def solid(triangles: np.ndarray, closed: bool = True) -> Mesh:
    """A solid bounded by triangles (m, 3, 3) exactly as they are: nothing is welded, turned or filled."""
    vertices = np.asarray(triangles, float).reshape(-1, 3)
    faces = np.arange(len(vertices), dtype=np.int32).reshape(-1, 3)
    a, b, c = vertices[faces].swapaxes(0, 1)
    normals = np.cross(b - a, c - a)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    report = {"faces": len(faces), "vertices": len(vertices), "closed": closed, "repairs": []}
    report["size_mm"] = float(np.ptp(vertices, axis=0).max())
    return Mesh(vertices, faces, np.repeat(normals, 3, axis=0), faces, closed, report, "solid")


def sphere_triangles(radius: float = 10.0, subdivisions: int = 5, centre: Any = (0.0, 0.0, 0.0)) -> np.ndarray:
    """A geodesic sphere with the volume of the round one."""
    mesh = trimesh.creation.icosphere(subdivisions=subdivisions)
    return mesh.triangles * radius * (4 / 3 * np.pi / mesh.volume) ** (1 / 3) + np.asarray(centre)


def sphere(radius: float = 10.0, subdivisions: int = 5) -> Mesh:
    return solid(sphere_triangles(radius, subdivisions))


def torus(major: float = 7.0, minor: float = 3.0) -> Mesh:
    return solid(trimesh.creation.torus(major, minor, major_sections=96, minor_sections=48).triangles)


def box_triangles(extents: Any, centre: Any = (0.0, 0.0, 0.0), turn: np.ndarray | None = None) -> np.ndarray:
    """An axis-aligned box, or one turned by a rotation matrix about its centre."""
    triangles = trimesh.creation.box(extents).triangles
    return (triangles if turn is None else triangles @ turn.T) + np.asarray(centre)


def box(extents: Any, turn: np.ndarray | None = None) -> Mesh:
    return solid(box_triangles(extents, turn=turn))


def hollow_sphere(radius: float = 10.0, cavity: float = 5.0) -> Mesh:
    """A ball around a closed cavity: the inner wall is wound inward."""
    return solid(np.concatenate([sphere_triangles(radius), sphere_triangles(cavity)[:, ::-1]]))


def flask() -> Mesh:
    """A bowl that closes to a narrow mouth: light inside meets the wall many times."""
    polar = np.linspace(-0.5, 0.44, 40) * np.pi
    arc = np.column_stack([np.cos(polar), np.sin(polar)])
    profile = np.vstack([10 * arc, 7 * arc[::-1]])
    profile[[0, -1], 0] = 0
    return solid(trimesh.creation.revolve(profile, sections=48).triangles)


def pulley(gap: float = 0.8) -> Mesh:
    """A wheel with a groove that is narrow and deep: one body whose parts nearly touch."""
    rim = np.array([(3, -1.5), (9, -1.5), (9, -gap / 2), (5, -gap / 2), (5, gap / 2), (9, gap / 2), (9, 1.5), (3, 1.5)])
    wheel = trimesh.creation.revolve(np.append(rim, rim[:1], axis=0), sections=96)
    return solid(wheel.triangles @ ROTATION.T)


def stack(width: float = 20.0, thickness: float = 1.0, plates: int = 4) -> Mesh:
    """Plates, tilted against the grid, as far apart as they are thick."""
    heights = 2 * thickness * np.arange(plates)
    parts = [box_triangles((width, width, thickness), ROTATION @ (0, 0, z), ROTATION) for z in heights]
    return solid(np.concatenate(parts))


def two_spheres(gap: float, radius: float = 5.0) -> Mesh:
    """Two balls that nearly touch."""
    axis = np.array([1.0, 0.3, 0.2]) / np.linalg.norm([1.0, 0.3, 0.2])
    parts = [sphere_triangles(radius, 4, side * (radius + gap / 2) * axis) for side in (-1, 1)]
    return solid(np.concatenate(parts))


ROTATION = trimesh.transformations.euler_matrix(0.4, 0.7, 1.1)[:3, :3]


def merge_all(centres: np.ndarray, h: float, depth: np.ndarray) -> np.ndarray:
    """A criterion that no cell is too wide for: only the layers below the surface stay fine."""
    return np.zeros(len(centres), bool)


def build_tree(device: Device, mesh: Mesh, resolution: int, refine: Refine | None = merge_all) -> octree.Octree:
    """The octree of a solid at a resolution; `refine` None leaves all cells on the finest level."""
    grid = cutcell.make_grid(mesh.bounds, resolution)
    return octree.build(device, grid, cutcell.sample_surface(device, grid, mesh), refine)


def is_split(ijk: np.ndarray) -> bool:
    """Whether several cells of a level, at (n, 3), lie in one place."""
    return len(np.unique(ijk, axis=0)) < len(ijk)


def links(level: Level) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Faces between cells of a level: cell, face, the cell beyond, its place in `Level.junction_cell` (or -1)."""
    nbr, start = level.nbr.get(), level.junction_start.get()
    cell, face = np.nonzero((nbr < level.n) & (nbr != np.arange(level.n)[:, None]))
    slot = np.repeat(level.junction_face.get(), np.diff(start))
    place = np.concatenate([np.full(len(cell), -1), np.arange(len(slot))])
    beyond = np.concatenate([nbr[cell, face], level.junction_cell.get()])
    return np.append(cell, slot // 6), np.append(face, slot % 6), beyond, place


def conductances(op: diffusion.Operator, k: int) -> np.ndarray:
    """T (m, 1 or 4) of each of the `links` of level `k`."""
    level = op.octree.levels[k]
    cell, face, _, place = links(level)
    T = op.T[k].get().reshape(level.n, 6, -1)[cell, face]
    share = op.share[k].get().reshape(-1, T.shape[1])
    return T * np.concatenate([share, np.ones((1, T.shape[1]))])[place]


def children(level: Level) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Coarse cell, octant and finer cell of everything that `Level.child` and its chains list."""
    child, chain = level.child.get(), level.chain.get()
    row, octant = np.nonzero(child != -1)
    cell, fine = level.covered.get()[row], child[row, octant]
    while (fine < 0).any():
        several = np.flatnonzero(fine < 0)
        first, rest = chain[-2 - fine[several]].T
        fine[several] = first
        cell, octant = np.append(cell, cell[several]), np.append(octant, octant[several])
        fine = np.append(fine, rest)
    return cell, octant, fine


def build_operator(device: Device, tree: octree.Octree, medium: Any) -> diffusion.Operator:
    """The discrete equation for a medium."""
    return diffusion.make_operator(
        device, tree, diffusion.sample_medium(device, tree, medium, fresnel_A(medium.eta))
    )


def fields(device: Device, tree: octree.Octree) -> tuple[Field, Load, Load]:
    """A solution, a right-hand side and a residual, of zeros."""
    return Field(device, tree), Load(device, tree), Load(device, tree)


def set_field(tree: octree.Octree, phi: Field, function: Any) -> None:
    """Set a field (its leaves; ghosts and covered cells follow) to a function of points (n, 3) -> (n,)."""
    for points, level, x in zip(diffusion.cell_points(tree), tree.levels, phi, strict=True):
        values = np.zeros(x.shape)
        values[: level.n] = function(points)[:, None]
        x.set(values)


@dataclass
class Solved:
    """A solution and where its values belong."""

    tree: octree.Octree
    convergence: Convergence
    phi: Field
    phi_B: np.ndarray

    def leaves(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Centroids (n, 3), volumes (n,), values (n, 3) of all leaves, and whether they are cut."""
        points, volumes, values, cut = [], [], [], []
        all_points, all_volumes = diffusion.cell_points(self.tree), self.tree.volumes()
        for k, level in enumerate(self.tree.levels):
            points.append(all_points[k][level.leaf])
            volumes.append(all_volumes[k][level.leaf])
            values.append(self.phi[k].get()[: level.n, :3][level.leaf])
            is_cut = np.zeros(level.n, bool)
            if level.depth == 0:
                is_cut[self.tree.cut.cell.get()] = True
            cut.append(is_cut[level.leaf])
        return tuple(np.concatenate(v) for v in (points, volumes, values, cut))


def solve(device: Device, mesh: Mesh, medium: Any, lights: list[Any], resolution: int, tolerance: float,
          **options: Any) -> Solved:  # fmt: skip
    """Solve for the fluence in a solid, without the exchange between parts of its surface."""
    tree = build_tree(device, mesh, resolution, **options)
    op = build_operator(device, tree, medium)
    src = source.make_source(device, tree, op.medium, lights, 1.0)
    phi = Field(device, tree)
    multigrid = Multigrid(device, op)
    convergence = multigrid.solve(src.b, phi, tolerance)
    phi_B = multigrid.residual.boundary_value(phi, src.moment).get()[:, :3].astype(float)
    return Solved(tree, convergence, phi, phi_B)


def relative_rms(value: np.ndarray, exact: Any, weight: Any = 1.0) -> float:
    """Weighted 2-norm of the error over that of the exact values (or one for all)."""
    exact = np.broadcast_to(exact, value.shape)
    return float(np.sqrt(np.sum(weight * (value - exact) ** 2) / np.sum(weight * exact**2)))
