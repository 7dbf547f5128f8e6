"""What the lights deposit in each cell: reduced incident light, attenuated along rays, and emission.

    F(x) = F0 T exp(-tau),   Q_i = -(sum_f B_f + B_B) + V q0,   B = A a (omega . n) F

The beam's flux is averaged logarithmically between centroids, so that what is deposited is what enters less what
passes through, times the albedo, at any cell size (kernels/attenuate.cl, kernels/source.cl).

References
----------
Haber et al. 2005, eq. (2), (3) and section 3.3.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from clsss.device import Buffer, Device
from clsss.diffusion import CHANNELS, Coefficients, Field, cell_points, channels
from clsss.jumps import mean_over_jumps
from clsss.layer import fitted_layer
from clsss.lights import DirectionalLight, Emission, EnvironmentLight, PointLight
from clsss.octree import Octree
from clsss.rays import LINING, RayCaster

ENVIRONMENT_BEAMS = 256


@dataclass(frozen=True, eq=False)
class Source:
    """Right-hand side of the diffusion equation.

    Attributes
    ----------
    b : Field
        What each leaf receives, in the operator's scale.
    moment : (n_cut, 4) real, device
        First moment r_B of the source between centroid and surface [W/mm^2].
    wall : (n_cut, 4) real, device
        3 D q1 . n at the boundary [W/mm^2].
    deposited, incident : (3,) float
        Power deposited, and power that the beams bring through the surface [W].
    lost : (3,) float
        Part of what is deposited that is absorbed before it gets to a centroid or the surface [W].
    """

    b: Field
    moment: Buffer
    wall: Buffer
    deposited: np.ndarray
    incident: np.ndarray
    lost: np.ndarray


def extinction(device: Device, octree: Octree, medium: Coefficients) -> tuple[Any, ...]:
    """Extinction per finest cell width as rays take it (body.h): a vector, or all levels' cells and their starts."""
    if medium.homogeneous:
        total = [a + s for a, s in zip(medium.sigma_a[-1].tolist(), medium.sigma_s[-1].tolist(), strict=True)]
        return (device.vector([octree.grid.h * t for t in total]),)
    parts = [a + s for a, s in zip(medium.sigma_a[::-1], medium.sigma_s[::-1], strict=True)]
    start = np.concatenate([[0], np.cumsum([len(p) for p in parts])]).astype(np.int32)
    return device.array(channels(np.concatenate(parts)) * octree.grid.h), device.array(start)


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
    """

    def __init__(
        self, device: Device, octree: Octree, medium: Coefficients, blockers: RayCaster | None = None
    ):
        self.blockers, self._points = blockers, cell_points(octree) if blockers else []
        self.device, self.octree, self.medium = device, octree, medium.on_device(device)
        n_cut = octree.cut.n
        self.Q = Field(device, octree)
        self.moment, self.wall = device.zeros((n_cut, CHANNELS)), device.zeros((n_cut, CHANNELS))
        self.lost = device.zeros((n_cut, CHANNELS))
        self.incident = np.zeros(3)
        brick = octree.brick.get()
        order = brick[(brick >= 0) & (brick & 15 == 0)] >> 4
        cut_order = octree.cut_index.get()[order]
        self._order, self._cut_order = device.array(order), device.array(cut_order[cut_order >= 0])
        self._F = Field(device, octree)
        self._F_B = device.empty((n_cut, CHANNELS))
        self._body = (*octree.body, *extinction(device, octree, medium))
        self._normal = octree.cut.normal.get()[:, :3].astype(float) * octree.grid.h**2
        self._x_B = octree.finest.ijk[octree.cut.cell.get()] + octree.cut.boundary.get()[:, :3].astype(float)

    def add(self, light: DirectionalLight | PointLight, unit: float) -> None:
        """Add a light's deposit, its strength in multiples of `unit`."""
        if isinstance(light, DirectionalLight):
            towards = np.broadcast_to(-light.direction, self._x_B.shape)
        else:
            away = self.octree.grid.to_cells(light.position) - self._x_B
            towards = away / np.linalg.norm(away, axis=1, keepdims=True)
        where, strength = light_arguments(self.device, self.octree, light, unit)
        self._trace(where, strength)
        if self.blockers:
            self._shade(light)
        entering = np.maximum(0, (towards * self._normal).sum(axis=1))
        self.incident += entering @ self._F_B.get()[:, :3].astype(float)
        self._deposit(where)
        if isinstance(light, PointLight):
            self._add_lamp_inside(light, unit)

    def _trace(self, where: Any, strength: Any) -> None:
        device, octree, cut, eta = self.device, self.octree, self.octree.cut, float(self.medium.eta)
        defines, finest = self.medium.defines, self.octree.finest
        cells = device.kernel("attenuate", "beam_in_cells", *defines)
        for k, level in enumerate(octree.levels):
            device.run(cells, -(-level.n // device.lanes), level.n, level.depth, octree.grid.h, eta, where, strength,
                       *self._body, None if level.depth else self._order, level.position, level.is_leaf,
                       self._F[k])  # fmt: skip
            if level.n_ghost:
                self._copy_ghosts(k)
        kernel = device.kernel("attenuate", "beam_at_boundary", *defines)
        device.run(kernel, -(-cut.n // device.lanes), cut.n, octree.grid.h, eta, where, strength, *self._body,
                   self._cut_order, finest.position, cut.cell, self._F_B)  # fmt: skip

    def _shade(self, light: DirectionalLight | PointLight) -> None:
        """No light where a blocker stands before it."""
        assert self.blockers is not None
        size = np.linalg.norm(self._normal, axis=1, keepdims=True)
        boundary = self.octree.grid.to_mm(self._x_B - LINING * self._normal / np.where(size > 0, size, 1))
        for points, F in zip([*self._points, boundary], [*self._F, self._F_B], strict=True):
            if isinstance(light, DirectionalLight):
                dark = self.blockers.occluded(points, -light.direction[None])
            else:
                dark = self.blockers.occluded(points, light.position - points, 1.0)
            values = F.get()
            values[: len(points)][dark] = 0
            F.set(values)
        for k in range(1, len(self.octree.levels)):
            self._copy_ghosts(k)

    def _copy_ghosts(self, k: int) -> None:
        level = self.octree.levels[k]
        self.device.run(self.device.kernel("prolong", "copy_ghosts"), level.n_ghost, level.n_ghost, level.n,
                        level.parent, self._F[k - 1], self._F[k])  # fmt: skip

    def _deposit(self, where: Any) -> None:
        device, octree, cut, medium = self.device, self.octree, self.octree.cut, self.medium
        levels, defines, g = octree.levels, medium.defines, float(medium.g)
        parts = list(zip(medium.D, medium.sigma_a, medium.sigma_s, strict=True))
        finest, F, F_B = octree.finest, self._F, self._F_B
        kernel = device.kernel("source", "deposit_finest", *defines)
        device.run(kernel, finest.n, finest.n, finest.h, g, float(medium.fresnel_A), where, *parts[-1], medium.D[-2],
                   medium.sigma_s[-2], medium.fitted, finest.position, finest.nbr, finest.parent, octree.cut_index,
                   cut.centroid, cut.boundary, cut.normal, cut.aperture, cut.face_centroid, F_B, F[-1], self.Q[-1],
                   self.lost)  # fmt: skip
        coarse = device.kernel("source", "deposit_coarse", *defines)
        interface = device.kernel("source", "deposit_interface", *defines)
        for k, level in enumerate(levels[:-1]):
            up, fine, m = max(k - 1, 0), levels[k + 1], level.interface.shape[0]
            device.run(coarse, level.n, level.n, level.h, g, level.depth, where, *parts[k], medium.D[up],
                       medium.sigma_s[up], level.position, level.nbr, level.parent, level.is_leaf, F[k],
                       self.Q[k])  # fmt: skip
            device.run(interface, m, m, fine.n, fine.h, g, fine.depth, where, *parts[k], medium.D[k + 1],
                       medium.sigma_s[k + 1], level.interface, level.interface_start, fine.ghost_face, fine.position,
                       F[k + 1], self.Q[k])  # fmt: skip
        kernel = device.kernel("moment", "moment", *defines)
        device.run(kernel, cut.n, cut.n, finest.h, g, where, *parts[-1], medium.fitted, finest.position,
                   cut.cell, cut.centroid, cut.boundary, cut.normal, F_B, F[-1], self.moment, self.wall)  # fmt: skip

    def _add_lamp_inside(self, lamp: PointLight, unit: float) -> None:
        """The beam of a lamp inside the object starts in a cell: what it emits there is no divergence of B."""
        depth, index = self.octree.find(lamp.position[None])
        if index[0] < 0:
            return
        k = len(self.octree.levels) - 1 - int(depth[0])
        sigma_a, sigma_s = self.medium.sigma_a[k], self.medium.sigma_s[k]
        if self.medium.homogeneous:
            a, s = np.array(sigma_a.tolist()), np.array(sigma_s.tolist())
        else:
            a, s = (channels(values.get()[index[0]].astype(float)) for values in (sigma_a, sigma_s))
        power = 4 * np.pi * channels(lamp.intensity / unit)
        Q = self.Q[k].get()
        Q[index[0]] += power * s / (a + s)
        self.Q[k].set(Q)
        self.incident += power[:3]


def _add_emission(beams: Beams, light: Emission, unit: float) -> np.ndarray:
    """Power [unit mm^2] that is absorbed before it gets to a centroid or the surface (3,)."""
    octree = beams.octree
    layer, cells = fitted_layer(beams.device, octree, beams.medium), octree.cut.cell.get()
    volumes, points, lost = octree.volumes(), cell_points(octree), np.zeros(3)
    for k, (level, q) in enumerate(zip(octree.levels, beams.Q, strict=True)):
        leaf = level.leaf
        density, power = np.zeros((level.n, 3)), np.zeros((level.n + level.n_ghost, 3))
        density[leaf] = light.density(points[k][leaf])
        if callable(light.q0) and level is octree.finest:
            density = mean_over_jumps(octree, density, light.density)
        density /= unit
        power[: level.n] = density * volumes[k][:, None]
        lost += power.sum(axis=0)
        if layer and level is octree.finest:
            moment = density[cells] * layer.moment
            power[: level.n] = density * layer.volume
            power[cells] += layer.conductance * moment
            beams.moment.set(beams.moment.get() + channels(moment))
        lost -= power.sum(axis=0)
        q.set(q.get() + channels(power))
    return lost


def light_unit(lights: list[Any], size: float) -> float:
    """The strength to measure lights by, so that float32 holds them whatever their units [W/mm^2]."""
    peaks = [0.0]
    for light in lights:
        if isinstance(light, DirectionalLight):
            peaks.append(float(light.irradiance.max()))
        elif isinstance(light, PointLight):
            peaks.append(float(light.intensity.max()) / size**2)
        elif isinstance(light, EnvironmentLight):
            peaks.append(float(np.asarray(light.radiance).mean()) * np.pi)
        elif not callable(light.q0):
            peaks.append(float(np.max(light.q0)) * size)
    return max(peaks) or 1.0


def make_source(device: Device, octree: Octree, medium: Coefficients, lights: list[Any], unit: float,
                blockers: RayCaster | None = None,
                progress: Callable[[float], None] | None = None) -> Source:  # fmt: skip
    """Deposit of all lights, in multiples of `unit` [W/mm^2].

    Parameters
    ----------
    device, octree, medium
        Where.
    lights : list of DirectionalLight, PointLight, EnvironmentLight or Emission
        They add up in one right-hand side.
    blockers : RayCaster, optional
        Opaque bodies in front of the lights.
    progress : callable, optional
        Called with the fraction done.

    Returns
    -------
    Source
    """
    beams, lost = Beams(device, octree, medium, blockers), np.zeros(3)
    collimated: list[Any] = []
    for light in lights:
        if isinstance(light, EnvironmentLight):
            collimated += light.beams(ENVIRONMENT_BEAMS)
        elif isinstance(light, Emission):
            lost += _add_emission(beams, light, unit)
        else:
            collimated.append(light)
    for done, light in enumerate(collimated, 1):
        beams.add(light, unit)
        device.finish()
        if progress is not None:
            progress(done / len(collimated))
    lost += beams.lost.get()[:, :3].astype(float).sum(axis=0)
    deposited = lost + sum(q.get()[:, :3].astype(float).sum(axis=0) for q in beams.Q)
    b = beams.Q
    scale = device.kernel("moment", "right_hand_side", *medium.defines)
    for level, D, q in zip(octree.levels, medium.D, b, strict=True):
        device.run(scale, level.n, level.n, D, q, q)
    subtract_moment(device, octree, medium, beams.moment, b[-1])
    return Source(b, beams.moment, beams.wall, deposited * unit, beams.incident * unit, lost * unit)


def subtract_moment(device: Device, octree: Octree, medium: Coefficients, moment: Buffer, b: Buffer) -> None:
    """Take the boundary's first moment (n_cut, 4) [W/mm^2] from the finest level's `b` (or residual)."""
    cut = octree.cut
    kernel = device.kernel("moment", "subtract_moment", *medium.defines)
    device.run(kernel, cut.n, cut.n, octree.grid.h, medium.fresnel_A, medium.D[-1], medium.fitted, cut.cell,
               cut.centroid, cut.boundary, cut.normal, moment, b)  # fmt: skip
