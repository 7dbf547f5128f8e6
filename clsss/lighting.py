"""One set of lights on one object: source, solve, and what leaves the surface.

`Setup` holds all that stays when the lights move; `light` does the rest, from the last solution where there is one.
"""

from __future__ import annotations

import weakref
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from time import perf_counter
from typing import Any

import numpy as np

from clsss.device import Device
from clsss.diffusion import Coefficients, Field, Load, cell_points, channels
from clsss.fresnel import entering_gain
from clsss.interreflection import Interreflection, PatchCoupling
from clsss.layer import Layer
from clsss.mesh import Mesh
from clsss.multigrid import Convergence, Multigrid
from clsss.octree import Octree
from clsss.rays import RayCaster
from clsss.single import split
from clsss.source import Deposit, light_unit, make_source
from clsss.surface import Shares

Progress = Callable[[str, float], None]
CHUNK = 1 << 16  # cells that are copied to or from the device at a time


@dataclass(eq=False)
class Setup:
    """What does not change with the lights."""

    device: Device
    mesh: Mesh
    octree: Octree
    medium: Coefficients
    multigrid: Multigrid
    layer: Layer | None
    coupling: PatchCoupling | None
    at_vertices: Shares  # carries values at the boundary of the cut cells to the vertices
    blockers: tuple[Mesh, ...]
    shadows: RayCaster | None
    split: bool  # whether light scattered once is traced on its own
    tolerance: float
    bytes_before: int  # that other results held on the device
    _on_device: weakref.ref[Fluence] | None = None

    @cached_property
    def right_hand_side(self) -> Load:
        """Of one set of lights after the other: no solution needs it any more."""
        return Load(self.device, self.octree)

    def vacate(self) -> None:
        """Make room: the device holds the fluence of one solution at a time, and of none while sources are made."""
        found = self._on_device and self._on_device()
        if found:
            found.leave()

    def hold(self, fluence: Fluence) -> Field:
        """A solution's fluence on the device; ghosts are stale where it was on the host."""
        if fluence.field is None:
            self.vacate()
            fluence.field = fluence.copy(self.device, self.octree)
        self._on_device = weakref.ref(fluence)
        return fluence.field


class Fluence:
    """Fluence in the cells of one solution: on the device until it makes room for another's, then on the host.

    Attributes
    ----------
    field : Field or None
        On the device.
    """

    def __init__(self, field: Field, octree: Octree):
        self.field: Field | None = field
        self._sizes = [level.n for level in octree.levels]
        self._kept: list[np.ndarray] = []  # (n, 3) real of each level

    def leave(self) -> None:
        """From now on be on the host."""
        if self.field and not self._kept:
            kept = [np.empty((n, 3), x.dtype) for x, n in zip(self.field, self._sizes, strict=True)]
            for x, values in zip(self.field, kept, strict=True):
                for first in range(0, len(values), CHUNK):
                    part = values[first : first + CHUNK]
                    part[:] = x.get(first, len(part))[:, :3]
            self._kept = kept  # only now: Ctrl-C may come before
        self.field = None

    def copy(self, device: Device, octree: Octree, scale: float | np.ndarray = 1.0) -> Field:
        """A copy on the device of what is on the host, times `scale` by channels; ghosts are zero."""
        field = Field(device, octree)
        for start, values in zip(field.start[:-1], self._kept, strict=True):
            for first in range(0, len(values), CHUNK):
                part = values[first : first + CHUNK] * np.asarray(scale, values.dtype)
                field.whole.rows(start + first, len(part)).set(channels(part))
        return field


@dataclass(frozen=True, eq=False)
class Solution:
    """A solution in multiples of `unit`.

    Attributes
    ----------
    unit : float
        Strength of the lights [W/mm^2].
    phi : Fluence
        In the cells; the device holds one solution's at a time (`Setup.hold`).
    flux : (n_cut, 3) real
        J.n at the boundary of the cut cells: what leaves them for good.
    exitance : (n_cut, 3) real
        All scattered light that comes out there.
    once : (n_cut, 3) float64, or None
        The part of the exitance that was scattered once, where it is traced.
    leaving : (p, 3) float64
        B of each patch of the exchange.
    moment : (n_cut, 3) float64, or None
        First moment at the boundary of all its sources, light from other parts of the surface included, where the
        energy balance of a fitted layer needs it.
    source : Deposit
    convergence : Convergence
    """

    unit: float
    phi: Fluence
    flux: np.ndarray
    exitance: np.ndarray
    once: np.ndarray | None
    leaving: np.ndarray
    moment: np.ndarray | None
    source: Deposit
    convergence: Convergence


def light(setup: Setup, lights: tuple[Any, ...], last: Solution | None, seconds: dict[str, float],
          tell: Progress) -> tuple[Solution, np.ndarray]:  # fmt: skip
    """Light an object.

    Parameters
    ----------
    setup : Setup
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
    fluence : (n_cut, 3) real
        Of diffuse light just inside the surface, in multiples of the solution's unit.
    """
    device, octree, medium = setup.device, setup.octree, setup.medium
    unit = light_unit(list(lights), setup.mesh.size)
    setup.vacate()
    with timed("source", seconds, tell), setup.multigrid.lent() as room:
        source = make_source(
            device, octree, medium, list(lights), unit, setup.shadows, lambda f: tell("source", f),
            (setup.right_hand_side, setup.multigrid.e, room),
        )
    once: np.ndarray | None = None
    kept: Any = 0.0
    if setup.split:
        with timed("single", seconds, tell):
            once, kept, source = split(device, octree, medium, list(lights), unit, source, setup.shadows,
                                       setup.tolerance, lambda f: tell("single", f))  # fmt: skip
    with timed("solve", seconds, tell):
        setup.multigrid.residual.wall = source.wall
        brighter = np.zeros(3)
        if last is not None:
            # As bright as the lights are now, by channels: where nothing is deposited no residual is told.
            before, now = last.source.deposited / last.unit, source.deposited / unit
            np.divide(now, before, out=brighter, where=before > 0)
        phi = last.phi.copy(device, octree, brighter) if last else Field(device, octree)
        coupling, residual = setup.coupling, setup.multigrid.residual
        follower = Interreflection(coupling, residual, source, phi) if coupling else None
        if follower and last:
            follower.start_from(last.leaving * brighter)
        convergence = setup.multigrid.solve(
            source.b, phi, setup.tolerance, progress=lambda f: tell("solve", f), follower=follower,
            from_zero=last is None,
        )  # fmt: skip
        moment = source.moment.get() if setup.layer else None
        flux, entering = follower.surface(phi) if follower else (
            setup.multigrid.residual.boundary_flux(phi, source.moment, source.moment), 0.0)  # fmt: skip
    gain = entering_gain(medium.eta)
    exitance = flux + entering
    fluence = (2 * medium.fresnel_A * flux + gain * (entering + kept)).astype(device.real)
    leaving = follower.leaving if follower else np.zeros((0, 3))
    if moment is not None:
        moment = moment - gain * entering
    deposit = Deposit(source.wall, source.deposited, source.incident, source.lost)
    solution = Solution(unit, Fluence(phi, octree), flux, exitance, once, leaving, moment, deposit, convergence)
    setup.hold(solution.phi)
    return solution, fluence


def interpolate(setup: Setup, solution: Solution, points: np.ndarray) -> np.ndarray:
    """Fluence (n, 3) at points (n, 3) [mm], linear about the centroids of the leaves that hold them; else NaN."""
    octree, phi = setup.octree, setup.hold(solution.phi)
    setup.multigrid.residual.wall = solution.source.wall
    setup.multigrid.residual.complete(phi)
    out = np.full((len(points), 3), np.nan)
    depth, index = octree.find(points)
    slopes = setup.multigrid.residual.slope.get().astype(float)
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
