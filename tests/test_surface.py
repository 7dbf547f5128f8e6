"""Values at points of the surface, fitted to those at the boundary of the cut cells."""

from __future__ import annotations

import cases
import numpy as np
import pytest
from shapes import ROTATION, box, build_tree, sphere

from clsss.surface import boundary_points, fluence_at


def smooth(directions):
    """A smooth field on the unit sphere, one per channel."""
    x, y, z = directions.T
    return np.stack([2 + np.sin(3 * x) * np.cos(2 * y), 3 + x * y + z, np.exp(z) + y + 1], axis=1)


def boundary_field(device, tree, function):
    return device.array(function(boundary_points(tree)[0]))


def on_sphere(points):
    return smooth(points / np.linalg.norm(points, axis=1, keepdims=True))


def test_values_on_a_sphere_have_order_two(double):
    mesh, resolutions = sphere(10, 5), [16, 32, 64]
    points, index = np.unique(mesh.vertices.round(9), axis=0, return_index=True)
    normals = points / np.linalg.norm(points, axis=1, keepdims=True)
    rms, greatest = [], []
    for resolution in resolutions:
        tree = build_tree(double, mesh, resolution)
        found = fluence_at(double, tree, boundary_field(double, tree, on_sphere), mesh.vertices[index], normals)
        error = np.abs(found - smooth(normals))
        rms.append(np.sqrt((error**2).mean()))
        greatest.append(error.max())
    h = [1 / n for n in resolutions]
    assert cases.order(h, rms) >= 1.9
    assert cases.order(h, greatest) >= 1.7


def test_constants_are_kept(device, eps):
    mesh = sphere()
    tree = build_tree(device, mesh, 24)
    phi_B = boundary_field(device, tree, lambda points: np.tile([1.0, 2.0, 3.0], (len(points), 1)))
    found = fluence_at(device, tree, phi_B, mesh.vertices)
    np.testing.assert_allclose(found, np.tile([1, 2, 3], (len(found), 1)), rtol=100 * eps)


def test_linear_fields_on_a_plane_are_nearly_exact(double):
    """Only the fit's ridge is left, a small part of the slope over a cell."""
    tree = build_tree(double, box((20, 20, 8), ROTATION), 48)
    phi_B = boundary_field(double, tree, lambda points: (10 + points @ ROTATION[:, :1]) * np.ones(3))
    local = np.random.default_rng(8).uniform(-6, 6, (200, 3))
    local[:, 2] = 4
    found = fluence_at(double, tree, phi_B, local @ ROTATION.T, np.tile(ROTATION[:, 2], (200, 1)))
    np.testing.assert_allclose(found[:, 0], 10 + local[:, 0], atol=1e-3 * tree.grid.h)


@pytest.mark.parametrize("cells", [1.2, 2.0, 4.0])
def test_two_sides_of_a_plate_stay_apart(device, eps, cells):
    """The upper side shines, the lower one is dark, at any thickness."""
    plate = box((20, 20, cells * 20 / 48), ROTATION)
    tree = build_tree(device, plate, round(48 * plate.size / 20))
    normal = ROTATION[:, 2]
    phi_B = boundary_field(device, tree, lambda points: (points @ normal > 0)[:, None] * [1.0, 2.0, 3.0])
    local = np.random.default_rng(9).uniform(-8, 8, (300, 3))
    for side in (1, -1):
        local[:, 2] = side * cells * 10 / 48
        found = fluence_at(device, tree, phi_B, local @ ROTATION.T, np.tile(side * normal, (300, 1)))
        np.testing.assert_allclose(found, np.tile(np.array([1, 2, 3]) * (side > 0), (300, 1)), atol=1e3 * eps)


def test_points_far_from_the_surface_get_the_nearest_value(device):
    tree = build_tree(device, sphere(), 16)
    phi_B = boundary_field(device, tree, on_sphere)
    directions = np.array([[1.0, 0, 0], [0, -1, 0], [0.6, 0, 0.8]])
    for distance in (5.0, 30.0, 1e6):
        found = fluence_at(device, tree, phi_B, distance * directions)
        np.testing.assert_allclose(found, smooth(directions), atol=0.5)


def test_values_are_never_negative(device):
    """Next to a shadow's edge a fitted plane would run below zero."""
    mesh = sphere()
    tree = build_tree(device, mesh, 24)
    phi_B = boundary_field(device, tree, lambda points: (points[:, 2:] > 0) * np.ones(3))
    assert fluence_at(device, tree, phi_B, mesh.vertices).min() >= 0


def test_zero_normals_are_those_of_the_nearest_cell(double):
    mesh = sphere()
    tree = build_tree(double, mesh, 24)
    phi_B = boundary_field(double, tree, on_sphere)
    points = mesh.vertices[:50]
    without = fluence_at(double, tree, phi_B, points, np.zeros((50, 3)))
    np.testing.assert_array_equal(without, fluence_at(double, tree, phi_B, points))
    np.testing.assert_allclose(without, on_sphere(points), atol=0.05)


def test_no_points(device):
    tree = build_tree(device, sphere(), 8)
    phi_B = boundary_field(device, tree, on_sphere)
    assert fluence_at(device, tree, phi_B, np.zeros((0, 3))).shape == (0, 3)


def test_boundary_points_lie_on_the_surface(double):
    for resolution, bound in ((16, 0.06), (32, 0.015)):
        points, normals = boundary_points(build_tree(double, sphere(10, 6), resolution))
        radius = np.linalg.norm(points, axis=1)
        assert np.abs(radius - 10).max() <= bound
        assert ((points / radius[:, None] * normals).sum(axis=1) > 0.9).all()
