"""Anderson acceleration: the solution of the least residual among the last cycles.

    phi - sum_k gamma_k s_k,   gamma = argmin |r - sum_k gamma_k d_k|,   s_k, d_k: what a cycle changed of phi and r

For a linear problem this is GMRES over the last `DEPTH` cycles, on true residuals, by channel. Changes of the residual
are kept in 16 bits a number: what that loses of a combination, the next true residual finds.

References
----------
Walker and Ni 2011, "Anderson acceleration for fixed-point iterations".
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

import numpy as np

from clsss.device import Buffer, Device
from clsss.fields import CHANNELS, Field, Load, channels
from clsss.sums import GROUP, inner_product, sum_of_parts, tiles

DEPTH = 3  # cycles that are looked back on, as in kernels/anderson.cl


class Coupling(Protocol):
    """How a follower takes part in V-cycles."""

    level: int  # that it is solved together with

    def respond(self, solve: Callable[[int | None], None], r: Load, e: Field) -> None:
        """Enqueue the solve of that level, of which `solve` is a V-cycle of some number of sweeps (None: the usual)."""

    def let_in(self, k: int, r: Buffer) -> None:
        """Enqueue to add what has moved to the right-hand side of a finer level `k`."""


class Follower(Protocol):
    """A part of the right-hand side that follows the solution, with a state of its own."""

    @property
    def coupling(self) -> Coupling:
        """Its part in V-cycles."""

    state: np.ndarray  # (p, 3), affine in the solution

    def update(self) -> None:
        """Enqueue to advance `state` by one step, for a complete solution."""

    def moved(self) -> float:
        """How far that moved it, relative to its size."""

    def adjust(self, residual: Load) -> None:
        """Enqueue to add the part of the right-hand side that the last update found to a residual."""

    def hold(self, phi: Field) -> None:
        """From now on count the solution from a complete `phi`."""

    def release(self) -> None:
        """Count from zero again."""


class Anderson:
    """Combines cycles: the solution (and a follower's state) of the least residual among the last ones.

    Parameters
    ----------
    device : Device
    phi : Field
        Solution.
    residual : Load
        Its residual where `measure` is called.
    follower : Follower, optional
    """

    def __init__(self, device: Device, phi: Field, residual: Load, follower: Follower | None):
        self.device, self.phi, self.residual, self.follower = device, phi, residual, follower
        self._n, self._n_cells = phi.whole.shape[0], residual.whole.shape[0]
        # what each of the last cycles changed: the solution, its residual, the follower's state
        self._steps = [device.zeros((self._n, 3)) for _ in range(DEPTH)]
        self._changes = [device.zeros((self._n_cells, 3), np.uint16) for _ in range(DEPTH)]
        self._states = [np.zeros_like(follower.state) if follower else np.zeros((0, 3)) for _ in range(DEPTH)]
        self._gram, self._right = np.zeros((3, DEPTH, DEPTH)), np.zeros((3, DEPTH))
        self._count = 0

    def _latest(self, buffers: list[Any]) -> list[Any]:
        """The last cycle's, the one's before it, the oldest's."""
        return [buffers[(self._count - 1 - k) % DEPTH] for k in range(DEPTH)]

    def measure(self) -> np.ndarray:
        """|residual|^2 by channel (3,); notes what the last cycle changed."""
        if not self._count:
            return inner_product(self.device, self.residual, self.residual)
        first, second, third = self._latest(self._changes)
        count = tiles(self._n_cells)
        partial = self.device.empty((count, 7, CHANNELS))
        self.device.run(self.device.kernel("anderson", "change_products"), GROUP * count, self._n_cells,
                        self.residual.whole, second, third, first, partial, group=GROUP)  # fmt: skip
        sums = sum_of_parts(partial)
        slots = self._latest(list(range(DEPTH)))
        self._right[:, slots] = sums[:3].T
        self._gram[:, slots[0], slots] = self._gram[:, slots, slots[0]] = sums[3:6].T
        if self.follower:
            self._states[slots[0]] += self.follower.state
        return sums[6]

    def combine(self) -> None:
        """Move solution, residual and state to the best combination of the last cycles."""
        gamma, follower = self._least_residual(), self.follower
        weights = [self.device.vector(channels(g)) for g in self._latest(list(gamma))]
        steps, changes = self._latest(self._steps), self._latest(self._changes)
        self.device.run(self.device.kernel("anderson", "move"), self._n, self._n, self._n_cells, *weights, *steps[:2],
                        *changes[:2], steps[2], changes[2], self.phi.whole, self.residual.whole)  # fmt: skip
        slot = self._count % DEPTH
        self._count += 1
        if follower:
            moved = -sum(g * state for g, state in zip(gamma, self._states, strict=True))
            follower.state = follower.state + moved
            self._states[slot] = moved - follower.state

    def add_correction(self, e: Field) -> None:
        """Add what a cycle found to the solution."""
        self.device.run(self.device.kernel("anderson", "add_correction"), self._n, self._n, e.whole,
                        self._latest(self._steps)[0], self.phi.whole)  # fmt: skip

    def _least_residual(self) -> np.ndarray:
        """Coefficients (DEPTH, 3) that take the most from the residual."""
        known = min(self._count, DEPTH)
        gamma = np.zeros((DEPTH, 3))
        for channel in range(3) if known else ():
            gram, right = self._gram[channel, :known, :known], self._right[channel, :known]
            gamma[:known, channel] = np.linalg.lstsq(gram, right, rcond=1e-6)[0]
        return gamma
