"""Winding numbers on the device against the sum of all solid angles."""

import numpy as np
import pytest
import trimesh

from clsss.device import Device
from clsss.rays import winding
from clsss.winding import winding_number

TOLERANCE = 0.04  # of the dipoles, as the function states


@pytest.fixture(scope="module", params=["single", "double"])
def device(request):
    return Device(precision=request.param)


def points_around(triangles, n=400):
    rng = np.random.default_rng(5)
    low, high = triangles.min(axis=(0, 1)), triangles.max(axis=(0, 1))
    return rng.uniform(low - 0.2 * (high - low), high + 0.2 * (high - low), (n, 3))


def test_closed_surface_gives_integers(device):
    triangles = trimesh.creation.torus(1.0, 0.4, major_sections=64, minor_sections=32).triangles * 7.0
    points = points_around(triangles)
    got = winding_number(device, triangles, points)
    exact = winding(points, triangles)
    np.testing.assert_allclose(got, exact, atol=TOLERANCE)
    assert np.abs(got - exact).mean() <= 0.0025
    assert set(np.round(got)) == {0.0, 1.0}


def test_open_soup_far_from_the_origin(device):
    triangles = trimesh.creation.icosphere(subdivisions=4).triangles[::3] + np.array([1e5, -2e5, 3e5])
    points = points_around(triangles)
    np.testing.assert_allclose(
        winding_number(device, triangles, points), winding(points, triangles), atol=TOLERANCE
    )


def test_shells_add_and_cavities_subtract(device):
    sphere = trimesh.creation.icosphere(subdivisions=3).triangles
    surface = np.concatenate([3 * sphere, 2 * sphere[:, ::-1], sphere])
    points = np.array([[0.1, 0, 0], [1.5, 0, 0], [0, 2.5, 0], [0, 0, 3.5]])
    np.testing.assert_allclose(winding_number(device, surface, points), [1, 0, 1, 0], atol=TOLERANCE)
    points = np.array([[0.1, 0.1, 0]])
    np.testing.assert_allclose(
        winding_number(device, np.concatenate([3 * sphere, 2 * sphere]), points), [2], atol=TOLERANCE
    )


@pytest.mark.parametrize("count", [1, 2, 4, 5, 9, 33])
def test_any_number_of_triangles(device, count):
    rng = np.random.default_rng(count)
    triangles, points = rng.normal(size=(count, 3, 3)), rng.normal(size=(50, 3))
    np.testing.assert_allclose(
        winding_number(device, triangles, points), winding(points, triangles), atol=TOLERANCE
    )


def test_error_falls_with_the_distance_of_dipoles(device, monkeypatch):
    """The terms left out are of second order: the error falls at least as FAR^-2."""
    import clsss.winding

    triangles = trimesh.creation.icosphere(subdivisions=4).triangles
    points = points_around(triangles)
    exact = winding(points, triangles)
    errors = []
    for far in (2.0, 4.0, 8.0):
        monkeypatch.setattr(clsss.winding, "FAR", far)
        errors.append(np.abs(winding_number(device, triangles, points) - exact).mean())
    assert errors[1] < errors[0] / 4
    assert errors[2] < errors[1] / 4
