"""Light scattered once, light that crosses cavities, and layered media, against path tracing and exact solutions."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from shapes import box, hollow_sphere, relative_rms, sphere, sphere_triangles

from clsss import montecarlo
from clsss.analytic import slab
from clsss.lights import DirectionalLight
from clsss.materials import Material
from clsss.simulate import simulate

DOWN = DirectionalLight((0, 0, -1))


def middles(triangles, every):
    """Centres and outward normals of every n-th triangle."""
    chosen = triangles[::every]
    normal = np.cross(chosen[:, 1] - chosen[:, 0], chosen[:, 2] - chosen[:, 0])
    return chosen.mean(axis=1), normal / np.linalg.norm(normal, axis=1, keepdims=True)


@pytest.mark.filterwarnings("ignore:diffusion is only approximate")
@pytest.mark.parametrize(("albedo", "single_bar", "multiple_bar"), [(0.9, 0.03, 0.04), (0.5, 0.03, 0.1)])
def test_single_and_multiple_scattering_as_by_path_tracing(albedo, single_bar, multiple_bar):
    """A sphere of 10 mean free paths in a beam."""
    mesh, medium = sphere(5.0, 4), Material(1 - albedo, albedo)
    points, normals = middles(sphere_triangles(5.0, 4), 60)
    truth = montecarlo.estimate(mesh, medium, [DOWN], n_paths=2000, points=points, normals=normals, seed=5)
    result = simulate(mesh, medium, [DOWN], resolution=40, scattering="split")
    single, total = result.radiosity_single(points)[:, 0], result.radiosity(points)[:, 0]
    assert relative_rms(single, truth.single[:, 0]) <= single_bar
    assert relative_rms(total - single, truth.radiosity[:, 0] - truth.single[:, 0]) <= multiple_bar


def test_radiance_over_all_directions_is_the_radiosity():
    """Seen from far away on all sides, the cosine-weighted mean radiance of a point is its radiosity / pi."""
    mesh = sphere(5.0, 3)
    result = simulate(mesh, Material(0.01, 1.0, eta=1.3), [DOWN], resolution=24)
    k = np.arange(600) + 0.5
    z, turn = 1 - 2 * k / 600, np.pi * (1 + 5**0.5) * k
    towards = np.stack([np.sqrt(1 - z * z) * np.cos(turn), np.sqrt(1 - z * z) * np.sin(turn), z], axis=1)
    vertices = np.arange(0, len(mesh.vertices), 50)
    total = np.zeros((len(vertices), 3))
    for direction in towards:
        cosine = np.maximum(0, mesh.normals[vertices] @ direction)
        total += result.radiance(1e6 * direction)[vertices] * cosine[:, None] * 4 * np.pi / len(towards)
    np.testing.assert_allclose(total, result.vertex_radiosity[vertices], rtol=0.02)


def test_light_that_crosses_a_cavity_as_by_path_tracing():
    """Beside a void the wall behind it is lit from within; a solver that lets nothing return is off by more."""
    mesh, medium = hollow_sphere(10.0, 6.0), Material(0.005, 1.0)
    points, normals = middles(sphere_triangles(10.0), 700)
    truth = montecarlo.estimate(mesh, medium, [DOWN], n_paths=1500, points=points, normals=normals, seed=2)
    found = simulate(mesh, medium, [DOWN], resolution=64).radiosity(points)[:, 0]
    assert relative_rms(found, truth.radiosity[:, 0]) <= 0.04


@dataclass(frozen=True)
class TwoLayers:
    """A slab around z = 0: the upper half scatters twice as much and absorbs a quarter."""

    homogeneous: bool = False
    g: float = 0.0
    eta: float = 1.0

    def coefficients(self, points):
        upper = (points[:, 2] > 0)[:, None] * np.ones(3)
        return np.where(upper, 0.02, 0.08), np.where(upper, 3.0, 1.5)


def test_slab_of_two_layers():
    result = simulate(box((28, 28, 6)), TwoLayers(), [DOWN], resolution=140)
    exact = slab([3.0, 3.0], [0.02, 0.08], [3.0, 1.5])
    depths = np.concatenate([np.linspace(0.3, 2.7, 20), np.linspace(3.3, 5.7, 20)])
    points = np.stack([0.1 * depths, -0.2 * depths, 3 - depths], axis=1)
    assert relative_rms(result.fluence(points)[:, 0], exact.phi(depths)) <= 0.01
    for z, expected in ((3.0, exact.reflectance), (-3.0, exact.transmittance)):
        assert result.radiosity([[0.3, 0.2, z]])[0, 0] == pytest.approx(expected, rel=0.01)
