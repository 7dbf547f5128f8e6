"""Which triangles share which edges, and the components of links, against plain sorting and scipy."""

import numpy as np
import pytest
import trimesh
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from clsss.halfedges import half_edges, join


@pytest.mark.parametrize("spread", [1, 10**7])
def test_half_edges_are_grouped_by_edge(spread):
    """However large the indices are: edges and half-edges may need more than 63 bits together."""
    faces = trimesh.creation.icosphere(subdivisions=2).faces[7:]
    edges = half_edges(np.ascontiguousarray(faces) * spread)
    tail, head = np.stack([faces, np.roll(faces, -1, axis=1)], axis=2).reshape(-1, 2).T
    ends, count = np.unique(np.sort(np.stack([tail, head], axis=1), axis=1), axis=0, return_counts=True)
    np.testing.assert_array_equal(edges.ends(np.arange(len(ends))), ends * spread)
    np.testing.assert_array_equal(edges.count, count)
    np.testing.assert_array_equal(edges.sign(slice(None)), np.where(tail < head, 1, -1)[edges.order])
    place, edge = edges.of(count == 1)
    np.testing.assert_array_equal(edges.start[count == 1], place)
    np.testing.assert_array_equal(edges.net[edge], edges.sign(place))
    np.testing.assert_array_equal(np.sort(edges.order), np.arange(3 * len(faces)))


@pytest.mark.parametrize("n", [0, 1, 2, 50, 3000])
@pytest.mark.parametrize("links", [0, 0.5, 1.1])
def test_components_as_scipy_numbers_them(n, links):
    rng = np.random.default_rng(n)
    a, b = rng.integers(0, n, (2, int(links * n)))
    graph = coo_matrix((np.ones(len(a)), (a, b)), shape=(n, n))
    expected = connected_components(graph, directed=False)[1] if n else []
    np.testing.assert_array_equal(join(a, b, n), expected)


def test_components_of_a_long_path():
    n = 2000
    path = np.random.default_rng(0).permutation(n)
    np.testing.assert_array_equal(join(path[:-1], path[1:], n), np.zeros(n))
