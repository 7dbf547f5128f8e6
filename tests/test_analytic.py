"""The closed forms solve the equation they claim to: residual, boundary condition, energy, known limits."""

from __future__ import annotations

import importlib.util
import os
from pathlib import Path

import cases
import numpy as np
import pytest

from clsss.analytic import half_space, scaled, slab
from clsss.analytic_sphere import sphere, sphere_beam
from clsss.errors import InputError
from clsss.fresnel import fresnel_A
from clsss.materials import Material

A = 2.8
R = 10.0


def second_derivative(f, x, h):
    return (-f(x + 2 * h) + 16 * f(x + h) - 30 * f(x) + 16 * f(x - h) - f(x - 2 * h)) / (12 * h * h)


def first_derivative(f, x, h):
    return (f(x - 2 * h) - 8 * f(x - h) + 8 * f(x + h) - f(x + 2 * h)) / (12 * h)


def laplacian(f, points, h):
    """Of f(points (n, 3)) by fourth-order differences."""
    return sum(second_derivative(lambda t, e=e: f(points + t * e), 0.0, h) for e in np.eye(3))


def quadrature(f, a, b, n=200):
    x, w = np.polynomial.legendre.leggauss(n)
    return np.sum(w * f(a + (b - a) * (x + 1) / 2)) * (b - a) / 2


SLABS = [(20.0, 0.01, 10.0, 0.9, phase) for phase in ("similarity", "delta-eddington", "p1")] + [
    ([5.0, 15.0], [0.02, 0.005], [10.0, 20.0], [0.9, 0.8], "p1"),
    ([1.0, 2.0, 7.0], [0.1, 0.02, 0.3], 5.0, 0.5, "p1"),
]


@pytest.mark.parametrize(("d", "sigma_a", "sigma_s", "g", "phase"), SLABS)
def test_slab(d, sigma_a, sigma_s, g, phase):
    s = slab(d, sigma_a, sigma_s, g, A, phase)
    edges = np.concatenate([[0], np.cumsum(np.atleast_1d(d))])
    layers = np.broadcast_arrays(np.atleast_1d(d), sigma_a, sigma_s, g)
    absorbed = 0.0
    for z0, z1, (_, a, sc, gc) in zip(edges[:-1], edges[1:], np.transpose(layers), strict=True):
        sc_star, g_star = scaled(sc, gc, phase)
        D = 1 / (3 * (a + (1 - gc) * sc))
        z, h = np.linspace(z0 + 0.01, z1 - 0.01, 101), 2e-3
        source = sc_star * s.beam(z) * (1 + 3 * D * g_star * (a + sc_star))
        residual = -D * second_derivative(s.phi, z, h) + a * s.phi(z) - source
        assert np.abs(residual).max() < 1e-6 * (source + a * s.phi(z)).max()
        flux = -D * first_derivative(s.phi, z, h) + 3 * D * g_star * sc_star * s.beam(z)
        np.testing.assert_allclose(flux, s.flux(z), atol=1e-7)
        absorbed += a * sum(
            quadrature(lambda x: s.phi(x) + s.beam(x), *ends)
            for ends in ((z0, z0 + (z1 - z0) / 8), (z0 + (z1 - z0) / 8, z1))
        )
    assert s.phi(0.0) == pytest.approx(-2 * A * s.flux(0.0), rel=1e-10)
    assert s.phi(edges[-1]) == pytest.approx(2 * A * s.flux(edges[-1]), rel=1e-10)
    assert s.reflectance + s.transmittance + s.unscattered + absorbed == pytest.approx(1, abs=1e-6)
    for z in edges[1:-1]:
        assert s.phi(z - 1e-12) == pytest.approx(s.phi(z + 1e-12), rel=1e-9)
        assert s.flux(z - 1e-12) == pytest.approx(s.flux(z + 1e-12), rel=1e-9)


def test_slab_without_absorption_keeps_all_light():
    s = slab(10.0, 0.0, 1.0, fresnel_A=2.0)
    assert s.reflectance + s.transmittance + s.unscattered == pytest.approx(1, abs=1e-12)


def test_thick_slab_reflects_what_the_material_states():
    m = Material(0.01, 1.0, eta=1.37)
    assert slab(500.0, 0.01, 1.0, 0.0, fresnel_A(1.37)).reflectance == pytest.approx(m.diffuse_reflectance[0])


def test_unknown_phase_is_named():
    with pytest.raises(InputError, match="phase"):
        slab(1.0, 0.1, 1.0, phase="delta")


def test_half_space():
    D = 1 / (3 * 1.01)

    def phi(p):
        return half_space(np.hypot(p[:, 0], p[:, 1]), p[:, 2], 1.0, 0.01, 1.0, A)

    points = np.array([[1.0, 0, 0.5], [3, 0, 2], [0.5, 2, 6], [8, 1, 3]])
    np.testing.assert_allclose(D * laplacian(phi, points, 1e-2), 0.01 * phi(points), rtol=1e-3)
    rho, h = np.array([1.0, 3, 10, 20]), 1e-3
    at = [half_space(rho, z, 1.0, 0.01, 1.0, A) for z in (0, h, 2 * h)]
    np.testing.assert_allclose(at[0], 2 * A * D * (-3 * at[0] + 4 * at[1] - at[2]) / (2 * h), rtol=1e-4)


@pytest.mark.parametrize("q0", [(0.2, 1.0), (0.0, 0.0)])
def test_layered_sphere(q0):
    radii, sigma_a, sigma_s = np.array([5.0, R]), np.array([0.05, 0.005]), np.array([2.0, 1.0])
    power = 0.7
    phi = sphere(radii, sigma_a, sigma_s, A, q0=q0, power=power)
    D, h = 1 / (3 * (sigma_a + sigma_s)), 1e-3
    absorbed = 0.0
    for i, (r0, r1) in enumerate([(0.0, 5.0), (5.0, R)]):
        r = np.linspace(r0 + 0.3, r1 - 0.01, 41)
        laplace = second_derivative(lambda x: x * phi(x), r, h) / r
        scale = (sigma_a[i] * phi(r) + q0[i]).max()
        assert np.abs(-D[i] * laplace + sigma_a[i] * phi(r) - q0[i]).max() < 1e-5 * scale
        absorbed += quadrature(lambda x, i=i: 4 * np.pi * x**2 * sigma_a[i] * phi(x), r0, r1)
    assert phi(5 - 1e-9) == pytest.approx(phi(5 + 1e-9), rel=1e-7)
    left, right = (np.array([s * first_derivative(phi, 5 + t, 1e-4)]) for s, t in ((D[0], -3e-4), (D[1], 3e-4)))
    np.testing.assert_allclose(left, right, rtol=2e-3)
    total = power + sum(q * 4 / 3 * np.pi * (b**3 - a**3) for q, a, b in zip(q0, (0, 5), (5, R), strict=True))
    assert absorbed + 4 * np.pi * R**2 * phi(R) / (2 * A) == pytest.approx(total, rel=1e-8)


def test_off_centre_source():
    args = ([5.0, R], [0.05, 0.005], [2.0, 1.0], 1.0)
    phi = sphere(*args, power=1.0, source_radius=7.0)
    reverse = sphere(*args, power=1.0, source_radius=3.0)
    assert phi(3.0, 0.4) == pytest.approx(reverse(7.0, 0.4), rel=1e-10)  # reciprocity
    centre = sphere(*args, power=1.0, source_radius=1e-6, degrees=3)
    np.testing.assert_allclose(centre([1.0, 9.0], 0.3), sphere(*args, power=1.0)([1.0, 9.0]), rtol=1e-5)
    c, h, D = np.linspace(-1, 1, 21), 1e-3, 1 / (3 * 1.005)
    slope = (3 * phi(R, c) - 4 * phi(R - h, c) + phi(R - 2 * h, c)) / (2 * h)
    np.testing.assert_allclose(phi(R, c), -2 * D * slope, rtol=1e-3)


def test_beam_on_a_sphere():
    sigma_a, sigma_s = 0.01, 1.0
    phi, D = sphere_beam(R, sigma_a, sigma_s, A), 1 / (3 * 1.01)

    def at(p):
        r = np.linalg.norm(p, axis=-1)
        return phi(r, p[..., 2] / r)

    points = np.array([[3.0, 0, 4], [-5, 2, -3], [1, 6, 0.5]])
    depth = np.sqrt(R * R - points[:, 0] ** 2 - points[:, 1] ** 2) - points[:, 2]
    source = sigma_s * np.exp(-1.01 * depth)
    residual = -D * laplacian(at, points, 0.05) + sigma_a * at(points) - source
    assert np.abs(residual).max() < 1e-3 * np.abs(sigma_a * at(points) + source).max()
    x, w = np.polynomial.legendre.leggauss(200)
    exited = 2 * np.pi * R * R * np.sum(w * phi(R, x)) / (2 * A)
    absorbed = quadrature(lambda r: 2 * np.pi * sigma_a * r * r * (phi(r[:, None], x) @ w), 0, R, 100)
    deposited = quadrature(
        lambda b: 2 * np.pi * b * sigma_s / 1.01 * (1 - np.exp(-2.02 * np.sqrt(R * R - b * b))), 0, R
    )
    assert exited + absorbed == pytest.approx(deposited, rel=5e-5)


CASES = [cases.uniform_source, cases.layered, cases.manufactured, cases.manufactured_robin]


@pytest.mark.parametrize("make", CASES)
def test_case_solves_its_equation(make):
    case, rng = make(), np.random.default_rng(0)
    points = rng.normal(size=(50, 3))
    points *= (case.radius * rng.uniform(0.55, 0.95, (50, 1))) / np.linalg.norm(points, axis=1)[:, None]

    def flux(p, axis, h=1e-3):
        e = h * np.eye(3)[axis]
        return -case.D(p) * (case.phi(p + e) - case.phi(p - e)) / (2 * h)

    h = 1e-2
    divergence = sum((flux(points + h * e, i) - flux(points - h * e, i)) / (2 * h) for i, e in enumerate(np.eye(3)))
    left = divergence + case.sigma_a(points) * case.phi(points)
    np.testing.assert_allclose(left, case.q0(points), rtol=2e-4)
    assert case.q0(points).min() >= 0
    n = points / np.linalg.norm(points, axis=1)[:, None]
    at, h = case.radius * n, 1e-3
    slope = (3 * case.phi(at) - 4 * case.phi(at - h * n) + case.phi(at - 2 * h * n)) / (2 * h)
    robin = case.phi(at) + 2 * case.A * case.D(at) * slope
    np.testing.assert_allclose(robin, case.robin(at), atol=1e-5 * case.phi(at).max())


def test_order_is_the_slope():
    h = np.array([0.1, 0.05, 0.025])
    assert cases.order(h, 3 * h**2) == pytest.approx(2)


def test_agrees_with_independent_formulas():
    folder = os.environ.get("CLSSS_SHARED")
    if not folder:
        pytest.skip("CLSSS_SHARED names no folder of reference data")
    spec = importlib.util.spec_from_file_location("truth", Path(folder) / "truth" / "analytic.py")
    truth = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(truth)
    z, r, c = np.linspace(0, 19.9, 40), np.linspace(0.5, R, 20), np.linspace(-1, 1, 11)
    layers = [5.0, 15.0], [0.02, 0.005], [10.0, 20.0], [0.9, 0.8]
    np.testing.assert_allclose(slab(*layers, A, "p1").phi(z), truth.slab_layers(*layers, A)["phi"](z), rtol=1e-10)
    np.testing.assert_allclose(
        half_space(r, 2.0, 1.0, 0.01, 1.0, A), truth.halfspace_point(r, 2.0, 1.0, 0.01, 1.0, A), rtol=1e-9
    )
    layers = [5.0, R], [0.05, 0.005], [2.0, 1.0], A
    np.testing.assert_allclose(
        sphere(*layers, power=1.0, source_radius=7.0)(r, 0.3),
        truth.sphere_point_offcenter(r, 0.3, 7.0, *layers),
        rtol=1e-9,
    )
    beam = truth.sphere_beam(np.full(11, R), c, R, 0.01, 1.0, 0.0, A)
    np.testing.assert_allclose(sphere_beam(R, 0.01, 1.0, A)(R, c), beam, rtol=2e-3)
