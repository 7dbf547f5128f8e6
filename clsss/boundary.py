"""The boundary of the cut cells as coarser levels have it, for light that passes between parts of the surface.

    J.n = (phi - gain H_t) / (2A + d/D)

with phi at depth d under the surface, and gain H_t what entering light adds to the fluence there (exchange.py). A
coarser cell has the sums of A_B / (2A + d/D) over the cut cells under it.

References
----------
Haber et al. 2005, eq. (5): the boundary condition, light from elsewhere added as in Haskell et al. 1994.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy import sparse

from clsss.diffusion import Operator
from clsss.exchange import Exchange
from clsss.surface import boundary_points


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
    per_area : (n_cut, 3) float64
        J.n per fluence.
    """

    def __init__(self, op: Operator):
        octree, medium, cut = op.octree, op.medium, op.octree.cut
        self.op, self._cut_cell = op, cut.cell.get()
        away = (cut.boundary.get() - cut.centroid.get())[:, :3].astype(float)
        depth = octree.grid.h * np.maximum((away * boundary_points(octree)[1]).sum(axis=1, keepdims=True), 0.1)
        D = np.array(medium.D_cut.tolist()) if medium.homogeneous else medium.D_cut.get().astype(float)
        self.area = cut.boundary.get()[:, 3:].astype(float) * octree.grid.h**2
        self.per_area = 1 / (2 * medium.fresnel_A + depth / D[..., :3])
        self._scaled = self.per_area / D[..., :3] if medium.homogeneous else self.per_area

    def above(self, exchange: Exchange, depth: int) -> list[Above]:
        """The same for the `depth` levels above the finest, from the finest of them.

        Fluence lets out there what the level's absorption holds: less than the sum, by the weights of pinning.h.
        """
        op, over, found = self.op, self._cut_cell, []
        whole = op.absorb[-1].get()[:, :3].astype(float)
        of_patch = exchange.share.copy()
        of_patch.data[:] = 1
        for k in range(len(op.absorb) - 2, len(op.absorb) - 2 - depth, -1):
            absorb, parent = op.absorb[k].get()[:, :3].astype(float), op.octree.levels[k + 1].parent
            assert parent is not None
            parents = parent.get()[: len(whole)]
            over = parents[over]
            summed = np.stack([np.bincount(parents, values, len(absorb)) for values in whole.T], axis=1)
            whole = np.where(op.octree.levels[k].leaf[:, None], absorb, summed)
            cell, above = np.unique(over, return_inverse=True)
            gather = sparse.csr_matrix((np.ones(len(above)), (above, np.arange(len(above)))))
            total = np.maximum(gather @ self.area, 1e-300)
            held = absorb[cell] / np.maximum(whole[cell], 1e-300)
            leaving = held * (gather @ (self.area * self.per_area)) / total
            blend = sparse.diags(1 / total[:, 0]) @ gather @ sparse.diags(self.area[:, 0]) @ of_patch.T
            found.append(Above(cell, leaving, gather @ (self.area * self._scaled), (exchange.share @ gather.T).tocsr(),
                               blend.tocsr()))  # fmt: skip
        return found
