"""One set of lights on one object: source, solve, and what leaves the surface.

`Scene` holds all that stays when the lights move; `light` does the rest, from the last solution where there is one.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np
from scipy import sparse

from clsss.device import Buffer, Device
from clsss.diffusion import CHANNELS, Coefficients, Field, cell_points, channels
from clsss.exchange import Exchange
from clsss.layer import Layer
from clsss.materials import fresnel_moments
from clsss.mesh import Mesh
from clsss.multigrid import Convergence, Multigrid
from clsss.octree import Octree
from clsss.rays import RayCaster
from clsss.residual import Residual
from clsss.single import split
from clsss.source import Source, light_unit, make_source, subtract_moment
from clsss.sparsematrix import SparseMatrix
from clsss.surface import shares_at

Progress = Callable[[str, float], None]
PASSAGES = 2  # between parts of the surface that a cycle anticipates


class Transport(NamedTuple):
    """The matrices of an `Exchange`, and the albedo of its patches, on the device."""

    share: SparseMatrix
    blend: SparseMatrix
    arriving: SparseMatrix
    entering: SparseMatrix
    albedo: Buffer


@dataclass(frozen=True, eq=False)
class Scene:
    """What does not change with the lights."""

    device: Device
    mesh: Mesh
    octree: Octree
    medium: Coefficients
    multigrid: Multigrid
    layer: Layer | None
    exchange: Exchange | None
    blockers: tuple[Mesh, ...]
    shadows: RayCaster | None
    split: bool  # whether light scattered once is traced on its own
    tolerance: float
    bytes_before: int  # that other results held on the device

    @cached_property
    def transport(self) -> Transport:
        """The exchange's matrices on the device."""
        assert self.exchange is not None
        matrices = (self.exchange.share, self.exchange.blend, self.exchange.arriving, self.exchange.entering)
        share, blend, arriving, entering = (SparseMatrix(self.device, matrix) for matrix in matrices)
        albedo = self.device.array(channels(patch_albedo(self.exchange, self.octree, self.medium)))
        return Transport(share, blend, arriving, entering, albedo)

    @cached_property
    def at_vertices(self) -> sparse.csr_matrix:
        """What carries values at the boundary of the cut cells to the vertices of the mesh (v, n_cut)."""
        return shares_at(self.device, self.octree, self.mesh.vertices, self.mesh.normals)


@dataclass(frozen=True, eq=False)
class Solution:
    """A solution in multiples of `unit`.

    Attributes
    ----------
    unit : float
        Strength of the lights [W/mm^2].
    phi : Field
        Fluence in the cells.
    flux : (n_cut, 3) float64
        J.n at the boundary of the cut cells: what leaves them for good.
    exitance, fluence : (n_cut, 3) float64
        All scattered light that comes out there, and the fluence of diffuse light just inside.
    once : (n_cut, 3) float64, or None
        The part of the exitance that was scattered once, where it is traced.
    leaving : (p, 3) float64
        B of each patch of the exchange.
    moment : (n_cut, 3) float64
        First moment at the boundary of all its sources, light from other parts of the surface included.
    source : Source
    convergence : Convergence
    """

    unit: float
    phi: Field
    flux: np.ndarray
    exitance: np.ndarray
    fluence: np.ndarray
    once: np.ndarray | None
    leaving: np.ndarray
    moment: np.ndarray
    source: Source
    convergence: Convergence


def boundary_flux(residual: Residual, phi: Field, moment: Buffer) -> np.ndarray:
    """J.n (n_cut, 3) at the boundary of the cut cells, for a complete `phi`."""
    phi_B = residual.device.empty(moment.shape)
    residual.take_boundary_value(phi, moment, phi_B)
    return phi_B.get()[:, :3].astype(float) / (2 * residual.op.medium.fresnel_A)


def patch_albedo(exchange: Exchange, octree: Octree, medium: Coefficients) -> np.ndarray:
    """Share (p, 3) of the light arriving at each patch that will come out of it again, as if that were a half space.

    Light that has come from a distance d varies over about d along the surface, so phi ~ exp(i x / d - kappa depth)
    with kappa^2 = sigma_eff^2 + 1 / d^2; what does not come out where it enters has gone astray.
    """
    cut = octree.cut.cell.get()
    D, sigma_a = medium.D[-1], medium.sigma_a[-1]
    if medium.homogeneous:
        D, sigma_a = (np.broadcast_to(values.tolist(), (len(cut), CHANNELS)) for values in (D, sigma_a))
    else:
        D, sigma_a = D.get()[cut], sigma_a[cut]
    D, sigma_a = exchange.share @ D[:, :3].astype(float), exchange.share @ sigma_a[:, :3].astype(float)
    inward = np.sqrt(D * (sigma_a + D * exchange.nearness[:, None] ** 2))
    everywhere = np.ones((len(exchange.nearness), 1))
    entering = exchange.entering @ everywhere / np.maximum(exchange.arriving @ everywhere, 1e-300)
    return 1 - np.minimum(1, entering * exchange.gain * inward / (1 + 2 * medium.fresnel_A * inward))


class Interreflection:
    """What parts of the surface send to one another, as a part of the right-hand side (a `Follower`).

    Its state is B (p, 3), all light that leaves each patch: B <- J.n + F B. J.n is of a solution that has not
    answered to that B yet; a cycle later it will have given back most of what is new. So each step goes on by
    some passages B <- J.n + F B_last + albedo F (B - B_last), of which a predicted `albedo` comes out again: it
    changes the way to the solution, not the solution.
    """

    def __init__(self, scene: Scene, source: Source, phi: Field):
        assert scene.exchange is not None
        self.scene, self.exchange, self.r_B, device = scene, scene.exchange, source.moment, scene.device
        n = scene.exchange.share.shape[0]
        self.state = np.zeros((n, 3))
        self._last, self._next, self._arriving, self._held = (device.zeros((n, CHANNELS)) for _ in range(4))
        self._passages = [self._next, *(device.empty((n, CHANNELS)) for _ in range(PASSAGES))]
        self._moment, self._phi_B = device.empty(self.r_B.shape), device.empty(self.r_B.shape)
        self._anticipate = device.kernel("exchange", "anticipate")
        self._update = device.capture(lambda: self._enqueue_update(phi))

    def hold(self, phi: Field) -> None:
        """From now on count the solution from a complete `phi`."""
        flux = boundary_flux(self.scene.multigrid.residual, phi, self.r_B)
        self._held.set(channels(self.exchange.share @ flux))
        self._set_aside = self.r_B.get()
        self.r_B.fill(0)

    def release(self) -> None:
        """Count from zero again."""
        self._held.fill(0)
        self.r_B.set(self._set_aside)

    def _enter(self, B: Buffer, plus: Buffer | None) -> None:
        """Overwrite the moment with -gain H_t, what the boundary lets in of B, and `plus`."""
        transport = self.scene.transport
        transport.entering.multiply(1, B, self._arriving)
        transport.blend.multiply(-self.exchange.gain, self._arriving, self._moment, plus)

    def _enqueue_update(self, phi: Field) -> None:
        transport, residual = self.scene.transport, self.scene.multigrid.residual
        self._enter(self._last, self.r_B)
        residual.take_boundary_value(phi, self._moment, self._phi_B)
        transport.arriving.multiply(1, self._last, self._arriving, self._held)
        transport.share.multiply(1 / (2 * self.scene.medium.fresnel_A), self._phi_B, self._next, self._arriving)
        n, rows = transport.arriving.n, transport.arriving.rows
        for before, after in itertools.pairwise(self._passages):
            self.scene.device.run(self._anticipate, n, n, *rows, transport.albedo, self._last, self._next, before,
                                  after)  # fmt: skip

    def update(self) -> float:
        """One step of the exchange; how far B moved, relative to its size."""
        self._last.set(channels(self.state))
        self._update()
        last, self.state = self.state, self._passages[-1].get()[:, :3].astype(float)
        size = np.linalg.norm(self.state, axis=0)
        return float((np.linalg.norm(self.state - last, axis=0) / np.where(size > 0, size, 1)).max())

    def adjust(self, residual: Field) -> None:
        """Add C_B gain H_t to the residual of the cut cells."""
        self._enter(self._passages[-1], None)
        subtract_moment(self.scene.device, self.scene.octree, self.scene.medium, self._moment, residual[-1])

    def surface(self, phi: Field) -> tuple[np.ndarray, np.ndarray]:
        """J.n and H_t (n_cut, 3) at the boundary of the cut cells."""
        self._enter(self._passages[-1], self.r_B)
        flux = boundary_flux(self.scene.multigrid.residual, phi, self._moment)
        return flux, self.exchange.blend @ (self.exchange.entering @ self.state)


def light(scene: Scene, lights: tuple[Any, ...], last: Solution | None, seconds: dict[str, float],
          tell: Progress) -> Solution:  # fmt: skip
    """Light an object.

    Parameters
    ----------
    scene : Scene
    lights : tuple
        DirectionalLight, PointLight, EnvironmentLight or Emission.
    last : Solution, optional
        Where the solve starts from.
    seconds : dict
        Gets the seconds of the stages "source", "single" and "solve".
    tell : callable
        Told ``(stage, fraction)``.

    Returns
    -------
    Solution
    """
    device, octree, medium = scene.device, scene.octree, scene.medium
    unit = light_unit(list(lights), scene.mesh.size)
    with timed("source", seconds, tell):
        source = make_source(
            device, octree, medium, list(lights), unit, scene.shadows, lambda f: tell("source", f)
        )
    once, kept = None, np.zeros(3)
    if scene.split:
        with timed("single", seconds, tell):
            once, kept, source = split(device, octree, medium, list(lights), unit, source, scene.shadows,
                                       scene.tolerance, lambda f: tell("single", f))  # fmt: skip
    with timed("solve", seconds, tell):
        scene.multigrid.residual.wall = source.wall
        phi = Field(device, octree)
        follower = Interreflection(scene, source, phi) if scene.exchange else None
        if last is not None:
            scene.multigrid.combine(last.unit / unit, last.phi, 0, phi)
            if follower:
                follower.state = last.leaving * (last.unit / unit)
        convergence = scene.multigrid.solve(
            source.b, phi, scene.tolerance, progress=lambda f: tell("solve", f), follower=follower
        )
        flux, entering = follower.surface(phi) if follower else (
            boundary_flux(scene.multigrid.residual, phi, source.moment), np.zeros(3))  # fmt: skip
    gain = 4 / (1 - fresnel_moments(medium.eta)[0])
    exitance, fluence = flux + entering, 2 * medium.fresnel_A * flux + gain * (entering + kept)
    leaving = follower.state if follower else np.zeros((0, 3))
    moment = source.moment.get()[:, :3] - gain * entering
    return Solution(unit, phi, flux, exitance, fluence, once, leaving, moment, source, convergence)


def interpolate(scene: Scene, solution: Solution, points: np.ndarray) -> np.ndarray:
    """Fluence (n, 3) at points (n, 3) [mm], linear about the centroids of the leaves that hold them; else NaN."""
    octree, phi = scene.octree, solution.phi
    scene.multigrid.residual.wall = solution.source.wall
    scene.multigrid.residual.complete(phi)
    out = np.full((len(points), 3), np.nan)
    depth, index = octree.find(points)
    slopes = scene.multigrid.residual.slope.get().astype(float)
    cut_index, centroids = octree.cut_index.get(), cell_points(octree)
    for k, level in enumerate(octree.levels):
        here = np.flatnonzero(depth == level.depth)
        if not len(here):
            continue
        i, values, nbr = index[here], phi[k].get()[:, :3].astype(float), level.nbr.get()
        low, high = nbr[i][:, ::2], nbr[i][:, 1::2]
        has_low, has_high = (low < level.n) & (low != i[:, None]), (high < level.n) & (high != i[:, None])
        own = values[i][:, None, :]
        rise = np.where(has_high[..., None], values[high] - own, 0)
        rise += np.where(has_low[..., None], own - values[low], 0)
        slope = rise / np.maximum(1, has_low.astype(int) + has_high)[..., None]
        if level.depth == 0:
            cut = cut_index[i]
            slope[cut >= 0] = slopes[cut[cut >= 0]]
        offset = (points[here] - centroids[k][i]) / level.h
        out[here] = values[i] + np.einsum("nd,ndc->nc", offset, slope)
    return out * solution.unit


@contextmanager
def timed(stage: str, seconds: dict[str, float], tell: Progress) -> Iterator[None]:
    """Tell that a stage begins and ends, and add up its seconds."""
    tell(stage, 0.0)
    start = perf_counter()
    yield
    seconds[stage] += perf_counter() - start
    tell(stage, 1.0)
