"""What the octree saves, and what that costs in accuracy, against the uniform grid."""

from __future__ import annotations

import numpy as np
import pytest
from shapes import relative_rms, solve, sphere

from clsss.analytic_sphere import sphere as exact_sphere
from clsss.lights import DirectionalLight, Emission
from clsss.materials import Material, fresnel_A, material
from clsss.mesh import load_mesh
from clsss.refinement import varies
from clsss.simulate import simulate

GLOWING = Material(sigma_a=0.01, sigma_s=0.99, eta=1.1263)  # A = 1.5, 20 mean free paths across


ABSORBING = Material(sigma_a=0.1, sigma_s=9.9, eta=1.1263)  # a diffusion length of 1.8 cells at 64


@pytest.mark.parametrize(
    ("medium", "most"), [(GLOWING, (0.5, 1.2, 1.05)), (ABSORBING, (0.7, 1.05, 1.05))], ids=["glowing", "absorbing"]
)
def test_the_octree_of_a_glowing_sphere_is_as_accurate_as_the_uniform_grid(double, medium, most):
    """At 64 cells: leaves, the surface's error and the interior's over the uniform grid's."""
    phi = exact_sphere(10.0, medium.sigma_a[0], medium.sigma_s[0], fresnel_A(medium.eta), q0=1.0)
    found = {}
    for refine in (None, varies(medium)):
        solved = solve(double, sphere(subdivisions=6), medium, [Emission(1.0)], 64, 1e-8, refine=refine)
        points, volumes, values, _ = solved.leaves()
        inside = relative_rms(values[:, 0], phi(np.linalg.norm(points, axis=1)), volumes)
        at_surface, area = float(phi(np.array([10.0]))[0]), solved.tree.cut.boundary.get()[:, 3]
        surface = relative_rms(solved.phi_B[:, 0], at_surface, area)
        found[refine is None] = np.array([solved.tree.n_leaves, surface, inside])
    assert (found[False] / found[True] <= most).all()


def vertex_areas(mesh):
    a, b, c = mesh.vertices[mesh.faces].swapaxes(0, 1)
    areas = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 6
    return np.bincount(mesh.faces.ravel(), np.repeat(areas, 3), len(mesh.vertices))


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::UserWarning")
@pytest.mark.parametrize("name", ["dragon_201k_clean.ply", "bunny_69k_holes.ply"])
def test_half_the_cells_of_a_scan_are_as_accurate(shared, name):
    """Radiosity at vertices at 256 cells, against 512: within a fifth of the uniform grid's error, half its cells."""
    mesh, sun = load_mesh(shared / "meshes" / name, size=20.0), DirectionalLight((0.4, -0.6, -0.7))
    exact = simulate(mesh, material("marble"), [sun], resolution=512).vertex_radiosity
    weight, errors, leaves = vertex_areas(mesh)[:, None], [], []
    for adaptive in (True, False):
        result = simulate(mesh, material("marble"), [sun], resolution=256, adaptive=adaptive)
        errors.append([relative_rms(result.vertex_radiosity[:, c], exact[:, c], weight[:, 0]) for c in range(3)])
        leaves.append(result.report["octree"]["leaves"])
    assert leaves[0] <= 0.5 * leaves[1]
    assert (np.array(errors[0]) <= 1.2 * np.array(errors[1])).all()
