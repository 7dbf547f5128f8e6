"""The pipeline on one page: mesh, medium and lights in; fluence and radiosity out."""

from __future__ import annotations

import os
import threading
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property, wraps
from time import perf_counter
from typing import Any, ParamSpec, TypeVar

import numpy as np

from clsss import cutcell, diffusion, octree, validity
from clsss.arguments import check, check_memory, reporter
from clsss.device import open_device
from clsss.errors import InputError
from clsss.exchange import leaving_shape, trace_exchange
from clsss.fresnel import fresnel_A
from clsss.heap import give_back
from clsss.inner import Inner, in_wide_cells, within
from clsss.interreflection import PatchMatrices, coupled
from clsss.layer import fitted_layer
from clsss.lighting import Progress, Setup, Solution, interpolate, light, tidy, timed
from clsss.mesh import Mesh, RayCaster, contains, opaque_triangles
from clsss.problem import checked_lights, checked_points
from clsss.refinement import varies
from clsss.report import account
from clsss.single import DEPTHS, SingleScattering
from clsss.stowed import Stowed
from clsss.surface import shares_at
from clsss.validity import ConvergenceWarning

P = ParamSpec("P")
T = TypeVar("T")
STAGES = ("device", "cut cells", "octree", "exchange", "source", "single", "solve", "surface")
_TURN = threading.RLock()


def _in_turn(work: Callable[P, T]) -> Callable[P, T]:
    """Let threads take turns: bakes share a device, which serves one at a time."""

    @wraps(work)
    def alone(*args: P.args, **options: P.kwargs) -> T:
        with _TURN:
            return work(*args, **options)

    return alone


@dataclass(frozen=True, eq=False)
class Result:
    """Light inside an object and what leaves its surface.

    Attributes
    ----------
    mesh, medium, lights
        What was asked for.
    report : dict
        What was done: mesh, octree, convergence, energy, seconds, memory.
    """

    mesh: Mesh
    medium: Any
    lights: tuple[Any, ...]
    report: dict[str, Any]
    _setup: Setup = field(repr=False)
    _solution: Solution = field(repr=False)
    _at_vertices: np.ndarray = field(repr=False)  # as computed, in the solution's unit: half of what users get

    @cached_property
    def vertex_radiosity(self) -> np.ndarray:
        """Radiant exitance (v, 3) of the scattered light, all orders, at the mesh's vertices [W/mm^2], float64."""
        return np.multiply(self._at_vertices[:, :3], self._solution.unit, dtype=float)

    @cached_property
    def vertex_fluence(self) -> np.ndarray:
        """Fluence (v, 3) of the scattered light just inside the surface [W/mm^2], float64."""
        return np.multiply(self._at_vertices[:, 3:6], self._solution.unit, dtype=float)

    @cached_property
    def vertex_radiosity_single(self) -> np.ndarray | None:
        """With ``scattering="split"``, the part of `vertex_radiosity` that was scattered exactly once, else None."""
        once = np.multiply(self._at_vertices[:, 6:], self._solution.unit, dtype=float)
        return np.minimum(once, self.vertex_radiosity) if once.size else None

    @property
    def blockers(self) -> tuple[Mesh, ...]:
        """The opaque bodies that were given."""
        return self._setup.blockers

    @_in_turn
    def radiosity(self, points: Any) -> np.ndarray:
        """Radiosity (n, 3) [W/mm^2] at points (n, 3) on or near the surface [mm]."""
        return self._at(checked_points(points), self._solution.exitance)

    @_in_turn
    def radiosity_single(self, points: Any) -> np.ndarray:
        """The part of `radiosity` (n, 3) [W/mm^2] that was scattered exactly once.

        Raises
        ------
        InputError
            The bake was not made with ``scattering="split"``.
        """
        once = self._solution.once
        if once is None:
            raise InputError('scattering: bake with scattering="split" to tell single scattering apart')
        return np.minimum(self._at(checked_points(points), once), self.radiosity(points))

    def _at(self, points: np.ndarray, field: Stowed) -> np.ndarray:
        """A field of the cut cells at points on or near the surface."""
        shares = shares_at(self._setup.device, self._setup.octree, points)
        return np.multiply(shares.carry(field.get()), self._solution.unit, dtype=float)

    @cached_property
    def _once(self) -> SingleScattering:
        setup, lights = self._setup, list(self.lights)
        return SingleScattering(setup.device, setup.octree, setup.medium, lights, self._solution.unit, setup.shadows)

    @_in_turn
    def radiance(self, eye: Any, depths: int = DEPTHS, least_cosine: float = 0.0) -> np.ndarray:
        """Radiance that leaves the vertices towards a camera.

        Multiple scattering as in the diffusion approximation, L = (1 - R) (phi_B + 3 J cos) / (4 pi eta^2); single
        scattering, where it is split off, along the refracted ray.

        Parameters
        ----------
        eye : (3,) float
            Where the camera is [mm].
        depths : int
            Points along each ray where light may have been scattered once.
        least_cosine : float
            Light is taken to leave at this cosine to the normal at least, where the camera would see the surface
            from the side or from behind; at 0 nothing leaves there, and triangles on the outline turn dark.

        Returns
        -------
        (v, 3) float64
            [W/mm^2/sr].
        """
        setup, solution, mesh = self._setup, self._solution, self.mesh
        away = checked_points([eye], "eye")[0] - mesh.vertices
        out = away / np.maximum(np.linalg.norm(away, axis=1, keepdims=True), 1e-300)
        mu = (out * mesh.normals).sum(axis=1)
        low = mu < least_cosine
        side = out[low] - mu[low, None] * mesh.normals[low]
        side *= np.sqrt(1 - least_cosine**2) / np.maximum(np.linalg.norm(side, axis=1, keepdims=True), 1e-300)
        out[low] = side + least_cosine * mesh.normals[low]
        mu = np.clip(mu, least_cosine, 1)
        single = 0.0 if self.vertex_radiosity_single is None else self.vertex_radiosity_single
        diffuse = (self.vertex_radiosity - single) / np.pi * leaving_shape(mu, setup.medium.eta)[:, None]
        if not setup.split:
            return diffuse
        return diffuse + self._once.radiance(mesh.vertices, mesh.normals, out, depths) * solution.unit

    @_in_turn
    def fluence(self, points: Any) -> np.ndarray:
        """Fluence (n, 3) of the scattered light [W/mm^2] at points (n, 3) inside [mm]; NaN outside."""
        points = checked_points(points)
        out, inside = np.full((len(points), 3), np.nan), contains(self.mesh, points)
        out[inside] = interpolate(self._setup, self._solution, points[inside])
        return out

    @_in_turn
    def relight(self, lights: Sequence[Any], progress: bool | Progress | None = None) -> Result:
        """The same object under other lights: only source and solve are redone, from the last solution.

        Lights inside the object need fine cells around them; where the octree has none it warns, and `simulate` does.
        """
        start, found = perf_counter(), checked_lights(lights)
        if in_wide_cells(self._setup.octree, found):
            text = "lights inside the object where its cells are wide, as they were made for others: simulate it again"
            warnings.warn(text, UserWarning, stacklevel=2)
        seconds = {"load": 0.0, **dict.fromkeys(STAGES, 0.0)}
        return _bake(self._setup, self.medium, found, self._solution, seconds, start, reporter(progress))

    def save(self, path: str | os.PathLike[str]) -> None:
        """Save by suffix: .glb .ply .obj .npz .vtu; written to a temporary name, then moved."""
        from clsss.export import save

        save(self, path)


@_in_turn
def simulate(mesh: Mesh, medium: Any, lights: Sequence[Any], resolution: int = 128, adaptive: bool = True,
             tolerance: float = 1e-4, precision: str = "single", device: str | None = None,
             phase: str = "similarity", scattering: str = "all", blockers: Sequence[Mesh] = (),
             progress: bool | Progress | None = None) -> Result:  # fmt: skip
    """Compute how light diffuses inside an object and what leaves its surface.

    Threads may call this and what a `Result` offers; they take turns.

    Parameters
    ----------
    mesh : Mesh
        From `clsss.load_mesh`.
    medium : Material, Mix, Grid or Inward
        What it is made of.
    lights : sequence of DirectionalLight, PointLight, EnvironmentLight, Emission
        They add up.
    resolution : int
        Finest cells along the longest side of the bounding box.
    adaptive : bool
        Merge cells inside, where light varies slowly: away from the surface, and from lamps and varying emission
        inside.
    tolerance : float
        Residual to reach relative to the source, 2-norm, in every channel.
    precision : {"single", "double"}
        Of the device's arithmetic.
    device : str, optional
        Substring of an OpenCL device's name; by default the best that works.
    phase : {"similarity", "delta-eddington", "p1"}
        How a beam treats forward scattering, for g > 0: a fraction g, g^2 or 0 of it counts as unscattered. The
        first needs cells of about the transport mean free path, the last of the mean free path.
    scattering : {"all", "split"}
        Whether diffusion stands for all scattered light, or light scattered once is traced on its own and diffusion
        driven by second scattering: closer to the truth where much is absorbed, and `radiance` gains the single
        part's dependence on the view, with the forward peak that `phase` leaves. Slower.
    blockers : sequence of Mesh
        Opaque black surfaces, closed or open, that cast shadows: on the object, and between parts of its surface.
        A flat card loads with ``load_mesh(..., solid=False)``.
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
    start, lights = perf_counter(), checked_lights(lights)
    check(mesh, medium, resolution, tolerance, phase, scattering, blockers)
    check_memory(mesh, int(resolution))
    validity.warn(mesh, medium, int(resolution))
    tell = reporter(progress)
    seconds = {"load": float(mesh.report.get("seconds", 0.0)), **dict.fromkeys(STAGES, 0.0)}
    with timed("device", seconds, tell):
        dev = open_device(device, precision)
        before = dev.peak = dev.allocated
    grid = cutcell.make_grid(mesh.bounds, int(resolution))
    with timed("cut cells", seconds, tell):
        samples = cutcell.sample_surface(dev, grid, mesh)
        dev.finish()
        give_back()
    with timed("octree", seconds, tell):
        refine = Inner(grid, lights, within(grid, samples.inside)).around(varies(medium)) if adaptive else None
        tree = octree.build(dev, grid, samples, refine)
        del samples
        if tree.n_leaves == 0:
            raise InputError(
                f"{mesh.name}: no cell of the grid lies inside at resolution {resolution}; raise the resolution: it is "
                f"{validity.thickness_of(mesh):.2g} mm thick on average, cells are {grid.h:.2g} mm wide"
            )
        give_back()
    validity.warn_unresolved(tree.thickness, grid.h, int(resolution))
    with timed("exchange", seconds, tell):
        opaque = opaque_triangles(blockers)
        shadows = None if opaque is None else RayCaster(opaque)
        exchange = trace_exchange(tree, medium.eta, shadows, lambda f: tell("exchange", f))
        matrices = PatchMatrices(dev, exchange) if exchange else None
        del exchange
    with timed("surface", seconds, reporter(None)):  # the device holds less now than when it has solved
        at_vertices = shares_at(dev, tree, mesh.vertices, mesh.normals)
        give_back()
    with timed("octree", seconds, reporter(None)):  # only now: what it fills of the device nothing before needs
        coefficients = diffusion.sample_medium(dev, tree, medium, fresnel_A(medium.eta), phase)
        multigrid, coupling = coupled(dev, diffusion.make_operator(dev, tree, coefficients), matrices)
        del matrices
        layer = fitted_layer(dev, tree, coefficients)
        dev.finish()
        give_back()
    setup = Setup(dev, mesh, tree, coefficients, multigrid, layer, coupling, at_vertices, tuple(blockers), shadows,
                  scattering == "split", float(tolerance), before)  # fmt: skip
    return _bake(setup, medium, lights, None, seconds, start, tell)


def _bake(setup: Setup, medium: Any, lights: tuple[Any, ...], last: Solution | None, seconds: dict[str, float],
          start: float, tell: Progress) -> Result:  # fmt: skip
    """Light the object, and carry what leaves it to the vertices."""
    solution, fields = light(setup, lights, last, seconds, tell)
    with timed("surface", seconds, tell):
        fields = setup.at_vertices.carry(fields)  # of cut cells before, of vertices now
        tidy(setup.octree, last)
    seconds["total"] = seconds["load"] + perf_counter() - start
    if not solution.convergence.converged:
        worst = float(solution.convergence.residuals[-1].max())
        advice = "use double precision" if setup.device.precision == "single" else "allow a larger tolerance"
        text = f"the solve stopped after {solution.convergence.cycles} cycles at a residual of {worst:.1e}, short of "
        warnings.warn(text + f"the tolerance {setup.tolerance:.0e}: {advice}", ConvergenceWarning, stacklevel=4)
    return Result(setup.mesh, medium, lights, account(setup, solution, seconds), setup, solution, fields)
