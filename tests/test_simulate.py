"""The whole pipeline against exact solutions and path tracing, its report, and what it refuses."""

from __future__ import annotations

import dataclasses
import json
import threading
import warnings

import cases
import numpy as np
import pytest
import trimesh
from shapes import ROTATION, box, box_triangles, hollow_sphere, relative_rms, solid, sphere, torus

import clsss
from clsss.analytic import slab
from clsss.device import Buffer, Device, open_device
from clsss.errors import DeviceError, InputError
from clsss.fresnel import fresnel_A, fresnel_transmittance
from clsss.lights import DirectionalLight, Emission, EnvironmentLight, PointLight
from clsss.materials import Material
from clsss.simulate import simulate

MARBLE = Material.from_reduced(sigma_a=(0.0021, 0.0041, 0.0071), sigma_s_prime=(2.19, 2.62, 3.0), eta=1.5)
SUN = DirectionalLight((0.3, -1.0, 0.2), irradiance=(1.0, 0.9, 0.7))


@pytest.fixture(scope="module")
def small():
    """A marble sphere, coarsely."""
    return simulate(sphere(subdivisions=4), MARBLE, [SUN], resolution=24)


@pytest.fixture(scope="module", params=[1.0, 1.37], ids=["matched", "fresnel"])
def wide_slab(request):
    """A slab of 4 mm lit from above, so wide that its middle knows nothing of the sides, turned off the grid."""
    medium = Material(sigma_a=(0.05, 0.1, 0.3), sigma_s=(2.0, 1.5, 1.0), eta=request.param)
    result = simulate(box((24, 24, 4), ROTATION), medium, [DirectionalLight(-ROTATION[:, 2])], resolution=100,
                      tolerance=1e-5, precision="double")  # fmt: skip
    T = float(fresnel_transmittance(1.0, request.param))
    A = fresnel_A(request.param)
    exact = [slab(4.0, a, s, fresnel_A=A) for a, s in zip(medium.sigma_a, medium.sigma_s, strict=True)]
    return result, exact, T


def in_slab(depths):
    rng = np.random.default_rng(11)
    local = np.stack([*rng.uniform(-2, 2, (2, len(depths))), 2 - depths], axis=1)
    return local @ ROTATION.T


@pytest.mark.parametrize(("first", "last", "bar"), [(0.3, 3.7, 0.01), (3.85, 3.98, 0.012)], ids=["inside", "cut cells"])
def test_slab_fluence(wide_slab, first, last, bar):
    """Also between the centroids of the cut cells, which are a third of a millimetre wide, and the far side."""
    result, exact, T = wide_slab
    depths = np.linspace(first, last, 40)
    found = result.fluence(in_slab(depths))
    for channel, solution in enumerate(exact):
        assert relative_rms(found[:, channel], T * solution.phi(depths)) <= bar


def test_slab_reflectance_and_transmittance(wide_slab):
    result, exact, T = wide_slab
    top, bottom = (result.radiosity(in_slab(np.full(30, depth))) for depth in (0.0, 4.0))
    for channel, solution in enumerate(exact):
        assert relative_rms(top[:, channel], T * solution.reflectance) <= 0.02
        assert relative_rms(bottom[:, channel], T * solution.transmittance) <= 0.02
        assert top[:, channel].mean() == pytest.approx(T * solution.reflectance, rel=0.01)
        assert bottom[:, channel].mean() == pytest.approx(T * solution.transmittance, rel=0.01)


def test_an_index_below_that_around():
    """eta = 0.8, an air bubble's side: no light is totally reflected inside, and a beam enters with T(1)."""
    medium, eta = Material(sigma_a=0.1, sigma_s=1.5, eta=0.8), 0.8
    result = simulate(box((24, 24, 4)), medium, [DirectionalLight((0, 0, -1))], resolution=80)
    exact, T = slab(4.0, 0.1, 1.5, fresnel_A=fresnel_A(eta)), float(fresnel_transmittance(1.0, eta))
    for z, expected in ((2.0, exact.reflectance), (-2.0, exact.transmittance)):
        assert result.radiosity([[0.3, 0.2, z]])[0, 0] == pytest.approx(T * expected, rel=0.01)
    energy = result.report["energy"]
    np.testing.assert_allclose(np.add(energy["absorbed_W"], energy["exited_W"]), energy["deposited_W"], rtol=1e-3)


@pytest.mark.parametrize("phase", ["delta-eddington", "p1"])
def test_light_goes_deeper_the_more_forward_it_scatters(phase):
    """g = 0, 0.5, 0.9 at one sigma_s: what comes through a slab rises."""
    media = [Material(0.02, 6.0, g=g, eta=1.3) for g in (0.0, 0.5, 0.9)]
    through = [simulate(box((12, 12, 3)), m, [DirectionalLight((0, 0, -1))], resolution=72,
                        phase=phase).radiosity([[0.1, 0.2, -1.5]])[0, 0] for m in media]  # fmt: skip
    assert 2 * through[0] < through[1] < through[2] / 2


@pytest.mark.parametrize("contrast", [10, 100])
def test_contrasts_converge(contrast):
    """Noise between a medium and one so many times as dense: in few cycles, and energy balances."""
    thin = Material(0.001, 0.3, eta=1.3)
    dense = Material(contrast * thin.sigma_a, contrast * thin.sigma_s, eta=1.3)
    result = simulate(sphere(subdivisions=4), clsss.Mix(thin, dense, clsss.Perlin(scale=4.0)), [SUN], resolution=40)
    report = result.report
    assert report["solve"]["converged"]
    assert report["solve"]["cycles"] <= {10: 12, 100: 25}[contrast]
    energy = report["energy"]
    np.testing.assert_allclose(np.add(energy["absorbed_W"], energy["exited_W"]), energy["deposited_W"], rtol=2e-3)


def test_doubts_are_told_once():
    """A bake of one object by several lights, and relighting it, warns one time."""
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        result = simulate(sphere(subdivisions=3), Material(0.5, 1.0), [SUN, PointLight((0, 20, 0), 5.0)], resolution=12)
        result.relight([SUN])
    assert [str(t.message) for t in told if t.category is clsss.DiffusionWarning] == [
        "diffusion is only approximate here: the reduced albedo is 0.67 in red, 0.67 in green, 0.67 in blue; "
        "it should be 0.9 or more"
    ]


def test_optically_thick_cells_keep_the_colour():
    """sigma_tr h of 5 in every channel: radiosity within 5 % of the exact, where the midpoint rule is 50 % off."""
    sigma = 5 * 48 / 24
    medium = Material(sigma_a=0.002 * sigma, sigma_s=0.998 * sigma)
    result = simulate(box((24, 24, 4), ROTATION), medium, [DirectionalLight(-ROTATION[:, 2])],
                      resolution=round(2 * np.ptp(box((24, 24, 4), ROTATION).bounds, axis=0).max()))  # fmt: skip
    exact = slab(4.0, 0.002 * sigma, 0.998 * sigma)
    top = result.radiosity(in_slab(np.zeros(50)))[:, 0]
    assert top.mean() == pytest.approx(exact.reflectance, rel=0.05)


@pytest.mark.parametrize("phase", ["similarity", "delta-eddington", "p1"])
def test_forward_scattering_by_every_phase(phase):
    """g = 0.8: each way to treat the forward peak against its own exact solution in a slab."""
    plate, medium = box((24, 24, 4), ROTATION), Material(sigma_a=0.05, sigma_s=4.0, g=0.8, eta=1.37)
    result = simulate(plate, medium, [DirectionalLight(-ROTATION[:, 2])], resolution=100, phase=phase)
    T = float(fresnel_transmittance(1.0, 1.37))
    exact = slab(4.0, 0.05, 4.0, g=0.8, fresnel_A=fresnel_A(1.37), phase=phase)
    depths = np.linspace(0.3, 3.7, 40)
    assert relative_rms(result.fluence(in_slab(depths))[:, 0], T * exact.phi(depths)) <= 0.02
    for depth, expected in ((0.0, exact.reflectance), (4.0, exact.transmittance)):
        found = result.radiosity(in_slab(np.full(30, depth)))[:, 0]
        assert relative_rms(found, T * expected) <= 0.03


def test_a_blocker_casts_its_shadow():
    """Half the slab lies under a board: dark far from the edge, lit as ever far on the other side."""
    medium, sun = Material(sigma_a=0.3, sigma_s=2.0), DirectionalLight((0, 0, -1))
    board = solid(box_triangles((16.0, 30.0, 0.5), (8.0, 0.0, 6.0)))
    open_, covered = (simulate(box((24, 24, 4)), medium, [sun], resolution=60, blockers=b) for b in ((), (board,)))
    y = np.linspace(-5, 5, 20)
    lit, dark = (np.stack([np.full(20, x), y, np.full(20, 2.0)], axis=1) for x in (-7.0, 7.0))
    np.testing.assert_allclose(covered.radiosity(lit), open_.radiosity(lit), rtol=1e-3)
    assert covered.radiosity(dark).max() <= 1e-3 * open_.radiosity(dark).min()


@pytest.mark.filterwarnings("ignore:diffusion is only approximate")
def test_blockers_may_be_flat_or_open():
    """A card shades as a board does; a tube without ends lets light through."""
    medium, sun = Material(sigma_a=0.3, sigma_s=2.0), DirectionalLight((0, 0, -1))
    board = solid(box_triangles((16.0, 30.0, 0.5), (8.0, 0.0, 6.0)))
    corners = np.array([[0, -15, 6], [16, -15, 6], [16, 15, 6], [0, 15, 6]], float)
    card = clsss.load_mesh(trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3]]), solid=False)
    tube = trimesh.creation.cylinder(9.0, 8.0)
    tube.update_faces(abs(tube.face_normals[:, 2]) < 0.5)
    tube.apply_translation((0, 0, 8.0))
    by = {name: simulate(box((24, 24, 4)), medium, [sun], resolution=40, blockers=b)
          for name, b in {"nothing": (), "board": [board], "card": [card],
                          "tube": [clsss.load_mesh(tube, solid=False)]}.items()}  # fmt: skip
    y = np.linspace(-4, 4, 20)
    lit, dark = (np.stack([np.full(20, x), y, np.full(20, 2.0)], axis=1) for x in (-4.0, 4.0))
    for points in (lit, dark):
        np.testing.assert_allclose(by["card"].radiosity(points), by["board"].radiosity(points), atol=1e-3)
        np.testing.assert_allclose(by["tube"].radiosity(points), by["nothing"].radiosity(points), rtol=0.01)
    assert by["card"].radiosity(dark).max() < 0.05 * by["nothing"].radiosity(dark).min()


def test_a_flat_card_is_no_object():
    card = clsss.load_mesh(trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]]), size=30, solid=False)
    assert card.report["scale"] == 30
    with pytest.raises(InputError, match="holds no volume"):
        simulate(card, MARBLE, [SUN])


@pytest.mark.parametrize("adaptive", [True, False], ids=["adaptive", "uniform"])
def test_sphere_in_a_beam(adaptive):
    """Against spherical harmonics, inside and at the surface."""
    case, mesh = cases.beam(), sphere(10, 5)
    result = simulate(mesh, case.medium, case.lights, resolution=48, adaptive=adaptive, tolerance=1e-5)
    points = np.random.default_rng(12).normal(size=(300, 3))
    points *= (9.5 * np.random.default_rng(13).uniform(0, 1, (300, 1)) ** (1 / 3)) / np.linalg.norm(
        points, axis=1, keepdims=True
    )
    assert relative_rms(result.fluence(points)[:, 0], case.phi(points)) <= 0.01
    directions = mesh.vertices / np.linalg.norm(mesh.vertices, axis=1, keepdims=True)
    exact = case.phi(case.radius * directions)
    assert relative_rms(result.vertex_fluence[:, 0], exact) <= 0.02
    assert relative_rms(result.vertex_radiosity[:, 0], exact / (2 * case.A)) <= 0.02


def test_layers_with_a_jump_in_D():
    """D and sigma_a jump by four and ten at half the radius."""
    case = cases.layered()
    result = simulate(sphere(10, 5), case.medium, case.lights, resolution=48)
    r = np.concatenate([np.linspace(0.5, 4.3, 20), np.linspace(5.7, 9.5, 20)])
    points = r[:, None] * trimesh.unitize([1.0, -2.0, 0.5])
    assert relative_rms(result.fluence(points)[:, 0], case.phi(points)) <= 0.03


@pytest.mark.parametrize("precision", ["single", "double"])
@pytest.mark.parametrize("make", [sphere, torus, hollow_sphere], ids=["sphere", "torus", "hollow"])
def test_energy_balances(make, precision):
    """absorbed + exited = deposited, to the solver's tolerance."""
    tolerance = 1e-4 if precision == "single" else 1e-7
    lights = [SUN, PointLight((3.0, 4.0, 12.0), 20.0), Emission((1e-3, 0.0, 2e-3))]
    medium = Material(sigma_a=(0.01, 0.05, 0.5), sigma_s=1.0, eta=1.3)
    energy = simulate(make(), medium, lights, resolution=32, tolerance=tolerance, precision=precision).report["energy"]
    spent = np.add(energy["absorbed_W"], energy["exited_W"])
    np.testing.assert_allclose(spent, energy["deposited_W"], rtol=20 * tolerance)


def test_nothing_absorbed_all_exits():
    energy = simulate(sphere(), Material(0.0, 1.0, eta=1.3), [SUN], resolution=24, tolerance=1e-5).report["energy"]
    assert energy["absorbed_W"] == [0, 0, 0]
    np.testing.assert_allclose(energy["exited_W"], energy["deposited_W"], rtol=1e-3)


REPORT = {
    "mesh": {"faces", "vertices", "closed", "repairs", "size_mm"},
    "octree": {"levels", "cells", "leaves", "cut_cells", "cells_per_level", "h_mm", "thinner_than"},
    "solve": {"cycles", "residuals", "converged", "factor"},
    "energy": {"incident_W", "deposited_W", "absorbed_W", "exited_W"},
    "seconds": {"load", "device", "octree", "cutcells", "source", "solve", "surface", "total"},
    "memory_mb": {"device", "peak_rss"},
}


def test_report_has_every_key(small):
    import json

    report = small.report
    assert report["clsss"] == clsss.__version__
    assert report["precision"] == "single"
    assert report["device"] == Device().name
    for part, keys in REPORT.items():
        assert keys <= report[part].keys()
    assert json.loads(json.dumps(report)) == report


def test_report_is_consistent(small):
    octree, solve, seconds = (small.report[part] for part in ("octree", "solve", "seconds"))
    assert octree["cells"] == sum(octree["cells_per_level"])
    assert octree["levels"] == len(octree["cells_per_level"])
    assert octree["cut_cells"] < octree["leaves"] <= octree["cells"]
    assert octree["h_mm"] == pytest.approx(small.mesh.size / 24)
    assert len(solve["residuals"]) == solve["cycles"] + 1
    np.testing.assert_allclose(solve["residuals"][0], 1, rtol=1e-4)
    assert solve["converged"]
    assert max(solve["residuals"][-1]) <= 1e-4
    assert sum(v for key, v in seconds.items() if key != "total") <= seconds["total"] * 1.01
    assert small.report["memory_mb"]["device"] > 0


def test_result_arrays(small):
    n = len(small.mesh.vertices)
    for values in (small.vertex_radiosity, small.vertex_fluence):
        assert values.shape == (n, 3)
        assert values.dtype == np.float64
        assert np.isfinite(values).all()
        assert (values > 0).all()
    np.testing.assert_allclose(small.vertex_radiosity, small.vertex_fluence / (2 * fresnel_A(1.5)), rtol=1e-5)
    assert small.medium is MARBLE
    assert small.lights == (SUN,)


def test_radiosity_at_vertices_is_the_vertices_radiosity(small):
    found = small.radiosity(small.mesh.vertices[:200])
    np.testing.assert_allclose(found, small.vertex_radiosity[:200], rtol=0.02)


def test_fluence_is_nan_outside():
    result = simulate(hollow_sphere(10, 5), MARBLE, [SUN], resolution=24)
    points = np.array([[7.0, 0, 0], [0, 0, 0], [4.5, 0, 0], [0, 10.5, 0], [0, -8, 0], [1e9, 0, 0]])
    np.testing.assert_array_equal(np.isnan(result.fluence(points)).any(axis=1), [False, True, True, True, False, True])


def test_fluence_of_every_inner_point_is_finite(small):
    """Also between the mesh's surface and that of the cells."""
    directions = trimesh.unitize(np.random.default_rng(14).normal(size=(500, 3)))
    for radius in (0.0, 5.0, 9.0, 9.9, 9.95):
        assert np.isfinite(small.fluence(radius * directions)).all()


def test_relight_equals_a_fresh_bake():
    mesh, lamp = torus(), PointLight((0.0, 12.0, 5.0), (10.0, 20.0, 5.0))
    first = simulate(mesh, MARBLE, [SUN], resolution=32, tolerance=1e-5)
    relit, fresh = first.relight([lamp]), simulate(mesh, MARBLE, [lamp], resolution=32, tolerance=1e-5)
    np.testing.assert_allclose(relit.vertex_radiosity, fresh.vertex_radiosity, atol=1e-3 * fresh.vertex_radiosity.max())
    np.testing.assert_allclose(relit.report["energy"]["deposited_W"], fresh.report["energy"]["deposited_W"], rtol=1e-6)
    assert relit.report["solve"]["converged"]
    assert relit.lights == (lamp,)
    assert relit.report["seconds"]["octree"] == 0


def test_a_relight_starts_from_what_is_near(small):
    """A sun that has moved a little: closer than zero from the start."""
    relit = small.relight([DirectionalLight((0.2, -1.0, 0.3))])
    assert max(relit.report["solve"]["residuals"][0]) < 0.5


def test_relight_leaves_the_first_result_alone(small):
    before = small.vertex_radiosity.copy()
    points = np.array([[1.0, 2.0, 3.0]])
    fluence = small.fluence(points)
    small.relight([DirectionalLight((1, 0, 0), 100.0)])
    np.testing.assert_array_equal(small.vertex_radiosity, before)
    np.testing.assert_array_equal(small.fluence(points), fluence)
    np.testing.assert_allclose(small.radiosity(small.mesh.vertices[:20]), before[:20], rtol=0.02)


def test_a_relight_that_is_stopped_leaves_the_first_result_alone(monkeypatch):
    """While the host copies its fluence, so that the device has room."""
    first, points = simulate(sphere(10, 3), MARBLE, [SUN], resolution=16), np.array([[0.0, 0, 0], [3, 2, 1]])
    expected = first.fluence(points)

    def stop(*_):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(Buffer, "get", stop)
        with pytest.raises(KeyboardInterrupt):
            first.relight([DirectionalLight((0, 0, -1))])
    first.relight([DirectionalLight((0, 0, -1))])
    np.testing.assert_allclose(first.fluence(points), expected, rtol=1e-6)


def test_relight_with_the_same_lights_takes_little(small):
    """Also where another light, so far away that it adds next to nothing, sets the unit."""
    for others in ([], [PointLight((0, 1e6, 0), 1e7)]):
        again = small.relight([SUN, *others])
        assert again.report["solve"]["cycles"] <= 1
        np.testing.assert_allclose(again.vertex_radiosity, small.vertex_radiosity, rtol=1e-3)


def test_results_are_linear_in_the_light(small):
    """Twice the light, twice the result; units of any size."""
    for factor in (2.0, 1e-20, 1e20):
        scaled = dataclasses.replace(SUN, irradiance=SUN.irradiance * factor)
        found = simulate(small.mesh, MARBLE, [scaled], resolution=24)
        np.testing.assert_allclose(found.vertex_radiosity / factor, small.vertex_radiosity, rtol=1e-4)


@pytest.mark.parametrize("scale", [1e-3, 1e3])
def test_scale_does_not_matter(small, scale):
    """An object a thousand times as large of a medium a thousand times as thin looks the same."""
    medium = Material(MARBLE.sigma_a / scale, MARBLE.sigma_s / scale, eta=1.5)
    mesh = solid(small.mesh.triangles * scale)
    found = simulate(mesh, medium, [SUN], resolution=24)
    np.testing.assert_allclose(found.vertex_radiosity, small.vertex_radiosity, rtol=2e-3)


def test_place_does_not_matter(small):
    found = simulate(solid(small.mesh.triangles + np.array([1e4, -2e4, 3e3])), MARBLE, [SUN], resolution=24)
    np.testing.assert_allclose(found.vertex_radiosity, small.vertex_radiosity, rtol=0.01)


@pytest.mark.parametrize("precision", ["single", "double"])
def test_same_bits_twice(precision):
    lights = [SUN, PointLight((0.0, 12.0, 5.0), 10.0), Emission(0.01)]
    one, other = (simulate(torus(), MARBLE, lights, resolution=24, precision=precision) for _ in range(2))
    np.testing.assert_array_equal(one.vertex_radiosity, other.vertex_radiosity)
    np.testing.assert_array_equal(one.vertex_fluence, other.vertex_fluence)


def test_single_and_double_agree(small):
    double = simulate(small.mesh, MARBLE, [SUN], resolution=24, precision="double")
    np.testing.assert_allclose(small.vertex_radiosity, double.vertex_radiosity, rtol=2e-3)


def test_one_light_needs_no_list(small):
    found = simulate(small.mesh, MARBLE, SUN, resolution=24)
    np.testing.assert_array_equal(found.vertex_radiosity, small.vertex_radiosity)


def test_sky(single):
    """A constant sky on a lossless body: what falls on it comes out, less what passes straight through."""
    sky = EnvironmentLight((1.0, 1.0, 1.0))
    result = simulate(sphere(), Material(0.0, 2.0), [sky], resolution=24)
    radiosity = result.vertex_radiosity[:, 0]
    assert np.abs(radiosity / radiosity.mean() - 1).max() <= 0.01
    assert result.vertex_radiosity.mean() == pytest.approx(np.pi, rel=0.05)


@pytest.mark.parametrize("medium", ["mix", "grid"])
def test_heterogeneous_media(medium):
    """A mixture of two equal parts is the part; so is a grid of one value."""
    a = Material(sigma_a=0.05, sigma_s=1.0, eta=1.3)
    if medium == "mix":
        given = clsss.Mix(a, a, clsss.Perlin(scale=3.0, seed=1))
    else:
        given = clsss.Grid(np.full((3, 3, 3), 0.05), np.full((3, 3, 3), 1.0), (-11, -11, -11), 11.0, eta=1.3)
    found, expected = (
        simulate(sphere(), m, [SUN], resolution=32, precision="double", tolerance=1e-7) for m in (given, a)
    )
    np.testing.assert_allclose(found.vertex_radiosity, expected.vertex_radiosity, rtol=1e-3)
    assert found.report["solve"]["converged"]


BAD = {
    "resolution": ["many", None, 3, 0, -5, 12.5, float("nan"), float("inf"), True],
    "tolerance": ["small", None, 0, 1, -1e-3, float("nan")],
    "precision": ["half", None, 32],
    "device": [3, b"pthread"],
    "lights": [[], None, "sun", [SUN, "lamp"], [None], 3],
    "medium": [None, "granite", 1.0],
    "mesh": [None, "nowhere.ply", 3],
    "phase": ["isotropic", None],
    "blockers": ["board.ply", [None]],
}


@pytest.mark.parametrize(("name", "value"), [(name, value) for name, values in BAD.items() for value in values])
def test_bad_argument_is_one_sentence(small, name, value):
    arguments = {"mesh": small.mesh, "medium": MARBLE, "lights": [SUN], "resolution": 8, name: value}
    with pytest.raises(InputError) as error:
        simulate(**arguments)
    message = str(error.value)
    assert message.startswith(f"{name}: ")
    assert "\n" not in message
    assert len(message) < 250


@pytest.mark.parametrize("points", [None, 1.0, [1.0, 2.0, 3.0], [[1.0, 2.0]], [[0.0, 0.0, np.nan]], "here"])
@pytest.mark.parametrize("method", ["radiosity", "fluence"])
def test_bad_points(small, method, points):
    with pytest.raises(InputError, match="points: needs finite numbers of shape"):
        getattr(small, method)(points)


def test_no_points(small):
    for values in (small.radiosity(np.zeros((0, 3))), small.fluence(np.zeros((0, 3)))):
        assert values.shape == (0, 3)


@pytest.mark.parametrize("colour", [(1, 0, 0), (0, 0.3, 0), (0, 0, 0), (1e-25, 1e-25, 0), (1e25, 0, 1e25)])
def test_relight_in_another_colour(small, colour):
    """As baked anew: dark where there is no light, without more cycles, however bright it was before."""
    lights = [DirectionalLight(SUN.direction, colour)]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = small.relight(lights)
    expected = simulate(small.mesh, small.medium, lights, resolution=24)
    assert found.report["solve"]["converged"]
    assert found.report["solve"]["cycles"] <= expected.report["solve"]["cycles"]
    np.testing.assert_allclose(found.vertex_radiosity, expected.vertex_radiosity, rtol=1e-3)
    assert not found.vertex_radiosity[:, np.array(colour) == 0].any()


def test_relight_refuses_what_simulate_refuses(small):
    for lights in ([], ["sun"]):
        with pytest.raises(InputError, match="lights: "):
            small.relight(lights)


def test_unknown_device(small):
    with pytest.raises(DeviceError, match="abacus"):
        simulate(small.mesh, MARBLE, [SUN], resolution=8, device="abacus")


@pytest.mark.parametrize("resolution", [20_000, 10**9])
def test_too_large_a_resolution_names_a_smaller_one(small, resolution):
    """Before anything is allocated; and the one it names passes the same check."""
    import re

    from clsss.arguments import check_memory

    with pytest.raises(DeviceError, match=r"use \d+ or less") as error:
        simulate(small.mesh, MARBLE, [SUN], resolution=resolution)
    named = int(re.search(r"use (\d+) or less", str(error.value))[1])
    assert 64 <= named < resolution
    check_memory(small.mesh, named)


def test_progress_names_the_stages_in_order(small):
    told = []
    simulate(torus(), MARBLE, [SUN], resolution=16, progress=lambda *stage: told.append(stage))
    stages = list(dict.fromkeys(stage for stage, _ in told))
    assert [s for s in stages if s in ("cut cells", "octree", "source", "solve", "surface")] == [
        "cut cells",
        "octree",
        "source",
        "solve",
        "surface",
    ]
    assert all(0 <= fraction <= 1 for _, fraction in told)
    for stage in stages:
        fractions = [fraction for name, fraction in told if name == stage]
        assert fractions == sorted(fractions)
        assert fractions[-1] == 1


def test_progress_prints(small, capsys):
    simulate(small.mesh, MARBLE, [SUN], resolution=8, progress=True)
    assert "solve" in capsys.readouterr().out


def test_quiet_by_default(small, capfd):
    simulate(small.mesh, MARBLE, [SUN], resolution=8)
    out, err = capfd.readouterr()
    assert (out, err) == ("", "")


@pytest.mark.parametrize("cells", [4, 5, 8])
def test_coarsest_resolutions_work(cells):
    result = simulate(sphere(), MARBLE, [SUN], resolution=cells)
    assert np.isfinite(result.vertex_radiosity).all()


def test_a_body_thinner_than_a_cell_says_so():
    """A plate that no sample meets has no cells; one sentence says what to do."""
    with pytest.raises(InputError, match="no cell of the grid lies inside at resolution 8; raise the resolution"):
        simulate(box((20, 20, 1e-4)), MARBLE, [SUN], resolution=8)


@pytest.mark.parametrize(
    ("case", "bar"), [("sphere10_marble", 0.03), ("torus20_marble", 0.05), ("plate12_backlit", 0.05)]
)
def test_radiosity_as_by_path_tracing(shared, case, bar):
    """All scattered light that leaves, in index-matched marble, at 64 cells; the paths' own noise is 1.5 %."""
    truth = np.load(shared / "truth" / "mitsuba" / f"{case}.npz")
    mesh = clsss.load_mesh(trimesh.Trimesh(truth["vertices"], truth["faces"], process=False))
    medium = Material(float(truth["sigma_a"]), float(truth["sigma_s"]), g=float(truth["g"]), eta=float(truth["eta"]))
    result = simulate(mesh, medium, [DirectionalLight(truth["light_dir"])], resolution=64)
    assert relative_rms(result.radiosity(truth["points"])[:, 0], truth["radiosity_total"]) <= bar


@pytest.mark.parametrize("scattering", ["all", "split"])
def test_black_cavity_as_by_path_tracing(shared, scattering):
    """A blocker lines the cavity: what leaves into it does not return, and the beam does not cross it."""
    truth = np.load(shared / "truth" / "mitsuba" / "box10_cavity_black.npz")
    whole = trimesh.Trimesh(truth["vertices"], truth["faces"], process=False)
    wall = trimesh.Trimesh(truth["vertices"], truth["faces"][truth["face_part"] == 1])
    medium = Material(float(truth["sigma_a"]), float(truth["sigma_s"]))
    result = simulate(clsss.load_mesh(whole), medium, [DirectionalLight(truth["light_dir"])], resolution=64,
                      scattering=scattering, blockers=[clsss.load_mesh(wall, solid=False)])  # fmt: skip
    outer = truth["part"] == 0
    assert relative_rms(result.radiosity(truth["points"])[outer, 0], truth["radiosity_total"][outer]) <= 0.06


def test_a_solve_that_stops_short_says_so():
    tolerance = np.float32(1e-12)
    with pytest.warns(clsss.ConvergenceWarning, match="stopped after .* short of the tolerance 1e-12: use double"):
        result = simulate(sphere(subdivisions=3), MARBLE, [SUN], resolution=16, tolerance=tolerance)
    assert json.loads(json.dumps(result.report))["solve"]["converged"] is False


def test_warnings_point_at_the_caller():
    """Both kinds, from a bake and from a relight."""
    dark = Material(sigma_a=0.5, sigma_s=1.0)
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        simulate(sphere(subdivisions=2), dark, [SUN], resolution=8, tolerance=1e-12).relight([SUN])
    assert {w.category for w in told} == {clsss.DiffusionWarning, clsss.ConvergenceWarning}
    assert {w.filename for w in told} == {__file__}


def test_threads_take_turns():
    """They share a device, whose kernels hold the arguments of one launch."""
    meshes = [sphere(subdivisions=3), torus()]
    alone = [simulate(mesh, MARBLE, [SUN], resolution=24).vertex_radiosity for mesh in meshes]
    together: list[list[np.ndarray]] = [[], []]

    def work(k):
        for _ in range(4):
            together[k].append(simulate(meshes[k], MARBLE, [SUN], resolution=24).vertex_radiosity)

    threads = [threading.Thread(target=work, args=(k,)) for k in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for expected, found in zip(alone, together, strict=True):
        assert len(found) == 4
        assert all(np.array_equal(values, expected) for values in found)


def test_what_a_bake_held_is_given_back():
    """Results free the device's memory as they go, without the garbage collector."""
    device = open_device(None, "single")
    held = []
    for _ in range(3):
        result = simulate(torus(), MARBLE, [SUN], resolution=24, scattering="split")
        result.radiance((0, 0, 100))
        held.append(device.allocated)
        result = result.relight([PointLight((0, 40, 0), 100.0)])
        del result
        held.append(device.allocated)
    assert held[0] > held[1]
    assert held[:2] == held[2:4] == held[4:]
