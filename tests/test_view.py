"""The picture: its colours are the radiosity, the mesh is in its middle; the viewer's options and thread."""

from __future__ import annotations

import argparse
import itertools
import queue
import threading
from types import SimpleNamespace

import numpy as np
import pytest

from clsss import grammar, scenefile, view
from clsss.baker import GLANCE, LOOK, Baker, View
from clsss.camera import Camera, fitted
from clsss.errors import DeviceError
from clsss.exposure import display_scale
from clsss.lights import DirectionalLight
from clsss.overlay import panel
from clsss.srgb import srgb_encode
from clsss.window import Window, rotation, turned

SIZE = (160, 90)
LOOKING = SimpleNamespace(camera=(0, 0, 1), up="y")


@pytest.fixture(scope="module")
def renderer():
    pytest.importorskip("moderngl")
    from clsss.opengl import standalone_context
    from clsss.renderer import Renderer

    try:
        return Renderer(standalone_context())
    except DeviceError as error:
        pytest.skip(str(error))


@pytest.fixture(scope="module")
def square():
    """Two triangles that face +z, 2 mm wide."""
    vertices = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], float)
    return SimpleNamespace(
        vertices=vertices,
        faces=np.array([[0, 1, 2], [0, 2, 3]], np.int32),
        normals=np.tile([0, 0, 1.0], (4, 1)),
    )


def front(mesh):
    return fitted(mesh.vertices, Camera(np.zeros(3), 1.0, 0, 0), SIZE[0] / SIZE[1])


def test_background_alone(renderer):
    picture = renderer.picture(SIZE, None)
    assert picture.shape == (SIZE[1], SIZE[0], 3)
    assert picture.min() > 10
    assert picture.max() < 80


def test_pictures_that_opengl_cannot_hold_are_refused(renderer):
    with pytest.raises(DeviceError, match=r"cannot hold a picture of 100000 x 16 pixels .*; make it smaller"):
        renderer.picture((100000, 16), None)
    assert renderer.picture(SIZE, None).shape == (SIZE[1], SIZE[0], 3)


def test_grey_before_the_bake(renderer, square):
    renderer.set_mesh(square)
    middle = renderer.picture(SIZE, front(square))[45, 80].astype(int)
    assert np.ptp(middle) <= 1
    assert middle[0] > 120


@pytest.mark.parametrize("exposure", [0, -2])
def test_pixels_are_the_radiosity(renderer, square, exposure):
    radiosity, scale = np.array([0.05, 0.2, 0.399]), 2.0  # up to 0.8 of white
    renderer.set_mesh(square)
    renderer.set_radiosity(np.tile(radiosity, (4, 1)), scale)
    picture = renderer.picture(SIZE, front(square), exposure).astype(int)
    expected = 255 * srgb_encode(radiosity * scale * 2.0**exposure)
    assert np.abs(picture[30:60, 60:100] - expected).max() <= 1
    assert picture[2, 2].max() < 80  # background in the corner


def test_radiosity_is_linear_across_triangles(renderer, square):
    renderer.set_mesh(square)
    renderer.set_radiosity(np.where(square.vertices[:, :1] > 0, 0.6, 0.2) * np.ones(3), 1.0)
    picture = renderer.picture(SIZE, front(square)).astype(int)
    assert np.abs(picture[20:70, 79:81] - 255 * srgb_encode(np.float64(0.4))).max() <= 2
    assert np.all(np.diff(picture[45, 50:110, 0]) >= -1)


def test_highlights_keep_their_hue_and_never_clip(renderer, square):
    renderer.set_mesh(square)
    values = []
    for strength in (1, 2, 4, 8):
        renderer.set_radiosity(np.tile([strength, strength / 2, strength / 4], (4, 1)), 1.0)
        values.append(renderer.picture(SIZE, front(square))[45, 80].astype(int))
    assert all(r > g > b for r, g, b in values)
    assert all(a[2] < b[2] for a, b in itertools.pairwise(values))
    peak = 4.0  # Khronos PBR Neutral above its knee
    top = 1 - 0.2**2 / (peak + 0.2 - 0.8)
    white = 1 - 1 / (0.15 * (peak - top) + 1)
    expected = (1 - white) * top * np.array([1, 0.5, 0.25]) + white * top
    np.testing.assert_allclose(values[2], 255 * srgb_encode(expected), atol=1)


def test_nan_is_black(renderer, square):
    renderer.set_mesh(square)
    renderer.set_radiosity(np.full((4, 3), np.nan), 1.0)
    assert renderer.picture(SIZE, front(square))[45, 80].max() <= 1


@pytest.mark.parametrize("up", ["y", "z"])
@pytest.mark.parametrize("angles", [(0, 0), (30, 15), (200, -70)])
def test_a_fitted_mesh_fills_the_picture_and_nothing_is_cut(up, angles):
    points = np.random.default_rng(1).normal(size=(500, 3)) * (1, 5, 2) + 40
    camera = fitted(points, Camera(np.zeros(3), 1.0, *angles, up), 16 / 9)
    clip = np.hstack([points, np.ones((500, 1))]) @ camera.matrix(16 / 9, 60).T
    seen = np.abs(clip[:, :3] / clip[:, 3:])
    assert seen.max() < 1
    assert seen[:, :2].max() == pytest.approx(0.88, abs=1e-9)


def test_near_and_far_planes_hold_the_ball_that_is_asked_for():
    camera = Camera(np.array([3.0, 4, 5]), 100.0, 30, 15)
    ends = camera.target + np.outer([20.0, -20.0], camera.axes()[2])
    clip = np.hstack([ends, np.ones((2, 1))]) @ camera.matrix(1.5, 20.0).T
    np.testing.assert_allclose(clip[:, 2] / clip[:, 3], (-1, 1), rtol=1e-9)


def test_orbits_end_before_the_camera_tips_over():
    """Where the options end, too, so that what is seen can be kept."""
    for over, most in ((1000, 89), (-1000, -89)):
        assert Camera(np.zeros(3), 1.0).orbited(0, over).elevation == most
        assert grammar.camera(f"0,{most}")[1] == most


def test_axes_are_right_handed_and_up_is_up():
    for up, axis in (("y", 1), ("z", 2)):
        axes = Camera(np.zeros(3), 1.0, 50, 20, up).axes()
        np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-15)
        assert np.linalg.det(axes) == pytest.approx(1)
        assert axes[0, axis] == 0
        assert axes[1, axis] > 0.9
    np.testing.assert_allclose(Camera(np.zeros(3), 1.0, 0, 0, "z").axes()[2], (0, -1, 0))


def test_zoom_and_pan_move_as_asked():
    """Twice as near; a picture's height to the right and half of one up."""
    camera = Camera(np.zeros(3), 100.0, 50, 20)
    assert camera.zoomed(2.0).distance == 50.0
    height = 2 * 100 * np.tan(np.radians(16.0))
    right, over, _ = camera.axes()
    np.testing.assert_allclose(camera.panned(1.0, 0.5).target, height * (right + over / 2))


def test_lights_turn_around_the_mesh():
    from clsss.lights import DirectionalLight, EnvironmentLight, PointLight

    quarter = rotation(np.array([0, 0, 1.0]), np.pi / 2)
    centre = np.array([1.0, 1, 0])
    np.testing.assert_allclose(turned(DirectionalLight((1, 0, 0), 3), quarter, centre).direction, (0, 1, 0), atol=1e-15)
    np.testing.assert_allclose(turned(PointLight((3, 1, 0)), quarter, centre).position, (1, 3, 0), atol=1e-15)
    sky = EnvironmentLight(1.0)
    assert turned(sky, quarter, centre) is sky


def test_the_light_can_be_asked_for_while_the_first_bake_runs(monkeypatch):
    """It says from when on; until then dragging turns the camera."""
    glfw = pytest.importorskip("glfw")
    monkeypatch.setattr(glfw, "get_mouse_button", lambda window, button: int(button == glfw.MOUSE_BUTTON_LEFT))
    monkeypatch.setattr(glfw, "get_key", lambda window, key: glfw.RELEASE)
    window = Window.__new__(Window)
    window.camera, window.view, window.moves_light, window.pointer = Camera(np.zeros(3), 1.0), None, False, (0, 0)
    window.args = SimpleNamespace(lights=[grammar.light("env:1")], up="y")
    window._typed("L")
    assert (window.message, window.moves_light) == ("light from all around cannot be turned", False)
    window.args.lights.append(grammar.light("directional:0,0,1"))
    window.renderer = SimpleNamespace(mesh=SimpleNamespace(bounds=np.array([[-1.0] * 3, [1.0] * 3])))
    window.lights, window.baker = [], SimpleNamespace(wishes=queue.SimpleQueue())
    window._typed("L")
    assert window.message == "drag turns the light as soon as it is baked"
    window._dragged(None, 10, 0)
    assert (window.camera.azimuth, window.baker.wishes.empty()) == (-4, True)
    monkeypatch.setattr(window.renderer, "set_radiosity", lambda radiosity, scale: None, raising=False)
    window._take(View(SimpleNamespace(lights=(DirectionalLight((0, 0, 1)),)), None, 1.0))
    assert window.message == "drag turns the light"
    window._dragged(None, 20, 0)
    assert window.camera.azimuth == -4
    assert window.baker.wishes.get()[0].direction[2] < 1


@pytest.fixture
def window(monkeypatch):
    """One without a screen, whose mouse holds the button that `pressed` names."""
    glfw = pytest.importorskip("glfw")
    window = Window.__new__(Window)
    monkeypatch.setattr(glfw, "get_mouse_button", lambda _, button: int(button == window.pressed))
    monkeypatch.setattr(glfw, "get_key", lambda _, key: glfw.RELEASE)
    monkeypatch.setattr(glfw, "get_window_size", lambda _: (800, 400))
    window.pressed, window.window, window.pointer = glfw.MOUSE_BUTTON_RIGHT, None, (0, 0)
    window.camera, window.exposure, window.moves_light = Camera(np.zeros(3), 100.0, 30, 10), 0.0, False
    window.view, window.lights = View(None, None, 1.0), [DirectionalLight(-window.camera.axes()[2])]
    window.baker = SimpleNamespace(wishes=queue.SimpleQueue())
    window.renderer = SimpleNamespace(mesh=SimpleNamespace(bounds=np.array([[-1.0] * 3, [1.0] * 3])))
    return window


def test_the_mesh_stays_under_the_pointer_and_the_wheel_brings_it_nearer(window):
    before = window.camera
    window._dragged(None, 100, 40)
    np.testing.assert_allclose(window.camera.target, before.panned(-0.25, 0.1).target)
    window._scrolled(None, 0, 1)
    assert window.camera.distance == pytest.approx(100 / 1.12)


def test_the_lamp_follows_the_pointer(window):
    """Light that comes from the camera comes from the right and from below after a drag to the lower right."""
    window.pressed, window.moves_light = pytest.importorskip("glfw").MOUSE_BUTTON_LEFT, True
    window._dragged(None, 50, 25)
    (light,) = window.baker.wishes.get()
    right, over, nearer = -light.direction @ window.camera.axes().T
    assert right == pytest.approx(np.sin(np.radians(20)))
    assert (over / nearer) == pytest.approx(-np.tan(np.radians(10)))
    assert window.turned


def test_keys_change_the_exposure_by_a_quarter_stop(window):
    for letter, stops in (("+", 0.25), ("=", 0.5), ("-", 0.25), ("_", 0.0)):
        window._typed(letter)
        assert window.exposure == stops


def test_overlay_grows_with_its_text_and_its_bar_with_progress():
    short, long = panel(["a"]), panel(["a", "key\tmeaning that is long"])
    assert long.shape > short.shape
    assert short.shape[2] == 4
    filled = [
        np.count_nonzero((panel(["solve"], fraction=f)[..., :3] == (226, 160, 92)).all(axis=2)) for f in (0.1, 0.9)
    ]
    assert filled[1] > 5 * filled[0]


def test_baker_reports_mesh_then_results_and_takes_the_last_lights(monkeypatch):
    def result(lights):
        return SimpleNamespace(lights=lights, relight=lambda new, progress: result(new), vertex_radiosity=None,
                               vertex_radiosity_single=None, mesh=None)  # fmt: skip

    monkeypatch.setattr("clsss.baker.load", lambda args: "mesh")
    monkeypatch.setattr("clsss.baker.bake", lambda args, mesh, progress: progress("solve", 0.5) or result("first"))
    monkeypatch.setattr("clsss.baker.display_scale", lambda mesh, radiosity, towards: 1.0)
    baker = Baker(LOOKING, lambda: None)
    for lights in ("dropped", "last", None):  # None: the camera alone has moved since
        baker.wishes.put(lights)
    baker.start()
    assert baker.events.get(timeout=60) == "mesh"
    assert [baker.events.get(timeout=60).result.lights for _ in range(2)] == ["first", "last"]


def test_baker_hands_over_its_error(monkeypatch):
    monkeypatch.setattr("clsss.baker.load", lambda args: [][0])
    baker = Baker(LOOKING, threading.Event().set)
    baker.start()
    assert isinstance(baker.events.get(timeout=60), IndexError)


@pytest.mark.parametrize("text", ["1", "1,2,3,4", "0,90", "0,0,0", "a,b"])
def test_bad_camera(text):
    with pytest.raises(argparse.ArgumentTypeError):
        grammar.camera(text)


@pytest.mark.parametrize("text", ["", "12", "1x1", "800x99999", "axb"])
def test_bad_window_size(text):
    with pytest.raises(argparse.ArgumentTypeError):
        grammar.window_size(text)


def test_screenshot_of_the_demonstration_mesh(tmp_path):
    pytest.importorskip("clsss.simulate")
    pytest.importorskip("clsss.demo")
    image = pytest.importorskip("PIL.Image")
    words = [
        "demo",
        "--screenshot",
        str(tmp_path / "größe 1.png"),
        "--window-size",
        "160x90",
        "--resolution",
        "16",
    ]
    args = scenefile.parse(view._parser(), [*words, "--quiet"])
    try:
        view.screenshot(args)
    except DeviceError as error:
        pytest.skip(str(error))
    with image.open(tmp_path / "größe 1.png") as picture:
        assert picture.size == (160, 90)
        assert np.asarray(picture).max() > 120


def test_far_from_the_origin_the_picture_is_the_same(renderer, square):
    pictures = []
    for offset in (0.0, 1e7):
        moved = SimpleNamespace(**{**vars(square), "vertices": square.vertices + offset})
        renderer.set_mesh(moved)
        renderer.set_radiosity(np.where(square.vertices[:, :1] > 0, 0.6, 0.2) * np.ones(3), 1.0)
        pictures.append(renderer.picture(SIZE, front(moved)).astype(int))
    assert np.abs(pictures[1] - pictures[0]).max() <= 1


def test_exposure_follows_the_camera(monkeypatch, square):
    """As a bake has it that starts where the camera is now: a closed window's scene file shows what the window did."""
    bright, dark = np.full((4, 3), 0.5), np.full((4, 3), 0.05)
    box = SimpleNamespace(
        vertices=np.vstack([square.vertices, square.vertices]),
        faces=np.vstack([square.faces, square.faces[:, ::-1] + 4]),
    )
    baked = SimpleNamespace(mesh=box, lights=(), vertex_radiosity=np.vstack([bright, dark]),
                            vertex_radiosity_single=None)  # fmt: skip
    monkeypatch.setattr("clsss.baker.load", lambda args: "mesh")
    monkeypatch.setattr("clsss.baker.bake", lambda args, mesh, progress: baked)
    baker = Baker(LOOKING, lambda: None)
    baker.start()
    assert baker.events.get(timeout=60) == "mesh"
    front = baker.events.get(timeout=60)
    assert front.scale == pytest.approx(display_scale(box, baked.vertex_radiosity, np.array([0, 0, 1.0])))
    baker.camera = baker.camera.orbited(180, 0)
    baker.wishes.put(None)
    back = baker.events.get(timeout=60)
    assert back.result is baked
    assert back.scale == pytest.approx(10 * front.scale)


def test_what_is_scattered_once_follows_the_camera(monkeypatch):
    """A glance as soon as the eye has moved, then a longer look; the lights are not solved again."""
    def radiance(eye, depths, least_cosine):
        return np.full((4, 3), round(eye[0]) + depths)

    baked = SimpleNamespace(lights=(), vertex_radiosity=None, vertex_radiosity_single=np.zeros((4, 3)),
                            radiance=radiance, mesh=None)  # fmt: skip
    monkeypatch.setattr("clsss.baker.display_scale", lambda mesh, radiosity, towards: 1.0)
    monkeypatch.setattr("clsss.baker.load", lambda args: "mesh")
    monkeypatch.setattr("clsss.baker.bake", lambda args, mesh, progress: baked)
    baker = Baker(LOOKING, lambda: None)
    baker.start()
    assert baker.events.get(timeout=60) == "mesh"
    seen = [baker.events.get(timeout=60).radiosity[0, 0] / np.pi for _ in range(2)]
    np.testing.assert_allclose(seen, [GLANCE, LOOK])
    baker.camera = Camera(np.array([100.0, 0, 0]), 0.0)
    baker.wishes.put(None)
    seen = [baker.events.get(timeout=60).radiosity[0, 0] / np.pi for _ in range(2)]
    np.testing.assert_allclose(seen, [100 + GLANCE, 100 + LOOK])
