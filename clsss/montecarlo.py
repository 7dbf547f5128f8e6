"""Monte Carlo path tracing of the radiative transfer equation: what the diffusion equation approximates.

    M(x) = int over outward directions of L_out cos dw, L_out of light scattered at least once

Input: mesh, medium, lights. Output: radiosity M at points [W/mm^2] and its standard error. With equal
indices inside and outside, paths start at the points and look for the lights. Otherwise light bends where it
enters, and no path backwards finds a parallel beam: photons start at the lights and are counted where they
leave, on the surface around the points.
"""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from clsss import paths, photons
from clsss.device import Device
from clsss.errors import InputError
from clsss.halfedges import half_edges
from clsss.launch import launched
from clsss.materials import Medium
from clsss.mesh import Mesh, contains, opaque_triangles
from clsss.problem import check_object, checked_points
from clsss.subdivision import outward_normals
from clsss.transport import Sources, Walk, gather, make_scene

CAP = 200_000  # collisions after which a path is given up; reported, never silent
PATCH = 0.01  # of the mesh's size: radius of the surface around a point that photons are counted on
SILENT = 0.1  # share of the points that may count no photon before it is said
LEAK = 1e-4  # share of the paths that may slip through the surface before it is said


class PathWarning(UserWarning):
    """Light is missing from a result, because paths were lost or given up."""


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
        Power [W] incident on the object or emitted in it, reflected at its surface, absorbed, and leaving it
        scattered, unscattered, lost or capped; empty unless photons were traced from the lights.
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
    blockers: Sequence[Mesh] = (),
) -> Estimate:
    """Radiosity at points on the surface by random walks.

    Parameters
    ----------
    mesh : Mesh
        The solid; where its surface is open, paths slip out, which a `PathWarning` tells.
    medium : Medium
        What fills it; media that vary in space are sampled on a grid.
    lights : sequence
        Directional, point and environment lights, a sky counting as `clsss.transport.SKY_BEAMS` beams; and
        emission, which counts like light scattered there for the first time.
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
        Photons from the lights instead of paths from the points; by default where ``medium.eta`` is not 1, for
        lamps inside the solid, which paths rarely come near, and for emission that is a function.
    radius : float, optional
        Photons count up to this far from a point, unless another is nearer [mm]; 1 % of the mesh's size.
    device : Device, optional
        In single precision; by default the best there is.
    progress : callable, optional
        Called with "paths" and the fraction done.
    blockers : sequence of Mesh
        Opaque black surfaces, closed or open: what meets them is absorbed.

    Raises
    ------
    InputError
        No mesh, no medium, no light, no point or one off the surface, `n_paths` below 1, or paths backwards where
        light bends or emission is a function.

    References
    ----------
    Pharr, Jakob and Humphreys 2023, "Physically Based Rendering", ch. 14; Woodcock et al. 1965 (media that
    vary); Prahl et al. 1989, "A Monte Carlo model of light propagation in tissue" (photons).
    """
    started = time.perf_counter()
    check_object(mesh, medium)
    check_counts(n_paths=n_paths, seed=seed)
    sources, opaque, device = gather(lights), opaque_triangles(blockers), device or Device(precision="single")
    forward = _goes_forward(mesh, medium, sources, forward)
    at, place, triangle = _anchored(mesh, points, normals)
    on = np.flatnonzero(triangle >= 0)
    walk, n = Walk(seed, reenter, CAP, progress), len(on)
    energy: dict[str, np.ndarray] = {}
    scene = make_scene(mesh.triangles, medium, sources, device, opaque)
    if forward:
        radius = radius or PATCH * mesh.size
        there = outward_normals(mesh.points[mesh.solid[triangle[on]]])
        patches = photons.patches(mesh.triangles, at[on], there, radius)
        lit = launched(scene, sources, mesh)
        results, energy = photons.trace(scene, lit, patches, n_paths * n, medium.eta, walk)
        incident = max(energy["incident"].sum(), np.finfo(float).tiny)
        lost, capped = (float(energy[k].sum() / incident) for k in ("lost", "capped"))
    else:
        radius = 0.0
        results, (lost, capped) = paths.trace(scene, sources, place[on], triangle[on], n_paths, walk)
    for name, values in results.items():
        results[name] = np.full((len(at), 3), np.nan)
        results[name][on] = values
    results["stderr"] = results.pop("radiosity_stderr")
    _tell(mesh, lost, capped, n_paths * n)
    if forward:
        _tell_of_silence(results["radiosity"][on], energy["scattered"], n_paths)
    seconds = time.perf_counter() - started
    return Estimate(**results, lost=lost, capped=capped, energy=energy, radius=radius, seconds=seconds)


def _goes_forward(mesh: Mesh, medium: Medium, sources: Sources, forward: bool | None) -> bool:
    """Whether photons start at the lights; see `estimate`."""
    if forward is None:
        lamps = sources.place[sources.lamps, :3]
        return medium.eta != 1 or sources.varies or bool(contains(mesh, lamps).any())
    if not forward and medium.eta != 1:
        raise InputError(f"forward: paths from the points need eta = 1, not {medium.eta:g}; leave it out")
    if not forward and sources.varies:
        raise InputError("forward: paths from the points need even emission, not a function; leave it out")
    return forward


def check_counts(seed: Any, **counts: Any) -> None:
    """Refuse numbers of points or paths below 1, named as callers know them, and seeds that generators do not take.

    Raises
    ------
    InputError
    """
    for name, value, least in (("seed", seed, 0), *((name, value, 1) for name, value in counts.items())):
        whole = isinstance(value, (int, np.integer)) and not isinstance(value, bool)
        if not whole or not least <= value < 2**31:
            raise InputError(f"{name}: needs a whole number from {least} to {2**31 - 1}, got {value!r}")


def _tell_of_silence(radiosity: np.ndarray, scattered: np.ndarray, n_paths: int) -> None:
    """Warn where no photon was counted at many of the points (n, 3), though some left elsewhere."""
    silent = int(np.all(radiosity == 0, axis=1).sum())
    if silent > SILENT * len(radiosity) and scattered.sum() > 0:
        text = f"no photon was counted at {silent} of {len(radiosity)} points, whose 0 is no estimate"
        advice = f"trace more than {n_paths} for each, they go everywhere, or give more points or a larger radius"
        warnings.warn(f"{text}: {advice}", PathWarning, stacklevel=3)


def _tell(mesh: Mesh, lost: float, capped: float, n_paths: int) -> None:
    """Warn of paths whose light is missing."""
    most = LEAK * n_paths
    if lost * n_paths > most + 3 * np.sqrt(most + 1):  # few paths may lose one or two by chance
        corners = np.unique(mesh.triangles.reshape(-1, 3), axis=0, return_inverse=True)
        edges = half_edges(corners[1].reshape(-1, 3))
        gaps = corners[0][edges.ends(np.flatnonzero(edges.net))].mean(axis=1)
        text = "it is closed, but has triangles too small for single precision"
        for x, y, z in gaps[:1]:
            text = f"{len(gaps)} of its edges are open, near ({x:.3g}, {y:.3g}, {z:.3g}) mm for one"
        text = f"{lost:.2%} of the paths slipped through the surface of {mesh.name} unseen: {text}; repair the mesh"
        warnings.warn(text, PathWarning, stacklevel=3)
    if capped > 0:
        text = f"{capped:.2g} of the paths were given up after {CAP} collisions and their light is missing"
        warnings.warn(f"{text}; the medium absorbs too little for its size", PathWarning, stacklevel=3)


def _anchored(mesh: Mesh, points: Any, normals: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points (n, 3), of the mesh where none are given, the places on its surface and the triangles they are on."""
    if points is None:
        return mesh.vertices, *paths.anchors(mesh, mesh.vertices, mesh.normals)
    at, facing = checked_points(points), None if normals is None else checked_points(normals, "normals")
    if not len(at):
        raise InputError("points: there are none; leave them out for the mesh's vertices")
    if facing is not None and facing.shape != at.shape:
        raise InputError(f"normals: has shape {facing.shape} but points has {at.shape}")
    place, triangle = paths.anchors(mesh, at, facing)
    if len(off := np.flatnonzero(triangle < 0)):
        where = f"number {off[0]} at ({', '.join(f'{x:.4g}' for x in at[off[0]])}) for one"
        far = f"{len(off)} of {len(at)} lie more than {paths.NEAR * mesh.size:g} mm off the surface"
        raise InputError(f"points: {far}, {where}; move them onto it")
    return at, place, triangle
