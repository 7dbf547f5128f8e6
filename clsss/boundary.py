"""The boundary of the cut cells as coarser levels have it, for light that passes between parts of the surface.

    J.n = (phi - gain H_t) / (2A + d/D)

with phi at depth d under the surface, and gain H_t what entering light adds to the fluence there (exchange.py). A
coarser cell has the sums of A_B / (2A + d/D) over the cut cells under it.

References
----------
Haber et al. 2005, eq. (5): the boundary condition, light from elsewhere added as in Haskell et al. 1994.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from scipy import sparse

from clsss.diffusion import Operator
from clsss.exchange import Exchange
from clsss.surface import boundary_normals


class Above(NamedTuple):
    """The boundary, as seen from the n_above cells of a level that lie over cut ones.

    Attributes
    ----------
    cell : (n_above,) int
    leaving : (n_above, 3) float64
        J.n per fluence of the cell.
    entering : (n_above, 3) float64
        What the cell gets, in the operator's scale, per fluence that entering light adds at the boundary.
    share : (p, n_above) sparse
        Area-weighted mean over the cells that each patch touches.
    blend : (n_above, p) sparse
        The like over the patches in each cell.
    """

    cell: np.ndarray
    leaving: np.ndarray
    entering: np.ndarray
    share: sparse.csr_matrix
    blend: sparse.csr_matrix


class Boundary:
    """Conductances C = A_B / (2A + d/D) of the cut cells, one linear profile from each centroid to the surface.

    Attributes
    ----------
    area : (n_cut, 1) float64
        [mm^2]
    per_area : (n_cut, 3) real
        J.n per fluence.
    """

    def __init__(self, op: Operator):
        octree, medium, cut = op.octree, op.medium, op.octree.cut
        self.op, self._cut_cell = op, cut.cell.get()
        away = (cut.boundary.get() - cut.centroid.get())[:, :3]
        depth = octree.grid.h * np.maximum((away * boundary_normals(octree)).sum(axis=1, keepdims=True), 0.1)
        D = np.array(medium.D_cut.tolist()) if medium.homogeneous else medium.D_cut.get().astype(float)
        self.area = cut.boundary.get()[:, 3:].astype(float) * octree.grid.h**2
        self.per_area = (1 / (2 * medium.fresnel_A + depth / D[..., :3])).astype(away.dtype)
        self._scale = 1 / D[..., :3] if medium.homogeneous else np.ones(3)

    def above(self, exchange: Exchange, depth: int) -> list[Above]:
        """The same for the `depth` levels above the finest, from the finest of them.

        Fluence lets out there what the level's absorption holds: less than the sum, by the weights of pinning.h.
        """
        op, over, area, found = self.op, self._cut_cell, self.area[:, 0], []
        whole, of_patch = op.absorb[-1].get(), exchange.share.tocsc()  # each cut cell is of one patch
        for k in range(len(op.absorb) - 2, len(op.absorb) - 2 - depth, -1):
            absorb, parent = op.absorb[k].get()[:, :3].astype(float), op.octree.levels[k + 1].parent
            assert parent is not None
            parents = parent.get()[: len(whole)]
            over = parents[over]
            whole = np.where(op.octree.levels[k].leaf[:, None], absorb, _sums(parents, whole.T[:3], len(absorb)))
            del parents
            cell, above = np.unique(over, return_inverse=True)
            above, shape = above.astype(np.int32), (len(cell), exchange.share.shape[0])
            total = np.maximum(np.bincount(above, area, len(cell)), 1e-300)
            held = absorb[cell] / np.maximum(whole[cell], 1e-300)
            flux = _sums(above, (area * values for values in self.per_area.T), len(cell))
            blend = sparse.coo_matrix((area / total[above], (above, of_patch.indices)), shape).tocsr()
            share = sparse.coo_matrix((of_patch.data, (of_patch.indices, above)), shape[::-1]).tocsr()
            found.append(Above(cell, held * flux / total[:, None], flux * self._scale, share, blend))
        return found


def _sums(group: np.ndarray, columns: Iterable[np.ndarray], n: int) -> np.ndarray:
    """Sums (n, ...) of columns over groups (m,)."""
    return np.stack([np.bincount(group, values, n) for values in columns], axis=1)
