"""Random walks backwards from points on the surface to the lights (kernels/paths.cl); for equal indices."""

from __future__ import annotations

import numpy as np

from clsss.device import Buffer
from clsss.mesh import Mesh, RayCaster
from clsss.transport import QUANTITIES, Sources, TracedScene, Walk, launches

NEAR = 1e-3  # of the mesh's size: how far off the surface a point may lie
INSET = 0.02  # of a triangle: how far points keep off its edges


def anchors(mesh: Mesh, points: np.ndarray, normals: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
    """Nearest place on the surface, a little off the triangles' edges.

    Parameters
    ----------
    mesh : Mesh
        The solid.
    points : (n, 3) float64
        Points on its surface [mm].
    normals : (n, 3) float64, optional
        To tell the two sides of thin parts apart.

    Returns
    -------
    place : (n, 3) float64
        Places on the surface [mm].
    triangle : (n,) int64
        Of `mesh.triangles`; -1 where none is near.
    """
    caster, near = RayCaster(mesh.triangles), NEAR * mesh.size
    outward = np.cross(*np.diff(caster.triangles, axis=1).transpose(1, 0, 2))
    best, triangle, place = np.full(len(points), np.inf), np.full(len(points), -1), points.copy()
    # rays aim a little inside, or they would pass by the points that lie on convex edges
    aim = points if normals is None else points - 0.05 * near * normals
    diagonals = np.stack(np.meshgrid(*[(-1.0, 1.0)] * 3), axis=-1).reshape(-1, 3) / np.sqrt(3)
    for axis in np.concatenate([np.eye(3), -np.eye(3), diagonals]):
        t, index = caster.hit(aim - near * axis, axis)
        off = np.abs(t - near)
        hit = (index >= 0) & (off < near)
        if normals is not None:
            off = off + near * (np.einsum("ij,ij->i", outward[index], normals) < 0)
        better = hit & (off < best)
        best[better], triangle[better] = off[better], index[better]
        place[better] = aim[better] + (t[better, None] - near) * axis
    met = caster.triangles[triangle]
    a, b, c = np.moveaxis(met, 1, 0)
    normal = outward[triangle]
    squared = np.maximum(np.einsum("ij,ij->i", normal, normal), np.finfo(float).tiny)
    v = np.einsum("ij,ij->i", np.cross(place - a, c - a), normal) / squared
    w = np.einsum("ij,ij->i", np.cross(b - a, place - a), normal) / squared
    weight = np.clip(np.stack([1 - v - w, v, w], axis=1), INSET, 1)
    weight /= weight.sum(axis=1, keepdims=True)
    return np.einsum("ij,ijk->ik", weight, met), triangle


def trace(
    scene: TracedScene, sources: Sources, place: np.ndarray, triangle: np.ndarray, n_paths: int, walk: Walk
) -> tuple[dict[str, np.ndarray], tuple[float, float]]:
    """Means and standard errors (n, 3) of `QUANTITIES`, and the shares of paths lost and capped.

    Parameters
    ----------
    scene : TracedScene
        Surface and medium; its index of refraction is not looked at.
    sources : Sources
        The lights.
    place, triangle : (n, 3) float64, (n,) int
        Where paths start, as from `anchors`.
    n_paths : int
        Per point and channel.
    walk : Walk
        How.
    """
    device, n, channels = scene.device, len(place), scene.n_channels
    lights = _choice(scene, sources) if len(sources.place) else (scene.lights, scene.lights, scene.lights)
    starts = device.array(place - scene.centre), device.array(scene.places[triangle])
    counters = device.zeros(2, np.uint32)
    shape = n, channels, len(sources.place), walk.cap, walk.seed, int(walk.reenter)
    half = scene.half + 0.02 * scene.half.max()
    box = device.vector(-half), device.vector(half)
    given = (*shape, *box, *scene.surface, *scene.medium, device.array(scene.emission), *lights, *starts)
    kernel, block = device.kernel("paths", "paths", *scene.defines), n * channels
    sums = np.zeros((len(QUANTITIES), 2, block))
    for start, count in launches(n_paths * block, walk.progress):
        out = device.empty((count, 2))
        device.run(kernel, count, count, start // block, start % block, *given, out, counters)
        total, single = out.get().astype(float).T
        where = (start + np.arange(count)) % block
        for into, values in zip(sums, (total, single, total - single), strict=True):
            np.add.at(into[0], where, values)  # one by one: however launches fall, the sums round alike
            np.add.at(into[1], where, values**2)
    mean, square = sums[:, 0] / n_paths, sums[:, 1] / n_paths
    error = np.sqrt(np.maximum(square - mean**2, 0) / max(n_paths - 1, 1))
    results = {}
    for name, m, e in zip(QUANTITIES, mean, error, strict=True):
        results[name], results[f"{name}_stderr"] = (scene.rgb(v.reshape(channels, n).T) for v in (m, e))
    lost, capped = counters.get() / (n_paths * block)
    return results, (float(lost), float(capped))


def _choice(scene: TracedScene, sources: Sources) -> tuple[Buffer, ...]:
    """Lights, their strengths over the chance to be chosen, and these chances summed up: about as they light."""
    far = np.linalg.norm(sources.place[:, :3] - scene.centre, axis=1)
    falloff = np.where(sources.lamps, np.maximum(far, scene.radius), 1)[:, None] ** 2
    chance = (scene.strength / falloff).mean(axis=1)
    chance /= chance.sum()
    weight = scene.strength / np.maximum(chance, np.finfo(float).tiny)[:, None]
    return scene.lights, scene.device.array(weight), scene.device.array(np.cumsum(chance))
