"""How photons start: from lights outside and inside, and where emission shines (kernels/launch.h)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from clsss.device import Buffer, Device
from clsss.errors import InputError
from clsss.lights import Emission
from clsss.mesh import Mesh, contains
from clsss.transport import Sources, TracedScene
from clsss.winding import winding_number

PILOT = 20_000  # births that emission's share of the photons is judged by
CANDIDATES = 4  # places looked at for each that is drawn
EVEN = 1.2207440846057596 ** -np.arange(1.0, 4)  # steps of the sequence R3, whose points lie evenly in a box


def births(
    mesh: Mesh, emission: Sequence[Emission], n: int, random: np.random.Generator, device: Device
) -> tuple[np.ndarray, np.ndarray]:
    """Draw places whose powers add up, on average, to the power emitted in the solid.

    Candidates spread evenly over the bounding box, shifted by chance; of those inside, each is drawn in proportion
    to its q0.

    Parameters
    ----------
    mesh : Mesh
        The solid.
    emission : sequence of Emission
        What shines inside.
    n : int
        How many places.
    random : numpy.random.Generator
        Where chance comes from.
    device : Device
        Tells inside from outside.

    Returns
    -------
    place : (n, 4) float64
        Places [mm], and how many bodies hold each.
    power : (n, 3) float64
        What each stands for [W]; all 0 where no candidate shone.

    Raises
    ------
    InputError
        An emission's function gives what is no power.

    References
    ----------
    Roberts 2018, "The unreasonable effectiveness of quasirandom sequences"; Cranley and Patterson 1976 (shift).
    """
    low, high = mesh.bounds
    steps = np.arange(CANDIDATES * n)[:, None] * EVEN
    candidates = low + (random.random(3) + steps) % 1 * (high - low)
    bodies = np.rint(winding_number(device, mesh.triangles, candidates))
    inside = np.flatnonzero(bodies > 0)
    candidates, bodies = candidates[inside], bodies[inside]
    q0 = np.sum([np.zeros((len(inside), 3)), *(light.density(candidates) for light in emission)], axis=0)
    density = q0.mean(axis=1)
    if not density.any():
        return np.zeros((n, 4)), np.zeros((n, 3))
    total = np.cumsum(density)
    levels = (np.arange(n) + random.random()) / n * total[-1]
    drawn = np.minimum(np.searchsorted(total, levels, side="right"), np.flatnonzero(density)[-1])
    share = np.prod(high - low) / (CANDIDATES * n) * total[-1] / n
    return np.column_stack([candidates[drawn], bodies[drawn]]), share * q0[drawn] / density[drawn, None]


@dataclass(frozen=True, eq=False)
class Launched:
    """Lights as the kernel takes them.

    Attributes
    ----------
    count : int
        How many, emission among them.
    buffers : tuple of Buffer
        Places, how many bodies hold each, photons' weights, and chances summed up.
    unit : (c,) float64
        Power that weight 1 stands for, in units of the channel's strongest light.
    births : callable
        Takes a number and a generator; gives kernel arguments for as many photons that emission starts.
    """

    count: int
    buffers: tuple[Buffer, ...]
    unit: np.ndarray
    births: Callable[[int, np.random.Generator], tuple[int, Buffer, Buffer]]


def launched(scene: TracedScene, sources: Sources, mesh: Mesh) -> Launched:
    """Photons' weights, so that each light gets photons by the power it sends at the sphere about the object.

    Raises
    ------
    InputError
        There is emission that shines nowhere inside.
    """
    device, lamps = scene.device, sources.lamps
    apart = np.linalg.norm(sources.place[:, :3] - scene.centre, axis=1)
    share = scene.radius / np.maximum(apart, scene.radius)
    cone = np.where(apart > scene.radius, 2 * np.pi * (1 - np.sqrt(1 - share**2)), 4 * np.pi)
    power = scene.strength * np.where(lamps, cone, np.pi * scene.radius**2)[:, None]
    place, inside = sources.place - np.where(lamps[:, None], [*scene.centre, 0], 0), np.zeros(len(lamps), np.int32)
    inside[lamps] = contains(mesh, sources.place[lamps, :3])
    glow = np.ones(scene.n_channels)
    if sources.emission:
        _, trial = _born(scene, sources, mesh, PILOT, np.random.Generator(np.random.Philox(0)))
        glow = PILOT * trial.max(axis=0)
        if not glow.any():
            raise InputError(f"lights: the emission shines nowhere inside {mesh.name}")
        power, inside = np.vstack([power, glow]), np.append(inside, np.int32(0))
        place, glow = np.vstack([place, [0, 0, 0, 2]]), np.where(glow > 0, glow, 1)
    chance = power.mean(axis=1) / power.mean(axis=1).sum()
    weight = power / np.maximum(chance, np.finfo(float).tiny)[:, None]
    unit = weight.max(axis=0)
    unit[unit == 0] = 1

    def births(n: int, random: np.random.Generator) -> tuple[int, Buffer, Buffer]:
        if not sources.emission:
            return 1, device.zeros((1, 4)), device.zeros((1, scene.n_channels))
        drawn, trial = _born(scene, sources, mesh, n, random)
        return n, device.array(drawn), device.array(n * trial / glow)

    buffers = tuple(device.array(v) for v in (place, inside, weight / unit, np.cumsum(chance)))
    return Launched(len(place), buffers, unit, births)


def _born(
    scene: TracedScene, sources: Sources, mesh: Mesh, n: int, random: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """`births` as the kernel takes them: places about the centre, powers (n, c) over each channel's scale."""
    place, power = births(mesh, sources.emission, n, random, scene.device)
    return place - [*scene.centre, 0], scene.traced(power / scene.scale)
