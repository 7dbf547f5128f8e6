"""The boundary of the cut cells as coarser levels have it, for light that passes between parts of the surface.

    J.n = (phi - gain H_t) / (2A + d/D)

with phi at depth d under the surface, and gain H_t what entering light adds to the fluence there (exchange.py). A
coarser cell has the sums of A_B / (2A + d/D) over the cut cells under it.

References
----------
Haber et al. 2005, eq. (5): the boundary condition, light from elsewhere added as in Haskell et al. 1994.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import NamedTuple

import numpy as np
from scipy import sparse

from clsss.device import Buffer
from clsss.diffusion import Operator
from clsss.surface import boundary_normals

CHUNK = 1 << 15  # cut cells at a time, so that what is reckoned with takes little memory


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
        D = np.array(medium.D_cut.tolist())[:3] if medium.homogeneous else np.ones(3)
        self.area, self.per_area = np.empty((cut.n, 1)), np.empty((cut.n, 3), op.irregular.device.real)
        for first in range(0, cut.n, CHUNK):
            some = slice(first, first + CHUNK)
            m = len(self.area[some])
            boundary = cut.boundary.get(first, m)
            away = (boundary - cut.centroid.get(first, m))[:, :3]
            below = (away * boundary_normals(octree, first, m)).sum(axis=1, keepdims=True)
            over_D = octree.grid.h * np.maximum(below, 0.1) / D
            if not medium.homogeneous:
                over_D /= medium.D_cut.get(first, m)[:, :3]
            self.area[some] = boundary[:, 3:].astype(float) * octree.grid.h**2
            self.per_area[some] = 1 / (2 * medium.fresnel_A + over_D)
        self._scale = 1 / D

    def above(self, share: sparse.csr_matrix, depth: int) -> Iterator[Above]:
        """The same for the `depth` levels above the finest, from the finest of them, for patches' means (p, n_cut).

        Fluence lets out there what the level's absorption holds: less than the sum, by the weights of pinning.h.
        """
        op, over, area = self.op, self._cut_cell, self.area[:, 0]
        of_patch, levels = share.tocsc(), op.octree.levels  # each cut cell is of one patch
        whole: Iterable[np.ndarray] = op.absorb[-1].parts()
        for k in range(len(op.absorb) - 2, len(op.absorb) - 2 - depth, -1):
            parents, leaf = levels[k + 1].parent, levels[k].leaf
            assert parents is not None
            sums = _sums_in_parents(whole, parents, len(leaf))
            over = parents.get(0, levels[k + 1].n)[over]
            is_over = np.zeros(len(leaf), bool)
            is_over[over] = True
            cell, above = np.flatnonzero(is_over), (np.cumsum(is_over, dtype=np.int32) - 1)[over]
            absorb, first = np.empty((len(cell), 3)), 0
            for part in op.absorb[k].parts():
                some = slice(first, first + len(part))
                start, end = np.searchsorted(cell, (some.start, some.stop))
                absorb[start:end] = part[cell[start:end] - first, :3]
                sums[some][leaf[some]] = part[leaf[some], :3]
                first = some.stop
            shape = (len(cell), share.shape[0])
            total = np.maximum(np.bincount(above, area, len(cell)), 1e-300)
            held = absorb / np.maximum(sums[cell], 1e-300)
            flux = np.stack([np.bincount(above, area * values, len(cell)) for values in self.per_area.T], axis=1)
            blend = sparse.coo_matrix((area / total[above], (above, of_patch.indices)), shape).tocsr()
            on_patches = sparse.coo_matrix((of_patch.data, (of_patch.indices, above)), shape[::-1]).tocsr()
            yield Above(cell, held * flux / total[:, None], flux * self._scale, on_patches, blend)
            whole = [sums]


def _sums_in_parents(parts: Iterable[np.ndarray], parents: Buffer, n: int) -> np.ndarray:
    """Sums (n, 3) over the children of each of n cells, whose values (m, 3 or more) come in parts."""
    summed, first = np.zeros((3, n)), 0
    for part in parts:
        parent = parents.get(first, len(part))
        for channel, values in zip(summed, part.T, strict=False):
            np.add.at(channel, parent, values.astype(float))
        first += len(part)
    return summed.T
