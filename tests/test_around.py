"""The cells around cut cells, told by where rows begin: as the map of leaves has them, on grids of any width."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from shapes import box, build_operator, build_tree, pulley, set_field, sphere, stack, torus

from clsss.around import NUMBERS, _list, list_around
from clsss.fields import Field, Load
from clsss.materials import Material
from clsss.residual import Residual

SOLIDS = pytest.mark.parametrize("make", [sphere, torus, pulley, stack])


def with_far(device, tree):
    """The list as the widest grids have it."""
    return _list(device, tree, device.empty((tree.cut.n, NUMBERS), np.int32))[0]


def decoded(around, cell):
    """Cells (n_cut, 9 rows, 3), -1 where there is none."""
    entry = around.near.get().astype(np.int64)
    odd = (np.arange(9) % 3 + np.arange(9) // 3) % 2 == 1
    middle = np.insert(entry[:, :8] - 32768, 4, 0, axis=1)
    own = np.stack([entry[:, 9:13] & 255, entry[:, 9:13] >> 8], axis=2).reshape(-1, 8)
    side = middle + np.where(odd, -1, 1) * (entry[:, 8:9] - 32768) + np.insert(own - 128, 4, 0, axis=1)
    step = np.stack([side, middle], axis=2)
    if around.far is not None:
        step += around.far.get().reshape(-1, 9, 2)
    exist = (entry[:, 13] | entry[:, 14] << 16)[:, None] >> np.arange(27) & 1
    red = cell < around.n_red
    opposite = np.where(red, np.minimum(cell + around.n_red, around.n - 1), cell - around.n_red)
    own, other = cell[:, None], opposite[:, None]
    side = np.where(odd, own, other) + step[:, :, 0]
    middle = np.where(odd, other, own) + step[:, :, 1]
    exist = exist.reshape(-1, 9, 3)
    at = np.stack([side, middle, side + (exist[:, :, 0] & exist[:, :, 2])], axis=2)
    assert at.min() >= 0
    assert at.max() < around.n, "what stands for a missing cell is read as well"
    return np.where(exist, at, -1)


@SOLIDS
@pytest.mark.parametrize("listed", [list_around, with_far], ids=["near", "far"])
def test_cells_are_those_in_their_places(single, make, listed):
    tree = build_tree(single, make(), 32)
    cell, ijk = tree.cut.cell.get().astype(np.int64), tree.positions()[-1]
    index = np.full(tree.grid.dims, -1)
    index[tuple(ijk.T)] = np.arange(len(ijk))
    z, y, x = np.meshgrid(*3 * [[-1, 0, 1]], indexing="ij")
    around = ijk[cell][:, None] + np.stack([x, y, z], axis=-1).reshape(-1, 3)
    expected = index[tuple(np.moveaxis(around, -1, 0))].reshape(-1, 9, 3)
    np.testing.assert_array_equal(decoded(listed(single, tree), cell), expected)


def test_gradients_are_the_same_on_the_widest_grids(device):
    tree = build_tree(device, pulley(), 24)
    op = build_operator(device, tree, Material(sigma_a=0.1, sigma_s=0.9, eta=1.3))
    phi = Field(device, tree)
    set_field(tree, phi, lambda points: np.random.default_rng(3).uniform(1, 2, len(points)))
    found = []
    for each in (op, replace(op, around=with_far(device, tree))):
        b, r = Load(device, tree), Load(device, tree)
        Residual(device, each)(phi, b, r)
        found.append(r[-1].get())
    np.testing.assert_array_equal(*found)


@pytest.mark.slow
def test_grids_of_more_than_16_bits_are_told(single):
    """A plane of cells so wide that the next plane's are 50,000 cells of a colour away."""
    tree = build_tree(single, box((20.0, 20.0, 0.25)), 330, refine=None)
    around, cell = list_around(single, tree), tree.cut.cell.get().astype(np.int64)
    assert around.far is not None
    expected = np.concatenate([tree.finest.nbr.get()[cell], cell[:, None]], axis=1)
    found = decoded(around, cell).reshape(-1, 27)[:, [12, 14, 10, 16, 4, 22, 13]]
    np.testing.assert_array_equal(np.where(found < 0, cell[:, None], found), expected)
