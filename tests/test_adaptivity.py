"""What the octree saves, and what that costs in accuracy, against the uniform grid."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from shapes import relative_rms, solve, sphere

from clsss.analytic_sphere import sphere as exact_sphere
from clsss.cutcell import make_grid
from clsss.fresnel import fresnel_A
from clsss.inner import Inner
from clsss.lights import DirectionalLight, Emission, PointLight
from clsss.materials import Material, material
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


SEED = 1.5  # radius of what shines inside a ball of 10 [mm]


def seed(points):
    assert (np.linalg.norm(points, axis=1) < 10.1).all()  # nobody is asked what shines outside
    return np.where(np.linalg.norm(points, axis=1) < SEED, 1.0, 0.0)


@pytest.mark.parametrize("medium", [GLOWING, ABSORBING], ids=["glowing", "absorbing"])
def test_cells_are_fine_where_light_starts_inside(double, medium):
    """A small glowing ball in the middle, where cells are widest: deposit and fluence as on the uniform grid."""
    a, s, A = medium.sigma_a[0], medium.sigma_s[0], fresnel_A(medium.eta)
    phi = exact_sphere([SEED, 10.0], [a, a], [s, s], A, q0=[1.0, 0.0])
    mesh, lights, found = sphere(subdivisions=5), [Emission(seed)], {}
    inner = Inner(make_grid(mesh.bounds, 64), lights, lambda points: np.linalg.norm(points, axis=1) < 10)
    for name, refine in (("uniform", None), ("octree", inner.around(varies(medium)))):
        solved = solve(double, mesh, medium, lights, 64, 1e-8, refine=refine)
        points, volumes, values, _ = solved.leaves()
        r = np.linalg.norm(points, axis=1)
        near = (r > SEED) & (r < 5)
        error = relative_rms(values[near, 0] / phi(r[near]), 1.0, volumes[near])
        found[name] = solved.tree.n_leaves, error, (seed(points) * volumes).sum()
    assert found["octree"][0] < 0.75 * found["uniform"][0]
    assert found["octree"][1] < found["uniform"][1] + 0.01
    assert found["octree"][2] == pytest.approx(found["uniform"][2], rel=1e-12)


def test_a_lamp_inside_is_as_exact_as_on_the_uniform_grid():
    mesh, lamp = load_mesh(trimesh.creation.icosphere(4, 10.0)), PointLight((2.0, 1.0, -3.0))
    r = np.linspace(1.5, 5, 8)[:, None]
    places = lamp.position + np.concatenate([r * d for d in np.vstack([np.eye(3), -np.eye(3)])])
    uniform, octree = (simulate(mesh, GLOWING, [lamp], 64, adaptive).fluence(places) for adaptive in (False, True))
    np.testing.assert_allclose(octree, uniform, rtol=0.03)


@pytest.mark.parametrize("place", [(0.0, 0, 0), (0.1, 0.2, -0.15)])
def test_a_lamp_inside_shines_to_all_sides_alike(place):
    mesh, sides = load_mesh(trimesh.creation.icosphere(4, 10.0)), np.vstack([np.eye(3), -np.eye(3)])
    medium = Material(sigma_a=0.06, sigma_s=2.94)
    around = simulate(mesh, medium, [PointLight(place)], 64).fluence(np.array(place) + 2 * sides)[:, 0]
    np.testing.assert_allclose(around, around.mean(), rtol=0.09)


def test_relight_says_where_its_octree_is_too_coarse():
    result = simulate(load_mesh(trimesh.creation.icosphere(4, 10.0)), GLOWING, [DirectionalLight((0, 0, 1))], 64)
    with pytest.warns(UserWarning, match="simulate it again"):
        result.relight([PointLight((0, 0, 0))])
    with pytest.warns(UserWarning, match="simulate it again"):
        result.relight([Emission(seed)])
    result.relight([PointLight((0, 0, 12)), Emission(1.0)])
