"""Lights: what they accept, and that an environment's beams add up to it."""

from __future__ import annotations

import numpy as np
import pytest

from clsss.errors import InputError
from clsss.lights import DirectionalLight, Emission, EnvironmentLight, PointLight

NORMALS = np.random.default_rng(0).normal(size=(200, 3))
NORMALS /= np.linalg.norm(NORMALS, axis=1)[:, None]


def irradiance(beams):
    directions = np.array([b.direction for b in beams])
    return np.maximum(-NORMALS @ directions.T, 0) @ np.array([b.irradiance for b in beams])


def test_directional_and_point():
    sun = DirectionalLight((0, 0, -2), (1, 2, 3))
    np.testing.assert_allclose(sun.direction, [0, 0, -1])
    np.testing.assert_allclose(sun.irradiance, [1, 2, 3])
    lamp = PointLight((1, 2, 3), 5)
    np.testing.assert_allclose(lamp.position, [1, 2, 3])
    np.testing.assert_allclose(lamp.intensity, 5)


@pytest.mark.parametrize(
    ("make", "field"),
    [
        (lambda: DirectionalLight((0, 0, 0)), "direction: must not be zero"),
        (lambda: DirectionalLight((0, 0, 1e300)), "direction: must not be zero nor endless"),
        (lambda: DirectionalLight((0, 1)), "direction: needs three"),
        (lambda: DirectionalLight("down"), "direction: needs three"),
        (lambda: DirectionalLight((0, 0, 1), -1), "irradiance"),
        (lambda: PointLight((0, 0, np.inf)), "position"),
        (lambda: PointLight((0, 0, 1), (1, 2)), "intensity"),
        (lambda: PointLight((0, 0, 1), np.nan), "intensity"),
        (lambda: Emission(-1), "q0"),
        (lambda: EnvironmentLight(-1), "radiance"),
        (lambda: EnvironmentLight("sky.hdr"), "radiance"),
        (lambda: EnvironmentLight(np.ones((4, 8))), "radiance"),
        (lambda: EnvironmentLight(np.ones((4, 8, 4))), "radiance"),
        (lambda: EnvironmentLight(np.full((4, 8, 3), -1.0)), "radiance"),
        (lambda: EnvironmentLight(1, up="x"), "up"),
        (lambda: EnvironmentLight(1).beams(0), "at least one"),
    ],
)
def test_bad_values_name_their_field(make, field):
    with pytest.raises(InputError, match=field):
        make()


def test_emission():
    points = np.arange(12.0).reshape(4, 3)
    np.testing.assert_allclose(Emission((1, 2, 3)).density(points), [[1, 2, 3]] * 4)
    np.testing.assert_allclose(Emission(lambda p: p[:, 0]).density(points), points[:, :1] * [1, 1, 1])
    np.testing.assert_allclose(Emission(lambda p: p).density(points), points)
    with pytest.raises(InputError, match="shape"):
        Emission(lambda p: np.zeros((2, 2))).density(points)
    with pytest.raises(InputError, match="q0: needs an array of numbers, got 'bright'"):
        Emission(lambda p: "bright").density(points)
    with pytest.raises(InputError, match="not negative"):
        Emission(lambda p: -p[:, 0]).density(points)


@pytest.mark.parametrize("radiance", [1.0, np.ones((16, 32, 3)), np.ones((1, 1, 3))])
def test_constant_sky_lights_every_plane_alike(radiance):
    beams = EnvironmentLight(radiance).beams(200)
    assert len(beams) == 200
    np.testing.assert_allclose(sum(b.irradiance for b in beams), 4 * np.pi)
    np.testing.assert_allclose(irradiance(beams), np.pi, rtol=0.01)


@pytest.mark.parametrize("up", ["y", "z"])
def test_image_is_sampled_within_a_percent(up):
    h, w = 150, 310
    image = np.random.default_rng(1).random((h, w, 3)) ** 4
    image[40:43, 50:53] = 500  # a sun
    image[:, :, 0] *= np.linspace(2, 0, h)[:, None]  # red from above
    polar, azimuth = np.pi * (np.arange(h) + 0.5) / h, 2 * np.pi * (np.arange(w) + 0.5) / w - np.pi
    edges = np.cos(np.linspace(0, np.pi, h + 1))
    power = image * ((edges[:-1] - edges[1:]) * 2 * np.pi / w)[:, None, None]
    sin, cos = np.sin(polar)[:, None], np.cos(polar)[:, None] + 0 * azimuth
    right, ahead = sin * np.sin(azimuth), sin * np.cos(azimuth)
    towards = np.stack([right, cos, -ahead] if up == "y" else [right, ahead, cos], axis=2)
    exact = np.maximum(NORMALS @ towards.reshape(-1, 3).T, 0) @ power.reshape(-1, 3)
    beams = EnvironmentLight(image, up).beams(300)
    np.testing.assert_allclose(sum(b.irradiance for b in beams), power.sum(axis=(0, 1)))
    np.testing.assert_allclose(irradiance(beams), exact, rtol=0.01)


def test_black_sky_gives_no_beams():
    assert EnvironmentLight(np.zeros((4, 8, 3))).beams(10) == []
