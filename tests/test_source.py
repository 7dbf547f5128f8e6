"""Reduced incident light: Beer-Lambert along rays, and not a watt lost on the way into the cells."""

from __future__ import annotations

import shutil

import cases
import numpy as np
import pytest
from shapes import (
    ROTATION,
    box,
    box_triangles,
    build_tree,
    hollow_sphere,
    merge_all,
    relative_rms,
    solid,
    solve,
    sphere,
)

from clsss import analytic, diffusion, kernelsource
from clsss.beams import Beams
from clsss.fresnel import fresnel_A, fresnel_transmittance
from clsss.layer import fitted_layer
from clsss.lights import DirectionalLight, Emission, EnvironmentLight, PointLight
from clsss.materials import Material
from clsss.media import Mix
from clsss.rays import RayCaster
from clsss.source import light_unit, make_source
from clsss.surface import boundary_points

TOP = 2.0  # of a slab 4 mm thick


def coefficients(device, tree, medium):
    return diffusion.sample_medium(device, tree, medium, fresnel_A(medium.eta))


def lit(device, mesh, resolution, medium, light, refine=merge_all):
    """Octree, and the reduced irradiance F (n, 3) at the centroids (n, 3) of its leaves."""
    tree = build_tree(device, mesh, resolution, refine)
    beams = Beams(device, tree, coefficients(device, tree, medium))
    beams.add(light, 1.0)
    points, values = [], []
    for level, p, F in zip(tree.levels, diffusion.cell_points(tree), beams._F, strict=True):
        points.append(p[level.leaf])
        values.append(F.get()[: level.n, :3][level.leaf])
    return tree, np.concatenate(points), np.concatenate(values)


def source_of(device, mesh, resolution, medium, lights):
    tree = build_tree(device, mesh, resolution)
    return tree, make_source(device, tree, coefficients(device, tree, medium), lights, 1.0)


def slab():
    return box((16.0, 16.0, 2 * TOP))


def in_the_middle(points, width=5.0):
    return (np.abs(points[:, :2]) < width).all(axis=1)


MEANS = """
#include "real.h"
#include "face.h"
#include "conductance.h"
#include "layer.h"
#include "mean.h"
__kernel void means(const int n, __global const REAL4 *u, __global const REAL4 *v, __global REAL4 *mean) {
    const int i = get_global_id(0);
    if (i < n) mean[i] = log_mean(u[i], v[i]);
}
"""


def test_logarithmic_means(tmp_path, monkeypatch, device, eps):
    """(u - v) / log(u / v): of neighbours, on either side of each power of two, from full light to none."""
    monkeypatch.setattr(kernelsource, "KERNEL_DIR", shutil.copytree(kernelsource.KERNEL_DIR, tmp_path / "kernels"))
    (tmp_path / "kernels" / "means.cl").write_text(MEANS)

    def mean(u, v):
        out = device.empty(u.shape)
        device.run(device.kernel("means", "means"), len(u), len(u), device.array(u), device.array(v), out)
        return out.get()

    halves = 2 ** (np.arange(60) / 2)
    ratio = np.concatenate([1 + np.geomspace(1e-12, 1, 200), halves * (1 - 1e-6), halves, np.geomspace(1, 1e30, 500)])
    full = np.repeat([1e-5, 1.0, 3e3], len(ratio))
    u, v = (np.stack(4 * [x], axis=1).astype(device.real) for x in (full, full / np.tile(ratio, 3)))
    rise = (u.astype(float) - v) / v
    exact = v * np.divide(rise, np.log1p(rise), out=np.ones(rise.shape), where=rise != 0)
    np.testing.assert_allclose(mean(u, v), exact, rtol=max(4 * eps, 1e-10))
    np.testing.assert_array_equal(mean(v, u), mean(u, v))
    assert not mean(np.array([[1.0, 0, 1, 0]]), np.array([[0, 0, -1, -1e-9]])).any()
    faint = mean(np.full((1, 4), 2e3), np.array([[1e-35, 1e-36, 1e-38, 1e-39]]))
    assert ((faint > 2e3 / 100) & (faint < 2e3 / 80)).all()


@pytest.mark.parametrize("sigma_h", [0.05, 0.5, 2.0, 10.0])
def test_beer_lambert_in_a_slab(device, eps, sigma_h):
    """F = exp(-sigma_tr depth), the three channels at three extinctions, in cells of every level."""
    resolution = 48
    sigma = sigma_h * resolution / 16 * np.array([1.0, 0.5, 0.1])
    medium = Material(0.1 * sigma, 0.9 * sigma)
    _, points, F = lit(device, slab(), resolution, medium, DirectionalLight((0, 0, -1)))
    middle = in_the_middle(points)
    depth = TOP - points[middle, 2:]
    np.testing.assert_allclose(F[middle], np.exp(-sigma * depth), rtol=2e3 * eps * (1 + sigma_h), atol=1e-30)


def test_beer_lambert_at_an_angle_with_fresnel_entry(device, eps):
    """The ray goes straight on; its share T(mu) enters."""
    eta, direction = 1.5, np.array([0.6, 0.0, -0.8])
    medium = Material(0.1, 0.9, eta=eta)
    _, points, F = lit(device, slab(), 48, medium, DirectionalLight(direction, irradiance=(1.0, 2.0, 3.0)))
    middle = in_the_middle(points, 4.0)
    expected = fresnel_transmittance(0.8, eta) * np.exp(-(TOP - points[middle, 2:]) / 0.8) * [1, 2, 3]
    np.testing.assert_allclose(F[middle], expected, rtol=1e4 * eps)


LAMP = PointLight((0.0, 0.0, 8.0), 100.0)


@pytest.mark.parametrize(
    ("light", "harmless"), [(DirectionalLight((0, 0, -1)), -13), (LAMP, 4)], ids=["beam", "lamp"]
)
def test_blockers_cast_shadows(device, light, harmless):
    """Half of the slab lies in the shadow of a board; another is beside the beam, or behind the lamp.

    What fine cells know of the coarser ones next to them (ghosts) is in the shadow, too.
    """
    tree = build_tree(device, slab(), 48)
    boards = [box_triangles((8, 18, 0.1), (4, 0, 5)), box_triangles((8, 18, 0.1), (harmless, 0, 12))]
    found = []
    for blockers in (None, RayCaster(np.concatenate(boards))):
        beams = Beams(device, tree, coefficients(device, tree, Material(0.1, 0.9)), blockers)
        beams.add(light, 1.0)
        found.append([F.get() for F in [*beams._F, beams._F_B]])
    places = [*diffusion.cell_points(tree), boundary_points(tree)[0]]
    for points, free, shaded in zip(places, *found, strict=True):
        x, n = points[:, 0], len(points)
        np.testing.assert_array_equal(shaded[:n], np.where(x[:, None] > 0, 0, free[:n]))
    for level, above, F in zip(tree.levels[1:], found[1], found[1][1:], strict=False):
        ghosts = slice(level.n, level.n + level.n_ghost)
        np.testing.assert_array_equal(F[ghosts], above[level.parent.get()[ghosts]])


def test_tilted_planes_are_exact_too(double):
    """The boundary's plane in its cut cells is the slab's own."""
    direction = -ROTATION[:, 2]
    _, points, F = lit(double, box((16, 16, 4), ROTATION), 48, Material(0.1, 0.9), DirectionalLight(direction))
    local = points @ ROTATION
    middle = in_the_middle(local)
    np.testing.assert_allclose(F[middle, 0], np.exp(-(TOP - local[middle, 2])), rtol=1e-6)


def test_lamp_outside(device, eps):
    """I / r^2, attenuated along the part of the ray inside."""
    lamp = np.array([1.0, -2.0, 7.0])
    _, points, F = lit(device, slab(), 48, Material(0.1, 0.9), PointLight(lamp, intensity=50.0))
    middle = in_the_middle(points)
    away = points[middle] - lamp
    r = np.linalg.norm(away, axis=1)
    inside = r * (TOP - points[middle, 2]) / (lamp[2] - points[middle, 2])
    np.testing.assert_allclose(F[middle, 0], 50 / r**2 * np.exp(-inside), rtol=1e4 * eps)


def test_lamp_inside(device, eps):
    """No surface is crossed: no Fresnel, all of the ray counts."""
    lamp = np.array([0.3, 0.2, -0.4])
    _, points, F = lit(device, slab(), 48, Material(0.1, 0.9, eta=1.3), PointLight(lamp))
    r = np.linalg.norm(points - lamp, axis=1)
    chosen = in_the_middle(points) & (r > 1.0) & (np.abs(points[:, 2]) < TOP - 0.5)
    np.testing.assert_allclose(F[chosen, 0], np.exp(-r[chosen]) / r[chosen] ** 2, rtol=1e4 * eps)


def test_cavities_attenuate_nothing(double):
    """Rays through the middle of a hollow sphere lose two walls only."""
    _, points, F = lit(double, hollow_sphere(10, 5), 48, Material(0.1, 0.4), DirectionalLight((0, 0, -1)))
    rho = np.linalg.norm(points[:, :2], axis=1)
    below = (rho < 3.0) & (points[:, 2] < 0)
    outer, inner = np.sqrt(100 - rho[below] ** 2), np.sqrt(25 - rho[below] ** 2)
    path = outer - points[below, 2] - 2 * inner
    np.testing.assert_allclose(F[below, 0], np.exp(-0.5 * path), rtol=0.02)


def test_gaps_attenuate_nothing(double):
    """The lower of two slabs gets what the upper one lets through."""
    slabs = solid(np.concatenate([box_triangles((16, 16, 2), (0, 0, 3)), box_triangles((16, 16, 2), (0, 0, -3))]))
    _, points, F = lit(double, slabs, 40, Material(0.1, 0.4), DirectionalLight((0, 0, -1)))
    lower = in_the_middle(points) & (points[:, 2] < 0)
    np.testing.assert_allclose(F[lower, 0], np.exp(-0.5 * (2 - 2 - points[lower, 2])), rtol=1e-6)


def chord_errors(device, resolution, sigma=0.5):
    """Error of F against exp(-sigma l), l the length of the ray inside the sphere, along a random direction."""
    direction = np.random.default_rng(7).normal(size=3)
    direction /= np.linalg.norm(direction)
    _, points, F = lit(device, sphere(10, 6), resolution, Material(0.1 * sigma, 0.9 * sigma),
                       DirectionalLight(direction))  # fmt: skip
    points = points * np.minimum(1, 10 / np.linalg.norm(points, axis=1))[:, None]
    along = points @ direction
    length = along + np.sqrt(np.maximum(0, along**2 + 100 - (points**2).sum(axis=1)))
    return np.sqrt(np.mean((F[:, 0] - np.exp(-sigma * length)) ** 2))


def test_rays_in_a_sphere_have_the_accuracy_of_its_surface(double):
    """Order between one and two: the error of a chord is that of the surface over the cosine of incidence."""
    resolutions = [12, 24, 48]
    found = [chord_errors(double, n) for n in resolutions]
    assert cases.order([1 / n for n in resolutions], found) >= 1.5
    assert found[-1] <= 5e-3


@pytest.mark.parametrize("sigma_h", [0.05, 0.3, 1.0, 5.0, 20.0])
@pytest.mark.parametrize("adaptive", [True, False], ids=["merged", "uniform"])
def test_deposit_is_albedo_times_what_stays(device, eps, sigma_h, adaptive):
    """Whatever the cell size: albedo (incident - transmitted), as the flux of the beam through the surface tells."""
    tree = build_tree(device, sphere(), 24, merge_all if adaptive else None)
    sigma = sigma_h / tree.grid.h
    medium = Material(np.array([0.1, 0.5, 0.01]) * sigma, np.array([0.9, 0.5, 0.99]) * sigma)
    beams = Beams(device, tree, coefficients(device, tree, medium))
    beams.add(DirectionalLight((0.3, -0.5, -0.8)), 1.0)
    normal = tree.cut.normal.get()[:, :3].astype(float) * tree.grid.h**2
    leaving = (normal @ np.array([0.3, -0.5, -0.8]) / np.sqrt(0.98))[:, None] * beams._F_B.get()[:, :3]
    stays = -leaving.sum(axis=0)
    found = make_source(device, tree, coefficients(device, tree, medium), [DirectionalLight((0.3, -0.5, -0.8))], 1.0)
    np.testing.assert_allclose(found.deposited, [0.9, 0.5, 0.99] * stays, rtol=1e-5)


@pytest.mark.parametrize("sigma_h", [0.05, 0.3, 1.0, 5.0, 20.0])
def test_deposit_in_a_sphere(double, sigma_h):
    """Incident pi R^2; transmitted 2 pi int c exp(-2 sigma c) dc over half chords c: within one per cent."""
    radius, resolution = 10.0, 32
    sigma = sigma_h * resolution / (2 * radius)
    _, found = source_of(double, sphere(radius, 6), resolution, Material(0.1 * sigma, 0.9 * sigma),
                         [DirectionalLight((0.3, -0.5, -0.8))])  # fmt: skip
    x = 2 * sigma * radius
    transmitted = 2 * np.pi * (1 - np.exp(-x) * (1 + x)) / (2 * sigma) ** 2
    np.testing.assert_allclose(found.incident, np.pi * radius**2, rtol=5e-3)
    np.testing.assert_allclose(found.deposited, 0.9 * (np.pi * radius**2 - transmitted), rtol=1e-2)


def test_right_hand_side_holds_the_deposit(double):
    """b is what is deposited, over D, less the moment that the boundary passes on at once."""
    medium = Material(0.001, 0.999, eta=1.3)
    tree, found = source_of(double, sphere(), 24, medium, [DirectionalLight((0, 0, -1))])
    total = sum(b.get()[: level.n, 0].sum() for level, b in zip(tree.levels, found.b, strict=True))
    points, normals = boundary_points(tree)
    centroids = diffusion.cell_points(tree)[-1][tree.cut.cell.get()]
    d = np.maximum(((points - centroids) * normals).sum(axis=1), 0.05 * tree.grid.h)
    area = tree.cut.boundary.get()[:, 3] * tree.grid.h**2
    passed = (area * found.moment.get()[:, 0] / (2 * fresnel_A(1.3) + d / medium.D[0])).sum()
    assert not found.lost.any()
    assert total == pytest.approx((found.deposited[0] - passed) / medium.D[0], rel=1e-10)


def test_right_hand_side_in_wide_cells_lacks_what_is_absorbed_on_the_way(double):
    """As above, less the light that is absorbed before it gets to a centroid or the boundary."""
    medium = Material(1.0, 9.0, eta=1.3)
    tree, found = source_of(double, sphere(), 16, medium, [DirectionalLight((0, 0, -1)), Emission(1.0)])
    layer = fitted_layer(double, tree, coefficients(double, tree, medium))
    total = sum(b.get()[: level.n, 0].sum() for level, b in zip(tree.levels, found.b, strict=True))
    passed = (layer.conductance.get() * found.moment.get()[:, :3]).sum(axis=0)
    assert (found.lost > 0.05 * found.deposited).all()
    assert total == pytest.approx((found.deposited - found.lost - passed)[0] / medium.D[0], rel=1e-10)


LIGHTS = {
    "directional": DirectionalLight((0.2, -1, 0.1), (1.0, 0.5, 0.0)),
    "lamp outside": PointLight((5.0, 14.0, -3.0), 40.0),
    "lamp inside": PointLight((2.0, 1.0, -3.0), 2.0),
    "emission": Emission((0.01, 0.0, 0.02)),
}


def test_lights_add_up(double):
    medium = Material(0.1, 0.9, eta=1.3)
    _, together = source_of(double, sphere(), 20, medium, list(LIGHTS.values()))
    parts = [source_of(double, sphere(), 20, medium, [light])[1] for light in LIGHTS.values()]
    for name in ("incident", "deposited"):
        np.testing.assert_allclose(getattr(together, name), sum(getattr(p, name) for p in parts), rtol=1e-12)
    for k, b in enumerate(together.b):
        np.testing.assert_allclose(b.get(), sum(p.b[k].get() for p in parts), atol=1e-12)


def test_unit_scales_the_right_hand_side_only(double):
    medium = Material(0.1, 0.9)
    tree = build_tree(double, sphere(), 16)
    medium = coefficients(double, tree, medium)
    one, other = (make_source(double, tree, medium, list(LIGHTS.values()), unit) for unit in (1.0, 8.0))
    np.testing.assert_allclose(one.deposited, other.deposited, rtol=1e-12)
    np.testing.assert_allclose(one.b[-1].get(), 8 * other.b[-1].get(), rtol=1e-12)


def test_emission_deposits_its_density(double):
    _, found = source_of(double, sphere(10, 6), 32, Material(0.1, 0.9), [Emission((1.0, 0.0, 2.0))])
    np.testing.assert_allclose(found.deposited, 4 / 3 * np.pi * 1000 * np.array([1, 0, 2]), rtol=1e-3)
    assert not found.incident.any()


def test_emission_as_a_function_of_place(double):
    """q0 = 1 + z / R: the odd part cancels."""
    glow = Emission(lambda points: 1 + points[:, 2] / 10)
    _, found = source_of(double, sphere(10, 6), 32, Material(0.1, 0.9), [glow])
    np.testing.assert_allclose(found.deposited, 4 / 3 * np.pi * 1000, rtol=1e-3)


def test_lamp_in_the_middle_deposits_what_its_ball_keeps(double):
    """4 pi I, less exp(-sigma R) of it, times the albedo."""
    medium = Material(0.03, 0.27)
    _, found = source_of(double, sphere(10, 6), 40, medium, [PointLight((0.1, 0.0, 0.0), 1.0)])
    np.testing.assert_allclose(found.deposited, 0.9 * 4 * np.pi * (1 - np.exp(-3.0)), rtol=1e-2)


def test_constant_sky_lights_a_convex_body_by_pi_per_area(double):
    _, found = source_of(double, sphere(10, 4), 16, Material(0.1, 0.9), [EnvironmentLight((1.0, 2.0, 3.0))])
    np.testing.assert_allclose(found.incident, 4 * np.pi * 100 * np.pi * np.array([1, 2, 3]), rtol=0.02)


class Halves:
    """Extinction 0.2 above, 1.0 below the middle of the slab."""

    g, eta, homogeneous = 0.0, 1.0, False

    def coefficients(self, points):
        total = np.where(points[:, 2:] > 0, 0.2, 1.0) * np.ones(3)
        return 0.1 * total, 0.9 * total


def test_optical_depth_adds_up_over_layers(double):
    _, points, F = lit(double, slab(), 48, Halves(), DirectionalLight((0, 0, -1)))
    middle = in_the_middle(points) & (np.abs(points[:, 2]) > 0.5)
    z = points[middle, 2]
    tau = np.where(z > 0, 0.2 * (TOP - z), 0.2 * TOP - z)
    np.testing.assert_allclose(F[middle, 0], np.exp(-tau), rtol=0.15)


def test_units_of_lights():
    assert light_unit([DirectionalLight((0, 0, 1), (0.0, 3.0, 1.0))], 10.0) == 3.0
    assert light_unit([PointLight((0, 0, 1), 50.0)], 10.0) == 0.5
    assert light_unit([Emission(2.0)], 10.0) == 20.0
    assert light_unit([DirectionalLight((0, 0, 1), 0.0)], 10.0) == 1.0


LIT_PLATES = [
    (2.0, 0.99, 0.01, 0.015),
    (5.0, 0.999, 0.005, 0.01),
    (2.0, 0.9, 0.02, 0.025),
    (5.0, 0.9, 0.02, 0.03),
    (10.0, 0.9, 0.04, 0.05),
    (10.0, 0.99, 0.02, 0.03),
]


@pytest.mark.parametrize(("sigma_h", "albedo", "mean", "rms"), LIT_PLATES)
def test_lit_side_of_a_tilted_plate(double, sigma_h, albedo, mean, rms):
    """phi_B at the boundary centroids against the slab's exact solution."""
    size, resolution, eta = np.array([40.0, 40.0, 12.0]), 40, 1.3
    mesh = box(tuple(size), ROTATION)
    sigma = sigma_h * resolution / mesh.size
    medium, inward = Material(sigma * (1 - albedo), sigma * albedo, eta=eta), -ROTATION[:, 2]
    solved = solve(double, mesh, medium, [DirectionalLight(inward)], resolution, 1e-7)
    points, normals = boundary_points(solved.tree)
    middle = (np.abs((points @ ROTATION)[:, :2]) < 6).all(axis=1) & (normals @ inward < -0.99)
    exact = analytic.slab(size[2], sigma * (1 - albedo), sigma * albedo, fresnel_A=fresnel_A(eta)).phi(0.0)
    error = solved.phi_B[middle, 0] / (fresnel_transmittance(1.0, eta) * exact) - 1
    area = solved.tree.cut.boundary.get()[middle, 3]
    assert abs(np.average(error, weights=area)) <= mean
    assert np.sqrt(np.average(error**2, weights=area)) <= rms


@pytest.mark.parametrize("albedos", [(0.99, 0.8), (0.8, 0.99)])
def test_lit_plate_of_two_albedos(double, albedos):
    """Nothing is scattered by passing from one albedo to another: against layers of one sigma_tr."""
    size, resolution, eta, top = np.array([24.0, 24.0, 8.0]), 48, 1.3, 1.3
    mesh, inward, sigma = box(tuple(size), ROTATION), -ROTATION[:, 2], 1.0
    layers = [Material(sigma * (1 - a), sigma * a, eta=eta) for a in albedos]
    medium = Mix(*layers, lambda points: size[2] / 2 - points @ ROTATION[:, 2] > top)
    solved = solve(double, mesh, medium, [DirectionalLight(inward)], resolution, 1e-7)
    points, normals = boundary_points(solved.tree)
    exact = analytic.slab((top, size[2] - top), *zip(*[(sigma * (1 - a), sigma * a) for a in albedos], strict=True),
                          fresnel_A=fresnel_A(eta))  # fmt: skip
    lit_side = (np.abs((points @ ROTATION)[:, :2]) < 4).all(axis=1) & (normals @ inward < -0.99)
    error = solved.phi_B[lit_side, 0] / (fresnel_transmittance(1.0, eta) * exact.phi(0.0)) - 1
    assert abs(np.average(error, weights=solved.tree.cut.boundary.get()[lit_side, 3])) <= 0.02


@pytest.mark.parametrize(("sigma_h", "albedo", "rms"), [(5.0, 0.99, 0.03), (5.0, 0.9, 0.05), (10.0, 0.9, 0.06)])
def test_side_of_a_glowing_tilted_plate(double, sigma_h, albedo, rms):
    """The same for a uniform source: sigma_a phi = 1 - C cosh(k z)."""
    size, resolution, eta = np.array([40.0, 40.0, 12.0]), 40, 1.3
    mesh = box(tuple(size), ROTATION)
    sigma = sigma_h * resolution / mesh.size
    medium = Material(sigma * (1 - albedo), sigma * albedo, eta=eta)
    solved = solve(double, mesh, medium, [Emission(1.0)], resolution, 1e-7)
    points, normals = boundary_points(solved.tree)
    middle = (np.abs((points @ ROTATION)[:, :2]) < 6).all(axis=1) & (normals @ ROTATION[:, 2] > 0.99)
    k, b = np.sqrt(medium.sigma_a / medium.D)[0], 2 * fresnel_A(eta) * medium.D[0]
    exact = (1 - 1 / (1 + b * k * np.tanh(k * size[2] / 2))) / medium.sigma_a[0]
    area = solved.tree.cut.boundary.get()[middle, 3]
    assert relative_rms(solved.phi_B[middle, 0], exact, area) <= rms
