"""Residual of the discrete diffusion equation, with the gradients of cut cells, and the fluence at their boundaries.

    r = Q - sum_f G_f - A_B phi_B / (2A) - sigma_a V phi

Gradients are least-squares fits (kernels/gradient.cl), taken anew of each field.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from clsss.device import Buffer, Device
from clsss.diffusion import Operator
from clsss.fields import Field, Load
from clsss.octree import Octree
from clsss.room import Room
from clsss.sparsematrix import SparseMatrix

CHUNK = 1 << 15  # cells that the host looks at the children of at a time


def _centred(device: Device, octree: Octree) -> list[Buffer]:
    """Which cells of each level but the finest have their value at their centre: all but those over cut cells."""
    whole = octree.cut_index.get() < 0
    found: list[Buffer] = []
    for level in octree.levels[-2::-1]:
        assert level.child is not None
        covered, below, whole = level.covered.get(), whole, level.leaf
        for first in range(0, len(covered), CHUNK):
            cells = covered[first : first + CHUNK]
            child = level.child.get(first, len(cells))
            whole[cells] = ((child >= 0) & below[child]).all(axis=1)
        found.insert(0, device.array(whole.astype(np.uint8)))
    return found


class Residual:
    """Residual of the second-order operator over all leaves, r = Q - A_h phi.

    Parameters
    ----------
    device : Device
    op : Operator
    room : Room, optional
        Memory that nothing else needs while residuals and boundary values are taken.

    Attributes
    ----------
    slope : (n_cut, 3, 3) real, device
        Gradients of the last field completed, by axis, then channel, per cell width; in `room` if there is enough.
    wall : (n_cut, 3) real, device, or None
        3 D q1 . n of the source at the boundary, which the gradients there need [W/mm^2]; None: there is no q1.
    """

    def __init__(self, device: Device, op: Operator, room: Room | None = None):
        self.device, self.op = device, op
        self.slope = (room or device).empty((op.octree.cut.n, 3, 3))
        self.wall: Buffer | None = None
        d = op.medium.defines
        self._average = device.kernel("restrict", "average", *d)
        self._carry = device.kernel("prolong", "carry_ghosts")
        self._centred = _centred(device, op.octree)
        self._residual = device.kernel("residual", "residual", *d)
        self._of_leaves = device.kernel("residual", "residual_of_leaves", *d)
        self._reflux = device.kernel("residual", "reflux", *d)
        self._gradient = device.kernel("gradient", "gradient", *d)
        self._correct = device.kernel("correct", "correct_residual", *d)
        self._boundary, self._with_entered, self._leave = (
            device.kernel("boundary", name, *d) for name in ("boundary_value", "value_with_entered", "leave_boundary")
        )

    def complete(self, phi: Field) -> None:
        """Fill what depends on the leaves: covered cells, ghosts, and `slope`."""
        run, op, levels = self.device.run, self.op, self.op.octree.levels
        # covered cells count where leaves of their width have them as neighbours
        needed = [k for k, level in enumerate(levels) if level.interface.shape[0]]
        for k in range(len(levels) - 2, min(needed, default=len(levels)) - 1, -1):
            m = levels[k].covered.shape[0]
            run(self._average, m, m, levels[k].covered, levels[k].child, phi[k + 1], phi[k])
        for k, fine in enumerate(levels[1:]):
            coarse = levels[k]
            m = coarse.interface.shape[0]
            run(self._carry, m, m, coarse.n, fine.n, coarse.interface, coarse.interface_start, coarse.nbr,
                self._centred[k], fine.ghost_face, fine.ghost_octant, phi[k], phi[k + 1])  # fmt: skip
        octree, cut, finest = op.octree, op.octree.cut, levels[-1]
        run(self._gradient, cut.n, cut.n, finest.h, op.medium.fresnel_A, op.medium.D_cut, *op.around.arguments,
            cut.cell, octree.cut_index, cut.centroid, cut.boundary, cut.normal, self.wall, phi[-1],
            self.slope)  # fmt: skip

    def __call__(self, phi: Field, b: Load, r: Load) -> None:
        """Overwrite `r` with b - A_h phi on the leaves, zero on covered cells.

        Parameters
        ----------
        phi : Field
            Fluence [W/mm^2]; it is completed.
        b, r : Load
            Right-hand side and residual, integrated over cells, in the scale of the operator.
        """
        self.complete(phi)
        run, op, octree, levels = self.device.run, self.op, self.op.octree, self.op.octree.levels
        finest, cut, T = levels[-1], octree.cut, op.T
        run(self._residual, finest.n, finest.n, finest.nbr, *op.two_point(-1), b[-1], phi[-1], r[-1])
        for k, level in enumerate(levels[:-1]):
            run(self._of_leaves, level.n, level.n, level.nbr, level.is_leaf, *op.two_point(k), b[k], phi[k], r[k])
            fine, m = levels[k + 1], level.interface.shape[0]
            run(self._reflux, m, m, fine.n, level.interface, level.interface_start, fine.ghost_face,
                T[k + 1].row, T[k + 1].values, phi[k + 1], r[k])  # fmt: skip
        m = op.irregular.shape[0]
        run(self._correct, m, m, finest.n, finest.h, op.medium.fresnel_A, op.medium.D_cut, op.medium.fitted,
            op.irregular, finest.nbr, octree.cut_index, cut.centroid, cut.boundary, cut.normal, cut.face_centroid,
            T[-1].row, T[-1].values, self.slope, phi[-1], r[-1])  # fmt: skip

    def of_zero(self, b: Load, r: Load) -> None:
        """The same for phi = 0, which is complete as it is, where there is no `wall`."""
        r.whole.copy_from(b.whole)
        self.slope.fill(0)

    def boundary_value(self, phi: Field, moment: Buffer) -> Buffer:
        """Fluence phi_B at the boundary of every cut cell (n_cut, 3) [W/mm^2].

        `moment` (n_cut, 3) is the source's first moment between the centroid and the surface.
        """
        self.complete(phi)
        phi_B = self.device.empty((self.op.octree.cut.n, 3))
        self.take_boundary_value(phi, moment, phi_B)
        return phi_B

    def take_boundary_value(self, phi: Field, moment: Buffer, phi_B: Buffer) -> None:
        """As `boundary_value`, for a complete `phi`, into `phi_B`, which may be `moment`."""
        self.device.run(self._boundary, self.op.octree.cut.n, self.op.octree.cut.n, *self._at_boundary, moment, phi[-1],
                        phi_B)  # fmt: skip

    def boundary_flux(self, phi: Field, moment: Buffer, phi_B: Buffer | None = None) -> np.ndarray:
        """J.n = phi_B / (2A) there (n_cut, 3) [W/mm^2], for a complete `phi`; overwrites `phi_B`, if it is given."""
        phi_B = phi_B or self.device.empty(moment.shape)
        self.take_boundary_value(phi, moment, phi_B)
        flux = phi_B.get()
        flux /= 2 * self.op.medium.fresnel_A
        return flux

    def add_flux(self, phi: Field, moment: Buffer, patches: tuple[Any, ...], blend: SparseMatrix, gain: float,
                 entered: Buffer, phi_B: Buffer, flux: Buffer) -> None:  # fmt: skip
        """Add J.n of `patches` of cut cells (`places_of`) to `flux` (p, 3), for a complete `phi`.

        Of what has `entered` patches (p, 3), `gain` times its mean by `blend` at a cut cell takes part in its moment.
        `phi_B` (n_cut, 3) gets the fluence at the boundary.
        """
        run, p, cut = self.device.run, flux.shape[0], self.op.octree.cut
        run(self._with_entered, cut.n, cut.n, *self._at_boundary, moment, phi[-1], *blend.rows, gain, entered,
            phi_B)  # fmt: skip
        run(self._leave, p, p, self.op.medium.fresnel_A, *patches, cut.boundary, phi_B, flux)

    @property
    def _at_boundary(self) -> tuple[Any, ...]:
        op, cut = self.op, self.op.octree.cut
        return (op.octree.grid.h, op.medium.fresnel_A, op.medium.D_cut, op.medium.fitted, cut.cell, cut.centroid,
                cut.boundary, cut.normal, self.slope)  # fmt: skip
