"""The demonstration mesh has the features it is there to show."""

import numpy as np
import pytest

from clsss.demo import demo_mesh
from clsss.mesh import RayCaster, contains, load_mesh


@pytest.fixture(scope="module")
def elephant():
    return demo_mesh()


@pytest.fixture(scope="module")
def solid(elephant):
    return load_mesh(elephant, size=100.0)


def test_closed_with_a_handle_and_a_cavity(elephant, solid):
    assert solid.closed
    assert solid.report["closed"]
    assert solid.report["repairs"] == []
    assert 20_000 < len(solid.faces) < 60_000
    bodies = sorted(elephant.split(only_watertight=False), key=lambda body: body.volume)
    assert [body.euler_number for body in bodies] == [2, 0]  # a ball, and one handle
    assert bodies[0].volume < 0 < bodies[1].volume


def test_stands_upright(solid):
    low, high = solid.bounds
    assert low[1] == pytest.approx(0.0, abs=0.5)
    assert high[1] > 60


def test_triangles_are_well_shaped(elephant):
    smallest = np.rad2deg(elephant.face_angles.min(axis=1))
    assert smallest.min() > 10
    assert np.percentile(smallest, 1) > 25


def test_some_parts_are_thin_and_others_thick(solid):
    """Distance through the solid from each face along its inward normal, against the size of 100."""
    corners = solid.vertices[solid.faces]
    centres = corners.mean(axis=1)
    inward = -np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    inward /= np.linalg.norm(inward, axis=1)[:, None]
    thickness, _ = RayCaster(solid.triangles).hit(centres + 0.05 * inward, inward)
    assert 0.05 < np.mean(thickness < 100 / 30) < 0.5
    assert np.percentile(thickness, 90) > 20


def test_points_are_inside_in_proportion_to_the_volume(solid):
    low, high = solid.bounds
    points = np.random.default_rng(1).uniform(low, high, (4000, 3))
    a, b, c = np.moveaxis(solid.triangles, 1, 0)
    volume = np.einsum("ij,ij", a, np.cross(b, c)) / 6
    assert contains(solid, points).mean() * np.prod(high - low) == pytest.approx(volume, rel=0.1)


def test_same_every_time(elephant):
    again = demo_mesh()
    np.testing.assert_array_equal(again.vertices, elephant.vertices)
    np.testing.assert_array_equal(again.faces, elephant.faces)
