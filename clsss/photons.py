"""Random walks forward from the lights, counted where they leave the surface (kernels/photons.cl)."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from clsss.device import Buffer
from clsss.mesh import Mesh, contains
from clsss.refine import areas, outward_normals, owners, refine
from clsss.transport import QUANTITIES, Scene, Sources, Walk, launches

BATCHES = 40  # the standard error comes from the scatter between batches
TALLIES = ("incident", "reflected", "absorbed", "scattered", "unscattered", "lost", "capped")
FIXED_POINT = 2.0**-20


def patches(
    triangles: np.ndarray, points: np.ndarray, normals: np.ndarray, radius: float
) -> tuple[np.ndarray, np.ndarray]:
    """Cut the surface into pieces and give each to the point it is nearest to, on the same side.

    Parameters
    ----------
    triangles : (m, 3, 3) float64
        The surface [mm].
    points, normals : (n, 3) float64
        Points on it [mm] and its outward normals there.
    radius : float
        How far from its point a piece may lie [mm].

    Returns
    -------
    pieces : (t, 3, 3) float64
        The surface in pieces small against `radius` [mm].
    owner : (t,) int64
        The point each belongs to, -1 where none is near.
    """
    pieces, _ = refine(triangles, radius / 2, at_least=2)
    return pieces, owners(pieces.mean(axis=1), outward_normals(pieces), points, normals, radius)


def trace(
    scene: Scene, lights: Launched, owner: np.ndarray, area: np.ndarray, n_photons: int, eta: float, walk: Walk
) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """Means and standard errors (n, 3) as of `clsss.paths.trace`, and where the power went, (3,) each [W].

    Parameters
    ----------
    scene : Scene
        Surface in pieces, and medium.
    lights : Launched
        As from `launched`.
    owner : (t,) int
        Which of n points each piece belongs to, or -1.
    area : (n,) float64
        Area of each point's pieces [mm^2]; points without any get NaN.
    n_photons : int
        In all, for each channel.
    eta : float
        Index of refraction.
    walk : Walk
        How.
    """
    device, channels, n = scene.device, scene.n_channels, len(area)
    bins = np.full(scene.n_places, -1, np.int32)
    bins[scene.places] = owner
    shape = channels, lights.count, n, walk.cap, walk.seed, int(walk.reenter), float(eta)
    sphere = device.vector([0, 0, 0, scene.radius])
    given = (*shape, sphere, *scene.surface, *scene.medium, *lights.buffers, device.array(bins))
    kernel = device.kernel("photons", "photons", *scene.defines)
    scores = device.empty((channels, n, 2, 2), np.uint32)
    tallies = device.empty((channels, len(TALLIES), 2), np.uint32)
    batches = min(BATCHES, n_photons)
    bounds = [n_photons * k // batches for k in range(batches + 1)]
    sums, spent = np.zeros((len(QUANTITIES), 2, channels, n)), np.zeros((channels, len(TALLIES)))
    for batch, (begin, end) in enumerate(itertools.pairwise(bounds)):
        scores.fill(0)
        tallies.fill(0)
        for start, count in launches((end - begin) * channels, None, channels):
            device.run(kernel, count, count, begin + start // channels, *given, scores, tallies)
            device.finish()
        single, multiple = np.moveaxis(_words(scores.get()) / (end - begin), 2, 0)
        for into, value in zip(sums, (single + multiple, single, multiple), strict=True):
            into[0] += value
            into[1] += value**2
        spent += _words(tallies.get())
        if walk.progress:
            walk.progress("paths", (batch + 1) / batches)
    energy = scene.rgb((spent * lights.unit[:, None] / n_photons).T)
    with np.errstate(divide="ignore", invalid="ignore"):
        mean, square = np.moveaxis(sums / batches, 1, 0)
        error = np.sqrt(np.maximum(square - mean**2, 0) / max(batches - 1, 1))
        per_area = lights.unit[:, None] / area
        results = {}
        for name, m, e in zip(QUANTITIES, mean, error, strict=True):
            results[name], results[f"{name}_stderr"] = (scene.rgb((v * per_area).T) for v in (m, e))
    return results, dict(zip(TALLIES, energy, strict=True))


@dataclass(frozen=True, eq=False)
class Launched:
    """Lights as the kernel takes them.

    Attributes
    ----------
    count : int
        How many.
    buffers : tuple of Buffer
        Places, whether inside the solid, photons' weights, and chances summed up.
    unit : (c,) float64
        Power that weight 1 stands for, in units of the channel's strongest light.
    """

    count: int
    buffers: tuple[Buffer, ...]
    unit: np.ndarray


def launched(scene: Scene, sources: Sources, mesh: Mesh) -> Launched:
    """Photons' weights, so that each light gets photons by the power it sends at the sphere about the object."""
    apart = np.linalg.norm(sources.place[:, :3] - scene.centre, axis=1)
    share = scene.radius / np.maximum(apart, scene.radius)
    cone = np.where(apart > scene.radius, 2 * np.pi * (1 - np.sqrt(1 - share**2)), 4 * np.pi)
    power = scene.strength * np.where(sources.lamps, cone, np.pi * scene.radius**2)[:, None]
    chance = power.mean(axis=1) / power.mean(axis=1).sum()
    weight = power / np.maximum(chance, np.finfo(float).tiny)[:, None]
    unit = weight.max(axis=0)
    inside = np.zeros(len(apart), np.int32)
    inside[sources.lamps] = contains(mesh, sources.place[sources.lamps, :3])
    buffers = (scene.device.array(v) for v in (inside, weight / unit, np.cumsum(chance)))
    return Launched(len(apart), (scene.lights, *buffers), unit)


def _words(sums: np.ndarray) -> np.ndarray:
    """Sums (..., 2) of 64-bit fixed point as numbers."""
    return (sums[..., 0] + sums[..., 1] * 2.0**32) * FIXED_POINT


def owned_areas(pieces: np.ndarray, owner: np.ndarray, n: int) -> np.ndarray:
    """Area of each point's pieces (n,) [mm^2]."""
    on = owner >= 0
    return np.bincount(owner[on], areas(pieces[on]), n)
