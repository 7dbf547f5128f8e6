"""Cut cells: closed polyhedra of the right size, and an inside that nothing about the triangles upsets."""

from __future__ import annotations

from dataclasses import dataclass

import cases
import numpy as np
import pytest
import trimesh
from shapes import ROTATION, box, box_triangles, build_tree, hollow_sphere, solid, sphere, sphere_triangles, torus

from clsss import cutcell
from clsss.rays import winding
from clsss.triangles import split_long

FACE_NORMALS = np.repeat(np.eye(3), 2, axis=0) * np.tile([-1, 1], 3)[:, None]


@dataclass
class Moments:
    """Cut cells on the host, in double."""

    kappa: np.ndarray
    centroid: np.ndarray
    area: np.ndarray
    area_vector: np.ndarray
    boundary: np.ndarray
    aperture: np.ndarray


def moments(tree):
    cut = tree.cut
    centroid, boundary = cut.centroid.get().astype(float), cut.boundary.get().astype(float)
    return Moments(centroid[:, 3], centroid[:, :3], boundary[:, 3], cut.normal.get()[:, :3].astype(float),
                   boundary[:, :3], tree.apertures())  # fmt: skip


def volume(tree):
    return sum(v[level.leaf].sum() for level, v in zip(tree.levels, tree.volumes(), strict=True))


def blob(seed):
    """An icosphere pushed in and out at random: dents, sharp edges, no symmetry."""
    mesh = trimesh.creation.icosphere(subdivisions=3)
    rng = np.random.default_rng(seed)
    radius = 8 * np.exp(0.25 * rng.normal(size=len(mesh.vertices)))
    return solid((mesh.vertices * radius[:, None])[mesh.faces])


def thin_fins():
    """Plates thinner than a cell, crossing each other."""
    return solid(np.concatenate([box_triangles((20, 12, 0.3), turn=ROTATION), box_triangles((0.4, 9, 15))]))


def aligned_cube():
    """A cube whose faces are planes of its grid, through nodes, or nearly so."""
    return box((16.0, 16.0, 16.0))


SOLIDS = {
    "sphere": sphere,
    "torus": torus,
    "hollow sphere": hollow_sphere,
    "turned box": lambda: box((20, 9, 4), ROTATION),
    "aligned cube": aligned_cube,
    "thin fins": thin_fins,
    **{f"blob {seed}": lambda seed=seed: blob(seed) for seed in range(3)},
}


@pytest.fixture(params=SOLIDS, ids=lambda name: name.replace(" ", "-"))
def any_solid(request):
    return SOLIDS[request.param]()


@pytest.mark.parametrize("resolution", [7, 16, 32])
def test_every_cell_closes(device, eps, any_solid, resolution):
    """sum_f alpha_f n_f + alpha_B n_B = 0: 1e-12 in double."""
    m = moments(build_tree(device, any_solid, resolution))
    gap = m.aperture @ FACE_NORMALS + m.area_vector
    assert np.abs(gap).max() <= (1e-12 if eps < 1e-10 else 32 * eps)


def test_moments_are_within_their_cell(device, eps, any_solid):
    m = moments(build_tree(device, any_solid, 16))
    for values in (m.kappa, m.aperture, m.centroid, m.boundary):
        assert np.isfinite(values).all()
        assert -8 * eps <= values.min() <= values.max() <= 1 + 8 * eps
    assert (np.linalg.norm(m.area_vector, axis=1) <= m.area * (1 + 32 * eps)).all()


def test_faces_open_towards_cells_only(device, eps, any_solid):
    """An aperture never meets an empty cell, and a full cell's is one. That both of two cut cells see the same face is
    in `test_every_cell_closes`, which takes the lower ones from the cells beyond."""
    tree = build_tree(device, any_solid, 16, refine=None)
    nbr, n = tree.finest.nbr.get(), tree.finest.n
    cell, cut_index, aperture = tree.cut.cell.get(), tree.cut_index.get(), tree.cut.aperture.get()
    for axis in range(3):
        other = nbr[cell, 2 * axis + 1]
        alone = other == cell
        assert not aperture[alone, axis].any(), "the cell beyond an open face was dropped"
        beside_full = ~alone & (other < n) & (cut_index[np.minimum(other, n - 1)] < 0)
        np.testing.assert_allclose(aperture[beside_full, axis], 1, atol=8 * eps)


def test_centroids_of_faces_are_those_of_the_plane(double):
    """A plane between the nodes cuts squares: known centroids of what is left of them."""
    tree = build_tree(double, box((14.0, 14.0, 14.0), ROTATION), 16, refine=None)
    cut, aperture, nbr = tree.cut, tree.cut.aperture.get(), tree.finest.nbr.get()
    n, cell, cut_index = ROTATION[:, 2], tree.cut.cell.get(), tree.cut_index.get()
    local = tree.cut_positions() + 0.5
    points = tree.grid.to_mm(local)
    flat = (np.abs(points @ ROTATION[:, :2]) < 4).all(axis=1) & (points @ n > 0)
    depth = (7 - tree.grid.to_mm(tree.cut_positions()) @ n) / tree.grid.h  # of the lower corner under the plane
    seen = 0
    for axis in range(3):
        u, w = (k for k in range(3) if k != axis)
        other = nbr[cell, 2 * axis + 1]
        for row in np.flatnonzero(flat & (other != cell) & (cut_index[np.minimum(other, tree.finest.n - 1)] >= 0)):
            s, t = (np.stack(np.meshgrid(*2 * [np.arange(400) / 400 + 1 / 800], indexing="ij"))).reshape(2, -1)
            inside = depth[row] - n[axis] - s * n[u] - t * n[w] > 0
            np.testing.assert_allclose(aperture[row, axis], inside.mean(), atol=4e-3)
            if inside.mean() > 0.05:
                expected = s[inside].mean(), t[inside].mean()
                np.testing.assert_allclose(cut.face_centroid.get()[row, axis], expected, atol=4e-3)
                seen += 1
    assert seen > 50


def test_places_in_faces_have_16_bits_in_single_precision(single, double):
    """Half of 2^-16 of a cell off, and what float32 itself leaves."""
    trees = [build_tree(device, sphere(subdivisions=4), 24, refine=None) for device in (single, double)]
    found, exact = (tree.cut.face_centroid.get() for tree in trees)
    assert found.dtype == np.uint16
    np.testing.assert_array_equal(trees[0].cut.cell.get(), trees[1].cut.cell.get())
    open_ = trees[1].cut.aperture.get() > 1e-2
    assert open_.sum() > 3000
    np.testing.assert_allclose(found[open_] / 2**16, exact[open_], atol=2**-17 + 2e-5)


def test_no_full_cell_touches_the_outside(device, any_solid):
    tree = build_tree(device, any_solid, 16, refine=None)
    nbr, cut_index = tree.finest.nbr.get(), tree.cut_index.get()
    full = np.flatnonzero(cut_index < 0)
    assert (nbr[full] != full[:, None]).all()


def test_sphere_volume_and_area_have_order_two(double):
    """-7.9e-3, -2.0e-3, -4.9e-4 of the volume at 16, 32, 64 cells with corner samples; half-cell samples do better."""
    radius, resolutions = 10.0, np.array([12, 24, 48])
    mesh, errors = sphere(radius, 6), []
    for resolution in resolutions:
        tree = build_tree(double, mesh, int(resolution))
        area = moments(tree).area.sum() * tree.grid.h**2
        errors.append([1 - volume(tree) / (4 / 3 * np.pi * radius**3), 1 - area / (4 * np.pi * radius**2)])
    errors = np.abs(errors)
    assert cases.order(1 / resolutions, errors[:, 0]) >= 1.9
    assert cases.order(1 / resolutions, errors[:, 1]) >= 1.9
    assert errors[-1, 0] <= 9e-4
    assert errors[-1, 1] <= 5e-4


@pytest.mark.parametrize("thickness", [1.5, 2.0, 3.0])
def test_plate_keeps_its_volume(device, thickness):
    """Half-cell samples: a plate of 1.5 cells loses nothing of its thickness."""
    extents = np.array([20.0, 20.0, thickness * 20 / 32])
    plate = box(extents, ROTATION)
    tree = build_tree(device, plate, round(32 * plate.size / 20))
    assert volume(tree) == pytest.approx(np.prod(extents), rel=0.02)


def test_aligned_cube_is_exact(device, eps):
    """Planes are exact wherever they lie between the nodes; edges lose a triangle of a subcell's size."""
    tree = build_tree(device, aligned_cube(), 16)
    edges = 12 * 16 * 0.5 * (0.5 * tree.grid.h) ** 2
    assert volume(tree) == pytest.approx(16**3, abs=edges)
    m = moments(tree)
    flat = np.abs(m.area_vector).max(axis=1) / np.linalg.norm(m.area_vector, axis=1) > 1 - 1e-6
    np.testing.assert_allclose(np.linalg.norm(m.area_vector, axis=1)[flat], m.area[flat], atol=16 * eps)


def test_scale_and_place_do_not_matter(double):
    """Lengths on the device are in cells: a speck far from the origin has the moments of a near one."""
    near = sphere_triangles(10.0, 4)
    reference = moments(build_tree(double, solid(near), 16))
    far = moments(build_tree(double, solid(near * 2.0**-20 + 2.0**-3), 16))
    np.testing.assert_allclose(far.kappa, reference.kappa, atol=1e-6)


def ball(radius=10.0, x=0.0):
    return sphere_triangles(radius, 3, (x, x / 8, 0))


def flipped(triangles):
    return triangles[:, ::-1]


INSIDE_OUT = {
    "flipped": lambda: flipped(ball()),
    "cavity": lambda: np.concatenate([ball(10), flipped(ball(6))]),
    "body in a cavity": lambda: np.concatenate([ball(10), flipped(ball(7)), ball(3)]),
    "nested, same winding": lambda: np.concatenate([ball(10), ball(6)]),
    "overlapping": lambda: np.concatenate([ball(8, -4), ball(8, 4)]),
    "overlapping, one flipped": lambda: np.concatenate([ball(8, -4), flipped(ball(8, 4))]),
    "twice the same": lambda: np.concatenate([ball(), ball()]),
}


@pytest.fixture(params=INSIDE_OUT, ids=lambda name: name.replace(" ", "-").replace(",", ""))
def odd_triangles(request):
    return INSIDE_OUT[request.param]()


@pytest.mark.parametrize("closed", [True, False], ids=["crossings", "solid-angles"])
def test_inside_is_where_the_winding_number_exceeds_a_half(device, odd_triangles, closed):
    """By crossings of scan lines or by generalised winding numbers: as by the sum of all solid angles."""
    mesh = solid(odd_triangles, closed)
    grid = cutcell.make_grid(mesh.bounds, 12)
    samples = cutcell.sample_surface(device, grid, mesh)
    inside = np.unpackbits(samples.inside, axis=2, bitorder="little")
    decided = np.ones(inside.shape, bool)
    if not closed:  # cells that the surface touches have states of their own
        decided[tuple(samples.cells[:, ::-1].T)] = False
    z, y, x = pick = np.random.default_rng(2).permutation(np.argwhere(decided))[:1000].T
    centres = grid.to_mm(np.stack([x, y, z], axis=1) + 0.5)
    np.testing.assert_array_equal(inside[tuple(pick)] != 0, np.abs(winding(centres, odd_triangles)) > 0.5)


def distance_to(point, triangles):
    """Distance of a point to the nearest of triangles (m, 3, 3)."""
    nearest = trimesh.triangles.closest_point(triangles, np.tile(point, (len(triangles), 1)))
    return np.linalg.norm(nearest - point, axis=1).min()


@pytest.mark.parametrize("closed", [True, False], ids=["crossings", "solid-angles"])
def test_distances_are_those_of_the_surface(double, odd_triangles, closed):
    """Signed distances at the nodes, against the closest of all triangles."""
    mesh = solid(odd_triangles, closed)
    grid = cutcell.make_grid(mesh.bounds, 12)
    samples = cutcell.sample_surface(double, grid, mesh)
    corner = np.stack(np.meshgrid([0, 1], [0, 1], [0, 1], indexing="ij"), axis=-1)[..., ::-1].reshape(8, 3)
    owner = samples.owners[:, 0]
    nodes = grid.to_mm(samples.cells[:, None] + 0.5 * corner).reshape(-1, 3)
    found = samples.distance.get()[owner].ravel() * grid.h
    rng = np.random.default_rng(3)
    pick = rng.choice(len(nodes), 300, replace=False)
    distance = np.array([distance_to(point, odd_triangles) for point in nodes[pick]])
    inside = np.abs(winding(nodes[pick], odd_triangles)) > 0.5
    near = distance < 0.8 * grid.h
    near &= distance > 1e-3 * grid.h
    np.testing.assert_allclose(np.abs(found[pick])[near], distance[near], atol=1e-9)
    np.testing.assert_array_equal(found[pick][near] < 0, inside[near])


def test_soup_agrees_with_the_closed_surface(device):
    """The same sphere as a closed cycle and as a soup of which nothing is known."""
    triangles = sphere_triangles()
    closed = build_tree(device, solid(triangles), 24)
    soup = build_tree(device, solid(triangles[::-1], closed=False), 24)
    assert soup.cut.n == closed.cut.n
    assert volume(soup) == pytest.approx(volume(closed), rel=1e-5)


def test_soup_with_holes_still_has_an_inside(device):
    """Every twentieth triangle is missing: the winding number sinks by that much and stays over a half."""
    triangles = sphere_triangles()
    keep = np.arange(len(triangles)) % 20 > 0
    tree = build_tree(device, solid(triangles[keep], closed=False), 16)
    assert volume(tree) == pytest.approx(4 / 3 * np.pi * 10**3, rel=0.03)


def test_long_triangles_are_split_without_moving(double):
    triangles = np.random.default_rng(4).normal(size=(20, 3, 3)) * [30, 5, 1]
    parts = split_long(triangles, 4.0)
    edges = np.linalg.norm(parts - np.roll(parts, -1, axis=1), axis=2)
    assert edges.max() <= 4.0

    def area_vectors(t):
        return np.cross(t[:, 1] - t[:, 0], t[:, 2] - t[:, 0]).sum(axis=0)

    np.testing.assert_allclose(area_vectors(parts), area_vectors(triangles), rtol=1e-12)


def test_grid_has_a_margin_and_whole_blocks():
    grid = cutcell.make_grid(np.array([[-1.0, 2, 3], [9, 5, 4]]), 20)
    assert grid.h == pytest.approx(0.5)
    assert not np.any(np.array(grid.dims) % 8)
    low, high = grid.to_cells([[-1, 2, 3], [9, 5, 4]])
    assert low.min() >= 2 - 1e-9
    assert (np.array(grid.dims) - high).min() >= 2 - 1e-9
