"""What parts of the surface send to one another while a solve goes on: B <- J.n + F B (exchange.py).

J.n answers to the light that enters, so both are found together: within each V-cycle the level of cells as wide as
patches is solved a few times, each time with what the patches have sent one another since. There a passage costs a
small part of a cycle.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from clsss.boundary import Boundary
from clsss.device import Buffer, Device
from clsss.diffusion import CHANNELS, Field, Load, Operator, channels
from clsss.exchange import Exchange, patch_depth
from clsss.residual import Residual
from clsss.source import Source, subtract_moment
from clsss.sparsematrix import SparseMatrix
from clsss.sums import sum_of_parts, take_products, tiles

PASSAGES = 3  # of light between parts of the surface, within each cycle
ROUGHLY = 1  # sweeps of a V-cycle that only tells what light goes on to the next passage


class PatchCoupling:
    """What an exchange does within the V-cycles of an operator (a `Coupling`), and its state.

    It keeps nothing of the exchange itself, which takes 100 bytes a cut cell on the host.

    Parameters
    ----------
    device : Device
    op : Operator
    exchange : Exchange

    Attributes
    ----------
    level : int
        The level that is solved together with the light on its way, of cells as wide as patches.
    B : (p, 4) real, device
        All light that leaves each patch.
    change : (p, 4) real, device
        How far the last step moved it; `respond` uses it up.
    patches, rays : int
        How many there are, and how many were traced.
    """

    def __init__(self, device: Device, op: Operator, exchange: Exchange):
        self.device, self.op, self._gain = device, op, exchange.gain
        self.patches, self.rays = exchange.share.shape[0], exchange.rays
        levels, boundary = op.octree.levels, Boundary(op)
        self.level = max(0, len(levels) - 1 - patch_depth(op.octree))
        above = boundary.above(exchange, len(levels) - 1 - self.level)
        self._share, self._blend = SparseMatrix(device, exchange.share), SparseMatrix(device, exchange.blend)
        self._arriving = SparseMatrix(device, exchange.arriving)
        self._entering = SparseMatrix(device, exchange.entering, self._arriving)
        self._giving = device.array(channels(exchange.gain * (exchange.share @ boundary.per_area)))
        self._above = {
            k: (device.array(seen.cell.astype(np.int32)), device.array(channels(exchange.gain * seen.entering)),
                SparseMatrix(device, seen.blend), device.empty((len(seen.cell), CHANNELS)))
            for k, seen in zip(range(len(levels) - 2, self.level - 1, -1), above, strict=True)
        }  # fmt: skip
        self._leaving = device.array(channels(above[-1].leaving))
        self._share_above = SparseMatrix(device, above[-1].share)
        p = exchange.share.shape[0]
        self.B, self.change = device.zeros((p, CHANNELS)), device.zeros((p, CHANNELS))
        self._more, self._next, self._entered = (device.empty((p, CHANNELS)) for _ in range(3))
        # what solving `level` changes of right-hand sides: at its cells over cut ones, at leaves next to finer cells
        cells = [*(level.interface for level in levels[: self.level]), self._above[self.level][0]]
        self._changed = [(k, at, device.empty((at.shape[0], 3))) for k, at in enumerate(cells) if at.shape[0]]
        self._moment = device.empty((op.octree.cut.n, CHANNELS))
        self._take, self._put, self._leave, self._enter, self._subtract = (
            device.kernel("passage", name) for name in ("take_rows", "put_rows", "leave", "enter", "subtract_scaled")
        )
        self._combination = device.kernel("reduce", "combine")
        self._squares = [device.zeros((tiles(p), CHANNELS)) for _ in range(2)]

    def boundary_moment(self, plus: Buffer | None = None) -> Buffer:
        """First moment (n_cut, 4) at the boundary of all light that enters, and of `plus`."""
        self._entering.multiply(1, self.B, self._entered)
        return self._moment_of_entered(plus)

    def _moment_of_entered(self, plus: Buffer | None = None) -> Buffer:
        self._blend.multiply(-self._gain, self._entered, self._moment, plus)
        return self._moment

    def entered(self) -> np.ndarray:
        """H_t (n_cut, 3) at the boundary, after `boundary_moment`, whose buffer it overwrites."""
        self._blend.multiply(1, self._entered, self._moment)
        return self._moment.get()[:, :3]

    def flux_of_patches(self, phi_B: Buffer) -> Buffer:
        """J.n (p, 4) of each patch, for fluence (n_cut, 4) at the boundary."""
        flux = self.device.empty(self.B.shape)
        self._share.multiply(1 / (2 * self.op.medium.fresnel_A), phi_B, flux)
        return flux

    def step(self, boundary_value: Callable[[Buffer], None], r_B: Buffer, held: Buffer | None) -> None:
        """B <- J.n + F B.

        Parameters
        ----------
        boundary_value : callable
            Overwrites a first moment (n_cut, 4) at the boundary with the fluence there.
        r_B : (n_cut, 4) real, device
            First moment of all else.
        held : (p, 4) real, device, or None
            J.n of a solution that no longer changes.
        """
        self._arriving.multiply_both(self._entering, self.B, self._next, self._entered, held)
        phi_B = self._moment_of_entered(r_B)
        boundary_value(phi_B)
        self._share.multiply(1 / (2 * self.op.medium.fresnel_A), phi_B, self.change, self._next)
        self._next.copy_from(self.B)
        self.B.copy_from(self.change)
        self._combine(-1, self._next, 1, self.change)
        for values, squares in zip((self.B, self.change), self._squares, strict=True):
            take_products(self.device, values, values, squares)

    def moved(self) -> float:
        """How far the last step moved B, relative to its size."""
        size, change = (np.sqrt(sum_of_parts(squares)) for squares in self._squares)
        return float((change / np.where(size > 0, size, 1)).max())

    def _combine(self, a: float, x: Buffer, b: float, y: Buffer) -> None:
        """Overwrite y with a x + b y, (p, 4) each."""
        p, scale = self.B.shape[0], [self.device.vector([v] * CHANNELS) for v in (a, b)]
        self.device.run(self._combination, p, p, *scale, x, y)

    def respond(self, solve: Callable[[int | None], None], r: Load, e: Field) -> None:
        """Enqueue the solve of `level`, of which `solve` is a V-cycle of some sweeps, with the light on its way."""
        run, k, p = self.device.run, self.level, self.B.shape[0]
        cell, _, _, at = self._above[k]
        m = cell.shape[0]
        for j, cells, kept in self._changed:
            run(self._take, cells.shape[0], cells.shape[0], cells, r[j], kept)
        # what comes out of the last step before `level` has answered to it
        self._arriving.multiply_both(self._entering, self.change, self._next, self._entered)
        run(self._subtract, p, p, self._giving, self._entered, self._next)
        self.change.copy_from(self._next)
        self._entered.fill(0)
        for passage in range(PASSAGES):
            if passage:
                for j, cells, kept in self._changed:
                    run(self._put, cells.shape[0], cells.shape[0], cells, kept, r[j])
                self.let_in(k, r[k])
            solve(ROUGHLY if passage < PASSAGES - 1 else None)
            run(self._leave, m, m, cell, self._leaving, e[k], at)
            self._share_above.multiply(1, at, self._more, self._next)
            run(self._subtract, p, p, self._giving, self._entered, self._more)
            self._arriving.multiply_both(self._entering, self._more, self._next, self._entered, self.change)
        self._combine(1, self._more, 1, self.B)

    def let_in(self, k: int, r: Buffer) -> None:
        """Enqueue to add what the light on its way brings level `k` to its right-hand side."""
        if k not in self._above:
            subtract_moment(self.device, self.op.octree, self.op.medium, self._moment_of_entered(), r)
            return
        cell, entering, blend, at = self._above[k]
        blend.multiply(1, self._entered, at)
        self.device.run(self._enter, cell.shape[0], cell.shape[0], cell, entering, at, r)


class Interreflection:
    """The exchange as a part of the right-hand side of one solve (a `Follower`).

    Parameters
    ----------
    coupling : PatchCoupling
    residual : Residual
        Its wall is the source's.
    source : Source
    phi : Field
        The solution that it follows.
    """

    def __init__(self, coupling: PatchCoupling, residual: Residual, source: Source, phi: Field):
        self.coupling, self.residual, self.r_B = coupling, residual, source.moment
        self._phi = phi
        coupling.B.fill(0)
        self._update = self._captured_update(None)

    @property
    def state(self) -> np.ndarray:
        """B of each patch, and how far the last step moved it (2 p, 3)."""
        return np.concatenate([self.coupling.B.get(), self.coupling.change.get()])[:, :3].astype(float)

    @state.setter
    def state(self, values: np.ndarray) -> None:
        self.coupling.B.set(channels(values[: len(values) // 2]))
        self.coupling.change.set(channels(values[len(values) // 2 :]))

    def _captured_update(self, held: Buffer | None) -> Callable[[], None]:
        def boundary_value(phi_B: Buffer) -> None:
            self.residual.take_boundary_value(self._phi, phi_B, phi_B)

        return self.coupling.device.capture(lambda: self.coupling.step(boundary_value, self.r_B, held))

    def update(self) -> None:
        """Enqueue one step of the exchange."""
        self._update()

    def moved(self) -> float:
        """How far it moved B, relative to its size."""
        return self.coupling.moved()

    def adjust(self, residual: Load) -> None:
        """Add C_B gain H_t to the residual of the cut cells."""
        op = self.coupling.op
        subtract_moment(self.coupling.device, op.octree, op.medium, self.coupling.boundary_moment(), residual[-1])

    def hold(self, phi: Field) -> None:
        """From now on count the solution from a complete `phi`."""
        phi_B = self.coupling.device.empty(self.r_B.shape)
        self.residual.take_boundary_value(phi, self.r_B, phi_B)
        self._update = self._captured_update(self.coupling.flux_of_patches(phi_B))
        self._set_aside = self.r_B.get()
        self.r_B.fill(0)

    def release(self) -> None:
        """Count from zero again."""
        self._update = self._captured_update(None)
        self.r_B.set(self._set_aside)

    def start_from(self, B: np.ndarray) -> None:
        """Begin with what leaves each patch (p, 3) of another solution."""
        self.coupling.B.set(channels(B))

    def surface(self, phi: Field) -> tuple[np.ndarray, np.ndarray]:
        """J.n and H_t (n_cut, 3) at the boundary of the cut cells, for a complete `phi`."""
        phi_B = moment = self.coupling.boundary_moment(self.r_B)
        return self.residual.boundary_flux(phi, moment, phi_B), self.coupling.entered()

    @property
    def leaving(self) -> np.ndarray:
        """B of each patch (p, 3)."""
        return self.coupling.B.get()[:, :3].astype(float)
