"""Monte Carlo path tracing of the radiative transfer equation: what the diffusion equation approximates.

    M(x) = int over outward directions of L_out cos dw, L_out of light scattered at least once

Input: mesh, medium, lights. Output: radiosity M at points [W/mm^2] and its standard error. With equal
indices inside and outside, paths start at the points and look for the lights. Otherwise light bends where it
enters, and no path backwards finds a parallel beam: photons start at the lights and are counted where they
leave, on the surface around the points.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from clsss import paths, photons
from clsss.device import Device
from clsss.errors import InputError
from clsss.materials import Medium
from clsss.mesh import Mesh, contains
from clsss.refine import outward_normals
from clsss.transport import Walk, gather, make_scene

CAP = 200_000  # collisions after which a path is given up; reported, never silent
PATCH = 0.01  # of the mesh's size: radius of the surface around a point that photons are counted on


@dataclass(frozen=True, eq=False)
class Estimate:
    """Radiosity at points with its standard error, and what became of the paths.

    Attributes
    ----------
    radiosity, stderr : (n, 3) float64
        Of all light scattered at least once [W/mm^2]; NaN where no surface belongs to a point.
    single, single_stderr : (n, 3) float64
        The part of it that was scattered exactly once.
    multiple, multiple_stderr : (n, 3) float64
        The part of it that was scattered more often.
    lost, capped : float
        Share of the paths that slipped through the surface unseen, and share given up after `CAP` collisions.
    energy : dict of (3,) float64
        Power [W] incident on the object, reflected at its surface, absorbed, and leaving it scattered,
        unscattered, lost or capped; empty unless photons were traced from the lights.
    radius : float
        Up to this far around its point a value is averaged over the surface [mm]; 0 where paths start there.
    seconds : float
        Time taken.
    """

    radiosity: np.ndarray
    stderr: np.ndarray
    single: np.ndarray
    single_stderr: np.ndarray
    multiple: np.ndarray
    multiple_stderr: np.ndarray
    lost: float
    capped: float
    energy: dict[str, np.ndarray]
    radius: float
    seconds: float


def estimate(
    mesh: Mesh,
    medium: Medium,
    lights: Sequence[Any],
    n_paths: int = 1000,
    points: Any = None,
    normals: Any = None,
    seed: int = 0,
    reenter: bool = True,
    forward: bool | None = None,
    radius: float | None = None,
    device: Device | None = None,
    progress: Callable[[str, float], None] | None = None,
) -> Estimate:
    """Radiosity at points on the surface by random walks.

    Parameters
    ----------
    mesh : Mesh
        The solid; where its surface is open, paths that slip out are counted in `Estimate.lost`.
    medium : Medium
        What fills it; media that vary in space are sampled on a grid.
    lights : sequence
        Directional, point and environment lights.
    n_paths : int
        Paths, or photons, per point and channel.
    points, normals : (n, 3) array_like, optional
        Points on the surface [mm], by default the mesh's vertices, and outward normals, which only choose
        between the sides of thin parts.
    seed : int
        Of the random numbers; the same seed gives the same paths.
    reenter : bool
        Whether light that left may enter again elsewhere. False makes cavities and facing parts black, as a
        diffusion solver has it that does not couple them.
    forward : bool, optional
        Photons from the lights instead of paths from the points; by default where ``medium.eta`` is not 1, and
        for lamps inside the solid, which paths rarely come near.
    radius : float, optional
        Photons count up to this far from a point, unless another is nearer [mm]; 1 % of the mesh's size.
    device : Device, optional
        In single precision; by default the best there is.
    progress : callable, optional
        Called with "paths" and the fraction done.

    Raises
    ------
    InputError
        No light, a point off the surface, `n_paths` below 1, or paths backwards where light bends.

    References
    ----------
    Pharr, Jakob and Humphreys 2023, "Physically Based Rendering", ch. 14; Woodcock et al. 1965 (media that
    vary); Prahl et al. 1989, "A Monte Carlo model of light propagation in tissue" (photons).
    """
    started = time.perf_counter()
    if n_paths < 1:
        raise InputError(f"n_paths: needs at least 1 path per point, got {n_paths}")
    sources, device = gather(lights), device or Device(precision="single")
    if forward is None:
        forward = medium.eta != 1 or bool(contains(mesh, sources.place[sources.lamps, :3]).any())
    if not forward and medium.eta != 1:
        raise InputError(f"forward: paths from the points need eta = 1, not {medium.eta:g}")
    at, facing = _checked(mesh, points, normals)
    place, triangle = paths.anchors(mesh, at, facing)
    on = np.flatnonzero(triangle >= 0)
    if points is not None and len(on) < len(at):
        off, near = len(at) - len(on), paths.NEAR * mesh.size
        raise InputError(f"points: {off} of {len(at)} lie more than {near:g} mm off the surface")
    walk, n = Walk(seed, reenter, CAP, progress), len(on)
    energy: dict[str, np.ndarray] = {}
    if forward:
        radius = radius or PATCH * mesh.size
        there = outward_normals(mesh.triangles[triangle[on]])
        pieces, owner = photons.patches(mesh.triangles, at[on], there, radius)
        scene, area = make_scene(pieces, medium, sources, device), photons.owned_areas(pieces, owner, n)
        launched = photons.launched(scene, sources, mesh)
        results, energy = photons.trace(scene, launched, owner, area, n_paths * n, medium.eta, walk)
        incident = max(energy["incident"].sum(), np.finfo(float).tiny)
        lost, capped = (float(energy[k].sum() / incident) for k in ("lost", "capped"))
    else:
        radius = 0.0
        scene = make_scene(mesh.triangles, medium, sources, device)
        results, (lost, capped) = paths.trace(scene, sources, place[on], triangle[on], n_paths, walk)
    for name, values in results.items():
        results[name] = np.full((len(at), 3), np.nan)
        results[name][on] = values
    results["stderr"] = results.pop("radiosity_stderr")
    seconds = time.perf_counter() - started
    return Estimate(**results, lost=lost, capped=capped, energy=energy, radius=radius, seconds=seconds)


def _checked(mesh: Mesh, points: Any, normals: Any) -> tuple[np.ndarray, np.ndarray | None]:
    """Points and normals as arrays; the mesh's own where none are given."""
    if points is None:
        return mesh.vertices, mesh.normals
    arrays: list[np.ndarray | None] = []
    for name, values in (("points", points), ("normals", normals)):
        array = None if values is None else np.asarray(values, float)
        if array is not None and (array.ndim != 2 or array.shape[1] != 3 or not np.all(np.isfinite(array))):
            raise InputError(f"{name}: needs finite numbers of shape (n, 3), got shape {array.shape}")
        arrays.append(array)
    at, facing = arrays
    assert at is not None
    if facing is not None and facing.shape != at.shape:
        raise InputError(f"normals: has shape {facing.shape} but points has {at.shape}")
    return at, facing
