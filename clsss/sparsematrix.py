"""Sparse matrices on the device, for products with four channels at once (kernels/exchange.cl)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from clsss.device import Buffer, Device

if TYPE_CHECKING:
    from scipy import sparse


class SparseMatrix:
    """A matrix by rows.

    Parameters
    ----------
    device : Device
    matrix : (n, m) sparse

    Attributes
    ----------
    n : int
    rows : tuple of Buffer
        Where each row starts, columns and values, as kernels take them.
    """

    def __init__(self, device: Device, matrix: sparse.csr_matrix):
        self.device, self.n = device, matrix.shape[0]
        self._kernel = device.kernel("exchange", "sparse_product")
        self.rows = device.array(matrix.indptr, np.int32), device.array(matrix.indices, np.int32), device.array(
            matrix.data, device.real
        )

    def multiply(self, scale: float, x: Buffer, y: Buffer, plus: Buffer | None = None) -> None:
        """Overwrite y (n, 4) with ``scale * A @ x + plus``, all on the device."""
        self.device.run(self._kernel, self.n, self.n, int(plus is not None), float(scale), *self.rows, x,
                        plus or x, y)  # fmt: skip
