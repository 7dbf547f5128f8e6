"""The pipeline on one page: mesh, medium and lights in; fluence and radiosity out."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from clsss import __version__, cutcell, diffusion, exchange, octree, source, surface
from clsss.device import Buffer, Device
from clsss.errors import DeviceError, InputError
from clsss.lights import DirectionalLight, Emission, EnvironmentLight, PointLight
from clsss.materials import fresnel_A
from clsss.mesh import Mesh, contains
from clsss.multigrid import Convergence, Multigrid

Progress = Callable[[str, float], None]
STAGES = ("device", "cut cells", "octree", "exchange", "source", "solve", "surface")
BYTES_PER_CELL = 420  # host and device together, measured on bakes of 0.1 to 3 million cells


@dataclass(frozen=True, eq=False)
class Result:
    """Light inside an object and what leaves its surface.

    Attributes
    ----------
    mesh, medium, lights
        What was asked for.
    vertex_radiosity : (v, 3) float64
        Radiant exitance of the scattered light, all orders, at the mesh's vertices [W/mm^2].
    vertex_fluence : (v, 3) float64
        Fluence of the scattered light just inside the surface [W/mm^2].
    report : dict
        What was done: mesh, octree, convergence, energy, seconds, memory.
    """

    mesh: Mesh
    medium: Any
    lights: tuple[Any, ...]
    vertex_radiosity: np.ndarray
    vertex_fluence: np.ndarray
    report: dict[str, Any]
    _scene: _Scene = field(repr=False)
    _light: _Light = field(repr=False)

    def radiosity(self, points: Any) -> np.ndarray:
        """Radiosity (n, 3) [W/mm^2] at points (n, 3) on or near the surface [mm]."""
        scene = self._scene
        return surface.fluence_at(scene.device, scene.octree, self._light.exitance, _points(points)) * self._light.unit

    def fluence(self, points: Any) -> np.ndarray:
        """Fluence (n, 3) of the scattered light [W/mm^2] at points (n, 3) inside [mm]; NaN outside."""
        points = _points(points)
        out = np.full((len(points), 3), np.nan)
        inside = contains(self.mesh, points)
        out[inside] = self._scene.fluence(self._light.phi, points[inside]) * self._light.unit
        return out

    def relight(self, lights: Sequence[Any], progress: bool | Progress | None = None) -> Result:
        """The same object under other lights: only source and solve are redone, from the last solution."""
        start = time.perf_counter()
        seconds = {"load": 0.0, **dict.fromkeys(STAGES, 0.0)}
        return _light(self._scene, _checked(lights), seconds, start, _reporter(progress), self._light)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Save by suffix: .glb .ply .obj .npz .vtu; written to a temporary name, then moved."""
        from clsss.export import save

        save(self, path)


@dataclass(frozen=True, eq=False)
class _Light:
    """A solution in multiples of `unit` [W/mm^2]: fluence, and at the cut cells' boundary J.n and all that leaves."""

    phi: list[Buffer]
    flux: np.ndarray
    exitance: Buffer
    H: np.ndarray | None
    unit: float


@dataclass(frozen=True, eq=False)
class _Scene:
    """What does not change with the lights."""

    device: Device
    mesh: Mesh
    given_medium: Any
    octree: octree.Octree
    medium: diffusion.Coefficients
    multigrid: Multigrid
    exchange: exchange.Exchange | None
    tolerance: float

    def fluence(self, phi: list[Buffer], points: np.ndarray) -> np.ndarray:
        """Linear interpolation about the centroids of the leaves that hold the points."""
        self.multigrid.residual.complete(phi)
        out = np.full((len(points), 3), np.nan)
        depth, index = self.octree.find(points)
        slopes = self.multigrid.op.slope.get()[:, :, :3].astype(float)
        cut_index = self.octree.cut_index.get()
        centroids = diffusion.cell_points(self.octree)
        for k, level in enumerate(self.octree.levels):
            here = np.flatnonzero(depth == level.depth)
            if not len(here):
                continue
            i, values, nbr = index[here], phi[k].get()[:, :3].astype(float), level.nbr.get()
            low, high = nbr[i][:, ::2], nbr[i][:, 1::2]
            has_low, has_high = (low < level.n) & (low != i[:, None]), (high < level.n) & (high != i[:, None])
            own = values[i][:, None, :]
            rise = np.where(has_high[..., None], values[high] - own, 0) + np.where(
                has_low[..., None], own - values[low], 0
            )
            slope = rise / np.maximum(1, has_low.astype(int) + has_high)[..., None]
            if level.depth == 0:
                cut = cut_index[i]
                slope[cut >= 0] = slopes[cut[cut >= 0]]
            offset = (points[here] - centroids[k][i]) / level.h
            out[here] = values[i] + np.einsum("nd,ndc->nc", offset, slope)
        return out


def simulate(mesh: Mesh, medium: Any, lights: Sequence[Any], resolution: int = 128, adaptive: bool = True,
             tolerance: float = 1e-4, precision: str = "single", device: str | None = None,
             progress: bool | Progress | None = None) -> Result:  # fmt: skip
    """Compute how light diffuses inside an object and what leaves its surface.

    Parameters
    ----------
    mesh : Mesh
        From `clsss.load_mesh`.
    medium : Material, Mix or Grid
        What it is made of.
    lights : sequence of DirectionalLight, PointLight, EnvironmentLight, Emission
        They add up.
    resolution : int
        Finest cells along the longest side of the bounding box.
    adaptive : bool
        Merge cells inside, where light varies slowly.
    tolerance : float
        Residual to reach relative to the source, 2-norm, in every channel.
    precision : {"single", "double"}
        Of the device's arithmetic.
    device : str, optional
        Substring of an OpenCL device's name; by default the best that works.
    progress : bool or callable, optional
        True prints stages; a callable gets ``(stage, fraction)``.

    Returns
    -------
    Result

    Raises
    ------
    InputError
        An argument is wrong.
    DeviceError
        The machine cannot do it: no device, not enough memory.
    """
    start = time.perf_counter()
    lights = _checked(lights)
    if isinstance(resolution, bool) or resolution != int(resolution) or resolution < 4:
        raise InputError(f"resolution: needs a whole number of at least 4 cells, got {resolution}")
    if not 0 < tolerance < 1:
        raise InputError(f"tolerance: needs a number between 0 and 1, got {tolerance}")
    _check_memory(mesh, int(resolution))
    tell = _reporter(progress)
    seconds = {"load": float(mesh.report.get("seconds", 0.0)), **dict.fromkeys(STAGES, 0.0)}
    with _timed("device", seconds, tell):
        dev = Device(device, precision)
    grid = cutcell.make_grid(mesh.bounds, int(resolution))
    with _timed("cut cells", seconds, tell):
        samples = cutcell.sample_surface(dev, grid, mesh)
        dev.finish()
    with _timed("octree", seconds, tell):
        tree = octree.build(dev, grid, samples, adaptive)
        del samples
        if tree.n_leaves == 0:
            raise InputError(
                f"{mesh.name}: no cell of the grid lies inside at resolution {resolution}; raise the resolution"
            )
        coefficients = diffusion.sample_medium(dev, tree, medium, fresnel_A(medium.eta))
        multigrid = Multigrid(dev, diffusion.make_operator(dev, tree, coefficients))
        dev.finish()
    with _timed("exchange", seconds, tell):
        coupling = exchange.trace_exchange(mesh, tree, medium.eta, lambda f: tell("exchange", f))
    scene = _Scene(dev, mesh, medium, tree, coefficients, multigrid, coupling, tolerance)
    return _light(scene, lights, seconds, start, tell, None)


class _Boundary:
    """The right-hand side at the boundary, which follows the light that parts of the surface exchange."""

    def __init__(self, scene: _Scene, src: source.Source, H: np.ndarray | None):
        self.scene, self.src = scene, src
        self.plain = scene.device.empty(src.b[-1].shape)
        self.plain.copy_from(src.b[-1])
        n_patches = 0 if scene.exchange is None else scene.exchange.share.shape[0]
        self.H = np.zeros((n_patches, 3)) if H is None else H
        self.entering = np.zeros((n_patches, 3))
        self.moment = scene.device.empty(src.moment.shape)
        self.r_B = src.moment.get()

    def update(self, phi: list[Buffer]) -> None:
        """Let what leaves each patch arrive at the others, and set the right-hand side."""
        coupling = self.scene.exchange
        if coupling is not None:
            leaving = coupling.share @ self.flux(phi) + self.H
            self.H, self.entering = coupling.arriving @ leaving, coupling.entering @ leaving
        self.apply()

    def apply(self) -> None:
        """Set the right-hand side for the present exchange."""
        scene, coupling = self.scene, self.scene.exchange
        moment = self.r_B.copy()
        if coupling is not None:
            moment[:, :3] -= coupling.gain * self.entering[coupling.patch]
        self.moment.set(moment)
        self.src.b[-1].copy_from(self.plain)
        source.subtract_moment(scene.device, scene.octree, scene.medium, self.moment, self.src.b[-1])

    def flux(self, phi: list[Buffer]) -> np.ndarray:
        """J.n (n_cut, 3) at the boundary of the cut cells."""
        values = self.scene.multigrid.residual.boundary_value(phi, self.moment).get()
        return values[:, :3].astype(float) / (2 * self.scene.medium.fresnel_A)


def _light(scene: _Scene, lights: tuple[Any, ...], seconds: dict[str, float], start: float, tell: Progress,
           last: _Light | None) -> Result:  # fmt: skip
    """Source, solve and surface values, from the last solution where there is one."""
    device, tree, medium = scene.device, scene.octree, scene.medium
    unit = source.light_unit(list(lights), scene.mesh.size)
    with _timed("source", seconds, tell):
        src = source.make_source(device, tree, medium, list(lights), unit, lambda f: tell("source", f))
    with _timed("solve", seconds, tell):
        phi = [device.zeros((level.n + level.n_ghost, diffusion.CHANNELS)) for level in tree.levels]
        boundary = _Boundary(scene, src, None)
        boundary.apply()
        if last is not None:
            for new, old in zip(phi, last.phi, strict=True):
                new.set(old.get() * (last.unit / unit))
            boundary.H = boundary.H if last.H is None else last.H * (last.unit / unit)
        convergence = scene.multigrid.solve(src.b, phi, scene.tolerance, progress=lambda f: tell("solve", f),
                                            update=boundary.update if scene.exchange else None)  # fmt: skip
    with _timed("surface", seconds, tell):
        flux = boundary.flux(phi)
        exitance, fluence = flux, 2 * medium.fresnel_A * flux
        if scene.exchange is not None:
            entering = boundary.entering[scene.exchange.patch]
            exitance, fluence = flux + entering, fluence + scene.exchange.gain * entering
        fields = [device.array(diffusion.channels(values)) for values in (exitance, fluence)]
        mesh = scene.mesh
        at_vertices = [surface.fluence_at(device, tree, f, mesh.vertices, mesh.normals) * unit for f in fields]
    seconds["total"] = seconds["load"] + time.perf_counter() - start
    solution = _Light(phi, flux, fields[0], boundary.H, unit)
    radiosity, vertex_fluence = at_vertices
    report = _report(scene, src, convergence, solution, seconds)
    return Result(mesh, scene.given_medium, lights, radiosity, vertex_fluence, report, scene, solution)


def _report(scene: _Scene, src: source.Source, convergence: Convergence, solution: _Light,
            seconds: dict[str, float]) -> dict[str, Any]:  # fmt: skip
    import resource

    tree, medium = scene.octree, scene.medium
    absorbed = np.zeros(3)
    for level, x, volume, sigma_a in zip(tree.levels, solution.phi, tree.volumes(), medium.sigma_a, strict=True):
        rate = np.array(sigma_a.tolist()) if medium.homogeneous else sigma_a.get().astype(float)
        absorbed += (x.get()[: level.n] * rate * (volume * level.leaf)[:, None]).sum(axis=0)[:3]
    area = tree.cut.boundary.get()[:, 3].astype(float) * tree.grid.h**2
    exited = area @ solution.flux
    return {
        "clsss": __version__,
        "device": scene.device.name,
        "precision": scene.device.precision,
        "mesh": {key: scene.mesh.report[key] for key in ("faces", "vertices", "closed", "repairs", "size_mm")},
        "octree": {
            "levels": len(tree.levels),
            "cells": tree.n_cells,
            "leaves": tree.n_leaves,
            "cut_cells": tree.cut.n,
            "cells_per_level": [level.n for level in tree.levels],
            "h_mm": tree.grid.h,
        },
        "solve": {
            "cycles": convergence.cycles,
            "residuals": [r.tolist() for r in convergence.residuals],
            "converged": convergence.converged,
            "factor": convergence.factor,
        },
        "exchange": {
            "patches": 0 if scene.exchange is None else scene.exchange.share.shape[0],
            "rays": 0 if scene.exchange is None else scene.exchange.rays,
        },
        "energy": {
            "incident_W": src.incident.tolist(),
            "deposited_W": src.deposited.tolist(),
            "absorbed_W": (absorbed * solution.unit).tolist(),
            "exited_W": (exited * solution.unit).tolist(),
        },
        "seconds": {key.replace(" ", ""): round(value, 4) for key, value in seconds.items()},
        "memory_mb": {
            "device": scene.device.peak / 2**20,
            "peak_rss": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**10,
        },
    }


def _checked(lights: Sequence[Any]) -> tuple[Any, ...]:
    kinds = (DirectionalLight, PointLight, EnvironmentLight, Emission)
    lights = tuple(lights) if isinstance(lights, (list, tuple)) else (lights,)
    if not lights:
        raise InputError("lights: give at least one light")
    for light in lights:
        if not isinstance(light, kinds):
            names = ", ".join(kind.__name__ for kind in kinds)
            raise InputError(f"lights: {light!r} is no light; use {names}")
    return lights


def _check_memory(mesh: Mesh, resolution: int) -> None:
    """Refuse what cannot fit before anything is allocated."""
    triangles = mesh.triangles - mesh.bounds.mean(axis=0)
    a, b, c = np.moveaxis(triangles, 1, 0)
    normal = np.cross(b - a, c - a)
    volume, area = abs((a * normal).sum() / 6), np.linalg.norm(normal, axis=1).sum() / 2
    box = np.prod(np.ptp(mesh.bounds, axis=0) / mesh.size + 8 / resolution)
    h = mesh.size / resolution
    cells = min(volume / h**3, 12 * area / h**2) + 2 * area / h**2
    needed = BYTES_PER_CELL * cells + 6 * box * resolution**3
    free = os.sysconf("SC_AVPHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    with open("/proc/meminfo") as lines:
        available = [int(line.split()[1]) * 1024 for line in lines if line.startswith("MemAvailable")]
    free = max([free, *available])
    if needed > free:
        largest = int(resolution * np.sqrt(free / needed) * 0.95)
        raise DeviceError(
            f"resolution {resolution} needs about {needed / 2**30:.1f} GB of memory and {free / 2**30:.1f} GB are "
            f"free; use {largest} or less"
        )


def _points(points: Any) -> np.ndarray:
    array = np.asarray(points, float)
    if array.ndim != 2 or array.shape[1] != 3 or not np.isfinite(array).all():
        raise InputError(f"points: needs finite numbers of shape (n, 3), got shape {array.shape}")
    return array


def _reporter(progress: bool | Progress | None) -> Progress:
    if callable(progress):
        return progress
    if progress:
        return lambda stage, fraction: print(f"{stage}: {100 * fraction:.0f} %", flush=True)
    return lambda stage, fraction: None


@contextmanager
def _timed(stage: str, seconds: dict[str, float], tell: Progress) -> Iterator[None]:
    tell(stage, 0.0)
    start = time.perf_counter()
    yield
    seconds[stage] += time.perf_counter() - start
    tell(stage, 1.0)
