"""Sparse matrices on the device against scipy's."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import sparse

from clsss.sparsematrix import SparseMatrix


def random_matrix(n, m, random):
    """Rows of 0 to 11 entries between 1e-4 and 1."""
    count = random.integers(0, 12, n)
    start = np.concatenate([[0], np.cumsum(count)])
    column = random.integers(0, m, start[-1])
    return sparse.csr_matrix((10 ** random.uniform(-4, 0, start[-1]), column, start), shape=(n, m))


def product(device, matrix, x, scale=1.0, plus=None):
    """On the device, on one channel."""
    spread = [device.array(np.repeat(v[:, None], 3, axis=1)) for v in (x, np.zeros(matrix.shape[0]))]
    SparseMatrix(device, matrix).multiply(scale, *spread, None if plus is None else device.array(
        np.repeat(plus[:, None], 3, axis=1)))  # fmt: skip
    return spread[1].get()[:, 0]


@pytest.mark.parametrize("m", [300, 200_000])  # columns in 16 bits, and in 32
def test_product_is_that_of_the_matrix(device, m):
    random = np.random.default_rng(1)
    matrix = random_matrix(500, m, random)
    x, plus = random.uniform(0, 1, m), random.uniform(0, 1, 500)
    found, exact = product(device, matrix, x, -2.5, plus), -2.5 * (matrix @ x) + plus
    assert np.abs(found - exact).max() <= 2.5 * 12 * 2**-16
    assert np.abs(found - exact).mean() <= 2.5 * 2**-16


def test_rows_keep_their_sums(device):
    """What a patch receives under an even exitance is exact; rows of means give back what is even."""
    random = np.random.default_rng(2)
    matrix = random_matrix(500, 300, random)
    eps = np.finfo(device.real).eps
    np.testing.assert_allclose(product(device, matrix, np.ones(300)), matrix @ np.ones(300), rtol=20 * eps)
    column = random.integers(0, 300, (500, 6))
    weight = random.dirichlet(np.ones(6), 500)
    mean = sparse.csr_matrix((weight.ravel(), column.ravel(), np.arange(0, 3001, 6)), shape=(500, 300))
    np.testing.assert_allclose(product(device, mean, np.ones(300)), 1, rtol=20 * eps)


def test_columns_keep_their_sums_on_average(device):
    """Power that leaves a patch and what arrives of it elsewhere: rounding errors of columns are independent."""
    random = np.random.default_rng(3)
    matrix = random_matrix(5000, 300, random)
    x = random.uniform(0, 1, 300)
    assert product(device, matrix, x).astype(float).sum() == pytest.approx((matrix @ x).sum(), rel=2e-6)


def test_matrices_alike_hold_their_places_once(device):
    random = np.random.default_rng(4)
    matrix, x = random_matrix(500, 300, random), random.uniform(0, 1, 300)
    half = matrix.copy()
    half.data *= random.uniform(0, 1, half.nnz)
    one, before = SparseMatrix(device, matrix), device.allocated
    other = SparseMatrix(device, half, one)
    assert device.allocated - before == 2 * half.nnz + 500 * device.real.itemsize
    found, alone = device.zeros((500, 3)), product(device, half, x)
    other.multiply(1, device.array(np.repeat(x[:, None], 3, axis=1)), found)
    assert np.array_equal(found.get()[:, 0], alone)
    both, spread = [device.zeros((500, 3)) for _ in range(2)], device.array(np.repeat(x[:, None], 3, axis=1))
    one.multiply_both(other, spread, *both)
    np.testing.assert_allclose(both[0].get()[:, 0], product(device, matrix, x), rtol=4 * np.finfo(device.real).eps)
    np.testing.assert_allclose(both[1].get()[:, 0], alone, rtol=4 * np.finfo(device.real).eps)


def test_four_bytes_an_entry(device):
    """Columns and numbers of 16 bits; where rows are equally long means, nothing else."""
    even = sparse.csr_matrix((np.full(600, 1 / 6), np.tile(np.arange(6), 100), np.arange(0, 601, 6)), shape=(100, 6))
    before = device.allocated
    held = SparseMatrix(device, even)
    assert device.allocated - before == 4 * held.n * 6
