"""V-cycles on the levels of few cells, one launch each: level by level, launches would cost more than cells do.

kernels/fused.cl takes the steps of a cycle from a table, with a barrier after each. They are those of `Multigrid`,
to the same bits.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import takewhile

import numpy as np

from clsss.device import Buffer
from clsss.diffusion import Operator
from clsss.fields import Field, Load

FEW = 1 << 16  # most cells of a level, over the compute units: a work-group has one, and leaves the others idle
GROUP = 256  # work-items, where a device computes across them
# as in fused.cl
(CLEAR, FROM_ZERO, RELAX, OVER_RELAX, FILL_JUNCTIONS, REFLUX, LEAVE_RESIDUAL, RESTRICT, COPY_GHOSTS, PROLONG,
 SOLVE) = range(11)  # fmt: skip
Step = tuple[int, int, int, int]  # kind, level, first item, number of items


def _join(arrays: list[Buffer]) -> tuple[Buffer, list[int]]:
    """Move arrays into one buffer of words of four bytes; where each starts."""
    device = arrays[0].device
    step = device.row_alignment
    start = np.cumsum([0, *(-(-v.nbytes // (4 * step)) * step for v in arrays)]).tolist()
    words = device.empty(start[-1], np.int32)
    for v, first in zip(arrays, start[:-1], strict=True):
        v.move(words, 4 * first)
    return words, start[:-1]


class FusedLevels:
    """The levels of few cells, from the coarsest on but without the finest. Their arrays move into one buffer.

    Parameters
    ----------
    op : Operator
    e : Field
    r : Load
        Correction and right-hand sides of the cycles.
    inverse : (n, n, 4) real, device
        Of the coarsest level, which is always among them.
    over : float
        Relaxation where it is not 1.
    sweeps : int
        Usual number on each level, before and after the next.
    few : int, optional
        Most cells of the others.

    Attributes
    ----------
    n : int
        How many levels.
    """

    def __init__(self, op: Operator, e: Field, r: Load, inverse: Buffer, over: float, sweeps: int,
                 few: int | None = None):  # fmt: skip
        self.device, self._over, self._usual = inverse.device, over, sweeps
        levels, handle = op.octree.levels, self.device.handle
        most = FEW // handle.max_compute_units if few is None else few
        self._levels = [levels[0], *takewhile(lambda level: level.n <= most, levels[1:-1])]
        self.n = len(self._levels)
        self._rows = np.diff(e.start).tolist()
        self._e, self._r = e.coarsest(self.n), r.coarsest(self.n)
        self._kernel = self.device.kernel("fused", "fused_v_cycle", *op.medium.defines)
        self._group = 1 if self.device.lanes > 1 else min(GROUP, handle.max_work_group_size)
        arrays = [self._arrays(op, k, inverse) for k in range(self.n)]
        self._words, starts = _join([v for of_level in arrays for v in of_level if v])
        start = iter(starts)
        table = [
            [level.n, level.n + level.n_ghost, e.start[k], r.start[k], op.absorb[k].last,
             *(next(start) if v else 0 for v in arrays[k])]
            for k, level in enumerate(self._levels)
        ]  # fmt: skip
        self._table = self.device.array(table, np.int32)
        self._steps: dict[tuple[int, int], Buffer] = {}
        self._steps_of(self.n - 1, sweeps)  # now: a solve leaves nothing on the device

    def _arrays(self, op: Operator, k: int, inverse: Buffer) -> list[Buffer | None]:
        """What fused.cl takes of level `k`, in its order."""
        level = self._levels[k]
        found = [level.nbr, level.parent, level.covered, level.child, level.chain, level.ghost_face, level.interface,
                 level.interface_start, level.junction_start, level.junction_cell, op.T[k].row, op.T[k].values,
                 op.absorb[k].values, op.share[k], op.weight[k], None if k else inverse]  # fmt: skip
        return [v if v and v.nbytes else None for v in found]

    def _steps_of(self, k: int, sweeps: int) -> Buffer:
        if (k, sweeps) not in self._steps:
            self._steps[k, sweeps] = self.device.array([step for step in self._cycle(k, sweeps) if step[3]], np.int32)
        return self._steps[k, sweeps]

    def v_cycle(self, k: int, sweeps: int | None = None) -> None:
        """Enqueue a V-cycle from level `k` down, of `sweeps` or the usual number."""
        steps = self._steps_of(k, sweeps or self._usual)
        self.device.run(self._kernel, self._group, steps.shape[0], self._over, steps, self._table, self._words,
                        self._r, self._e, group=self._group)  # fmt: skip

    def _cycle(self, k: int, sweeps: int) -> Iterator[Step]:
        """The steps of a V-cycle, as `Multigrid.v_cycle` takes them."""
        if not k:
            yield SOLVE, 0, 0, self._levels[0].n
            return
        fine, coarse = self._levels[k], self._levels[k - 1]
        n_red = fine.colour_start[1]
        red, black = (k, 0, n_red), (k, n_red, fine.n - n_red)
        junctions = FILL_JUNCTIONS, k, 0, fine.junction_face.shape[0]
        yield CLEAR, k, fine.n, self._rows[k] - fine.n
        yield FROM_ZERO, *red
        for cells in (black, *(red, black) * (sweeps - 1)):
            yield junctions
            yield RELAX, *cells
        yield REFLUX, k, 0, coarse.interface.shape[0]
        yield junctions
        yield LEAVE_RESIDUAL, *red
        yield RESTRICT, k, 0, coarse.covered.shape[0]
        yield from self._cycle(k - 1, sweeps)
        yield COPY_GHOSTS, k, 0, fine.n_ghost
        yield PROLONG, *black
        for _ in range(sweeps):
            yield junctions
            yield RELAX, *red
            yield junctions
            yield OVER_RELAX, *black
