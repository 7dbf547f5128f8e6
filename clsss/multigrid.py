"""Multigrid for the diffusion equation: defect correction around V-cycles of the two-point part.

    r = Q - A_h phi;   phi <- phi + w V(r);   until |r| <= tolerance |Q| in every channel

A V(2,2) smooths each level by red-black relaxation on the cells of its own width; coarser leaves next to them
hold still as ghosts. Restriction sums residuals, prolongation is linear along resistances, coarse coefficients
are sums (coefficients.cl); the coarsest level is solved by its dense inverse.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial

import numpy as np

from clsss.anderson import Anderson, Coupling, Follower
from clsss.device import Buffer, Device
from clsss.diffusion import Operator
from clsss.fields import CHANNELS, Field, Load, PerLevel, channels
from clsss.fused import FusedLevels
from clsss.residual import Residual
from clsss.room import Room
from clsss.rounding import Held, rounding_gain
from clsss.steps import share, without_coupling
from clsss.sums import inner_product

SWEEPS = 2  # before and after the coarser level, on the finest
COARSE_SWEEPS = 3  # on the others: little work, and what they leave undone adds up from level to level
SLOW = 0.25  # plain cycles that reduce the residual less are accelerated, unless two more would do
# Relaxation of the first red half-sweep and, after the coarser level, of the black ones (Yavneh 1996). The last
# half-sweep before restricting must be plain: restriction counts on black cells without residual.
OVER = 1.25
STALL = 4  # cycles without a tenth less residual end a solve: rounding allows no more
HOLD = 1e-2  # residual at which a solution is held, where rounding it would leave too much
NEAR = 0.25  # of the tolerance: what rounding may leave
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
        self.e, self.r = Field(device, op.octree, -(-9 * op.octree.cut.n // CHANNELS)), Load(device, op.octree)
        self.room = Room(device, self.e.lent())  # no correction is wanted while a residual is taken
        self.residual = Residual(device, op, self.room)
        self._smooth, self._from_zero = (device.kernel("smooth", name, *d) for name in ("smooth", "smooth_from_zero"))
        self._leave_residual = device.kernel("restrict", "leave_residual", *d)
        self._junctions = device.kernel("junction", "fill_junctions", *d)
        self._restrict = device.kernel("restrict", "restrict_residual", *d)
        self._reflux = device.kernel("residual", "reflux", *d)
        self._ghosts = device.kernel("prolong", "copy_ghosts")
        self._prolong = device.kernel("prolong", "prolong")
        self._combine = device.kernel("reduce", "combine")
        self._fused = FusedLevels(op, self.e, self.r, self._invert_coarsest(), OVER, COARSE_SWEEPS)
        # captured by the last solve, by what takes part in them: the next replays them, unless that is another
        self._cycles: dict[Coupling | None, Callable[[], None]] = {}

    def _invert_coarsest(self) -> Buffer:
        level, op = self.op.octree.levels[0], self.op
        n, nbr = level.n, level.nbr.get()
        T = op.T[0].get().astype(float).reshape(n, 6, -1)
        start, beyond = level.junction_start.get(), level.junction_cell.get()
        row, face = np.divmod(np.repeat(level.junction_face.get(), np.diff(start)), 6)
        plain = np.nonzero(nbr < n)
        i, j = np.concatenate([plain[0], row]), np.concatenate([nbr[plain], beyond])
        T_ij = np.concatenate([T[plain], T[row, face] * op.share[0].get().reshape(len(beyond), T.shape[2])])
        total = op.absorb[0].get().astype(float) + T.sum(axis=1)
        T_ij = T_ij * np.ones(CHANNELS)
        inverse = np.empty((n, n, CHANNELS))
        for channel in range(CHANNELS):
            A = np.diag(total[:, channel])
            np.subtract.at(A, (i, j), T_ij[:, channel])
            inverse[:, :, channel] = np.linalg.inv(A)
        return self.device.array(inverse)

    def smooth(self, k: int, sweeps: int | None = None, from_zero: bool = False) -> None:
        """Red-black sweeps on level `k`: those after the coarser level, or the ones before it, which start `from_zero`
        whatever the cells' values but with ghosts of zero.
        """
        level = self.op.octree.levels[k]
        sweeps = sweeps or (SWEEPS if k == len(self.e) - 1 else COARSE_SWEEPS)
        red, black, end = level.colour_start
        for sweep in range(sweeps):
            for first, n in ((red, black - red), (black, end - black)):
                if from_zero and not sweep and first == red:
                    self.device.run(self._from_zero, n, first, n, OVER, *self.op.two_point(k), self.r[k],
                                    self.e[k])  # fmt: skip
                else:
                    omega = OVER if first == black and not from_zero else 1.0
                    self._fill_junctions(k)
                    self.device.run(self._smooth, n, first, n, omega, level.nbr, *self.op.two_point(k), self.r[k],
                                    self.e[k])  # fmt: skip

    def _fill_junctions(self, k: int) -> None:
        level = self.op.octree.levels[k]
        m = level.junction_face.shape[0]
        self.device.run(self._junctions, m, m, level.n + level.n_ghost, level.junction_start, level.junction_cell,
                        self.op.share[k], self.e[k])  # fmt: skip

    def restrict(self, k: int) -> None:
        """What level `k` leaves becomes the right-hand side of level `k` - 1, and stands in the place of red values."""
        run, op, fine, coarse = self.device.run, self.op, self.op.octree.levels[k], self.op.octree.levels[k - 1]
        red = fine.colour_start[1]
        self._fill_junctions(k)
        run(self._leave_residual, red, red, fine.nbr, *op.two_point(k), self.r[k], self.e[k])
        m = coarse.covered.shape[0]
        run(self._restrict, m, m, coarse.covered, coarse.child, coarse.chain, self.e[k], self.r[k - 1])

    @contextmanager
    def lent(self) -> Iterator[Room]:
        """Memory that is only needed while it solves, beside the correction's."""
        yield Room(self.device, self.r.lent(), self.e.lent_beyond())
        self.r.whole.fill(0)

    def v_cycle(self, k: int, coupling: Coupling | None = None, sweeps: int | None = None) -> None:
        """One V-cycle from level `k` down: `e` approximates the correction for the right-hand sides `r`.

        A `coupling` takes part on its level and those finer than it. `sweeps` other than the usual number smooth each
        level before and after the next.
        """
        levels, op, run = self.op.octree.levels, self.op, self.device.run
        if k == 0 or (not coupling and k < self._fused.n):
            self._fused.v_cycle(k, sweeps)
            return
        fine, coarse = levels[k], levels[k - 1]
        _, black, end = fine.colour_start
        self.e.clear_from(k, fine.n)
        self.smooth(k, sweeps, from_zero=True)
        m = coarse.interface.shape[0]
        run(self._reflux, m, m, fine.n, coarse.interface, coarse.interface_start, fine.ghost_face,
            op.T[k].row, op.T[k].values, self.e[k], self.r[k - 1])  # fmt: skip
        self.restrict(k)
        if coupling and coupling.level == k - 1:
            coupling.respond(lambda number: self.v_cycle(k - 1, sweeps=number), self.r, self.e)
        else:
            self.v_cycle(k - 1, coupling, sweeps)
        if coupling:
            coupling.let_in(k, self.r[k])
        run(self._ghosts, fine.n_ghost, fine.n_ghost, fine.n, fine.parent, self.e[k - 1], self.e[k])
        # red cells are overwritten next
        run(self._prolong, end - black, black, end - black, fine.nbr, fine.parent, op.weight[k], self.e[k - 1],
            self.e[k])  # fmt: skip
        self.smooth(k, sweeps)

    def inner_product(self, x: PerLevel, y: PerLevel) -> np.ndarray:
        """Sum over all cells of x y, by colour channel (3,)."""
        return inner_product(self.device, x, y)

    def combine(self, a: np.ndarray | float, x: Field, b: np.ndarray | float, y: Field) -> None:
        """Overwrite y with a x + b y; `a` and `b` one number or one per colour channel (3,)."""
        n = x.whole.shape[0]
        scale = [self.device.vector(channels(np.broadcast_to(v, 3).astype(float))) for v in (a, b)]
        self.device.run(self._combine, n, n, *scale, x.whole, y.whole)

    def solve(self, b: Load, phi: Field, tolerance: float, max_cycles: int = 40,
              progress: Callable[[float], None] | None = None, follower: Follower | None = None,
              from_zero: bool = False) -> Convergence:  # fmt: skip
        """Solve A_h phi = b, starting from `phi`.

        Where the plain cycle is slower than `SLOW`, cycles are combined so that the residual is least (`Anderson`).
        Where rounding `phi` would leave more than the tolerance, the solve goes on from a solution that it no longer
        changes (`Held`); the residuals told are then those before the last rounding.

        Parameters
        ----------
        b : Load
            Right-hand sides [W in the operator's scale].
        phi : Field
            Fluence [W/mm^2]: start and result, the latter complete.
        tolerance : float
            Relative 2-norm of the residual to reach in every channel.
        max_cycles : int
            When to give up.
        progress : callable, optional
            Called with the fraction done after each cycle.
        follower : Follower, optional
            Part of the source that depends on the solution.
        from_zero : bool
            Whether `phi` is zero, ghosts included.

        Returns
        -------
        Convergence
            Not converging is told there, never raised.
        """
        scale = np.sqrt(self.inner_product(b, b))
        lit = scale > 0
        r, capture, top = self.r, self.device.capture, len(self.e) - 1
        take_residual = capture(lambda: self.residual(phi, b, r))
        adjust = capture(lambda: follower.adjust(r)) if follower else None
        coupling = follower.coupling if follower else None
        self._cycles = {
            c: self._cycles.get(c) or capture(partial(self.v_cycle, top, c)) for c in {None, coupling}
        }  # fmt: skip
        cycle, uncoupled = self._cycles[coupling], self._cycles[None]
        anderson: Anderson | None = None
        held: Held | None = None
        undecided = True
        residuals: list[np.ndarray] = []
        while True:
            if from_zero and not residuals and self.residual.wall is None:
                self.residual.of_zero(b, r)
            else:
                take_residual()
            if follower and adjust:
                follower.update()
                adjust()
            square = anderson.measure() if anderson else self.inner_product(r, r)
            moving = follower.moved() if follower else 0.0
            residuals.append(np.where(lit, np.sqrt(square) / np.where(lit, scale, 1), 0))
            history = [float(r.max()) for r in residuals]
            done = history[-1] <= tolerance and moving <= MOVING * tolerance
            stalled = len(history) > STALL and history[-1] > 0.9 * history[-1 - STALL]
            if done or stalled or len(history) > max_cycles or not np.isfinite(history[-1]):
                if held:
                    held.release()
                    self.residual.complete(phi)
                return Convergence(residuals, done, tolerance)
            if progress is not None:
                progress(float(np.clip(np.log(1 / max(history[-1], tolerance)) / np.log(1 / tolerance), 0, 1)))
            if undecided and history[-1] <= HOLD:
                undecided = False
                left_by_rounding = rounding_gain(self.op) * np.sqrt(self.inner_product(phi, phi))
                if (left_by_rounding > NEAR * tolerance * scale).any():
                    take_residual()
                    held = Held(phi, b, r, self.residual.wall, follower)
                    if adjust:
                        adjust()
            if anderson is None and len(history) > 2:
                rate = history[-1] / history[-2]
                if rate > SLOW and rate**2 * history[-1] > tolerance:
                    anderson = Anderson(self.device, phi, r, follower)
            if anderson:
                anderson.combine()
                cycle()
                anderson.add_correction(self.e)
            else:
                (uncoupled if without_coupling(history, tolerance) else cycle)()
                self.combine(share(history, tolerance), self.e, 1, phi)
