"""Light between parts of the surface: what one sends, another receives."""

from __future__ import annotations

import importlib

import numpy as np
import pytest
import trimesh
from shapes import box_triangles, build_tree, hollow_sphere, relative_rms, solid, sphere, sphere_triangles, torus

from clsss.exchange import leaving_shape, trace_exchange
from clsss.fresnel import entering_gain, fresnel_transmittance
from clsss.lights import DirectionalLight, Emission
from clsss.materials import Material
from clsss.rays import RayCaster
from clsss.simulate import simulate
from clsss.surface import boundary_points


@pytest.mark.parametrize("eta", [1.0, 1.1, 1.3, 1.5])
def test_leaving_shape_has_the_exitance_of_a_lambertian_surface(eta):
    """2 int_0^1 shape(mu) mu dmu = 2 int_0^1 mu dmu = 1."""
    x, weight = np.polynomial.legendre.leggauss(200)
    mu = (x + 1) / 2
    assert (weight * mu * leaving_shape(mu, eta)).sum() == pytest.approx(1, rel=1e-4)


def test_leaving_shape_of_matched_media_is_linear():
    """eta = 1: L ~ phi_B + 3 J mu with phi_B = 2 J; 2 int (2 + 3 mu) mu dmu = 4."""
    mu = np.linspace(0, 1, 11)
    np.testing.assert_allclose(leaving_shape(mu, 1.0), (2 + 3 * mu) / 4, rtol=1e-6)


CONVEX = {
    "sphere": sphere,
    "box": lambda: solid(box_triangles((10, 7, 5))),
    "ellipsoid": lambda: solid(sphere().triangles * [1, 0.3, 0.6]),
}


@pytest.mark.parametrize("shape", CONVEX)
def test_convex_bodies_exchange_nothing(single, shape):
    mesh = CONVEX[shape]()
    assert trace_exchange(build_tree(single, mesh, 32), 1.3) is None


@pytest.fixture(scope="module")
def cavity(single):
    """The octree of a hollow sphere."""
    return build_tree(single, hollow_sphere(10, 6), 40)


def of_wall(tree, exchange):
    """Area of every patch, and which patches lie on the cavity's wall."""
    areas = tree.cut.boundary.get()[:, 3].astype(float) * tree.grid.h**2
    area = (exchange.share > 0) @ areas
    inner = np.linalg.norm(boundary_points(tree)[0], axis=1) < 8
    return area, (exchange.share @ inner) > 0.5


@pytest.mark.parametrize("eta", [1.0, 1.3])
def test_all_that_leaves_a_cavity_s_wall_arrives_there(cavity, eta):
    """Row sums: irradiance under uniform exitance 1. Column sums: power that arrives of what one patch sends."""
    tree = cavity
    exchange = trace_exchange(tree, eta)
    area, wall = of_wall(tree, exchange)
    F = exchange.arriving
    received = F @ np.ones(F.shape[1])
    assert np.average(received[wall], weights=area[wall]) == pytest.approx(1, rel=0.03)
    assert np.sqrt(np.average((received[wall] - 1) ** 2, weights=area[wall])) <= 0.1
    assert not received[~wall].any()
    sent = (F.T @ area) / area
    assert np.average(sent[wall], weights=area[wall]) == pytest.approx(1, rel=0.03)
    exitance = wall * np.random.default_rng(10).uniform(0, 1, len(area))
    assert area @ (F @ exitance) == pytest.approx(area @ exitance, rel=0.03)


def test_exchange_within_a_sphere_is_reciprocal_and_uniform(cavity):
    """Both ends of a chord meet the wall at one angle: A_i F_ij is symmetric, and each patch sees all others."""
    tree = cavity
    exchange = trace_exchange(tree, 1.0)
    area, wall = of_wall(tree, exchange)
    flow = exchange.arriving.multiply(area[:, None]).tocsr()
    assert abs(flow - flow.T).sum() <= 0.1 * flow.sum()
    points = exchange.share @ boundary_points(tree)[0]
    upper, lower = wall & (points[:, 2] > 0), wall & (points[:, 2] <= 0)
    there = flow[upper][:, lower].sum()
    back = flow[lower][:, upper].sum()
    assert there == pytest.approx(back, rel=0.02)


def test_what_enters_is_the_transmitted_part(cavity):
    """H_t <= H, and about 1 - R_ext for diffuse light."""
    tree = cavity
    eta = 1.3
    exchange = trace_exchange(tree, eta)
    area, _ = of_wall(tree, exchange)
    one = np.ones(len(area))
    arriving, entering = exchange.arriving @ one, exchange.entering @ one
    assert (entering <= arriving * (1 + 1e-9)).all()
    x, weight = np.polynomial.legendre.leggauss(100)
    mu = (x + 1) / 2
    transmitted = (weight * mu * leaving_shape(mu, eta) * fresnel_transmittance(mu, eta)).sum()
    assert area @ entering / (area @ arriving) == pytest.approx(transmitted, rel=0.03)
    assert exchange.gain == pytest.approx(entering_gain(eta))


def test_facing_plates_see_each_other_as_form_factors_say(single):
    """Two square plates at a distance of half their side: form factor 0.4153 (Lambertian)."""
    side, gap = 10.0, 5.0
    plates = np.concatenate([box_triangles((side, side, 2), (0, 0, z * (gap / 2 + 1))) for z in (1, -1)])
    tree = build_tree(single, solid(plates), 40)
    exchange = trace_exchange(tree, 1.0)
    points, normals = boundary_points(tree)
    areas = tree.cut.boundary.get()[:, 3].astype(float) * tree.grid.h**2
    area = (exchange.share > 0) @ areas
    top = (exchange.share @ ((normals[:, 2] < -0.9) & (points[:, 2] > 0))) > 0.5
    bottom = (exchange.share @ ((normals[:, 2] > 0.9) & (points[:, 2] < 0))) > 0.5
    x = side / gap
    a = np.sqrt(1 + x * x)
    factor = np.log(a * a / np.sqrt(1 + 2 * x * x)) + 2 * x * a * np.arctan(x / a) - 2 * x * np.arctan(x)
    factor *= 2 / (np.pi * x * x)
    flow = exchange.arriving.multiply(area[:, None]).tocsr()
    found = flow[bottom][:, top].sum() / area[top].sum()
    # more leaves along the normal than from a Lambertian surface: between 1 and 5/4 times the form factor
    assert factor <= found <= 1.25 * factor


@pytest.mark.parametrize("off", [-0.05, 0.0, 0.05])
def test_a_lined_cavity_is_black(cavity, off):
    """A black lining on the wall or a little to either side of it: nothing crosses, but for neighbours that touch."""
    tree = cavity
    lined = trace_exchange(tree, 1.3, RayCaster(sphere_triangles(6 - off * tree.grid.h)))
    crossing = 0.0 if lined is None else lined.arriving.sum()
    assert crossing <= 0.01 * trace_exchange(tree, 1.3).arriving.sum()


def test_a_card_between_plates_is_black_on_both_sides(single):
    """It leaves nothing of the exchange where it is, and all where it is not."""
    plates = np.concatenate([box_triangles((10, 10, 2), (0, 0, z)) for z in (2, -2)])
    tree = build_tree(single, solid(plates), 40)
    card = RayCaster(np.array([[[-20.0, -20, 0.1], [20, -20, 0.1], [0, 40, 0.1]]]))
    assert trace_exchange(tree, 1.0, card) is None
    aside = RayCaster(card.triangles + np.array([0, 0, 9.0]))
    plain, beside = trace_exchange(tree, 1.0), trace_exchange(tree, 1.0, aside)
    assert (plain.arriving != beside.arriving).nnz == 0


def test_light_from_a_bright_spot_is_even(single, monkeypatch):
    """Few rays of each patch find a spot: what they miss shows as blotches where little other light comes from."""
    tree = build_tree(single, torus(), 48)
    points, _ = boundary_points(tree)

    def irradiance():
        exchange = trace_exchange(tree, 1.3)
        spot = exchange.share @ (np.linalg.norm(points - [4.0, 0, 0], axis=1) < 2.0)
        return exchange.blend @ (exchange.arriving @ spot)

    found = irradiance()
    monkeypatch.setattr("clsss.exchange.RAYS", 2048)
    exact = irradiance()
    lit = exact > 0.1 * exact.max()
    assert relative_rms(found[lit], exact[lit]) < 0.25


def test_exchange_is_the_same_every_time(single):
    mesh = torus()
    tree = build_tree(single, mesh, 24)
    one, other = trace_exchange(tree, 1.3), trace_exchange(tree, 1.3)
    assert (one.arriving != other.arriving).nnz == 0
    assert (one.entering != other.entering).nnz == 0


MARBLE = Material.from_reduced(sigma_a=0.0041, sigma_s_prime=2.62, eta=1.5)


def without_exchange(monkeypatch, *arguments, **options):
    """Simulate as if no part of the surface saw another."""
    with monkeypatch.context() as patch:
        patch.setattr(importlib.import_module("clsss.simulate"), "trace_exchange", lambda *_, **__: None)
        return simulate(*arguments, **options)


def test_a_torus_lights_itself(monkeypatch, single):
    """Nothing gets darker, and the inner side of the ring brightens most."""
    mesh, lights = torus(), [DirectionalLight((0.6, 0, -0.8))]
    alone = without_exchange(monkeypatch, mesh, MARBLE, lights, resolution=40)
    coupled = simulate(mesh, MARBLE, lights, resolution=40)
    gain = (coupled.vertex_radiosity - alone.vertex_radiosity)[:, 0]
    assert gain.min() >= -0.01 * alone.vertex_radiosity.max()
    rho = np.linalg.norm(mesh.vertices[:, :2], axis=1)
    assert gain[rho < 5].mean() > 3 * gain[rho > 9].mean()
    assert coupled.report["solve"]["converged"]


@pytest.mark.parametrize("eta", [1.0, 1.3])
def test_cavity_gives_back_what_it_takes(eta):
    """Nothing is absorbed inside an empty cavity: J.n over its wall sums to zero."""
    medium = Material(sigma_a=0.05, sigma_s=1.0, eta=eta)
    result = simulate(hollow_sphere(10, 5), medium, [DirectionalLight((0, 0, -1))], resolution=40)
    tree, flux = result._setup.octree, result._solution.flux.get()[:, 0]
    area = tree.cut.boundary.get()[:, 3].astype(float) * tree.grid.h**2
    inner = np.linalg.norm(boundary_points(tree)[0], axis=1) < 7.5
    assert abs(area[inner] @ flux[inner]) <= 0.03 * area[inner] @ np.abs(flux[inner])


def test_uniformly_glowing_hollow_sphere_is_a_closed_cavity(monkeypatch):
    """No net flux through the wall anywhere: phi as if the inner boundary reflected all (dphi/dr = 0)."""
    radius, cavity, sigma_a, sigma_s = 10.0, 5.0, 0.02, 1.0
    medium = Material(sigma_a, sigma_s, eta=1.3)
    result = simulate(hollow_sphere(radius, cavity), medium, [Emission(1.0)], resolution=48)
    D, k, A = float(medium.D[0]), float(np.sqrt(sigma_a / medium.D[0])), 2.34053
    grow = np.array([lambda r: np.sinh(k * r) / r, lambda r: np.cosh(k * r) / r])
    slope = np.array([lambda r: k * np.cosh(k * r) / r - np.sinh(k * r) / r**2,
                      lambda r: k * np.sinh(k * r) / r - np.cosh(k * r) / r**2])  # fmt: skip
    rows = [[s(cavity) for s in slope], [g(radius) + 2 * A * D * s(radius) for g, s in zip(grow, slope, strict=True)]]
    c = np.linalg.solve(rows, [0.0, -1 / sigma_a])
    r = np.linspace(5.6, 9.4, 20)
    direction = trimesh.unitize([1.0, 2.0, -0.5])
    exact = 1 / sigma_a + sum(ci * g(r) for ci, g in zip(c, grow, strict=True))
    np.testing.assert_allclose(result.fluence(r[:, None] * direction)[:, 0], exact, rtol=0.01)
