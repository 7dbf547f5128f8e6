"""The references against exact values and other people's programs: dipole and Monte Carlo.

The default run is short; `-m slow` repeats the comparisons with third-party data at full length.
"""

from __future__ import annotations

import functools
import json
import os
import re
import time
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

from clsss import bvh, montecarlo, paths, pointtree
from clsss.device import Device
from clsss.dipole import SPACING, dipole, entering, groenhuis_A, profile
from clsss.errors import InputError
from clsss.fresnel import fresnel_transmittance
from clsss.lights import DirectionalLight, Emission, EnvironmentLight, PointLight
from clsss.materials import Material, material
from clsss.media import Mix, Perlin
from clsss.mesh import Mesh, load_mesh
from clsss.montecarlo import PathWarning, estimate
from clsss.photons import patches
from clsss.reference import monte_carlo
from clsss.subdivision import areas, owners, subdivide

DOWN = DirectionalLight((0, 0, -1))


@functools.cache
def ball(subdivisions=3, radius=5.0):
    return load_mesh(trimesh.creation.icosphere(subdivisions, radius))


@functools.cache
def block(x=200.0, y=200.0, z=100.0):
    return load_mesh(trimesh.creation.box((x, y, z)))


def shared(name):
    folder = os.environ.get("CLSSS_SHARED")
    if not folder:
        pytest.skip("CLSSS_SHARED names no folder of reference data")
    file = Path(folder) / "truth" / name
    if not file.exists():
        pytest.skip(f"{file} is not there")
    return np.load(file)


def triangles_of(mesh_triangles):
    """A mesh of exactly these triangles, without repair."""
    vertices = mesh_triangles.reshape(-1, 3)
    faces = np.arange(len(vertices), dtype=np.int32).reshape(-1, 3)
    normals = np.repeat(np.cross(*np.diff(mesh_triangles, axis=1).transpose(1, 0, 2)), 3, axis=0)
    return Mesh(vertices, faces, normals / np.linalg.norm(normals, axis=1)[:, None], faces, True)


# ---------------------------------------------------------------- pieces


@pytest.mark.parametrize("m", [1, 2, 5, 12, 1280])
def test_tree_holds_every_triangle_within_its_boxes(m):
    triangles = ball().triangles[:m]
    tree = bvh.build(triangles)
    assert set(tree.order) == set(range(m))
    leaves = triangles[tree.order].reshape(tree.n_leaves, -1, 3)
    low, high = tree.boxes[:, :3], tree.boxes[:, 3:]
    assert np.all(low[tree.n_leaves :] <= leaves.min(axis=1) + 1e-5)
    assert np.all(high[tree.n_leaves :] >= leaves.max(axis=1) - 1e-5)
    for child in range(2, len(tree.boxes)):
        assert np.all(low[child // 2] <= low[child])
        assert np.all(high[child // 2] >= high[child])


def test_places_belong_to_points_on_their_side():
    points, facing = np.array([[0, 0, 1.0], [0, 0, -1], [5, 0, 1]]), np.array([[0, 0, 1.0], [0, 0, -1], [0, 0, 1]])
    places = np.array([[1, 0, 1.0], [1, 0, -1], [4, 0, 1], [4, 0, -1], [9, 0, 1]])
    normals = np.array([[0, 0, 1.0], [0, 0, -1], [0, 0, 1], [0, 0, -1], [0, 0, 1]])
    np.testing.assert_array_equal(owners(places, normals, points, facing, 3.0), [0, 1, 2, -1, -1])
    np.testing.assert_array_equal(owners(places, normals, points, facing, 5.0), [0, 1, 2, 1, 2])


def test_octree_walk_meets_every_point_once():
    places = np.random.default_rng(0).normal(size=(3000, 3))
    tree = pointtree.build(places)
    assert sorted(tree.order) == list(range(3000))
    size = tree.end - tree.start
    assert size[tree.leaf].sum() == 3000
    assert size[tree.leaf].max() <= pointtree.LEAF
    assert tree.skip[0] == len(tree.start)
    np.testing.assert_allclose(tree.sums(places[tree.order])[0], places.sum(axis=0))
    for node in range(0, len(tree.start), 97):
        inside = places[tree.order[tree.start[node] : tree.end[node]]]
        assert np.linalg.norm(np.ptp(inside, axis=0)) <= 2 * tree.half_diagonal[node] + 1e-9


def test_refined_triangles_cover_the_same_surface():
    triangles = block().triangles
    pieces, parent = subdivide(triangles, 30.0)
    np.testing.assert_allclose(np.bincount(parent, areas(pieces)), areas(triangles))
    edges = np.linalg.norm(pieces - np.roll(pieces, 1, axis=1), axis=2)
    assert edges.max() <= 30
    outward = np.einsum("ij,ij->i", np.cross(*np.diff(pieces, axis=1).transpose(1, 0, 2)), pieces[:, 0])
    assert outward.min() > 0


# ---------------------------------------------------------------- dipole


def test_profile_has_the_published_total():
    """Jensen et al. 2001: R = a/2 (1 + exp(-4/3 A s)) exp(-s), s = sqrt(3 (1 - a))."""
    r = np.geomspace(1e-4, 1e3, 20001)
    for name in ("marble", "skimmilk", "ketchup"):
        m = material(name)
        total = np.trapezoid(2 * np.pi * r[:, None] ** 2 * profile(r, m), np.log(r), axis=0)
        s = np.sqrt(3 * (1 - m.albedo))
        exact = m.albedo / 2 * (1 + np.exp(-4 / 3 * groenhuis_A(m.eta) * s)) * np.exp(-s)
        np.testing.assert_allclose(total, exact, rtol=1e-4)


def test_better_dipole_approaches_all_light_where_nothing_is_absorbed():
    r = np.geomspace(1e-4, 1e5, 40001)
    total = np.trapezoid(
        2 * np.pi * r[:, None] ** 2 * profile(r, Material(1e-8, 1.0, eta=1.4), "better"), np.log(r), axis=0
    )
    np.testing.assert_allclose(total, 1, rtol=2e-3)


@pytest.mark.parametrize("model", ["jensen", "better"])
def test_dipole_on_a_plane_is_its_total(model):
    m = Material(0.05, 2.0, eta=1.3)
    mesh = load_mesh(trimesh.creation.box((40, 40, 20)).subdivide_to_size(4.0))
    r = np.geomspace(1e-4, 1e3, 20001)
    total = np.trapezoid(2 * np.pi * r[:, None] ** 2 * profile(r, m, model), np.log(r), axis=0)
    top = (mesh.vertices[:, 2] > 9.9) & (np.abs(mesh.vertices[:, :2]).max(axis=1) < 5)
    radiosity = dipole(mesh, m, [DOWN], model)[top]
    np.testing.assert_allclose(
        radiosity, np.broadcast_to(total * fresnel_transmittance(1.0, 1.3), radiosity.shape), rtol=5e-3
    )


def test_hierarchy_agrees_with_all_pairs():
    m, lights = Material((0.002, 0.004, 0.007), (2, 2.5, 3), eta=1.5), [DOWN, PointLight((9, 0, 3), (9, 5, 1))]
    fast, exact = (dipole(ball(4), m, lights, hierarchical=h) for h in (True, False))
    np.testing.assert_allclose(fast, exact, rtol=0.01)


@pytest.mark.parametrize("hierarchical", [True, False])
@pytest.mark.parametrize("model", ["jensen", "better"])
def test_dipole_is_reciprocal(model, hierarchical):
    """Two lights may change places: int M_1 E_2 dA = int M_2 E_1 dA, E what enters, M what leaves for it."""
    mesh, medium = load_mesh(trimesh.creation.torus(4, 2, 96, 48)), Material((0.1, 0.02, 0.005), 2.0, eta=1.3)
    lights = [DirectionalLight((0.3, -0.2, -1))], [PointLight((9, 2, -3.0), 50.0)]
    area, fine = areas(mesh.triangles) / 3, np.zeros((len(mesh.vertices), 1))
    np.add.at(fine[:, 0], mesh.faces.ravel(), np.repeat(area, 3))
    enters = [entering(mesh, mesh.vertices, mesh.normals, medium.eta, light) for light in lights]
    leaves = [dipole(mesh, medium, light, model, hierarchical) for light in lights]
    there, back = (np.sum(fine * leaves[k] * enters[1 - k], axis=0) for k in (0, 1))
    np.testing.assert_allclose(there, back, rtol=0.01)


@pytest.mark.slow
def test_hierarchy_is_much_faster_at_a_hundred_thousand_vertices():
    """Some of the points stand for all in the sum over all pairs."""
    mesh, medium, device = ball(7), material("marble"), Device(precision="single")
    few = mesh.vertices[::100]
    some = replace(mesh, vertices=few, normals=mesh.normals[::100], solid=mesh.solid + len(few), centroids=mesh.points)
    np.testing.assert_array_equal(some.triangles, mesh.triangles)
    seconds, radiosity = [], []
    for part, hierarchical in ((mesh, True), (some, False)):
        started = time.process_time()
        radiosity.append(dipole(part, medium, [DOWN], hierarchical=hierarchical, device=device))
        seconds.append(time.process_time() - started)
    np.testing.assert_allclose(radiosity[0][::100], radiosity[1], rtol=0.01)
    assert seconds[1] * 100 > 20 * seconds[0]


def test_dipole_sees_shadows():
    bodies = trimesh.util.concatenate(
        [trimesh.creation.icosphere(3, 3.0), trimesh.creation.icosphere(3, 3.0).apply_translation((0, 0, 10))]
    )
    mesh, m = load_mesh(bodies), Material(0.5, 5.0)
    radiosity = dipole(mesh, m, [DOWN])[:, 0]
    z = mesh.vertices[:, 2]
    assert radiosity[z > 12].min() > 50 * radiosity[(z > 2.5) & (z < 5)].max()


def test_dipole_names_what_it_cannot_do():
    m = Material(0.1, 1.0)
    with pytest.raises(InputError, match="model"):
        dipole(ball(), m, [DOWN], "best")
    with pytest.raises(InputError, match="material"):
        dipole(ball(), Mix(m, m, Perlin()), [DOWN])
    with pytest.raises(InputError, match="Emission"):
        dipole(ball(), m, [Emission(1)])
    with pytest.raises(InputError, match="mesh: needs a mesh"):
        dipole("ball.ply", m, [DOWN])
    with pytest.raises(InputError, match="material: needs a Material"):
        dipole(ball(), "marble", [DOWN])
    with pytest.raises(InputError, match="at least one light"):
        dipole(ball(), m, [])


def test_samples_are_fine_enough():
    coarse, fine = Material(0.05, 1.0), ball(4)
    pieces, _ = subdivide(fine.triangles, SPACING / coarse.sigma_tr.max())
    assert np.linalg.norm(pieces - np.roll(pieces, 1, axis=1), axis=2).max() <= SPACING / coarse.sigma_tr.max()


# ---------------------------------------------------------------- Monte Carlo


def top_points(n, half=40.0, z=50.0):
    return np.column_stack([np.random.default_rng(0).uniform(-half, half, (n, 2)), np.full(n, z)])


@pytest.mark.parametrize(("albedo", "exact"), [(0.99, 0.75272), (0.9, 0.41495), (0.5, 0.11523)])
def test_semi_infinite_medium(albedo, exact):
    """Chandrasekhar 1960: 1 - sqrt(1 - a) H(1) for isotropic scattering and perpendicular light."""
    e = estimate(block(), Material(1 - albedo, albedo), [DOWN], 1000, top_points(64))
    stderr = np.sqrt(np.sum(e.stderr[:, 0] ** 2)) / 64
    assert stderr < 0.005 * exact
    assert np.mean(e.radiosity) == pytest.approx(exact, abs=3 * stderr)
    single = albedo / 2 * (1 - np.log(2))
    assert np.mean(e.single) == pytest.approx(single, abs=3 * np.sqrt(np.sum(e.single_stderr[:, 0] ** 2)) / 64)
    np.testing.assert_allclose(e.radiosity, e.single + e.multiple)
    assert e.lost == e.capped == 0


def balance(energy):
    kept = sum(energy[k] for k in ("reflected", "absorbed", "scattered", "unscattered", "lost", "capped"))
    return kept / energy["incident"] - 1


def test_no_photon_slips_through_triangles_of_all_sizes():
    """A torus has triangles of all lengths, which are cut differently to count what leaves through their parts.

    Where patches cover all of it, and what has left does not come back, all of it is counted.
    """
    mesh, beam = load_mesh(trimesh.creation.torus(4, 2, 48, 24)), [DirectionalLight((0.3, -0.2, -1))]
    e = estimate(mesh, Material(0.01, 3.0, eta=1.3), beam, 40, radius=1.0, reenter=False)
    assert e.lost < 1e-4
    area = patches(mesh.triangles, mesh.vertices, mesh.normals, 1.0).area
    assert area.sum() == pytest.approx(mesh.area_and_volume[0])
    np.testing.assert_allclose(area @ e.radiosity, e.energy["scattered"], rtol=1e-4)


def test_a_place_is_found_in_its_piece():
    """The numbering that kernels/bvh.h finds pieces by: the piece's three parts about the place fill it."""
    k, corners = 5, np.array([[0.0, 0, 0], [3, 1, 0], [1, 2, 1]])
    pieces, _ = subdivide(corners[None], 1e9, at_least=k)
    assert len(pieces) == k**2
    u = np.random.default_rng(0).random((200, 2))
    u = np.where(u.sum(axis=1, keepdims=True) > 1, 1 - u, u)
    at = corners[0] + u @ (corners[1:] - corners[0])
    i, j = np.floor(u * k).astype(int).T
    index = i * (2 * k - i) + 2 * j + ((u * k).sum(axis=1) - i - j > 1)
    a, b, c = np.moveaxis(pieces[index], 1, 0)
    inside = [np.linalg.norm(np.cross(q - p, at - p), axis=1) for p, q in ((a, b), (b, c), (c, a))]
    np.testing.assert_allclose(np.sum(inside, axis=0) / 2, areas(pieces[index]))


@pytest.mark.parametrize("eta", [1.0, 1.37])
def test_power_is_kept(eta):
    medium = Mix(Material(0.01, 1.0, eta=eta), Material(0.1, 3.0, g=0.6, eta=eta), Perlin(2.0))
    e = estimate(ball(), medium, [DOWN, PointLight((0, 0, 9))], 20, forward=True)
    np.testing.assert_allclose(balance(e.energy), 0, atol=2e-3)
    assert e.lost < 1e-4
    assert e.energy["absorbed"].min() > 0


def test_photons_reflect_and_bend_as_fresnel_and_snell_say():
    """A plate that only absorbs, lit at 60 degrees: R, and (1 - R)^2 E / (1 - R E), E = exp(-sigma_a d / cos)."""
    eta, plate = 1.5, block(200.0, 200.0, 1.0)
    light = DirectionalLight((np.sin(np.pi / 3), 0, -0.5))
    e = estimate(plate, Material(1.0, 1e-6, eta=eta), [light], 200_000, [[0, 0, 0.5]], radius=5.0)
    R = 1 - fresnel_transmittance(0.5, eta)
    left = np.exp(-1 / np.sqrt(1 - 0.75 / eta**2))
    np.testing.assert_allclose(e.energy["reflected"] / e.energy["incident"], R, rtol=0.04)
    through = (1 - R) ** 2 * left / (1 - R * left)
    np.testing.assert_allclose(e.energy["unscattered"] / e.energy["incident"], through, rtol=0.03)


def test_albedo_one_gives_everything_back():
    e = estimate(ball(), Material(0.0, 2.0, eta=1.3), [DOWN], 50)
    np.testing.assert_allclose(e.energy["absorbed"], 0)
    out = e.energy["scattered"] + e.energy["reflected"] + e.energy["unscattered"]
    np.testing.assert_allclose(out / e.energy["incident"], 1, atol=2e-3)
    area = np.repeat(areas(ball().triangles) / 3, 3)
    per_vertex = np.bincount(ball().faces.ravel(), area, len(ball().vertices))
    np.testing.assert_allclose(per_vertex @ e.radiosity, e.energy["scattered"], rtol=0.02)


MEDIA = {
    "anisotropic": Material((0.01, 0.02, 0.05), (2.0, 3.0, 4.0), g=0.8),
    "mixed": Mix(Material(0.01, 1.0), Material(0.05, 4.0, g=0.5), Perlin(2.0)),
}


@pytest.mark.parametrize("name", MEDIA)
def test_forward_and_backward_agree(name):
    points, lights = ball(4).vertices[::80], [DOWN, EnvironmentLight((0.1, 0.2, 0.05))]
    a = estimate(ball(4), MEDIA[name], lights, 100, points)
    b = estimate(ball(4), MEDIA[name], lights, 500, points, forward=True, radius=0.4)
    z = (a.radiosity - b.radiosity) / np.hypot(a.stderr, b.stderr)
    assert np.sqrt(np.mean(z**2)) < 1.5
    noise = np.sqrt(np.sum(a.stderr**2 + b.stderr**2, axis=0))
    assert np.all(np.abs(np.sum(a.radiosity - b.radiosity, axis=0)) < 3.5 * noise)
    assert np.all(noise < 0.1 * b.radiosity.sum(axis=0))


@pytest.mark.parametrize("g", [0.5, -0.4])
@pytest.mark.parametrize("forward", [True, False], ids=["sampled", "evaluated"])
def test_thin_plates_scatter_forward_as_henyey_and_greenstein_say(g, forward):
    """Share of the light scattered once that goes on: (1 - g^2) / 2g (1 / (1 - g) - 1 / sqrt(1 + g^2))."""
    plate = block(6.0, 6.0, 0.1)
    points, normals = np.array([[0, 0, 0.05], [0, 0, -0.05]]), np.array([[0, 0, 1.0], [0, 0, -1.0]])
    medium = Material(0.0, 0.1, g)
    e = estimate(plate, medium, [DOWN], 100_000, points, normals, forward=forward, radius=2.5)
    found = e.single[1] / e.single.sum(axis=0)
    onward = (1 - g * g) / (2 * g) * (1 / (1 - g) - 1 / np.sqrt(1 + g * g))
    np.testing.assert_allclose(found, onward, atol=0.03)
    np.testing.assert_allclose(e.single.sum(axis=0), 0.01, rtol=0.1)


def test_paths_start_where_light_neither_bends_nor_shines_inside():
    inside, outside = PointLight((0, 0, 1.0)), PointLight((0, 0, 9.0))
    straight, bending = Material(0.1, 1.0), Material(0.1, 1.0, eta=1.3)
    for medium, light, forward in ((straight, outside, False), (straight, inside, True), (bending, outside, True)):
        e = estimate(ball(), medium, [light], 2, ball().vertices[:5])
        assert bool(e.energy) is (e.radius > 0) is forward


@pytest.mark.parametrize("forward", [False, True])
def test_standard_errors_are_those_of_repeats(forward):
    """What two runs differ by, in standard errors, has an rms of 1: 5 % of 200 points' own."""
    points = ball(4).vertices[::12]
    medium = Material(0.05, 1.0)
    a, b = (estimate(ball(4), medium, [DOWN], 300, points, seed=s, forward=forward, radius=0.5) for s in (1, 2))
    lit = (a.stderr > 0)[:, 0] & (b.stderr > 0)[:, 0]
    assert lit.sum() >= 190
    z = ((a.radiosity - b.radiosity) / np.hypot(a.stderr, b.stderr))[lit, 0]
    assert np.sqrt(np.mean(z**2)) == pytest.approx(1, abs=0.2)


def test_seed_fixes_the_result():
    points = ball().vertices[::50]
    first, second, other = (estimate(ball(), Material(0.1, 1.0), [DOWN], 20, points, seed=s) for s in (1, 1, 2))
    np.testing.assert_array_equal(first.radiosity, second.radiosity)
    np.testing.assert_array_equal(first.stderr, second.stderr)
    assert not np.allclose(first.radiosity, other.radiosity)


def test_far_from_the_origin_is_as_good():
    shift = np.array([3e4, -2e4, 1e4])
    body = trimesh.creation.icosphere(3, 5.0)
    far = load_mesh(body.copy().apply_translation(shift))
    lamp = PointLight((9, 0, 3), (9, 5, 1))
    there = [DOWN, PointLight(lamp.position + shift, lamp.intensity)]
    medium = Material(0.1, 1.0)
    np.testing.assert_allclose(dipole(far, medium, there), dipole(ball(), medium, [DOWN, lamp]), rtol=1e-3)
    for forward in (True, False):
        e = estimate(far, medium, there, 10, forward=forward)
        near = estimate(ball(), medium, [DOWN, lamp], 10, forward=forward)
        assert e.lost < 1e-4
        np.testing.assert_allclose(e.radiosity.sum(axis=0), near.radiosity.sum(axis=0), rtol=0.1)


def test_channels_are_independent():
    points, n = ball().vertices[::50], 50
    both = estimate(ball(), Material((0.1, 0.1, 1.0), 1.0), [DirectionalLight((0, 0, -1), (1, 2, 3))], n, points)
    red = estimate(ball(), Material(0.1, 1.0), [DOWN], n, points)
    np.testing.assert_allclose(both.radiosity[:, 0], red.radiosity[:, 0], rtol=1e-5)
    np.testing.assert_allclose(both.radiosity[:, 1], 2 * red.radiosity[:, 0], rtol=1e-5)
    assert both.radiosity[:, 2].sum() < both.radiosity[:, 0].sum()


def test_light_crosses_a_cavity():
    inner = trimesh.creation.icosphere(3, 3.0)
    inner.invert()
    mesh = load_mesh(trimesh.util.concatenate([trimesh.creation.icosphere(3, 5.0), inner]))
    points = trimesh.creation.icosphere(2, 5.0).vertices
    points = points[points[:, 2] < -4]
    lit, black = (estimate(mesh, Material(0.01, 1.0), [DOWN], 500, points, reenter=r) for r in (True, False))
    assert lit.radiosity.sum() > 1.3 * black.radiosity.sum()
    assert lit.lost < 1e-4


@pytest.mark.parametrize("forward", [False, True])
def test_overlapping_bodies_are_one(forward):
    one = trimesh.creation.icosphere(3, 3.0)
    other = one.copy().apply_translation((0, 0, 3.0))
    both = load_mesh(trimesh.util.concatenate([one, other]))
    union = load_mesh(trimesh.boolean.union([one, other], engine="manifold"))
    points = union.vertices[np.abs(union.vertices[:, 2] - 1.5) > 0.3][::20]
    light = [DirectionalLight((1, 0, -1))]
    a, b = (estimate(m, Material(0.01, 1.0), light, 300, points, forward=forward, radius=0.5) for m in (both, union))
    noise = np.sqrt(np.sum(a.stderr[:, 0] ** 2 + b.stderr[:, 0] ** 2))
    assert np.sum(a.radiosity[:, 0]) == pytest.approx(np.sum(b.radiosity[:, 0]), abs=3.5 * noise)
    assert noise < 0.05 * np.sum(b.radiosity[:, 0])


def test_open_mesh_reports_what_slips_out():
    mesh = triangles_of(ball().triangles[100:])
    gap = ball().triangles[:100].reshape(-1, 3)
    for eta in (1.0, 1.3):
        with pytest.warns(PathWarning, match="slipped through") as told:
            e = estimate(mesh, Material(0.01, 1.0, eta=eta), [DOWN], 50, mesh.triangles[::200].mean(axis=1))
        assert e.lost > 0.01
        number, place = re.search(r"(\d+) of its edges are open, near \((.*)\) mm", str(told[0].message)).groups()
        assert int(number) > 20
        assert np.linalg.norm(gap - [float(x) for x in place.split(",")], axis=1).min() < 0.5


def test_few_paths_may_lose_one_by_chance():
    """A watertight ball: one path of 5000 says nothing of the surface, ten do."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        montecarlo._tell(ball(), 1 / 5000, 0.0, 5000)
    with pytest.warns(PathWarning, match=r"0.20% of the paths .* it is closed, but has triangles too small"):
        montecarlo._tell(ball(), 10 / 5000, 0.0, 5000)


def test_points_without_a_photon_are_reported():
    """Photons go everywhere: of few points some see none, and 0 +- 0 is no estimate."""
    mesh, glassy = ball(), Material(0.01, 1.0, eta=1.3)
    with pytest.warns(PathWarning, match=r"no photon was counted at \d+ of 5 points"):
        estimate(mesh, glassy, [DOWN], 20, mesh.vertices[:5])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        estimate(mesh, glassy, [DOWN], 20000, mesh.vertices[:5], radius=3.0)


def test_capped_paths_are_reported(monkeypatch):
    monkeypatch.setattr("clsss.montecarlo.CAP", 3)
    with pytest.warns(PathWarning, match="given up after 3 collisions"):
        e = estimate(ball(), Material(0.0, 5.0), [DOWN], 20, ball().vertices[:10])
    assert e.capped > 0.3


def test_progress_ends_at_one():
    seen = []
    monte_carlo(ball(), Material(0.1, 1.0), [DOWN], 5, ball().vertices[:10])
    for forward in (True, False):
        estimate(ball(), Material(0.1, 1.0), [DOWN], 5, forward=forward, progress=lambda s, f: seen.append((s, f)))
        assert seen[-1] == ("paths", 1.0)


def test_unused_vertices_have_no_radiosity():
    mesh = ball()
    loose = Mesh(
        np.vstack([mesh.vertices, [[50, 0, 0]]]),
        mesh.faces,
        np.vstack([mesh.normals, [[0, 0, 0]]]),
        mesh.solid,
        True,
    )
    e = estimate(loose, Material(0.5, 1.0), [DOWN], 5)
    assert np.isnan(e.radiosity[-1]).all()
    assert np.isfinite(e.radiosity[:-1]).all()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"n_paths": 0}, "n_paths: needs a whole number"),
        ({"n_paths": 2.5}, "n_paths: needs a whole number"),
        ({"seed": -1}, "seed: needs a whole number"),
        ({"points": [[0, 0, 5], [0, 0, 0]]}, r"1 of 2 lie more than 0.01 mm off the surface, number 1 at \(0, 0, 0\)"),
        ({"points": [[0, 0]]}, "points: needs"),
        ({"points": "here"}, "points: needs"),
        ({"points": np.zeros((0, 3))}, "points: there are none"),
        ({"points": [[0, 0, 5.0]], "normals": "up"}, "normals: needs"),
        ({"mesh": "ball.ply"}, "mesh: needs a mesh"),
        ({"medium": "marble"}, "medium: needs a Material"),
        ({"lights": [3]}, "3 is no light"),
        ({"points": [[0, 0, 5.0]], "normals": [[0, 0, 1], [0, 0, 1]]}, "normals: has shape"),
        ({"lights": []}, "at least one light"),
        ({"lights": [DirectionalLight((0, 0, 1), 0)]}, "no light"),
        ({"medium": Material(0.1, 1, eta=1.3), "forward": False}, "eta"),
    ],
)
def test_bad_input_is_named(arguments, words):
    with pytest.raises(InputError, match=words):
        estimate(**{"mesh": ball(), "medium": Material(0.1, 1.0), "lights": [DOWN], "n_paths": 1, **arguments})


# ---------------------------------------------------------------- other people's programs


def scores(estimate, stderr, truth, truth_stderr):
    both = np.hypot(stderr, truth_stderr)
    return np.where(both > 0, (estimate - truth) / np.where(both > 0, both, 1), 0)


def standard_error(stderr, n, truth, truth_stderr, truth_n):
    """Standard error of the difference of two means whose samples have the same variance but for one factor.

    Where hardly a path finds light, a sample does not know its own variance: what is too dark also looks too sure,
    and where no path found any it is 0 +- 0. Both programs estimate one integral by paths from the point that look
    for the light at each collision, so what a single path's variance is there, both samples tell together: pooled
    by their numbers of paths, as in Student's test of equal means. The factor between the programs is that of the
    bright points, where each knows its own.
    """
    variance, truth_variance = n * stderr**2, truth_n * truth_stderr**2
    bright = truth > 0.3 * truth.mean()
    factor = np.median(truth_variance[bright] / variance[bright])
    pooled = (truth_n * truth_variance + n * factor * variance) / (truth_n + n)
    return np.sqrt(pooled / truth_n + pooled / factor / n)


CASES = ["sphere10_marble", "torus20_marble", "plate12_backlit", "box10_cavity_black"]


def against_mitsuba(case, n_paths):
    d = shared(f"mitsuba/{case}.npz")
    mesh = triangles_of(d["vertices"].astype(float)[d["faces"]])
    e = estimate(
        mesh,
        Material(float(d["sigma_a"]), float(d["sigma_s"]), float(d["g"])),
        [DirectionalLight(d["light_dir"])],
        n_paths,
        d["points"],
        d["normals"],
        reenter="black" not in case,
    )
    assert e.radiosity.sum() == pytest.approx(3 * d["radiosity_total"].sum(), rel=0.03 if n_paths < 4000 else 0.006)
    for name, a, s, stderr in (
        ("total", e.radiosity, e.stderr, "stderr"),
        ("single", e.single, e.single_stderr, "stderr_single"),
        ("multiple", e.multiple, e.multiple_stderr, "stderr_multiple"),
    ):
        truth = d[f"radiosity_{name}"]
        error = standard_error(s[:, 0], n_paths, truth, d[stderr], d["n_paths"])
        yield name, a[:, 0] - truth, error, truth < 0.02 * truth.mean()


@pytest.mark.parametrize("case", CASES)
def test_agrees_with_mitsuba(case):
    for name, off, error, _ in against_mitsuba(case, 300):
        z = scores(off, error, 0, 0)
        assert np.mean(np.abs(z) < 3) > 0.98, name
        assert np.sqrt(np.mean(z**2)) < 1.2, name


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES)
def test_agrees_with_mitsuba_at_length(case):
    """Three standard errors at 99 % of the points; and no light leaks to where it is dark, all such points together."""
    for name, off, error, dark in against_mitsuba(case, 15000):
        z = scores(off, error, 0, 0)
        assert np.mean(np.abs(z) < 3) >= 0.99, name
        assert np.sqrt(np.mean(z**2)) < 1.1, name
        assert abs(off[dark].sum()) <= 3 * np.sqrt(np.sum(error[dark] ** 2)), name


SPHERES = {
    "own_sphere_beam_n137": DirectionalLight((0, 0, -1), 1 / (100 * np.pi)),
    "own_sphere_off5_n137": PointLight((0, 0, 5.0), 1 / (4 * np.pi)),
}


def against_sphere(name, n_photons):
    d = shared(f"mcx/{name}.npz")
    mesh = ball(5, 10.0)
    e = estimate(mesh, Material(0.01, 1.0, eta=1.37), [SPHERES[name]], n_photons)
    incident = e.energy["incident"][0]
    for key, kinds in (
        ("absorbed", ("absorbed",)),
        ("exited", ("scattered", "unscattered")),
        ("specular", ("reflected",)),
    ):
        share = sum(e.energy[k][0] for k in kinds) / incident
        assert share == pytest.approx(json.loads(str(d["meta"]))[key], abs=0.002 if n_photons > 20 else 0.008)
    band = np.clip(np.digitize(mesh.vertices[:, 2] / 10, d["cos_edges"]) - 1, 0, 39)
    count = np.bincount(band, minlength=40)
    mean = np.bincount(band, e.radiosity[:, 0], 40) / count
    error = np.sqrt(np.bincount(band, e.stderr[:, 0] ** 2, 40)) / count
    return scores(mean, error, d["exit"], d["exit_sem"])


@pytest.mark.parametrize("name", SPHERES)
def test_agrees_with_an_exact_sphere(name):
    z = against_sphere(name, 5)
    assert np.mean(np.abs(z) < 3) > 0.95
    assert np.sqrt(np.mean(z**2)) < 1.5


@pytest.mark.slow
@pytest.mark.parametrize("name", SPHERES)
def test_agrees_with_an_exact_sphere_at_length(name):
    assert np.mean(np.abs(against_sphere(name, 200)) < 3) > 0.97


def exitance(d):
    """Exitance and its standard error at both ends of an MCX slab, from the zero voxels beyond them."""
    return [(d["exit"][..., k].mean(), np.sqrt(np.mean(d["exit_sem"][..., k] ** 2) / 16)) for k in (0, -1)]


@pytest.mark.slow
@pytest.mark.parametrize(("name", "eta"), [("slab_matched", 1.0), ("slab_n137", 1.37)])
def test_agrees_with_mcx_slabs(name, eta):
    """A block so wide that its middle does not know its sides; light that has entered counts as 1."""
    d = shared(f"mcx/{name}.npz")
    mesh = block(240.0, 240.0, 20.0)
    for z, (truth, sem) in zip((10.0, -10.0), exitance(d), strict=True):
        if eta == 1:
            e = estimate(mesh, Material(0.01, 10.0, 0.9), [DOWN], 1000, top_points(100, 40.0, z))
        else:
            e = estimate(mesh, Material(0.01, 10.0, 0.9, eta), [DOWN], 100_000, [[0.0, 0, z]], radius=50.0)
        mean, error = np.mean(e.radiosity), np.sqrt(np.sum(e.stderr[:, 0] ** 2)) / len(e.stderr)
        entered = fresnel_transmittance(1.0, eta)
        assert mean / entered == pytest.approx(truth, abs=3 * np.hypot(error / entered, sem) + 1e-4)


def test_points_on_the_edges_of_a_box_are_found():
    """Rays along the axes pass by vertices on axis-aligned convex edges. Places keep off triangles' edges by 2 %."""
    cube = trimesh.creation.box((4.0, 4.0, 4.0)).subdivide().subdivide()
    mesh = load_mesh(cube)
    place, triangle = paths.anchors(mesh, mesh.vertices, mesh.normals)
    assert (triangle >= 0).all()
    np.testing.assert_allclose(place, mesh.vertices, atol=0.03 * np.sqrt(2))
