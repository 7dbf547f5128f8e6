"""Emission and bodies that block light, in the references: exact values, balances, one way against the other."""

from __future__ import annotations

import functools

import numpy as np
import pytest
import trimesh

from clsss.dipole import dipole, entering
from clsss.errors import InputError
from clsss.fresnel import fresnel_transmittance
from clsss.lights import DirectionalLight, Emission, EnvironmentLight, PointLight
from clsss.materials import Material
from clsss.media import Mix, Perlin
from clsss.mesh import load_mesh
from clsss.montecarlo import estimate
from clsss.reference import monte_carlo
from clsss.simulate import simulate

RADIUS = 5.0
COLOURS = np.array([1.0, 2.0, 0.5])
DOWN = DirectionalLight((0, 0, -1))


def icosphere(radius, centre=(0, 0, 0), inward=False):
    mesh = trimesh.creation.icosphere(3, radius).apply_translation(centre)
    if inward:
        mesh.invert()
    return mesh


@functools.cache
def ball():
    return load_mesh(icosphere(RADIUS))


def everywhere(mesh):
    """A point on every triangle, whose mean by area is that of the surface, and the shares of the area."""
    area = np.linalg.norm(np.cross(*np.diff(mesh.triangles, axis=1).transpose(1, 0, 2)), axis=1)
    return mesh.triangles.mean(axis=1), area / area.sum()


def agree(a, b, share, bound=3.5):
    """Two estimates' means over the surface, channel by channel, to their errors."""
    noise = np.sqrt(share**2 @ (a.stderr**2 + b.stderr**2))
    assert np.all(np.abs(share @ (a.radiosity - b.radiosity)) < bound * noise)
    assert np.all(noise < 0.03 * share @ b.radiosity)


# ---------------------------------------------------------------- emission


@pytest.mark.parametrize(("eta", "forward"), [(1.0, False), (1.0, True), (1.4, True)])
def test_all_that_is_emitted_leaves_where_nothing_absorbs(eta, forward):
    """Power out = q0 V: the mean exitance is q0 V / S at any scattering and index."""
    points, share = everywhere(ball())
    e = estimate(ball(), Material(0.0, 1.0, eta=eta), [Emission(COLOURS)], 25, points, forward=forward, radius=0.5)
    area, volume = ball().area_and_volume
    mean, error = share @ e.radiosity, np.sqrt(share**2 @ e.stderr**2)
    assert np.all(error < 0.012 * mean)
    np.testing.assert_allclose(mean / (COLOURS * volume / area), 1, atol=0.03)
    np.testing.assert_allclose(e.radiosity, e.single + e.multiple, atol=1e-12)
    if forward:
        np.testing.assert_allclose(e.energy["incident"], COLOURS * volume, rtol=2e-3)
        np.testing.assert_allclose(e.energy["scattered"], e.energy["incident"], rtol=1e-4)


@pytest.mark.parametrize("forward", [False, True])
@pytest.mark.parametrize("sigma_a", [0.1, 1.0])
def test_emission_in_a_ball_that_only_absorbs(sigma_a, forward):
    """L = q0 / (4 pi sigma_a) (1 - exp(-2 R sigma_a cos)), integrated over the hemisphere."""
    points, share = everywhere(ball())
    e = estimate(ball(), Material(sigma_a, 1e-9), [Emission(COLOURS)], 30, points, forward=forward, radius=0.5)
    x = 2 * RADIUS * sigma_a
    exact = COLOURS / (2 * sigma_a) * (0.5 - (1 - (1 + x) * np.exp(-x)) / x**2)
    mean, error = share @ e.radiosity, np.sqrt(share**2 @ e.stderr**2)
    assert np.all(error < 0.016 * exact)
    np.testing.assert_allclose(mean / exact, 1, atol=0.04)
    np.testing.assert_allclose(e.multiple, 0, atol=1e-6)


def test_emission_is_the_same_both_ways_where_the_medium_varies():
    points, share = everywhere(ball())
    medium = Mix(Material((0.01, 0.02, 0.05), 1.0), Material(0.2, 3.0, g=0.5), Perlin(2.0))
    lights = [Emission(COLOURS / 10), EnvironmentLight(0.02), PointLight((0, 0, 9.0), 3.0)]
    a, b = (estimate(ball(), medium, lights, 8, points, forward=f, radius=0.5) for f in (False, True))
    agree(a, b, share)


def glow(points):
    """A lump off the centre, of another colour on either side."""
    inside = np.linalg.norm(points - [1, 0, 0], axis=1) < 2
    return inside[:, None] * np.where(points[:, :1] > 1, [1.0, 2, 0], [3.0, 0, 1])


@pytest.mark.parametrize("eta", [1.0, 1.4])
def test_power_of_emission_that_is_a_function(eta):
    e = estimate(ball(), Material(0.02, 2.0, eta=eta), [Emission(glow), DOWN], 10, *everywhere(ball())[:1])
    incident = 4 / 3 * np.pi * 8 * np.array([2, 1, 0.5]) + np.pi * RADIUS**2
    np.testing.assert_allclose(e.energy["incident"], incident, rtol=0.01)
    kept = sum(e.energy[k] for k in ("reflected", "absorbed", "scattered", "unscattered", "lost", "capped"))
    np.testing.assert_allclose(kept, e.energy["incident"], rtol=2e-3)


def test_a_function_of_one_value_is_even_emission():
    points, share = everywhere(ball())
    medium = Material(0.05, 1.0)
    even, called = (
        estimate(ball(), medium, [Emission(q0)], 20, points, forward=True, radius=0.5, seed=seed)
        for q0, seed in ((0.3, 0), (lambda at: np.full(len(at), 0.3), 1))
    )
    agree(even, called, share)


def test_diffusion_agrees_on_emission():
    """Diffusion is good where light comes from within."""
    medium = Material((0.01, 0.02, 0.05), 3.0)
    lights = [Emission(lambda at: np.exp(-((np.linalg.norm(at - [0, 0, 1.5], axis=1) / 2) ** 2)))]
    ours = simulate(ball(), medium, lights, resolution=40)
    points = ball().triangles.mean(axis=1)[::8]
    e = estimate(ball(), medium, lights, 300, points, radius=1.0)
    off = ours.radiosity(points) - e.radiosity
    assert np.linalg.norm(off) < 0.03 * np.linalg.norm(e.radiosity) + 1.2 * np.linalg.norm(e.stderr)


def test_bodies_that_overlap_glow_as_one():
    """Photons born where two bodies overlap are inside both, and scatter on until they have left both."""
    mesh = load_mesh(trimesh.util.concatenate([icosphere(3.0), icosphere(3.0, (0, 0, 2.0))]))
    union = trimesh.boolean.union([icosphere(3.0), icosphere(3.0, (0, 0, 2.0))], engine="manifold")
    e = estimate(mesh, Material(0.0, 1.0, eta=1.2), [Emission(1.0)], 2)
    np.testing.assert_allclose(e.energy["incident"], union.volume, rtol=5e-3)
    np.testing.assert_allclose(e.energy["scattered"], e.energy["incident"], rtol=2e-3)


@pytest.mark.parametrize(
    ("q0", "forward", "words"),
    [
        (lambda at: np.ones(len(at)), False, "not a function"),
        (lambda at: 0.0 * at, None, "shines nowhere"),
        (lambda at: np.ones(2), None, "q0: must give"),
        (0.0, None, "no light"),
    ],
)
def test_emission_that_cannot_be_is_named(q0, forward, words):
    with pytest.raises(InputError, match=words):
        estimate(ball(), Material(0.1, 1.0), [Emission(q0)], 1, forward=forward)


# ---------------------------------------------------------------- bodies that block light


@functools.cache
def lid():
    """A plate above the ball that covers half of it."""
    return load_mesh(trimesh.creation.box((20, 20, 0.5)).apply_translation((10, 0, 12)))


def test_nothing_is_lit_behind_a_body():
    """A sheet with one side is as good as a body, whichever way it faces."""
    whole = trimesh.creation.box((20, 20, 0.5)).apply_translation((0, 0, 40))
    sheet = trimesh.Trimesh([[-20, -20, 9], [20, -20, 9], [0, 30, 9]], [[0, 2, 1]])
    for blocker in (load_mesh(whole), load_mesh(sheet, solid=False)):
        for forward in (False, True):
            e = estimate(ball(), Material(0.1, 1.0), [DOWN], 5, forward=forward, blockers=[blocker])
            np.testing.assert_array_equal(e.radiosity, 0)
            assert not any(power.any() for power in e.energy.values())
        np.testing.assert_array_equal(dipole(ball(), Material(0.1, 1.0), [DOWN], blockers=[blocker]), 0)


def test_half_a_shadow_both_ways_and_in_the_dipole():
    points, share = everywhere(ball())
    lights = [DOWN, PointLight((0, 0, 20.0), 300.0)]
    a, b = (
        estimate(ball(), Material(0.1, 1.0), lights, 30, points, forward=f, radius=0.5, blockers=[lid()])
        for f in (False, True)
    )
    agree(a, b, share)
    free = estimate(ball(), Material(0.1, 1.0), lights, 10, points)
    assert share @ a.radiosity[:, 0] < 0.7 * share @ free.radiosity[:, 0]
    assert b.energy["incident"][0] < 0.7 * np.pi * RADIUS**2 * (1 + 300 / 20**2)
    up = points / np.linalg.norm(points, axis=1, keepdims=True)
    lit = entering(ball(), points, up, 1.0, [DOWN], blockers=[lid()])[:, 0]
    np.testing.assert_array_equal(lit > 0, (up[:, 2] > 1e-3) & (points[:, 0] < 0))
    shaded = dipole(ball(), Material(0.1, 1.0), [DOWN], blockers=[lid()])
    assert 0.3 < shaded.sum() / dipole(ball(), Material(0.1, 1.0), [DOWN]).sum() < 0.7


@pytest.mark.parametrize("eta", [1.0, 1.3])
def test_a_body_that_fills_a_cavity_makes_it_black(eta):
    shell = load_mesh(trimesh.util.concatenate([icosphere(RADIUS), icosphere(4.0, inward=True)]))
    core = load_mesh(icosphere(3.99))
    points = shell.triangles[: len(shell.triangles) // 2].mean(axis=1)
    share = np.full(len(points), 1 / len(points))
    medium, lights = Material(0.01, 1.0, eta=eta), [DOWN, Emission(0.05)]
    black, filled, empty = (
        estimate(shell, medium, lights, n, points, reenter=r, blockers=b, radius=0.5)
        for n, r, b in ((40, False, ()), (40, True, [core]), (5, True, ()))
    )
    agree(black, filled, share)
    assert share @ empty.radiosity[:, 0] > 1.2 * share @ filled.radiosity[:, 0]


def test_diffusion_agrees_in_a_shadow():
    medium = Material(0.005, 3.0)
    ours = simulate(ball(), medium, [DOWN], resolution=48, blockers=[lid()])
    points = ball().triangles.mean(axis=1)[::4]
    radiosity, stderr = monte_carlo(ball(), medium, [DOWN], 400, points, blockers=[lid()])
    off = ours.radiosity(points) - radiosity
    assert np.linalg.norm(off) < 0.03 * np.linalg.norm(radiosity) + 1.2 * np.linalg.norm(stderr)


def test_lamp_enters_by_the_square_of_its_distance():
    """E = I T(cos) cos / r^2 above the ball, nothing on its far side."""
    normals = np.array([[0, 0, 1.0], [0.6, 0, 0.8], [0, 0, -1.0]])
    points = RADIUS * normals
    lamp = np.array([0, 0, 9.0])
    r = np.linalg.norm(lamp - points, axis=1)
    cosine = np.maximum(0, ((lamp - points) * normals).sum(axis=1) / r)
    found = entering(ball(), points, normals, 1.4, [PointLight(lamp, (1.0, 2.0, 3.0))])
    expected = (fresnel_transmittance(cosine, 1.4) * cosine / r**2)[:, None] * [1, 2, 3]
    np.testing.assert_allclose(found, expected, rtol=1e-3)


def test_blockers_that_are_none_are_named():
    for method in (monte_carlo, dipole):
        with pytest.raises(InputError, match="blockers: needs"):
            method(ball(), Material(0.1, 1.0), [DOWN], blockers=["lid.ply"])
