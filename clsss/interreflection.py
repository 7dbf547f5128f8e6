"""What parts of the surface send to one another while a solve goes on: B <- J.n + F B (exchange.py).

J.n answers to the light that enters, so both are found together: within each V-cycle the level of cells as wide as
patches is solved a few times, each time with what the patches have sent one another since. There a passage costs a
small part of a cycle.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np

from clsss.boundary import Boundary
from clsss.device import Buffer, Device
from clsss.diffusion import Operator
from clsss.exchange import Exchange, patch_depth
from clsss.fields import CHANNELS, Field, Load
from clsss.heap import give_back
from clsss.multigrid import Multigrid
from clsss.residual import Residual
from clsss.room import Room
from clsss.source import Source, add_entered
from clsss.sparsematrix import SparseMatrix, places_of
from clsss.sums import GROUP, sum_of_parts, tiles

PASSAGES = 3  # of light between parts of the surface, within each cycle
ROUGHLY = 1  # sweeps of a V-cycle that only tells what light goes on to the next passage


def _shortened(device: Device, values: np.ndarray) -> Buffer:
    """Numbers in 16 bits (real.h), for what changes the way to a solution alone."""
    bits = values.astype(np.float32).view(np.uint32)
    return device.array(((bits + 0x7FFF + ((bits >> 16) & 1)) >> 16).astype(np.uint16))


class PatchMatrices:
    """An exchange on the device, where it takes a quarter of what it does on the host.

    Parameters
    ----------
    device : Device
    exchange : Exchange

    Attributes
    ----------
    share : (p, n_cut) sparse, on the host
        Of the exchange.
    patches : tuple
        Where it has entries (`places_of`).
    blend, arriving, entering : SparseMatrix
        The others.
    gain, rays : float and int
        Of the exchange.
    """

    def __init__(self, device: Device, exchange: Exchange):
        self.share, self.gain, self.rays = exchange.share, exchange.gain, exchange.rays
        self.patches, self.blend = places_of(device, exchange.share), SparseMatrix(device, exchange.blend)
        self.arriving = SparseMatrix(device, exchange.arriving)
        self.entering = SparseMatrix(device, exchange.entering, self.arriving)


class PatchCoupling:
    """What an exchange does within the V-cycles of an operator (a `Coupling`), and its state.

    Parameters
    ----------
    device : Device
    op : Operator
    matrices : PatchMatrices
        Their `share` is not kept.

    Attributes
    ----------
    level : int
        The level that is solved together with the light on its way, of cells as wide as patches.
    B : (p, 3) real, device
        All light that leaves each patch.
    change : (p, 3) real, device
        How far the last step moved it; `respond` uses it up.
    patches, rays : int
        How many there are, and how many were traced.
    """

    def __init__(self, device: Device, op: Operator, matrices: PatchMatrices):
        self.device, self.op, self._gain = device, op, matrices.gain
        self.patches, self.rays = matrices.share.shape[0], matrices.rays
        self._patches, self._blend = matrices.patches, matrices.blend
        self._arriving, self._entering = matrices.arriving, matrices.entering
        levels, boundary, gain, p = op.octree.levels, Boundary(op), matrices.gain, self.patches
        self.level = max(0, len(levels) - 1 - patch_depth(op.octree))
        self._giving = _shortened(device, gain * (matrices.share @ boundary.per_area))
        self._above: dict[int, tuple[Buffer, Buffer, SparseMatrix]] = {}
        above = boundary.above(matrices.share, len(levels) - 1 - self.level)
        for k, seen in zip(range(len(levels) - 2, self.level - 1, -1), above, strict=True):
            self._above[k] = (device.array(seen.cell.astype(np.int32)), _shortened(device, gain * seen.entering),
                              SparseMatrix(device, seen.blend))  # fmt: skip
        self._leaving = _shortened(device, seen.leaving)
        self._share_above = SparseMatrix(device, seen.share)
        self.B, self.change = device.zeros((p, 3)), device.zeros((p, 3))
        self._take, self._put, self._leave, self._enter, self._subtract, self._add, self._advance = (
            device.kernel("passage", name)
            for name in ("take_rows", "put_rows", "leave", "enter", "subtract_scaled", "add_rows", "advance")
        )
        self._squares = device.zeros((tiles(p), 2, CHANNELS))  # of B, and of how far it moved

    def borrow(self, e: Field, room: Room) -> None:
        """Memory to work in.

        Parameters
        ----------
        e : Field
            The correction of those V-cycles: its finest level's red cells are lent while coarser ones are solved.
        room : Room
            Lent while residuals are taken.
        """
        p, levels = self.patches, self.op.octree.levels
        self.room, self._came_in = room, room.empty((p, 3))
        red = Room(self.device, (e.whole, e.start[-2], e.start[-2] + levels[-1].colour_start[1]))
        self._entered, self._steady, self._more = (red.empty((p, 3)) for _ in range(3))
        # what solving `level` changes of right-hand sides: at its cells over cut ones, at leaves next to finer cells
        cells = [*(level.interface for level in levels[: self.level]), self._above[self.level][0]]
        self._changed = [(k, at, red.empty((at.shape[0], 3))) for k, at in enumerate(cells) if at.shape[0]]

    def step(self, residual: Residual, phi: Field, r_B: Buffer, phi_B: Buffer, held: Buffer | None) -> None:
        """B <- J.n + F B.

        Parameters
        ----------
        residual : Residual
        phi : Field
            Complete.
        r_B : (n_cut, 3) real, device
            First moment of all else than the exchange at the boundary.
        phi_B : (n_cut, 3) real, device
            Gets the fluence at the boundary.
        held : (p, 3) real, device, or None
            J.n of a solution that no longer changes.
        """
        p = self.B.shape[0]
        self._arriving.multiply_both(self._entering, self.B, self.change, self._came_in, held)
        residual.add_flux(phi, r_B, self._patches, self._blend, self._gain, self._came_in, phi_B, self.change)
        self.device.run(self._advance, GROUP * tiles(p), p, self.B, self.change, self._squares, group=GROUP)

    def moved(self) -> float:
        """How far the last step moved B, relative to its size."""
        size, change = np.sqrt(sum_of_parts(self._squares))
        return float((change / np.where(size > 0, size, 1)).max())

    def add_arrived(self, r: Buffer) -> None:
        """Enqueue to add C_B gain H_t to the residual of the finest level."""
        self._entering.multiply(1, self.B, self._came_in)
        self._add_entered(self._came_in, r)

    def add_moment(self, r_B: Buffer) -> None:
        """Add the first moment (n_cut, 3) at the boundary of all light that enters."""
        self._entering.multiply(1, self.B, self._came_in)
        self._blend.multiply(-self._gain, self._came_in, r_B, r_B)

    def entered(self, room: Buffer) -> np.ndarray:
        """H_t (n_cut, 3) at the boundary, after `add_moment`; overwrites `room` (n_cut, 3)."""
        self._blend.multiply(1, self._came_in, room)
        return room.get()

    def flux_of_patches(self, residual: Residual, phi: Field, moment: Buffer, phi_B: Buffer) -> Buffer:
        """J.n (p, 3) of each patch, for a complete `phi` and a first moment (n_cut, 3) at the boundary."""
        flux = self.device.zeros(self.B.shape)
        residual.add_flux(phi, moment, self._patches, self._blend, 0.0, self._came_in, phi_B, flux)
        return flux

    def _add_entered(self, entered: Buffer, r: Buffer) -> None:
        add_entered(self.device, self.op.octree, self.op.medium, self._blend, self._gain, entered, r)

    def respond(self, solve: Callable[[int | None], None], r: Load, e: Field) -> None:
        """Enqueue the solve of `level`, of which `solve` is a V-cycle of some sweeps, with the light on its way."""
        run, k, p = self.device.run, self.level, self.B.shape[0]
        for j, cells, kept in self._changed:
            run(self._take, cells.shape[0], cells.shape[0], cells, r[j], kept)
        # what comes out of the last step before `level` has answered to it
        self._arriving.multiply_both(self._entering, self.change, self._steady, self._entered)
        run(self._subtract, p, p, self._giving, self._entered, self._steady)
        self._entered.fill(0)
        before, more, spare = self._steady, self.change, self._more
        for passage in range(PASSAGES):
            if passage:
                for j, cells, kept in self._changed:
                    run(self._put, cells.shape[0], cells.shape[0], cells, kept, r[j])
                self.let_in(k, r[k])
            last = passage == PASSAGES - 1
            solve(None if last else ROUGHLY)
            run(self._leave, p, p, *self._share_above.rows, self._above[k][0], self._leaving, e[k], self._giving,
                self._entered, before, more)  # fmt: skip
            if last:
                self._entering.multiply(1, more, self._entered)
                run(self._add, p, p, more, self.B)
            else:
                self._arriving.multiply_both(self._entering, more, spare, self._entered, self._steady)
                before, more, spare = spare, spare, more

    def let_in(self, k: int, r: Buffer) -> None:
        """Enqueue to add what the light on its way brings level `k` to its right-hand side."""
        if k not in self._above:
            self._add_entered(self._entered, r)
            return
        cell, entering, blend = self._above[k]
        m = cell.shape[0]
        self.device.run(self._enter, m, m, cell, entering, *blend.rows, self._entered, r)


def coupled(device: Device, op: Operator, matrices: PatchMatrices | None) -> tuple[Multigrid, PatchCoupling | None]:
    """The multigrid of an operator, and what an exchange does in it, found first: it takes the host's memory."""
    coupling = PatchCoupling(device, op, matrices) if matrices else None
    give_back()
    multigrid = Multigrid(device, op)
    if coupling:
        coupling.borrow(multigrid.e, multigrid.room)
    return multigrid, coupling


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
        self._phi, self._phi_B = phi, coupling.room.rest().empty((residual.op.octree.cut.n, 3))
        coupling.B.fill(0)
        self._update = self._captured_update(None)

    @property
    def state(self) -> np.ndarray:
        """B of each patch, and how far the last step moved it (2 p, 3)."""
        return np.concatenate([self.coupling.B.get(), self.coupling.change.get()]).astype(float)

    @state.setter
    def state(self, values: np.ndarray) -> None:
        self.coupling.B.set(values[: len(values) // 2])
        self.coupling.change.set(values[len(values) // 2 :])

    def _captured_update(self, held: Buffer | None) -> Callable[[], None]:
        step = partial(self.coupling.step, self.residual, self._phi, self.r_B, self._phi_B, held)
        return self.coupling.device.capture(step)

    def update(self) -> None:
        """Enqueue one step of the exchange."""
        self._update()

    def moved(self) -> float:
        """How far it moved B, relative to its size."""
        return self.coupling.moved()

    def adjust(self, residual: Load) -> None:
        """Add C_B gain H_t to the residual of the cut cells."""
        self.coupling.add_arrived(residual[-1])

    def hold(self, phi: Field) -> None:
        """From now on count the solution from a complete `phi`."""
        self._update = self._captured_update(self.coupling.flux_of_patches(self.residual, phi, self.r_B, self._phi_B))
        self._set_aside = self.r_B.get()
        self.r_B.fill(0)

    def release(self) -> None:
        """Count from zero again."""
        self._update = self._captured_update(None)
        self.r_B.set(self._set_aside)

    def start_from(self, B: np.ndarray) -> None:
        """Begin with what leaves each patch (p, 3) of another solution."""
        self.coupling.B.set(B)

    def surface(self, phi: Field) -> tuple[np.ndarray, np.ndarray]:
        """J.n and H_t (n_cut, 3) at the boundary of the cut cells, for a complete `phi`; overwrites `r_B`."""
        self.coupling.add_moment(self.r_B)
        return self.residual.boundary_flux(phi, self.r_B, self.r_B), self.coupling.entered(self.r_B)

    @property
    def leaving(self) -> np.ndarray:
        """B of each patch (p, 3)."""
        return self.coupling.B.get().astype(float)
