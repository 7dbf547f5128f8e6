"""Multigrid for the diffusion equation: defect correction around V-cycles of the two-point part.

    r = Q - A_h phi;   phi <- phi + V(r);   until |r| <= tolerance |Q| in every channel

A V(2,2) smooths each level by red-black Gauss-Seidel on the cells of its own width; coarser leaves next to them
hold still as ghosts. Restriction sums residuals, prolongation is linear along resistances, coarse coefficients
are sums (coefficients.cl); the coarsest level is solved by its dense inverse.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from clsss.device import Buffer, Device
from clsss.diffusion import CHANNELS, Operator, Residual

SWEEPS = 2
PARTIAL_SUMS = 256


@dataclass(frozen=True)
class Convergence:
    """How a solve went.

    Attributes
    ----------
    residuals : list of (3,) float
        |r| / |Q| of each channel, before the first cycle and after each; 0 where a channel has no source.
    converged : bool
        Whether the last is within the tolerance in every channel.
    tolerance : float
    """

    residuals: list[np.ndarray]
    converged: bool
    tolerance: float

    @property
    def cycles(self) -> int:
        """Number of V-cycles."""
        return len(self.residuals) - 1

    @property
    def factor(self) -> float:
        """Mean reduction of the residual per cycle, of the worst channel."""
        first, last = self.residuals[0], self.residuals[-1]
        lit = first > 0
        if not self.cycles or not lit.any():
            return 0.0
        return float(((last[lit] / first[lit]) ** (1 / self.cycles)).max())


class Multigrid:
    """V-cycles on the levels of an octree.

    Parameters
    ----------
    device : Device
    op : Operator
    """

    def __init__(self, device: Device, op: Operator):
        self.device, self.op = device, op
        levels, d = op.octree.levels, op.medium.defines
        self.residual = Residual(device, op)
        self.e = [device.zeros((level.n + level.n_ghost, CHANNELS)) for level in levels]
        self.r = [device.empty((level.n, CHANNELS)) for level in levels]
        self._partial = [device.empty((PARTIAL_SUMS, CHANNELS)) for _ in levels]
        self._smooth = device.kernel("smooth", "smooth", *d)
        self._restrict = device.kernel("restrict", "restrict_residual", *d)
        self._reflux = device.kernel("residual", "reflux", *d)
        self._ghosts = device.kernel("prolong", "copy_ghosts")
        self._prolong = device.kernel("prolong", "prolong")
        self._coarsest = device.kernel("coarsest", "solve_coarsest")
        self._squares = device.kernel("reduce", "sum_squares")
        self._add = device.kernel("reduce", "add")
        self._inverse = self._invert_coarsest()

    def _invert_coarsest(self) -> Buffer:
        level = self.op.octree.levels[0]
        n, nbr = level.n, level.nbr.get()
        T = self.op.T[0].get().astype(float).reshape(n, 6, -1) * np.ones(CHANNELS)
        absorb = self.op.absorb[0].get().astype(float)
        inverse = np.empty((n, n, CHANNELS))
        rows = np.arange(n)
        for channel in range(CHANNELS):
            A = np.zeros((n, n))
            A[rows, rows] = absorb[:, channel] + T[:, :, channel].sum(axis=1)
            for face in range(6):
                A[rows, nbr[:, face]] -= T[:, face, channel]
            inverse[:, :, channel] = np.linalg.inv(A)
        return self.device.array(inverse)

    def smooth(self, k: int, sweeps: int = SWEEPS) -> None:
        """Red-black sweeps on level `k`."""
        level = self.op.octree.levels[k]
        red, black, end = level.colour_start
        for _ in range(sweeps):
            for first, n in ((red, black - red), (black, end - black)):
                self.device.run(self._smooth, n, first, n, level.nbr, self.op.T[k], self.op.absorb[k], self.r[k],
                                self.e[k])  # fmt: skip

    def v_cycle(self, k: int) -> None:
        """One V-cycle from level `k` down: `e` approximates the correction for the right-hand sides `r`."""
        levels, op, run = self.op.octree.levels, self.op, self.device.run
        if k == 0:
            n = levels[0].n
            run(self._coarsest, n, n, self._inverse, self.r[0], self.e[0])
            return
        fine, coarse = levels[k], levels[k - 1]
        self.e[k].fill(0)
        self.smooth(k)
        run(self._restrict, coarse.n, coarse.n, coarse.is_leaf, coarse.child, fine.nbr, op.T[k], op.absorb[k],
            self.r[k], self.e[k], self.r[k - 1])  # fmt: skip
        m = coarse.interface.shape[0]
        run(self._reflux, m, m, fine.n, coarse.interface, coarse.interface_start, fine.ghost_face, op.T[k],
            self.e[k], self.r[k - 1])  # fmt: skip
        self.v_cycle(k - 1)
        run(self._ghosts, fine.n_ghost, fine.n_ghost, fine.n, fine.parent, self.e[k - 1], self.e[k])
        run(self._prolong, fine.n, fine.n, fine.position, fine.nbr, fine.parent, op.weight[k], self.e[k - 1],
            self.e[k])  # fmt: skip
        self.smooth(k)

    def norm(self, fields: list[Buffer]) -> np.ndarray:
        """2-norm over all cells of fields (n, 4), by colour channel (3,)."""
        for level, field, partial in zip(self.op.octree.levels, fields, self._partial, strict=True):
            self.device.run(self._squares, PARTIAL_SUMS, level.n, PARTIAL_SUMS, field, partial)
        total = sum(partial.get().astype(float).sum(axis=0) for partial in self._partial)
        return np.sqrt(total)[:3]

    def correct(self, phi: list[Buffer]) -> None:
        """Add one V-cycle's correction for the residual in `r` to `phi`."""
        self.v_cycle(len(self.e) - 1)
        for level, e, x in zip(self.op.octree.levels, self.e, phi, strict=True):
            self.device.run(self._add, level.n, level.n, e, x)

    def solve(self, b: list[Buffer], phi: list[Buffer], tolerance: float, max_cycles: int = 40,
              progress: Callable[[float], None] | None = None,
              update: Callable[[list[Buffer]], None] | None = None) -> Convergence:  # fmt: skip
        """Solve A_h phi = b, starting from `phi`.

        Parameters
        ----------
        b : list of (n, 4) real, device
            Right-hand sides [W in the operator's scale].
        phi : list of (n + n_ghost, 4) real, device
            Fluence [W/mm^2]: start and result.
        tolerance : float
            Relative 2-norm of the residual to reach in every channel.
        progress : callable, optional
            Called with the fraction done after each cycle.
        update : callable, optional
            Called with `phi` before each residual; may overwrite `b` where the source follows the solution.

        Returns
        -------
        Convergence
            Not converging is told there, never raised.
        """
        scale = self.norm(b)
        safe = np.where(scale > 0, scale, 1)
        residuals: list[np.ndarray] = []
        while True:
            if update is not None:
                update(phi)
            self.residual(phi, b, self.r)
            residuals.append(np.where(scale > 0, self.norm(self.r) / safe, 0))
            worst = float(residuals[-1].max())
            if worst <= tolerance or len(residuals) > max_cycles or not np.isfinite(worst):
                return Convergence(residuals, worst <= tolerance, tolerance)
            if progress is not None:
                progress(min(1.0, np.log(max(worst, tolerance)) / np.log(tolerance)) if worst < 1 else 0.0)
            self.correct(phi)
