"""Painted surfaces: files give their colours, colours give the albedo that shows them, and go inward."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from clsss import request
from clsss.errors import InputError
from clsss.exposure import display_scale
from clsss.lights import DirectionalLight
from clsss.materials import Material, diffuse_reflectance, material
from clsss.mesh import load_mesh
from clsss.paint import Inward, read_colours
from clsss.simulate import simulate
from clsss.srgb import srgb_decode
from tests.test_volumes import options


def painted(path):
    """A ball whose red follows x, green and blue 0; the file is written and its (vertices, bytes) returned."""
    ball = trimesh.creation.icosphere(2, 5.0)
    colours = np.zeros((len(ball.vertices), 4), np.uint8)
    colours[:, 0], colours[:, 3] = np.rint(255 * (ball.vertices[:, 0] + 5) / 10), 255
    ball.visual.vertex_colors = colours
    ball.export(path)
    return ball.vertices, colours[:, :3] / 255


@pytest.mark.parametrize("suffix", ["ply", "obj", "glb"])
def test_vertex_colours_are_linear(tmp_path, suffix):
    path = tmp_path / f"größe.{suffix}"
    vertices, stored = painted(path)
    found_at, found = read_colours(path)
    np.testing.assert_allclose(found_at, vertices, atol=1e-6)
    np.testing.assert_allclose(found, stored if suffix == "glb" else srgb_decode(stored), atol=1e-6)


def test_a_texture_counts_as_paint(tmp_path):
    image = pytest.importorskip("PIL.Image")
    ball = trimesh.creation.icosphere(2, 1.0)
    ramp = image.fromarray(np.tile(np.arange(256, dtype=np.uint8), (256, 1))).convert("RGB")
    uv = ball.vertices[:, :2] * 0.49 + 0.5
    ball.visual = trimesh.visual.TextureVisuals(uv=uv, image=ramp)
    ball.export(tmp_path / "a.glb")
    at, colours = read_colours(tmp_path / "a.glb")
    np.testing.assert_allclose(colours[:, 1], srgb_decode(at[:, 0] * 0.49 + 0.5), atol=0.02)


def test_every_part_of_a_scene_counts_by_what_it_has(tmp_path):
    """A texture, a base colour, vertex colours, and nothing: white."""
    image = pytest.importorskip("PIL.Image")
    visual, pbr = trimesh.visual, trimesh.visual.material.PBRMaterial
    grey = image.new("RGB", (4, 4), (188, 188, 188))
    looks = [
        visual.TextureVisuals(np.full((8, 2), 0.5), pbr(baseColorTexture=grey)),
        visual.TextureVisuals(None, pbr(baseColorFactor=[51, 102, 153, 255])),
        visual.ColorVisuals(vertex_colors=np.tile(np.array([102, 51, 0, 255], np.uint8), (8, 1))),
        None,
    ]
    scene = trimesh.Scene()
    for k, look in enumerate(looks):
        scene.add_geometry(trimesh.Trimesh(*_box(), visual=look, process=False),
                           transform=trimesh.transformations.translation_matrix((3 * k, 0, 0)))  # fmt: skip
    scene.export(tmp_path / "a.glb")
    at, colours = read_colours(tmp_path / "a.glb")
    half = srgb_decode(188 / 255)
    for k, colour in enumerate([(half, half, half), (0.2, 0.4, 0.6), (0.4, 0.2, 0), (1, 1, 1)]):
        part = np.abs(at[:, 0] - 3 * k) < 1
        assert np.count_nonzero(part) == 8
        np.testing.assert_allclose(colours[part], np.tile(colour, (8, 1)), atol=1e-6)


def _box():
    box = trimesh.creation.box()
    return box.vertices, box.faces


def test_a_saved_bake_can_be_paint(tmp_path):
    """Colours beside a material, as modelling programs write them too."""
    mesh = load_mesh(trimesh.creation.icosphere(3, 5.0))
    result = simulate(mesh, material("marble"), [DirectionalLight((0, 0, 1))], resolution=16)
    result.save(tmp_path / "a.glb")
    _, colours = read_colours(tmp_path / "a.glb")
    shown = np.clip(result.vertex_radiosity * display_scale(mesh, result.vertex_radiosity), 0, 1)
    np.testing.assert_allclose(colours, shown, atol=1e-6)


def test_no_colours_is_said(tmp_path):
    trimesh.creation.box().export(tmp_path / "a.ply")
    with pytest.raises(InputError, match=r"a\.ply: has neither"):
        read_colours(tmp_path / "a.ply")
    (tmp_path / "b.ply").write_text("junk")
    with pytest.raises(InputError, match=r"b\.ply: its colours cannot be read"):
        read_colours(tmp_path / "b.ply")


@pytest.mark.parametrize("eta", [1.0, 1.4])
def test_paint_reflects_its_colour(eta):
    colours = np.array([[0.05, 0.3, 0.9], [0.5, 0.7, 0.2]])
    base = Material(0.01, (1, 2, 3), 0.5, eta)
    medium = Inward.painted(np.eye(3)[:2], colours, base)
    reduced = (1 - medium.g) * medium.sigma_s
    sigma_tr = medium.sigma_a + reduced
    np.testing.assert_allclose(sigma_tr, np.tile(base.sigma_tr, (2, 1)))
    np.testing.assert_allclose(diffuse_reflectance(reduced / sigma_tr, eta), colours, rtol=1e-4)


def test_black_and_white_paint_are_media():
    medium = Inward.painted([[0, 0, 0], [1, 0, 0]], [[0, 0, 0], [1, 1, 1]], material("marble"))
    reduced = (1 - medium.g) * medium.sigma_s
    found = diffuse_reflectance(reduced / (medium.sigma_a + reduced), medium.eta)
    np.testing.assert_allclose(found, np.array([[0.01], [0.98]]) * np.ones(3), rtol=1e-3)


def test_coefficients_are_those_of_the_nearest_point():
    a, b = Material(0.1, 1.0, 0.2, 1.2), Material(0.3, 5.0, 0.6, 1.4)
    medium = Inward.blend([[0, 0, 0], [2, 0, 0], [9, 0, 0]], [0, 0.5, 1], a, b)
    sigma_a, sigma_s = medium.coefficients(np.array([[0.4, 0.2, 0], [1.7, 1, 0], [8, 0, 3]]))
    np.testing.assert_allclose(sigma_a[:, 0], [0.1, 0.2, 0.3])
    np.testing.assert_allclose((1 - medium.g) * sigma_s[:, 0], [0.8, 1.4, 2.0])
    assert (medium.g, medium.eta) == (pytest.approx(0.4), pytest.approx(1.3))
    assert not medium.homogeneous


def test_points_and_coefficients_belong_together():
    with pytest.raises(InputError, match="sigma_a: needs shape"):
        Inward(np.zeros((2, 3)), np.zeros((1, 3)), np.ones((2, 3)))
    for points, says in ((None, "shape"), (np.zeros(3), "shape"), ([[0, 0, 0], [1]], "an array of numbers")):
        with pytest.raises(InputError, match=f"points: needs .*{says}"):
            Inward(points, np.zeros((1, 3)), np.ones((1, 3)))
    with pytest.raises(InputError, match="weight: needs an array of numbers, got 'half'"):
        Inward.blend(np.zeros((1, 3)), "half", material("marble"), material("skin1"))


@pytest.mark.parametrize("words", [(), ("marble", "ketchup")])
def test_options_paint_the_mesh_at_its_size(tmp_path, words):
    path = tmp_path / "a.ply"
    painted(path)
    mesh = load_mesh(path, size=40)
    args = options("", vertex_colours=words, mesh=str(path))
    medium = request.medium_from(args, mesh)
    red, black = (medium.coefficients(np.array([[x, 0.0, 0.0]])) for x in (20, -20))
    assert medium.points.max() == pytest.approx(20, rel=0.01)
    if words:
        np.testing.assert_allclose(black[0][0], material("marble").sigma_a, rtol=1e-3)
        assert red[0][0, 1] > 10 * black[0][0, 1]
    else:
        assert red[0][0, 0] < red[0][0, 1]
        np.testing.assert_allclose(black[0][0, 0], red[0][0, 1], rtol=0.2)
