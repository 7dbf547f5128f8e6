"""Coefficients, the table, and media that vary in space."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from clsss.analytic import slab
from clsss.errors import InputError
from clsss.fresnel import fresnel_A
from clsss.materials import Material, material, materials
from clsss.media import Grid, Mix, Perlin

POINTS = np.random.default_rng(0).uniform(-10, 10, (200, 3))


def test_derived_coefficients():
    m = Material((0.01, 0.02, 0.03), 10.0, g=0.9, eta=1.37)
    np.testing.assert_allclose(m.sigma_s_prime, 1)
    np.testing.assert_allclose(m.sigma_t, [10.01, 10.02, 10.03])
    np.testing.assert_allclose(m.sigma_tr, [1.01, 1.02, 1.03])
    np.testing.assert_allclose(m.D, 1 / (3 * m.sigma_tr))
    np.testing.assert_allclose(m.sigma_eff**2, m.sigma_a / m.D)
    np.testing.assert_allclose(m.albedo, 1 / m.sigma_tr)
    assert Material(0, 1, eta=1.4).diffuse_reflectance == pytest.approx(1)
    reduced = Material.from_reduced(m.sigma_a, m.sigma_s_prime, eta=1.37, g=0.9)
    np.testing.assert_allclose(reduced.sigma_s, m.sigma_s)
    assert [a.shape for a in m.coefficients(POINTS)] == [(200, 3), (200, 3)]


@pytest.mark.parametrize("eta", [1.0, 1.4])
@pytest.mark.parametrize("albedo", [0.5, 0.9, 0.99])
def test_diffuse_reflectance_is_that_of_a_thick_slab(albedo, eta):
    exact = slab(60.0, 1 - albedo, albedo, fresnel_A=fresnel_A(eta)).reflectance
    assert Material(1 - albedo, albedo, eta=eta).diffuse_reflectance == pytest.approx(exact, rel=1e-6)


def test_material_cannot_be_changed():
    m = Material(0.01, 1.0)
    with pytest.raises(dataclasses.FrozenInstanceError):
        m.g = 0.5
    with pytest.raises(ValueError, match="read-only"):
        m.sigma_a[0] = 1
    assert len({m, m}) == 1


@pytest.mark.parametrize(
    ("arguments", "field"),
    [
        ({"sigma_a": -1}, "sigma_a: must not be negative"),
        ({"sigma_a": np.nan}, "sigma_a: must be finite"),
        ({"sigma_a": (1, 2)}, "sigma_a: needs one number or three"),
        ({"sigma_a": "red"}, "sigma_a: needs one number or three"),
        ({"sigma_s": 0}, "sigma_s: must be above 0"),
        ({"sigma_s": (1, 1, np.inf)}, "sigma_s: must be finite"),
        ({"sigma_s": (1, -1, 1)}, "sigma_s: must not be negative"),
        ({"g": 1}, "g: must lie between"),
        ({"g": "x"}, "g: needs one number"),
        ({"eta": 0}, "eta: must be above 0"),
        ({"eta": np.nan}, "eta: must be finite"),
    ],
)
def test_bad_values_name_their_field(arguments, field):
    with pytest.raises(InputError, match=field):
        Material(**{"sigma_a": 0.1, "sigma_s": 1.0, **arguments})


def test_bad_reduced_scattering_is_named():
    with pytest.raises(InputError, match="sigma_s_prime"):
        Material.from_reduced(0.1, -1)


def test_table():
    assert len(materials()) >= 40
    for name in materials():
        m = material(name)
        assert m.name == name
        assert m.source
        assert np.all((m.diffuse_reflectance > 0) & (m.diffuse_reflectance <= 1))
    marble = material("Marble")
    np.testing.assert_allclose(marble.sigma_s_prime, [2.19, 2.62, 3.0])
    np.testing.assert_allclose(marble.sigma_a, [0.0021, 0.0041, 0.0071])
    assert (marble.eta, marble.g) == (1.5, 0)
    assert material("skim milk").name == material("Skim_Milk").name == "skimmilk"
    np.testing.assert_allclose(material("chicken1").sigma_a, [0.015, 0.077, 0.19])
    np.testing.assert_allclose(material("regular milk").sigma_s_prime, [4.5513, 5.8294, 7.136])


def test_unknown_material_names_the_nearest():
    with pytest.raises(InputError, match=r"'marbel'.*marble"):
        material("marbel")


def test_mix_blends_what_diffusion_sees():
    a, b = Material(0.01, 10.0, g=0.9, eta=1.3), Material(0.03, 3.0, eta=1.5)
    mix = Mix(a, b, lambda p: np.full(len(p), 0.25))
    sigma_a, sigma_s = mix.coefficients(POINTS)
    np.testing.assert_allclose(sigma_a, 0.015)
    np.testing.assert_allclose((1 - mix.g) * sigma_s, 1.5)
    assert (mix.eta, mix.g, mix.homogeneous) == (1.4, 0.45, False)
    nested = Mix(mix, a, Perlin(scale=3)).coefficients(POINTS)
    assert nested[0].min() >= 0.01
    assert nested[0].max() <= 0.015


def test_mix_refuses_what_it_cannot_use():
    m = Material(0.01, 1)
    with pytest.raises(InputError, match="weight"):
        Mix(m, m, 0.5)
    with pytest.raises(InputError, match="a: needs"):
        Mix("marble", m, Perlin())
    with pytest.raises(InputError, match="weight: must give"):
        Mix(m, m, lambda p: np.zeros(3)).coefficients(POINTS)


def test_perlin_is_smooth_repeatable_and_in_range():
    noise = Perlin(scale=2.0, seed=3)
    w = noise(POINTS)
    np.testing.assert_array_equal(w, Perlin(2.0, 3)(POINTS))
    assert not np.allclose(w, Perlin(2.0, 4)(POINTS))
    assert 0 <= w.min() < 0.35 < 0.65 < w.max() <= 1
    lattice = np.array([[0, 0, 0], [2, -4, 6]], float)
    np.testing.assert_allclose(noise(lattice), 0.5)
    face, step = lattice + np.array([0, 0.7, 0.3]), 1e-6 * np.eye(3)[0]
    slopes = [(noise(face + s * step) - noise(face)) / s for s in (1, -1)]
    np.testing.assert_allclose(*slopes, atol=1e-9)
    with pytest.raises(InputError, match="scale"):
        Perlin(scale=0)
    with pytest.raises(InputError, match="seed"):
        Perlin(seed=-1)


def test_grid_is_trilinear_and_constant_outside():
    centres = (np.indices((5, 6, 7)) + 0.5).transpose(1, 2, 3, 0) * 2.0 - 4

    def linear(p):
        return 3 + p @ [0.1, 0.05, 0.02]

    grid = Grid(np.full((5, 6, 7), 0.1), np.repeat(linear(centres)[..., None], 3, axis=3), -4.0, 2.0, g=0.2)
    inside = np.random.default_rng(1).uniform(-3, [5, 7, 9], (100, 3))
    sigma_a, sigma_s = grid.coefficients(inside)
    np.testing.assert_allclose(sigma_s[:, 1], linear(inside))
    np.testing.assert_allclose(sigma_a, 0.1)
    np.testing.assert_allclose(grid.coefficients([[-99.0, -99, -99]])[1][0], linear(np.full(3, -3.0)))


def test_grid_names_what_is_wrong():
    ones = np.ones((2, 2, 2))
    with pytest.raises(InputError, match="sigma_s: has shape"):
        Grid(ones, np.ones((3, 2, 2)), 0, 1)
    with pytest.raises(InputError, match="sigma_a: needs shape"):
        Grid(np.ones(3), ones, 0, 1)
    with pytest.raises(InputError, match="sigma_a: needs an array of numbers, got 'dense'"):
        Grid("dense", ones, 0, 1)
    with pytest.raises(InputError, match="sigma_s: must be above 0"):
        Grid(ones, 0 * ones, 0, 1)
    with pytest.raises(InputError, match="spacing"):
        Grid(ones, ones, 0, 0)
