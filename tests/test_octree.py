"""The octree's invariants, on every level of every shape."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage, sparse
from scipy.sparse import csgraph
from shapes import (
    ROTATION,
    box,
    box_triangles,
    build_tree,
    children,
    hollow_sphere,
    is_split,
    links,
    merge_all,
    pulley,
    solid,
    sphere,
    sphere_triangles,
    stack,
    torus,
)

from clsss import diffusion
from clsss.coarsening import DENSE
from clsss.cutcell import Grid
from clsss.leafmap import clearance_map

STEPS = np.array([(-1, 0, 0), (1, 0, 0), (0, -1, 0), (0, 1, 0), (0, 0, -1), (0, 0, 1)])


def disjoint_bodies():
    """A large sphere, a small one and a speck, far apart."""
    parts = [sphere_triangles(*part) for part in ((8, 5, (-12, 0, 0)), (3, 4, (10, 6, 2)), (0.4, 2, (12, -8, 0)))]
    return solid(np.concatenate(parts))


SOLIDS = {
    "sphere": (sphere, 48),
    "torus": (torus, 40),
    "hollow sphere": (lambda: hollow_sphere(10, 3), 48),
    "thin plate": (lambda: box((20, 20, 0.9), ROTATION), 32),
    "needle": (lambda: box((20, 0.3, 0.3), ROTATION), 24),
    "tiny": (lambda: sphere(1e-4), 8),
    "bodies": (disjoint_bodies, 48),
    "coarse": (sphere, 4),
    "stack": (stack, 48),
    "pulley": (pulley, 48),
}


@pytest.fixture(scope="module", params=SOLIDS, ids=lambda name: name.replace(" ", "-"))
def tree(single, request):
    make, resolution = SOLIDS[request.param]
    return build_tree(single, make(), resolution)


def leaf_depths(tree):
    """Depth of the leaf that covers each cell of the finest grid (x, y, z), -1 where there is none."""
    out = np.full(tree.grid.dims, -1, np.int8)
    for level, ijk in zip(tree.levels, tree.positions(), strict=True):
        width = 1 << level.depth
        for x, y, z in ijk[level.leaf] * width:
            part = out[x : x + width, y : y + width, z : z + width]
            assert (part == -1).all(), "leaves overlap"
            part[...] = level.depth
    return out


def test_neighbouring_leaves_differ_by_one_level_at_most(tree):
    """2:1 across faces, edges and corners."""
    depth = leaf_depths(tree)
    deepest = ndimage.maximum_filter(depth, 3)
    shallowest = ndimage.minimum_filter(np.where(depth < 0, 99, depth), 3)
    assert (deepest - shallowest)[depth >= 0].max() <= 1


def test_every_leaf_is_found_at_its_centre(tree):
    for level, ijk in zip(tree.levels, tree.positions(), strict=True):
        leaves = np.flatnonzero(level.leaf)
        centre = tree.grid.to_mm((ijk[leaves] + 0.5) * 2**level.depth)
        depth, index = tree.find(centre)
        assert (depth == level.depth).all()
        np.testing.assert_array_equal(index, leaves)


def test_nothing_is_found_outside(tree):
    dims = np.array(tree.grid.dims)
    corners = tree.grid.to_mm(np.array([[0.5, 0.5, 0.5], dims - 0.5, [-1, 3, 3], dims + 2, -1e6 * dims]))
    depth, index = tree.find(corners)
    assert (depth == -1).all()
    assert (index == -1).all()


def test_parents_and_children_are_inverse(tree):
    positions = tree.positions()
    for k, (coarse, fine) in enumerate(zip(tree.levels[:-1], tree.levels[1:], strict=True)):
        parent, (cell, octant, child) = fine.parent.get()[: fine.n], children(coarse)
        np.testing.assert_array_equal(positions[k][parent], positions[k + 1] >> 1)
        np.testing.assert_array_equal(np.sort(child), np.arange(fine.n))
        np.testing.assert_array_equal(parent[child], cell)
        np.testing.assert_array_equal((positions[k + 1][child] & 1) @ [1, 2, 4], octant)
        np.testing.assert_array_equal(np.bincount(cell, minlength=coarse.n) > 0, ~coarse.leaf)
    assert tree.levels[0].parent is None
    assert tree.finest.leaf.all()


def test_neighbours_lie_where_they_should(tree):
    positions = tree.positions()
    for k, (level, ijk) in enumerate(zip(tree.levels, positions, strict=True)):
        cell, face, beyond, _ = links(level)
        np.testing.assert_array_equal(ijk[beyond], ijk[cell] + STEPS[face])
        there = set(zip(cell, face, beyond, strict=True))
        assert there == set(zip(beyond, face ^ 1, cell, strict=True))
        assert len(there) == len(cell)
        nbr, own = level.nbr.get(), np.arange(level.n)
        for face, step in enumerate(STEPS):
            j = nbr[:, face]
            ghost = (j >= level.n) & (j < level.n + level.n_ghost)
            beyond = level.parent.get()[j[ghost]] if ghost.any() else own[:0]
            if ghost.any():
                np.testing.assert_array_equal(positions[k - 1][beyond], (ijk[ghost] + step) >> 1)


def test_coarse_cells_are_the_connected_parts_of_their_blocks(tree):
    for coarse, fine, ijk in zip(tree.levels[:-1], tree.levels[1:], tree.positions()[1:], strict=True):
        parent, (cell, _, beyond, _) = fine.parent.get()[: fine.n], links(fine)
        inside = (ijk[cell] >> 1 == ijk[beyond] >> 1).all(axis=1)
        edges = sparse.coo_matrix((np.ones(inside.sum()), (cell[inside], beyond[inside])), shape=(fine.n, fine.n))
        n, part = csgraph.connected_components(edges, directed=False)
        assert n == (~coarse.leaf).sum() == len(np.unique(np.stack([part, parent]), axis=1).T)


def test_coarse_neighbours_are_those_behind_open_finer_faces(tree):
    for coarse, fine in zip(tree.levels[:-1], tree.levels[1:], strict=True):
        parent, (cell, face, beyond, _) = fine.parent.get()[: fine.n], links(fine)
        apart = parent[cell] != parent[beyond]
        expected = set(zip(parent[cell[apart]], face[apart], parent[beyond[apart]], strict=True))
        cell, face, beyond, _ = links(coarse)
        covered = ~coarse.leaf[cell] & ~coarse.leaf[beyond]
        assert set(zip(cell[covered], face[covered], beyond[covered], strict=True)) == expected


def test_only_bodies_that_come_close_split_blocks(single):
    assert not any(map(is_split, build_tree(single, sphere(), 48).positions()))
    for make in (stack, pulley):
        tree = build_tree(single, make(), 48)
        assert any(map(is_split, tree.positions()))
        assert not is_split(tree.positions()[-1])
    assert any(level.junction_face.shape[0] for level in tree.levels)
    assert any(level.chain.shape[0] for level in tree.levels)


def test_levels_go_on_where_splitting_leaves_many_cells(single):
    tree = build_tree(single, stack(), 96)
    assert max(np.ptp(tree.positions()[1], axis=0)) < 4
    assert tree.levels[1].n > DENSE >= tree.levels[0].n
    test_coarse_cells_are_the_connected_parts_of_their_blocks(tree)
    test_coarse_neighbours_are_those_behind_open_finer_faces(tree)


def test_many_specks_share_cells_of_the_coarsest_level(single):
    """Its inverse is dense."""
    at = np.stack(np.meshgrid(*[np.arange(-9, 10, 2.0)] * 3), axis=-1).reshape(-1, 3)
    specks = solid(np.concatenate([box_triangles((0.7, 0.7, 0.7), centre) for centre in at]))
    levels = build_tree(single, specks, 32).levels
    assert levels[0].n <= 64
    assert levels[1].n >= len(at) > DENSE


def test_leaves_face_one_cell_of_their_width_at_most(tree):
    """Parts of a split block that face one leaf hang together along it: no child next to a leaf is cut."""
    for level in tree.levels:
        assert not level.leaf[level.junction_face.get() // 6].any()


def test_parents_of_ghosts_are_leaves(tree):
    for coarse, fine in zip(tree.levels[:-1], tree.levels[1:], strict=True):
        parent = fine.parent.get()[fine.n : fine.n + fine.n_ghost]
        assert len(parent) == fine.n_ghost
        assert coarse.leaf[parent].all()
        faces = fine.ghost_face.get()
        np.testing.assert_array_equal(fine.nbr.get().ravel()[faces], fine.n + np.arange(fine.n_ghost))
        assert len(np.unique(faces)) == fine.n_ghost


def test_interface_lists_the_ghosts_of_each_leaf(tree):
    for coarse, fine in zip(tree.levels[:-1], tree.levels[1:], strict=True):
        interface, start = coarse.interface.get(), coarse.interface_start.get()
        np.testing.assert_array_equal(
            np.repeat(interface, np.diff(start)) if len(interface) else interface,
            fine.parent.get()[fine.n : fine.n + fine.n_ghost],
        )


def test_no_neighbours_share_a_colour(tree):
    for level in tree.levels:
        red, black, end = level.colour_start
        assert (red, end) == (0, level.n)
        colour = np.arange(level.n) >= black
        cell, _, beyond, _ = links(level)
        assert (colour[cell] != colour[beyond]).all()


def test_cells_of_one_colour_are_in_order(tree):
    for level, ijk in zip(tree.levels, tree.positions(), strict=True):
        for first, end in zip(level.colour_start[:-1], level.colour_start[1:], strict=True):
            x, y, z = ijk[first:end].T.astype(np.int64)
            key = (z << 40) + (y << 20) + x
            assert (np.diff(key) >= 0).all()
            assert is_split(ijk) or (np.diff(key) > 0).all()


def test_cut_cells_and_all_around_them_are_finest(tree):
    depth = leaf_depths(tree)
    near = np.zeros(depth.shape, bool)
    near[tuple(tree.cut_positions().T)] = True
    near = ndimage.binary_dilation(near, np.ones((3, 3, 3)))
    assert depth[near].max() <= 0


def test_bands_are_two_cells_wide(tree):
    """Between a leaf and those two levels coarser lie at least two cells of the level between, diagonals included."""
    depth = leaf_depths(tree)
    for level in range(int(depth.max()) - 1):
        width = 2 << level
        finer = ndimage.binary_dilation((depth >= 0) & (depth <= level), np.ones((3, 3, 3)), iterations=2 * width)
        assert not (finer & (depth > level + 1)).any()


def test_cut_index_and_cut_cells_are_inverse(tree):
    index, cell = tree.cut_index.get(), tree.cut.cell.get()
    assert (np.diff(cell) > 0).all()
    np.testing.assert_array_equal(index[cell], np.arange(tree.cut.n))
    assert (index >= 0).sum() == tree.cut.n


@pytest.mark.parametrize(
    ("make", "expected", "resolution", "accuracy"),
    [
        (sphere, 4 / 3 * np.pi * 1000, 48, 2e-3),
        (torus, 2 * np.pi**2 * 7 * 9, 48, 6e-3),
        (lambda: hollow_sphere(10, 5), 4 / 3 * np.pi * 875, 48, 3e-3),
        (lambda: box((20, 20, 0.9), ROTATION), 360, 48, 0.02),
        (disjoint_bodies, 4 / 3 * np.pi * (8**3 + 3**3 + 0.4**3), 64, 6e-3),
    ],
    ids=["sphere", "torus", "hollow", "plate", "bodies"],
)
@pytest.mark.parametrize("refine", [merge_all, None], ids=["merged", "uniform"])
def test_leaves_tile_the_object(single, make, expected, resolution, accuracy, refine):
    tree = build_tree(single, make(), resolution, refine)
    volume = sum(v[level.leaf].sum() for level, v in zip(tree.levels, tree.volumes(), strict=True))
    assert volume == pytest.approx(expected, rel=accuracy)


def test_without_adaption_all_leaves_are_finest(single):
    tree = build_tree(single, sphere(), 32, refine=None)
    assert not any(level.leaf.any() for level in tree.levels[:-1])
    assert tree.n_leaves == tree.finest.n
    assert all(level.n_ghost == 0 for level in tree.levels)


def test_merging_saves_cells_and_keeps_cut_cells(single):
    merged, uniform = (build_tree(single, sphere(), 64, refine) for refine in (merge_all, None))
    assert merged.n_leaves < uniform.n_leaves
    np.testing.assert_allclose(merged.cut.centroid.get(), uniform.cut.centroid.get())


def test_refinement_where_asked(single):
    """A criterion splits cells wherever they are; balance and bands still hold."""
    plain = build_tree(single, sphere(), 64)

    def at_centre(centres, h, depth):
        return (np.abs(centres) <= h / 2).all(axis=1)

    refined = build_tree(single, sphere(), 64, at_centre)
    assert refined.find(np.zeros((1, 3)))[0][0] < plain.find(np.zeros((1, 3)))[0][0]
    test_neighbouring_leaves_differ_by_one_level_at_most(refined)
    test_bands_are_two_cells_wide(refined)
    test_every_leaf_is_found_at_its_centre(refined)


def test_separate_bodies_keep_their_leaves(single):
    tree = build_tree(single, disjoint_bodies(), 64)
    points = np.array([[-12.0, 0, 0], [10, 6, 2], [12, -8, 0]])
    assert (tree.find(points)[0] >= 0).all()
    assert tree.find(np.zeros((1, 3)))[0][0] == -1


def test_coarsest_level_is_small(tree):
    """Its dense inverse has to stay cheap."""
    assert tree.levels[0].n <= DENSE == 64


def test_points_are_inside_their_cells(tree):
    for points, level, ijk in zip(diffusion.cell_points(tree), tree.levels, tree.positions(), strict=True):
        local = tree.grid.to_cells(points) / 2**level.depth - ijk
        assert -1e-5 <= local.min() <= local.max() <= 1 + 1e-5


def test_clearance_is_the_distance_to_another_kind(device):
    """Chessboard distance up to 15, in every cell of blocks of several kinds, the least of all in others."""
    noise = ndimage.gaussian_filter(np.random.default_rng(2).normal(size=(64, 40, 48)), 7)
    kind = np.where(np.abs(noise) < 0.0005, 0, np.where(noise > 0, 129, 1))
    expected = np.zeros(kind.shape, int)
    for value in (1, 129):
        padded = np.pad(kind == value, 20, mode="edge")
        distance = ndimage.distance_transform_cdt(padded, "chessboard")[20:-20, 20:-20, 20:-20]
        expected = np.where(kind == value, (value & 128) + np.minimum(distance, 15), expected)
    blocks = expected.reshape(8, 8, 5, 8, 6, 8).transpose(0, 2, 4, 1, 3, 5).reshape(-1, 512)
    grid = Grid(np.zeros(3), 1.0, (48, 40, 64))
    near, clearance = clearance_map(device, grid, kind == 129, kind == 0)
    mixed = near >= 0
    assert 50 < mixed.sum() < len(near) - 10
    np.testing.assert_array_equal(clearance[near[mixed]], blocks[mixed])
    np.testing.assert_array_equal(-1 - near[~mixed], blocks[~mixed].min(axis=1))
