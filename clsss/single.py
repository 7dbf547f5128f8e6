"""Light scattered exactly once, which diffusion blurs: traced along rays, with the coefficients of the beams.

    L(x, omega) = T / eta^2 int sigma_s p F exp(-tau) ds,    M_1 = int L cos dw

Diffusion knows it too, as the first order of its own series, and lets too much of it out: 11 % where a beam meets
a half space squarely. The excess goes back into the solve as light that the wall has kept inside, so that diffusion
is driven by second scattering alone, and energy still balances:

    div J + sigma_a phi = q0,   J.n = (phi - 4 (M_1' - M_1) / (1 - R_phi)) / (2A),   M = J.n
    div J' + sigma_t phi' = q0,   M_1' = phi' / (2A)

References
----------
Jensen et al. 2001, section 2.2.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from clsss import bvh
from clsss.beams import extinction, light_arguments, scattering
from clsss.device import Device
from clsss.diffusion import Coefficients, make_operator
from clsss.fields import CHANNELS, Field
from clsss.fresnel import entering_gain, fresnel_A, fresnel_reflectance, unit_quadrature
from clsss.lights import DirectionalLight, Emission, EnvironmentLight, PointLight
from clsss.multigrid import Multigrid
from clsss.octree import Octree
from clsss.rays import RayCaster
from clsss.source import Source, make_source, subtract_moment
from clsss.surface import boundary_points, tangent_frame

DEPTHS = 24  # points along a ray where the light may have scattered
RINGS, TURNS, FEW = 4, 6, 8  # rays per point for its exitance: angles from the normal and around it, points on each
SKY_BEAMS = 24  # directions that an environment is taken from


class SingleScattering:
    """Light of some lights that is scattered exactly once in an object.

    Parameters
    ----------
    device, octree
        Where.
    medium : Coefficients
        The same as of the diffuse light: its phase says what counts as scattered.
    lights : list
        Emission inside is no part of it.
    unit : float
        Strength that results are multiples of [W/mm^2].
    blockers : RayCaster, optional
        Opaque bodies.
    """

    def __init__(self, device: Device, octree: Octree, medium: Coefficients, lights: list[Any], unit: float,
                 blockers: RayCaster | None = None):  # fmt: skip
        self.device, self.octree, self.medium = device, octree, medium
        self._lights = [light_arguments(device, octree, light, unit) for light in collimated(lights)]
        total = extinction(device, octree, medium)
        self._body, self._scatters = (*octree.lend_body(), *total), scattering(device, octree, medium)
        self._rate = float(np.mean(total[0].tolist()[:3] if medium.homogeneous else total[0].get()))
        self._surface: tuple[Any, ...] = ()
        if blockers:
            triangles = octree.grid.to_cells(blockers.triangles)
            tree = bvh.build(triangles)
            self._surface = (tree.n_leaves, tree.leaf_size, device.array(tree.boxes),
                             device.array(triangles[tree.order].reshape(-1, 9)))  # fmt: skip
        defines = (*medium.defines, *(["BLOCKED"] if blockers else []))
        self._kernel = device.kernel("single", "scattered_once", *defines)

    def radiance(self, points: np.ndarray, normals: np.ndarray, out: np.ndarray, depths: int = DEPTHS) -> np.ndarray:
        """Radiance that leaves points of the surface.

        Parameters
        ----------
        points, normals, out : (n, 3) float
            Points on the surface [mm], outward normals, directions in which the light leaves.
        depths : int
            Points along each ray.

        Returns
        -------
        (n, 3) float64
            In multiples of `unit` [W/mm^2/sr].
        """
        device, octree, n = self.device, self.octree, len(points)
        spare = np.zeros((n, 1))
        arrays = [device.array(np.hstack([v, spare])) for v in (octree.grid.to_cells(points), normals, out)]
        radiance, nodes = device.zeros((n, 4)), device.array(np.stack(unit_quadrature(depths), axis=1))
        for where, strength in self._lights:
            device.run(self._kernel, n, n, depths, octree.grid.h, float(self.medium.eta), float(self.medium.g),
                       self._rate, where, strength, *self._body, self._scatters, *self._surface, *arrays, nodes,
                       radiance)  # fmt: skip
        return radiance.get()[:, :3].astype(float)

    def exitance(self, points: np.ndarray, normals: np.ndarray,
                 progress: Callable[[float], None] | None = None) -> np.ndarray:  # fmt: skip
        """Exitance (n, 3) at points of the surface, in multiples of `unit`; parameters as of `radiance`."""
        s, t = tangent_frame(normals)
        total = np.zeros((len(points), 3))
        for ring, (mu, weight) in enumerate(zip(*unit_quadrature(RINGS), strict=True)):
            for turn in range(TURNS):
                angle = 2 * np.pi * (turn / TURNS + 0.6180339887 * ring)
                out = np.sqrt(1 - mu * mu) * (np.cos(angle) * s + np.sin(angle) * t) + mu * normals
                total += 2 * np.pi / TURNS * weight * mu * self.radiance(points, normals, out, FEW)
                if progress is not None:
                    progress((ring * TURNS + turn + 1) / (RINGS * TURNS))
        return total


def collimated(lights: list[Any]) -> list[DirectionalLight | PointLight]:
    """Beams and lamps; an environment as a few beams."""
    found: list[DirectionalLight | PointLight] = []
    for light in lights:
        if isinstance(light, EnvironmentLight):
            found += light.beams(SKY_BEAMS)
        elif isinstance(light, (DirectionalLight, PointLight)):
            found.append(light)
    return found


def _diffused_once(device: Device, octree: Octree, medium: Coefficients, source: Source,
                   tolerance: float) -> np.ndarray:  # fmt: skip
    """M_1' (n_cut, 3), the exitance of light scattered once as diffusion has it: every collision absorbs."""
    phi = Field(device, octree)
    multigrid = Multigrid(device, make_operator(device, octree, medium))
    multigrid.residual.wall = source.wall
    multigrid.solve(source.b, phi, tolerance, from_zero=True)
    return multigrid.residual.boundary_flux(phi, source.moment)


def most_excess(eta: float) -> float:
    """The largest (M_1' - M_1) / M_1 of a half space in a beam, over all angles; what coarse cells add is theirs."""
    (inner, weight), mu = unit_quadrature(256), np.linspace(0.02, 1, 50)[:, None]
    exact = (weight * (1 - fresnel_reflectance(inner, eta)) * inner * mu / (mu + inner)).sum(axis=1) / 2
    particular = 1 / (1 - 1 / (3 * mu[:, 0] ** 2))
    slow, fast = 1 / (2 * fresnel_A(eta)), 1 / np.sqrt(3)
    decaying = -particular * (1 / (3 * mu[:, 0]) + slow) / (fast + slow)
    return float((slow * (particular + decaying) / exact).max() - 1)


def _opaque(device: Device, medium: Coefficients) -> tuple[list[Any], list[Any]]:
    """D' = 1 / (3 sigma_t) and sigma_t on every level."""
    D: list[Any] = []
    sigma_t: list[Any] = []
    for a, s in zip(medium.sigma_a, medium.sigma_s, strict=True):
        if medium.homogeneous:
            total = np.add(a.tolist(), s.tolist())
            sigma_t.append(device.vector(total))
            D.append(device.vector(1 / (3 * total)))
        else:
            total = a.astype(float) + s
            sigma_t.append(total.astype(device.real))
            D.append((1 / (3 * total)).astype(device.real))
    return D, sigma_t


def _none_fitted(device: Device, medium: Coefficients) -> Any:
    return device.vector([0.0] * CHANNELS) if medium.homogeneous else device.empty((0, 3))


def split(device: Device, octree: Octree, medium: Coefficients, lights: list[Any], unit: float, source: Source,
          blockers: RayCaster | None, tolerance: float,
          progress: Callable[[float], None] | None = None) -> tuple[np.ndarray, np.ndarray, Source]:  # fmt: skip
    """Take light scattered once out of what drives diffusion.

    Parameters
    ----------
    source : Source
        Of all scattered light.
    tolerance : float
        Of the solve for M_1'.

    Returns
    -------
    once : (n_cut, 3) float64
        M_1 at the boundary of the cut cells.
    excess : (n_cut, 3) float64
        M_1' - M_1.
    source : Source
        With the excess kept inside.
    """
    points, normals = boundary_points(octree)
    once = SingleScattering(device, octree, medium, lights, unit, blockers).exitance(points, normals, progress)
    D, sigma_t = _opaque(device, medium)
    D_cut = D[-1] if medium.homogeneous else device.array(D[-1][octree.cut.cell.get()])
    thin = replace(medium, D=D, D_cut=D_cut, fitted=_none_fitted(device, medium))
    beams = [light for light in lights if not isinstance(light, Emission)]
    known = source if medium.g == 0 and len(beams) == len(lights) and not source.lost.any() else make_source(
        device, octree, thin, beams, unit, blockers)  # fmt: skip
    excess = _diffused_once(device, octree, replace(thin, sigma_a=sigma_t), known, tolerance) - once
    most = most_excess(medium.eta) * once
    excess = np.clip(excess, -most, most)
    part = device.array(-entering_gain(medium.eta) * excess)
    moment = device.array(source.moment.get() + part.get())
    subtract_moment(device, octree, medium, part, source.b[-1])
    return once, excess, replace(source, moment=moment)
