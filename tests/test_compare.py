"""The comparison: right scores for known differences, a table, and a picture."""

from __future__ import annotations

import functools
from types import SimpleNamespace

import numpy as np
import pytest
import trimesh

from clsss.camera import Camera, fitted
from clsss.compare import Comparison, Score, compare, noise_of
from clsss.comparison_picture import RANGE, colours, interpolated, picture
from clsss.dipole import dipole
from clsss.errors import DeviceError, InputError
from clsss.lights import DirectionalLight, Emission
from clsss.materials import Material
from clsss.media import Mix, Perlin
from clsss.mesh import load_mesh
from clsss.montecarlo import estimate

LIGHTS = [DirectionalLight((0, 0, -1))]


@functools.cache
def ball():
    return load_mesh(trimesh.creation.icosphere(3, 5.0))


def stand_in(medium, radiosity=None, lights=LIGHTS, blockers=()):
    """What `compare` needs of a result; without radiosity, ours is the dipole."""
    values = dipole(ball(), medium, lights, blockers=blockers) if radiosity is None else radiosity
    report = {"device": "", "seconds": {"total": 1.5}}
    return SimpleNamespace(
        mesh=ball(), medium=medium, lights=lights, blockers=blockers, vertex_radiosity=values, report=report
    )


@pytest.mark.parametrize("eta", [1.0, 1.4])
def test_same_radiosity_gets_the_same_score(eta):
    c = compare(stand_in(Material(0.02, 2.0, eta=eta)), 100, 50)
    ours, other = c.scores
    assert (ours.name, other.name) == ("clsss", "dipole")
    assert ours.rms == other.rms < 0.5
    assert ours.seconds == 1.5
    assert 0 < c.noise < 0.3
    assert len(c.points) == len(c.truth) == 100
    lines = c.table().splitlines()
    assert len(lines) == 5
    assert lines[1].startswith("clsss")
    assert "100 points" in lines[-1]


def test_noise_that_hides_an_error_is_said():
    """Ours is Monte Carlo itself with other chances: all that its rms shows is noise."""
    medium = Material(0.02, 2.0)
    same = estimate(ball(), medium, LIGHTS, 300, seed=1).radiosity
    c = compare(stand_in(medium, same), 200, 30)
    ours, other = c.scores
    (bound, told), (beyond, clear) = c.beyond(ours), c.beyond(other)
    assert not told
    assert ours.rms < 1.3 * c.noise
    assert clear
    assert beyond == pytest.approx(np.sqrt(other.rms**2 - c.noise**2))
    exact = compare(stand_in(medium, same), 200, 1000)
    assert exact.scores[0].rms < 0.7 * bound
    assert abs(ours.bias) < 3 * c.bias_noise
    assert c.table().count("hides") == 1
    assert "hides how far clsss" in c.table()
    assert f"< {bound:.2%}" in c.table()


def test_noise_is_that_of_channels_which_share_their_paths():
    """n points of one standard error s: rms s; of the sum, whose channels are off together, s / sqrt(n)."""
    truth, stderr = np.full((100, 3), 2.0), np.full((100, 3), 0.1)
    np.testing.assert_allclose(noise_of(truth, stderr), (0.05, 0.05 / 10, 2 * np.sqrt(2 / 100) * 0.05**2))


def test_blockers_are_compared():
    plate = load_mesh(trimesh.creation.box((20, 20, 1)).apply_translation((10, 0, 9)))
    medium = Material(0.02, 2.0)
    free = dipole(ball(), medium, LIGHTS)
    c = compare(stand_in(medium, free, blockers=(plate,)), 100, 50)
    ours, other = c.scores
    assert ours.bias > 0.5
    assert abs(other.bias) < 0.25


def test_emission_is_compared_with_monte_carlo_alone():
    c = compare(stand_in(Material(0.02, 2.0), np.ones((len(ball().vertices), 3)), [Emission(0.6)]), 50, 20)
    assert [s.name for s in c.scores] == ["clsss"]
    assert "not Emission" in c.table()
    assert c.truth.mean() == pytest.approx(0.6 * 5 / 3, rel=0.2)


def test_media_that_vary_leave_the_dipole_out():
    medium = Mix(Material(0.02, 2.0), Material(0.1, 1.0), Perlin(2.0))
    c = compare(stand_in(medium, np.ones((len(ball().vertices), 3))), 20, 20)
    assert list(c.radiosity) == ["clsss"]
    assert "no dipole" in c.table()


def test_no_points_is_refused():
    with pytest.raises(InputError, match="n_points"):
        compare(stand_in(Material(0.02, 2.0)), 0, 1)


def made_up():
    values, points = np.ones((len(ball().vertices), 3)), np.arange(0, len(ball().vertices), 3)
    scores = [Score("clsss", 0.1, 0.2, 0.1, 1.0), Score("dipole", 0.2, 0.4, -0.2, 2.0)]
    truth = np.ones((len(points), 3))
    return Comparison(
        ball(), {"clsss": 1.1 * values, "dipole": 0.8 * values}, points, truth, 0 * truth, scores, 0.0, 0.0, 0.0, 3.0
    )


def test_monte_carlo_is_interpolated_between_its_points():
    c = made_up()
    np.testing.assert_allclose(interpolated(c), 1)
    linear = c.mesh.vertices[c.points]
    near = interpolated(Comparison(**{**c.__dict__, "truth": linear}))
    np.testing.assert_allclose(near[c.points], linear, atol=1e-6)
    mesh = SimpleNamespace(vertices=np.diag([0.0, 1, 2]), normals=np.tile([0, 0, 1.0], (3, 1)), size=1.0)
    found = interpolated(SimpleNamespace(mesh=mesh, points=np.array([1, 2]), truth=np.array([[5.0], [10.0]])))
    assert found[0] == pytest.approx((5 / 1 + 10 / 4) / (1 / 1 + 1 / 4))  # by inverse squares of 1 and 2


def test_colours_are_white_at_zero_and_stop_at_the_range():
    low, none, high = colours(np.array([-2 * RANGE, 0, 2 * RANGE]))
    assert np.ptp(none) == 0
    assert low[2] > low[0]
    assert high[0] > high[2]


def test_picture_shows_all_panels():
    from clsss.opengl import standalone_context
    from clsss.renderer import Renderer

    try:
        renderer = Renderer(standalone_context())
    except DeviceError as error:
        pytest.skip(str(error))
    camera = fitted(ball().vertices, Camera(np.zeros(3), 1.0, -25.0, 12.0, "y"), 1.0)
    image = picture(made_up(), renderer, camera, (120, 120))
    assert image.shape == (308, 360, 3)
    middle = {
        (row, column): image[34 + 60 + 154 * row, 60 + 120 * column].astype(int)
        for row in (0, 1)
        for column in (0, 1, 2)
    }
    assert middle[1, 0][0] > middle[1, 0][2] + 20  # ours is brighter: red
    assert middle[1, 1][2] > middle[1, 1][0] + 20  # the dipole is darker: blue
    assert middle[0, 0].min() > middle[0, 1].min()
    assert image[34 + 154 + 60 + 5, 240 + 45 : 240 + 75].std() > 1  # the colour bar
