"""What rounding the solution costs its residual, and the remedy: phi = held + e, of which only e is rounded.

Cells are coupled by T (phi_i - phi_j): rounding phi by eps leaves a residual of eps |T phi|, which grows as 1/h^2
against the source where cells are optically thin. Differences of stored values are exact, and so nearly is the
residual of the solution as stored: iterative refinement can go on from it, without higher precision.

References
----------
Higham 2002, "Accuracy and Stability of Numerical Algorithms", chapter 12.
"""

from __future__ import annotations

import numpy as np

from clsss.anderson import Follower
from clsss.device import Buffer
from clsss.diffusion import Operator
from clsss.fields import Field, Load


def rounding_gain(op: Operator) -> np.ndarray:
    """2-norm (3,) of the residual that rounding leaves, in 2-norms of the solution.

    A number is off by .41 of half the spacing at 1 (rms), and a full cell's row weighs its own by 6 T, six others by
    T = h D. On coarser leaves it is less.
    """
    D, finest = op.medium.D[-1], op.octree.finest
    spread = 1.0 if op.medium.homogeneous else np.sqrt((D.astype(float) ** 2).mean(axis=0))
    return np.broadcast_to(0.2 * np.finfo(op.irregular.device.real).eps * np.sqrt(42) * finest.h * spread, 3)


class Held:
    """A solve that goes on from the solution reached. What it sets aside lies in the host's memory.

    Parameters
    ----------
    phi : Field
        Complete. It is set to zero, and counts from what it was until `release`.
    b, r : Load
        Right-hand side, and the residual of `phi` without the follower's part, which takes its place.
    wall : (n_cut, 3) real, device, or None
        The boundary's source, `Residual.wall`: it belongs to what is held, and is set to zero.
    follower : Follower or None
    """

    def __init__(self, phi: Field, b: Load, r: Load, wall: Buffer | None, follower: Follower | None):
        self._phi, self._follower = phi, follower
        if follower:
            follower.hold(phi)
        self._held = phi.whole.get()
        self._aside = [(buffer, buffer.get()) for buffer in (b.whole, wall) if buffer]
        b.whole.copy_from(r.whole)
        phi.whole.fill(0)
        if wall:
            wall.fill(0)

    def release(self) -> None:
        """Add what was held to the solution, and put right-hand side and wall back."""
        self._phi.whole.set(self._held + self._phi.whole.get())
        for buffer, values in self._aside:
            buffer.set(values)
        if self._follower:
            self._follower.release()
