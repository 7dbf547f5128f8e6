"""What the lights deposit in each cell: reduced incident light, attenuated along rays, and emission.

    Q_i = -(sum_f B_f + B_B) + V q0,   b_i = Q_i / D,  less what the boundary passes on at once

B, what beams bring, is of beams.py. Input: an octree, a medium, lights. Output: the right-hand side.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from clsss.beams import Beams
from clsss.device import Buffer, Device
from clsss.diffusion import Coefficients
from clsss.emission import cell_emission
from clsss.fields import Field, Load
from clsss.layer import fitted_layer
from clsss.lights import DirectionalLight, Emission, EnvironmentLight, PointLight
from clsss.octree import Octree
from clsss.rays import RayCaster
from clsss.room import Room
from clsss.sparsematrix import SparseMatrix
from clsss.sums import total

ENVIRONMENT_BEAMS = 256


@dataclass(frozen=True, eq=False)
class Deposit:
    """What is asked of a source once the equation is solved.

    Attributes
    ----------
    wall : (n_cut, 3) real, device, or None where g = 0
        3 D q1 . n at the boundary [W/mm^2].
    deposited, incident : (3,) float
        Power deposited, and power that the beams bring through the surface [W].
    lost : (3,) float
        Part of what is deposited that is absorbed before it gets to a centroid or the surface [W].
    """

    wall: Buffer | None
    deposited: np.ndarray
    incident: np.ndarray
    lost: np.ndarray


@dataclass(frozen=True, eq=False)
class Source(Deposit):
    """Right-hand side of the diffusion equation.

    Attributes
    ----------
    b : Load
        What each leaf receives, in the operator's scale.
    moment : (n_cut, 3) real, device
        First moment r_B of the source between centroid and surface [W/mm^2].
    """

    b: Load
    moment: Buffer


def _add_emission(beams: Beams, light: Emission, unit: float) -> np.ndarray:
    """Power [unit mm^2] that is absorbed before it gets to a centroid or the surface (3,)."""
    octree = beams.octree
    layer, cells = fitted_layer(beams.device, octree, beams.medium), octree.cut.cell.get()
    emitted = cell_emission(octree, light.density) if callable(light.q0) else None
    volumes, lost = octree.volumes(), np.zeros(3)
    for k, (level, q) in enumerate(zip(octree.levels, beams.Q, strict=True)):
        density = (level.leaf[:, None] * light.q0 if emitted is None else emitted[k]) / unit
        power = density * volumes[k][:, None]
        lost += power.sum(axis=0)
        if layer and level is octree.finest:
            moment = density[cells] * layer.moment.get()
            power = density * layer.volume.get()
            power[cells] += layer.conductance.get() * moment
            beams.moment.set(beams.moment.get() + moment)
        lost -= power.sum(axis=0)
        q.set(q.get() + power)
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
                blockers: RayCaster | None = None, progress: Callable[[float], None] | None = None,
                lent: tuple[Load, Field, Room] | None = None) -> Source:  # fmt: skip
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
    lent : tuple of Load, Field and Room, optional
        Where the right-hand side shall lie, one to overwrite, and other memory.

    Returns
    -------
    Source
    """
    beams, lost = Beams(device, octree, medium, blockers, lent), np.zeros(3)
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
        if progress is not None:
            progress(done / len(collimated))
    b = beams.Q
    lost += total(device, beams.lost) if beams.lost else 0
    deposited = lost + total(device, b.whole)
    if medium.homogeneous:
        n = b.whole.shape[0]
        device.run(device.kernel("moment", "right_hand_side"), n, n, medium.D[-1], b.whole)
    subtract_moment(device, octree, medium, beams.moment, b[-1])
    return Source(beams.wall, deposited * unit, beams.incident * unit, lost * unit, b, beams.moment)


def subtract_moment(device: Device, octree: Octree, medium: Coefficients, moment: Buffer, b: Buffer) -> None:
    """Take the boundary's first moment (n_cut, 3) [W/mm^2] from the finest level's `b` (or residual)."""
    kernel = device.kernel("moment", "subtract_moment", *medium.defines)
    device.run(kernel, octree.cut.n, *_at_boundary(octree, medium), moment, b)


def add_entered(device: Device, octree: Octree, medium: Coefficients, blend: SparseMatrix, gain: float,
                entered: Buffer, b: Buffer) -> None:  # fmt: skip
    """Add what light brings that has `entered` patches (p, 3), `gain` times its `blend` at each cut cell [W/mm^2]."""
    kernel = device.kernel("moment", "add_entered", *medium.defines)
    device.run(kernel, octree.cut.n, *_at_boundary(octree, medium), *blend.rows, gain, entered, b)


def _at_boundary(octree: Octree, medium: Coefficients) -> tuple[Any, ...]:
    cut = octree.cut
    return (cut.n, octree.grid.h, medium.fresnel_A, medium.D_cut, medium.fitted, cut.cell, cut.centroid, cut.boundary,
            cut.normal)  # fmt: skip
