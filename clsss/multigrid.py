"""Multigrid for the diffusion equation: defect correction around V-cycles of the two-point part.

    r = Q - A_h phi;   phi <- phi + V(r);   until |r| <= tolerance |Q| in every channel

A V(2,2) smooths each level by red-black Gauss-Seidel on the cells of its own width; coarser leaves next to them
hold still as ghosts. Restriction sums residuals, prolongation is linear along resistances, coarse coefficients
are sums (coefficients.cl); the coarsest level is solved by its dense inverse.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from clsss.device import Buffer, Device
from clsss.diffusion import CHANNELS, Field, Operator, Residual, channels

SWEEPS = 2  # before and after the coarser level, on the finest
COARSE_SWEEPS = 3  # on the others: little work, and what they leave undone adds up from level to level
PARTIAL_SUMS = 1024
DEPTH = 3  # cycles that Anderson acceleration looks back on
SLOW = 0.25  # a plain cycle that reduces the residual less is accelerated
STALL = 4  # cycles without a tenth less residual end a solve: rounding allows no more
MOVING = 10.0  # tolerance of a follower's state over that of the residual


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
        d = op.medium.defines
        self.residual = Residual(device, op)
        self.e, self.r = Field(device, op.octree), Field(device, op.octree)
        self._partial = device.empty((PARTIAL_SUMS, CHANNELS))
        self._smooth = device.kernel("smooth", "smooth", *d)
        self._restrict = device.kernel("restrict", "restrict_residual", *d)
        self._reflux = device.kernel("residual", "reflux", *d)
        self._ghosts = device.kernel("prolong", "copy_ghosts")
        self._prolong = device.kernel("prolong", "prolong")
        self._coarsest = device.kernel("coarsest", "solve_coarsest")
        self._inner = device.kernel("reduce", "inner_product")
        self._combine = device.kernel("reduce", "combine")
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

    def smooth(self, k: int, sweeps: int | None = None) -> None:
        """Red-black sweeps on level `k`."""
        level = self.op.octree.levels[k]
        sweeps = sweeps or (SWEEPS if k == len(self.e) - 1 else COARSE_SWEEPS)
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

    def inner_product(self, x: Field, y: Field) -> np.ndarray:
        """Sum over all cells of x y, by colour channel (3,)."""
        n = x.whole.shape[0]
        self.device.run(self._inner, PARTIAL_SUMS, n, PARTIAL_SUMS, x.whole, y.whole, self._partial)
        return self._partial.get()[:, :3].astype(float).sum(axis=0)

    def combine(self, a: np.ndarray | float, x: Field, b: np.ndarray | float, y: Field) -> None:
        """Overwrite y with a x + b y; `a` and `b` one number or one per colour channel (3,)."""
        n = x.whole.shape[0]
        scale = [self.device.vector(channels(np.broadcast_to(v, 3).astype(float))) for v in (a, b)]
        self.device.run(self._combine, n, n, *scale, x.whole, y.whole)

    def solve(self, b: Field, phi: Field, tolerance: float, max_cycles: int = 40,
              progress: Callable[[float], None] | None = None,
              follower: Follower | None = None) -> Convergence:  # fmt: skip
        """Solve A_h phi = b, starting from `phi`.

        Where the plain cycle is slower than `SLOW`, and always with a follower, cycles are combined so that the
        residual is least (`Anderson`).

        Parameters
        ----------
        b : Field
            Right-hand sides [W in the operator's scale].
        phi : Field
            Fluence [W/mm^2]: start and result.
        tolerance : float
            Relative 2-norm of the residual to reach in every channel.
        max_cycles : int
            When to give up.
        progress : callable, optional
            Called with the fraction done after each cycle.
        follower : Follower, optional
            Part of the source that depends on the solution.

        Returns
        -------
        Convergence
            Not converging is told there, never raised.
        """
        scale = np.sqrt(self.inner_product(b, b))
        lit = scale > 0
        f = Field(self.device, self.op.octree)
        anderson = Anderson(self, phi, f, follower) if follower else None
        residuals: list[np.ndarray] = []
        while True:
            self.residual.complete(phi)
            moving = follower.update(phi) if follower else 0.0
            self.residual(phi, b, f, completed=True)
            if follower:
                follower.adjust(f)
            residuals.append(np.where(lit, np.sqrt(self.inner_product(f, f)) / np.where(lit, scale, 1), 0))
            history = [float(r.max()) for r in residuals]
            done = history[-1] <= tolerance and moving <= MOVING * tolerance
            stalled = len(history) > STALL and history[-1] > 0.9 * history[-1 - STALL]
            if done or stalled or len(history) > max_cycles or not np.isfinite(history[-1]):
                return Convergence(residuals, done, tolerance)
            if progress is not None:
                progress(float(np.clip(np.log(max(history[-1], tolerance)) / np.log(tolerance), 0, 1)))
            if anderson is None and len(history) > 2 and history[-1] > SLOW * history[-2]:
                anderson = Anderson(self, phi, f, None)
            if anderson:
                anderson.combine()
            self.r.whole.copy_from(f.whole)
            self.v_cycle(len(self.e) - 1)
            self.combine(1, self.e, 1, phi)
            if anderson:
                anderson.add_step(self.e)


class Follower(Protocol):
    """A part of the right-hand side that follows the solution, with a state of its own."""

    state: np.ndarray  # (p, 3), affine in the solution

    def update(self, phi: Field) -> float:
        """Advance `state` by one step, for a complete `phi`; how far it moved, relative to its size."""

    def adjust(self, residual: Field) -> None:
        """Add its part of the right-hand side to a residual."""


class Anderson:
    """Combines cycles: the solution (and a follower's state) of the least residual among the last ones.

    For a linear problem this is GMRES over the last `DEPTH` cycles, on true residuals, by channel.

    References
    ----------
    Walker and Ni 2011, "Anderson acceleration for fixed-point iterations".
    """

    def __init__(self, multigrid: Multigrid, phi: Field, residual: Field, follower: Follower | None):
        self.multigrid, self.phi, self.residual, self.follower = multigrid, phi, residual, follower
        device, octree = multigrid.device, multigrid.op.octree
        # what each of the last cycles changed: the solution, its residual, the follower's state
        self._steps = [(Field(device, octree), Field(device, octree)) for _ in range(DEPTH)]
        self._states = [np.zeros_like(follower.state) if follower else np.zeros((0, 3)) for _ in range(DEPTH)]
        self._count = 0

    def combine(self) -> None:
        """Move solution, residual and state to the best combination of the last cycles."""
        mg, follower, known = self.multigrid, self.follower, min(self._count, DEPTH)
        if self._count:
            last = (self._count - 1) % DEPTH
            mg.combine(1, self.residual, 1, self._steps[last][1])
            if follower:
                self._states[last] += follower.state
        gamma = np.zeros((DEPTH, 3))
        gamma[:known] = self._least_residual(known)
        slot = self._count % DEPTH
        self._count += 1
        for kind, current in enumerate((self.phi, self.residual)):
            moved = self._steps[slot][kind]
            mg.combine(0, moved, -gamma[slot], moved)
            for i in range(known):
                if i != slot:
                    mg.combine(-gamma[i], self._steps[i][kind], 1, moved)
            mg.combine(1, moved, 1, current)
        mg.combine(-1, self.residual, 1, self._steps[slot][1])
        if follower:
            moved_state = -sum(g * state for g, state in zip(gamma, self._states, strict=True))
            follower.state = follower.state + moved_state
            self._states[slot] = moved_state - follower.state

    def add_step(self, correction: Field) -> None:
        """Note what the cycle added to the solution."""
        self.multigrid.combine(1, correction, 1, self._steps[(self._count - 1) % DEPTH][0])

    def _least_residual(self, known: int) -> np.ndarray:
        """Coefficients (known, 3) that take the most from the residual."""
        if not known:
            return np.zeros((0, 3))
        changes = [self._steps[i][1] for i in range(known)]
        gram, right = np.zeros((3, known, known)), np.zeros((3, known))
        for i, change in enumerate(changes):
            right[:, i] = self.multigrid.inner_product(change, self.residual)
            for j in range(i + 1):
                gram[:, i, j] = gram[:, j, i] = self.multigrid.inner_product(change, changes[j])
        return np.stack([np.linalg.lstsq(g, r, rcond=1e-6)[0] for g, r in zip(gram, right, strict=True)], axis=-1)
