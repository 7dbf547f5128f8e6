"""Random walks forward from the lights, counted where they leave the surface (kernels/photons.cl)."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from clsss.launch import Launched
from clsss.subdivision import areas, outward_normals, owners, subdivide
from clsss.transport import QUANTITIES, TracedScene, Walk, launches

BATCHES = 40  # the standard error comes from the scatter between batches
TALLIES = ("incident", "reflected", "absorbed", "scattered", "unscattered", "lost", "capped")
FIXED_POINT = 2.0**-20


@dataclass(frozen=True, eq=False)
class Patches:
    """The surface in pieces, each given to the point it is nearest to, on the same side.

    Attributes
    ----------
    cut : (m, 2) int32
        Of each triangle the first piece, and how many follow one another along a side (`clsss.subdivision.subdivide`).
    owner : (t,) int32
        The point each piece belongs to, -1 where none is near.
    area : (n,) float64
        Of the pieces of each point [mm^2].
    """

    cut: np.ndarray
    owner: np.ndarray
    area: np.ndarray


def patches(triangles: np.ndarray, points: np.ndarray, normals: np.ndarray, radius: float) -> Patches:
    """Cut the surface (m, 3, 3) [mm] and share it between points on it (n, 3) with outward normals (n, 3).

    `radius` is how far from its point a piece may lie [mm].
    """
    pieces, parent = subdivide(triangles, radius / 2, at_least=2)
    owner = owners(pieces.mean(axis=1), outward_normals(pieces), points, normals, radius)
    _, first, count = np.unique(parent, return_index=True, return_counts=True)
    cut = np.stack([first, np.rint(np.sqrt(count))], axis=1).astype(np.int32)
    on = owner >= 0
    return Patches(cut, owner.astype(np.int32), np.bincount(owner[on], areas(pieces[on]), len(points)))


def trace(
    scene: TracedScene, lights: Launched, patches: Patches, n_photons: int, eta: float, walk: Walk
) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """Means and standard errors (n, 3) as of `clsss.paths.trace`, and where the power went, (3,) each [W].

    Parameters
    ----------
    scene : TracedScene
        Surface and medium.
    lights : Launched
        How photons start.
    patches : Patches
        Where photons are counted; points without any get NaN.
    n_photons : int
        In all, for each channel.
    eta : float
        Index of refraction.
    walk : Walk
        How.
    """
    batches = min(BATCHES, n_photons)
    sums, spent = _counted(scene, lights, patches, n_photons, batches, eta, walk)
    energy = scene.rgb((spent * lights.unit[:, None] / n_photons).T)
    with np.errstate(divide="ignore", invalid="ignore"):
        mean, square = np.moveaxis(sums / batches, 1, 0)
        error = np.sqrt(np.maximum(square - mean**2, 0) / max(batches - 1, 1))
        per_area = lights.unit[:, None] / patches.area
        results = {}
        for name, m, e in zip(QUANTITIES, mean, error, strict=True):
            results[name], results[f"{name}_stderr"] = (scene.rgb((v * per_area).T) for v in (m, e))
    return results, dict(zip(TALLIES, energy, strict=True))


def _counted(
    scene: TracedScene, lights: Launched, patches: Patches, n_photons: int, batches: int, eta: float, walk: Walk
) -> tuple[np.ndarray, np.ndarray]:
    """Sums over batches (3, 2, c, n) of scores per photon and of their squares, and of tallies (c, t)."""
    device, channels, n = scene.device, scene.n_channels, len(patches.area)
    cut = np.zeros((scene.n_places, 2), np.int32)
    cut[scene.places] = patches.cut
    shape = channels, lights.count, n, walk.cap, walk.seed, int(walk.reenter), float(eta), scene.radius, scene.reach
    given = (*shape, *scene.surface, *scene.medium, *lights.buffers)
    counted = device.array(cut), device.array(patches.owner)
    random = np.random.Generator(np.random.Philox(walk.seed))
    kernel = device.kernel("photons", "photons", *scene.defines)
    scores = device.empty((channels, n, 2, 2), np.uint32)
    tallies = device.empty((channels, len(TALLIES), 2), np.uint32)
    bounds = [n_photons * k // batches for k in range(batches + 1)]
    sums, spent = np.zeros((len(QUANTITIES), 2, channels, n)), np.zeros((channels, len(TALLIES)))
    for batch, (begin, end) in enumerate(itertools.pairwise(bounds)):
        scores.fill(0)
        tallies.fill(0)
        born = lights.births(-(-n_photons // batches), random)
        for start, count in launches((end - begin) * channels, None, channels):
            device.run(kernel, count, count, begin + start // channels, *given, *born, *counted, scores, tallies)
            device.finish()
        single, multiple = np.moveaxis(_words(scores.get()) / (end - begin), 2, 0)
        for into, value in zip(sums, (single + multiple, single, multiple), strict=True):
            into[0] += value
            into[1] += value**2
        spent += _words(tallies.get())
        if walk.progress:
            walk.progress("paths", (batch + 1) / batches)
    return sums, spent


def _words(sums: np.ndarray) -> np.ndarray:
    """Sums (..., 2) of 64-bit fixed point as numbers."""
    return (sums[..., 0] + sums[..., 1] * 2.0**32) * FIXED_POINT
