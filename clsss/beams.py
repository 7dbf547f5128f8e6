"""Beams of collimated lights through an octree: what reaches each cell of them, and what they deposit there.

    F(x) = F0 T exp(-tau),   Q_i = -(sum_f B_f + B_B),   B = A a (omega . n) F

The beam's flux is averaged logarithmically between centroids, so that what is deposited is what enters less what
passes through, times the albedo, at any cell size (kernels/attenuate.cl, kernels/source.cl).

References
----------
Haber et al. 2005, eq. (2), (3) and section 3.3.
"""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np

from clsss.device import Device
from clsss.diffusion import Coefficients, cell_points
from clsss.fields import CHANNELS, Field, Load, channels
from clsss.heap import give_back
from clsss.kept import kept
from clsss.level import Level
from clsss.lights import DirectionalLight, PointLight
from clsss.octree import Octree
from clsss.rays import LINING, RayCaster
from clsss.room import Room
from clsss.stowed import Stowed, stow
from clsss.sums import GROUP, sum_of_parts, tiles


@kept
def ray_order(octree: Octree) -> list[Stowed]:
    """Full leaves of each level in an order in which neighbours' rays meet the same cells.

    Coarse leaves come depth first, finest ones brick by brick.
    """
    orders, cells = [], np.arange(octree.levels[0].n, dtype=np.int32)
    for level in octree.levels[:-1]:
        leaf = level.leaf
        orders.append(stow(cells[leaf[cells]]))
        if level.depth > 1:
            cells = _children(level, np.cumsum(~leaf, dtype=np.int32)[cells[~leaf[cells]]] - 1)
    finest, cut_index = octree.finest_by_bricks(), octree.cut_index.get()
    return [*orders, stow(*(cells[cut_index[cells] < 0] for cells in finest))]


def _children(level: Level, rows: np.ndarray) -> np.ndarray:
    """Cells in the covered ones that `Level.covered` has in some rows (m,), one row after the other."""
    assert level.child
    child, chain = level.child.get()[rows], level.chain.get()
    while (shared := child < -1).any():
        child[shared] = chain[-2 - child[shared], 1]
    return np.concatenate([child[child >= 0], chain[:, 0]])


def extinction(device: Device, octree: Octree, medium: Coefficients) -> tuple[Any, ...]:
    """Extinction per finest cell width as rays take it (body.h): a vector, or all levels' cells and their starts."""
    if medium.homogeneous:
        total = [a + s for a, s in zip(medium.sigma_a[-1].tolist(), medium.sigma_s[-1].tolist(), strict=True)]
        return (device.vector([octree.grid.h * t for t in total]),)
    parts = [a + s for a, s in zip(medium.sigma_a[::-1], medium.sigma_s[::-1], strict=True)]
    start = np.concatenate([[0], np.cumsum([len(p) for p in parts])]).astype(np.int32)
    return device.array(np.concatenate(parts) * octree.grid.h), device.array(start)


def scattering(device: Device, octree: Octree, medium: Coefficients) -> Any:
    """sigma_s per finest cell width: a vector, or all levels' cells, in the order of `extinction`."""
    if medium.homogeneous:
        return device.vector([octree.grid.h * s for s in medium.sigma_s[-1].tolist()])
    return device.array(channels(np.concatenate(medium.sigma_s[::-1])) * octree.grid.h)


def light_arguments(device: Device, octree: Octree, light: Any, unit: float) -> tuple[Any, Any]:
    """A beam's or lamp's place and strength as the kernels take them (beam.h)."""
    if isinstance(light, DirectionalLight):
        return device.vector([*-light.direction, 0.0]), device.vector(channels(light.irradiance / unit))
    position = octree.grid.to_cells(light.position)
    return device.vector([*position, 1.0]), device.vector(channels(light.intensity / unit))


class Beams:
    """Adds up the beams of collimated lights on an octree.

    Parameters
    ----------
    device : Device
    octree : Octree
    medium : Coefficients
    blockers : RayCaster, optional
        Opaque bodies in front of the lights.
    lent : tuple of Load, Field and Room, optional
        Where to add deposits up, where the beams may leave their irradiance, and what else they need.
    """

    def __init__(self, device: Device, octree: Octree, medium: Coefficients, blockers: RayCaster | None = None,
                 lent: tuple[Load, Field, Room] | None = None):  # fmt: skip
        self.blockers = blockers
        self.device, self.octree, self.medium = device, octree, medium.on_device(device)
        n_cut = octree.cut.n
        self.Q, self._F, room = lent or (Load(device, octree), Field(device, octree), Room(device))
        body = octree.lend_body(leaves=not medium.homogeneous, room=room)
        self._body = (*body, *extinction(device, octree, medium))
        self.Q.whole.fill(0)
        self.moment = device.zeros((n_cut, 3))
        self.wall = device.zeros((n_cut, 3)) if medium.g else None
        self.lost = room.empty((n_cut, 3)) if medium.any_fitted else None
        if self.lost:
            self.lost.fill(0)
        self.incident = np.zeros(3)
        self._F_B, self._aperture = room.empty((n_cut, 3)), octree.cut.aperture.on_device(room)
        self._position = octree.lend_positions(room)
        orders = [order.on_device(room) for order in ray_order(octree)]
        self._orders = [*enumerate(orders), (len(orders) - 1, body[-1])]
        give_back(octree.n_cells)

    @cached_property
    def _points(self) -> list[np.ndarray]:
        """Where F is: centroids of the cells of each level, boundaries of the cut cells, on their inner side [mm]."""
        octree, cut = self.octree, self.octree.cut
        normal = cut.normal.get()[:, :3].astype(float)
        size = np.linalg.norm(normal, axis=1, keepdims=True)
        x_B = octree.cut_positions() + cut.boundary.get()[:, :3].astype(float)
        inside = x_B - LINING * normal / np.where(size > 0, size, 1)
        return [*cell_points(octree), octree.grid.to_mm(inside)]

    def add(self, light: DirectionalLight | PointLight, unit: float) -> None:
        """Add a light's deposit, its strength in multiples of `unit`."""
        where, strength = light_arguments(self.device, self.octree, light, unit)
        self._trace(where, strength)
        if self.blockers:
            self._shade(light)
        self._deposit(where)
        self.incident += self._entering(where)
        if isinstance(light, PointLight):
            self._add_lamp_inside(light, unit)

    def _entering(self, where: Any) -> np.ndarray:
        """Power (3,) that a light brings through the surface."""
        device, octree, cut = self.device, self.octree, self.octree.cut
        partial = device.empty((tiles(cut.n), CHANNELS))
        device.run(device.kernel("entering", "entering"), GROUP * tiles(cut.n), cut.n, where, self._position[-1],
                   cut.cell, cut.boundary, cut.normal, self._F_B, partial, group=GROUP)  # fmt: skip
        return octree.grid.h**2 * sum_of_parts(partial)

    def _trace(self, where: Any, strength: Any) -> None:
        device, octree, cut, eta = self.device, self.octree, self.octree.cut, float(self.medium.eta)
        defines = self.medium.defines
        cells = device.kernel("attenuate", "beam_in_cells", *defines)
        for k, order in self._orders:
            n, depth = order.shape[0], octree.levels[k].depth
            device.run(cells, -(-n // device.lanes), n, depth, octree.grid.h, eta, where, strength, *self._body, order,
                       self._position[k], self._F[k])  # fmt: skip
        self._copy_ghosts()
        kernel = device.kernel("attenuate", "beam_at_boundary", *defines)
        device.run(kernel, -(-cut.n // device.lanes), cut.n, octree.grid.h, eta, where, strength, *self._body,
                   self._position[-1], self._F_B)  # fmt: skip

    def _shade(self, light: DirectionalLight | PointLight) -> None:
        """No light where a blocker stands before it."""
        assert self.blockers is not None
        for points, F in zip(self._points, [*self._F, self._F_B], strict=True):
            if isinstance(light, DirectionalLight):
                dark = self.blockers.occluded(points, -light.direction[None])
            else:
                dark = self.blockers.occluded(points, light.position - points, 1.0)
            values = F.get()
            values[: len(points)][dark] = 0
            F.set(values)
        self._copy_ghosts()

    def _copy_ghosts(self) -> None:
        kernel = self.device.kernel("prolong", "copy_ghosts")
        for k, level in enumerate(self.octree.levels):
            self.device.run(kernel, level.n_ghost, level.n_ghost, level.n, level.parent, self._F[k - 1], self._F[k])

    def _deposit(self, where: Any) -> None:
        device, octree, cut, medium = self.device, self.octree, self.octree.cut, self.medium
        levels, defines, g = octree.levels, medium.defines, float(medium.g)
        parts = list(zip(medium.D, medium.sigma_a, medium.sigma_s, strict=True))
        finest, F, F_B = octree.finest, self._F, self._F_B
        kernel = device.kernel("source", "deposit_finest", *defines)
        device.run(kernel, finest.n, finest.n, finest.h, g, float(medium.fresnel_A), where, *parts[-1], medium.D[-2],
                   medium.sigma_s[-2], medium.fitted, self._position[-1], finest.nbr, finest.parent, octree.cut_index,
                   cut.centroid, cut.boundary, cut.normal, self._aperture, cut.face_centroid, F_B, F[-1], self.Q[-1],
                   self.lost)  # fmt: skip
        coarse = device.kernel("source", "deposit_coarse", *defines)
        interface = device.kernel("source", "deposit_interface", *defines)
        for k, level in enumerate(levels[:-1]):
            up, fine, m = max(k - 1, 0), levels[k + 1], level.interface.shape[0]
            device.run(coarse, level.n, level.n, level.h, g, level.depth, where, *parts[k], medium.D[up],
                       medium.sigma_s[up], self._position[k], level.nbr, level.parent, level.is_leaf, F[k],
                       self.Q[k])  # fmt: skip
            device.run(interface, m, m, fine.n, fine.h, g, fine.depth, where, *parts[k], medium.D[k + 1],
                       medium.sigma_s[k + 1], level.interface, level.interface_start, fine.ghost_face,
                       self._position[k + 1], F[k + 1], self.Q[k])  # fmt: skip
        kernel = device.kernel("moment", "moment", *defines)
        device.run(kernel, cut.n, cut.n, finest.h, g, where, *parts[-1], medium.fitted, self._position[-1],
                   cut.cell, cut.centroid, cut.boundary, cut.normal, F_B, F[-1], self.moment, self.wall)  # fmt: skip

    def _add_lamp_inside(self, lamp: PointLight, unit: float) -> None:
        """The beam of a lamp inside the object starts there: what it emits is no divergence of B.

        The eight cells around it share the power, so that its first moment is right: all in one cell's centroid, the
        lamp would stand up to h / 2 aside.
        """
        depth, index = self.octree.find(lamp.position[None])
        if index[0] < 0:
            return
        width = 2 ** int(depth[0])
        at = self.octree.grid.to_cells(lamp.position) / width - 0.5
        low = np.floor(at)
        corners = np.array(list(np.ndindex(2, 2, 2)))
        shares = np.where(corners, at - low, low + 1 - at).prod(axis=1)
        depths, cells = self.octree.find(self.octree.grid.to_mm((low + corners + 0.5) * width))
        outside = cells < 0
        depths[outside], cells[outside] = depth[0], index[0]
        power = 4 * np.pi * channels(lamp.intensity / unit)
        for d, cell, share in zip(depths.tolist(), cells.tolist(), shares.tolist(), strict=True):
            k = len(self.octree.levels) - 1 - d
            sigma_a, sigma_s = self.medium.sigma_a[k], self.medium.sigma_s[k]
            if self.medium.homogeneous:
                a, s = np.array(sigma_a.tolist()), np.array(sigma_s.tolist())
            else:
                a, s = (channels(values.get()[cell].astype(float)) for values in (sigma_a, sigma_s))
            Q = self.Q[k].get()
            Q[cell] += (share * power * s / (a + s))[:3]
            self.Q[k].set(Q)
        self.incident += power[:3]
