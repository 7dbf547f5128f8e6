"""Random walks forward from the lights, counted where they leave the surface (kernels/photons.cl)."""

from __future__ import annotations

import itertools
from collections.abc import Callable

import numpy as np

from clsss.mesh import Mesh, contains
from clsss.refine import areas, refine
from clsss.transport import Scene, Sources, launches

BATCHES = 40  # the standard error comes from the scatter between batches
TALLIES = ("incident", "reflected", "absorbed", "scattered", "unscattered", "lost", "capped")
FIXED_POINT = 2.0**-20


def patches(triangles: np.ndarray, points: np.ndarray, radius: float) -> tuple[np.ndarray, np.ndarray]:
    """Cut the surface into pieces and give each to the point it is nearest to.

    Parameters
    ----------
    triangles : (m, 3, 3) float64
        The surface [mm].
    points : (n, 3) float64
        Points on it [mm]; of several at one place, the first owns its surroundings.
    radius : float
        How far from its point a piece may lie [mm].

    Returns
    -------
    pieces : (t, 3, 3) float64
        The surface in pieces small against `radius` [mm].
    owner : (t,) int64
        The point each belongs to, -1 where none is near.
    """
    from scipy.spatial import cKDTree

    pieces, _ = refine(triangles, radius / 2, at_least=2)
    distance, owner = cKDTree(points).query(pieces.mean(axis=1))
    first = np.unique(points, axis=0, return_index=True, return_inverse=True)[1:]
    return pieces, np.where(distance <= radius, first[0][first[1].ravel()][owner], -1)


def _beams(scene: Scene, sources: Sources, centre: np.ndarray, radius: float) -> np.ndarray:
    """Power (l, c) each light sends at the sphere about the object, in units of its channel's strength."""
    apart = np.linalg.norm(sources.place[:, :3] - centre, axis=1)
    share = radius / np.maximum(apart, radius)
    cone = np.where(apart > radius, 2 * np.pi * (1 - np.sqrt(1 - share**2)), 4 * np.pi)
    return scene.strength * np.where(sources.lamps, cone, np.pi * radius**2)[:, None]


def trace(
    scene: Scene,
    sources: Sources,
    mesh: Mesh,
    owner: np.ndarray,
    area: np.ndarray,
    n_photons: int,
    eta: float,
    seed: int,
    reenter: bool,
    cap: int,
    progress: Callable[[str, float], None] | None,
) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """Means and standard errors (n, 3) as of `clsss.paths.trace`, and where the power went, (3,) each [W].

    Parameters
    ----------
    scene : Scene
        Surface in pieces, and medium.
    sources : Sources
        The lights.
    mesh : Mesh
        Whose inside a lamp may be in.
    owner : (t,) int
        Which of n points each piece belongs to, or -1.
    area : (n,) float64
        Area of each point's pieces [mm^2]; points without any get NaN.
    n_photons, eta, seed, reenter, cap, progress
        As in `clsss.montecarlo.estimate`; photons over all points.
    """
    device, channels, n = scene.device, scene.n_channels, len(area)
    centre, radius = scene.centre, scene.radius
    power = _beams(scene, sources, centre, radius)
    chance = power.mean(axis=1) / power.mean(axis=1).sum()
    weight = power / np.maximum(chance, np.finfo(float).tiny)[:, None]
    unit = weight.max(axis=0)
    inside = sources.lamps & contains(
        mesh, np.where(sources.lamps[:, None], sources.place[:, :3], 2 * scene.high)
    )
    bins = np.full(scene.n_places, -1, np.int32)
    bins[scene.places] = owner
    arrays = [
        device.array(sources.place),
        device.array(inside.astype(np.int32)),
        device.array(weight / unit),
        device.array(np.cumsum(chance)),
        device.array(bins),
    ]
    shape = (
        channels,
        len(chance),
        scene.n_leaves,
        scene.leaf_size,
        cap,
        seed,
        int(reenter),
        n,
        scene.g,
        float(eta),
    )
    medium = scene.nodes, scene.origin, scene.inverse_spacing, scene.majorant, scene.grid
    sphere = device.vector([*centre, radius])
    kernel = device.kernel("photons", "photons", *scene.defines)
    scores, tallies = (
        device.empty((channels, n, 2, 2), np.uint32),
        device.empty((channels, len(TALLIES), 2), np.uint32),
    )
    batches = min(BATCHES, n_photons)
    bounds = [n_photons * k // batches for k in range(batches + 1)]
    sums, squares, spent = (
        np.zeros((3, channels, n)),
        np.zeros((3, channels, n)),
        np.zeros((channels, len(TALLIES))),
    )
    for batch, (begin, end) in enumerate(itertools.pairwise(bounds)):
        scores.fill(0)
        tallies.fill(0)
        for start, count in launches((end - begin) * channels, None, channels):
            first = begin + start // channels
            surface = scene.boxes, scene.triangles
            device.run(
                kernel, count, count, first, *shape, sphere, *medium, *surface, *arrays, scores, tallies
            )
            device.finish()
        single, multiple = np.moveaxis(_words(scores.get()) / (end - begin), 2, 0)
        for k, value in enumerate((single + multiple, single, multiple)):
            sums[k] += value
            squares[k] += value**2
        spent += _words(tallies.get())
        if progress:
            progress("paths", (batch + 1) / batches)
    with np.errstate(divide="ignore", invalid="ignore"):
        per_area = unit[:, None] / area
        mean = sums / batches
        error = np.sqrt(np.maximum(squares / batches - mean**2, 0) / max(batches - 1, 1))
        results = {}
        for k, name in enumerate(("radiosity", "single", "multiple")):
            results[name] = scene.rgb((mean[k] * per_area).T)
            results[f"{name}_stderr"] = scene.rgb((error[k] * per_area).T)
    energy = scene.rgb((spent * unit[:, None] / n_photons).T)
    return results, dict(zip(TALLIES, energy, strict=True))


def _words(sums: np.ndarray) -> np.ndarray:
    """Sums (..., 2) of 64-bit fixed point as numbers."""
    return (sums[..., 0] + sums[..., 1] * 2.0**32) * FIXED_POINT


def owned_areas(pieces: np.ndarray, owner: np.ndarray, n: int) -> np.ndarray:
    """Area of each point's pieces (n,) [mm^2]."""
    on = owner >= 0
    return np.bincount(owner[on], areas(pieces[on]), n)
