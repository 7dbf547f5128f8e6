"""Sparse matrices on the device, for products with three channels at once (kernels/matrix.h)."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from clsss.device import Buffer, Device

if TYPE_CHECKING:
    from scipy import sparse

LARGEST = 65535  # what the greatest entry of a row is as a whole number, or the sum of a row of means


class SparseMatrix:
    """A matrix by rows, four bytes an entry.

    Columns have 16 bits where these suffice. An entry is a whole number of its row's unit, which is such that rows keep
    their sums: light is neither made nor lost.

    Parameters
    ----------
    device : Device
    matrix : (n, m) sparse
        Entries are not negative.
    like : SparseMatrix, optional
        One with entries in the same places: these are held once.

    Attributes
    ----------
    n : int
    rows : tuple of int, Buffer or None
        As kernels take them: entries of each row, or where each starts; columns in 16 or in 32 bits; numbers; units,
        or None where rows sum to one.
    """

    def __init__(self, device: Device, matrix: sparse.csr_matrix, like: SparseMatrix | None = None):
        self.device, self.n = device, matrix.shape[0]
        self._kernel = device.kernel("exchange", "sparse_product")
        self._kernels = device.kernel("exchange", "sparse_products")
        number, unit = _whole_numbers(np.diff(matrix.indptr), matrix.data)
        assert not like or like.rows[4].shape == number.shape
        places = like.rows[:4] if like else places_of(device, matrix)
        units = None if unit is None else device.array(unit)
        self.rows: tuple[Any, ...] = (*places, device.array(number, np.uint16), units)

    def multiply(self, scale: float, x: Buffer, y: Buffer, plus: Buffer | None = None) -> None:
        """Overwrite y (n, 3) with ``scale * A @ x + plus``, all on the device; `plus` may be `y`."""
        self.device.run(self._kernel, self.n, self.n, int(plus is not None), float(scale), *self.rows, x,
                        plus or x, y)  # fmt: skip

    def multiply_both(self, other: SparseMatrix, x: Buffer, y: Buffer, z: Buffer, plus: Buffer | None = None) -> None:
        """Overwrite y with ``A @ x + plus`` and z with ``other @ x``, whose entries are in the same places."""
        self.device.run(self._kernels, self.n, self.n, int(plus is not None), *self.rows, *other.rows[4:], x, plus or x,
                        y, z)  # fmt: skip


def places_of(device: Device, matrix: sparse.csr_matrix) -> tuple[Any, ...]:
    """Where a matrix has entries, as kernels take it: the first four of `SparseMatrix.rows`."""
    count, narrow = np.diff(matrix.indptr), matrix.shape[1] <= 1 << 16
    return (
        int(count[0]),
        None if (count == count[0]).all() else device.array(matrix.indptr, np.int32),
        device.array(matrix.indices, np.uint16) if narrow else None,
        None if narrow else device.array(matrix.indices, np.int32),
    )


def _whole_numbers(count: np.ndarray, data: np.ndarray) -> tuple[np.ndarray, np.ndarray | None]:
    """Entries as whole numbers of their rows' units, and those units (n,); None where rows sum to one."""
    filled = np.flatnonzero(count)
    unit = np.zeros(len(count))
    if not len(filled):
        return unit, unit
    first = np.cumsum(count)[filled] - count[filled]
    total = np.add.reduceat(data, first)
    if len(filled) == len(count) and np.abs(total - 1).max() < 1e-9:
        number, ends = np.empty(len(data), np.uint16), np.cumsum(data)
        ends *= LARGEST
        np.rint(ends, out=ends)
        number[0] = ends[0]
        np.subtract(ends[1:], ends[:-1], out=number[1:], casting="unsafe")
        return number, None
    number = np.rint(data * np.repeat(LARGEST / np.maximum(np.maximum.reduceat(data, first), 1e-300), count[filled]))
    unit[filled] = total / np.maximum(np.add.reduceat(number, first), 1)
    return number, unit
