"""One set of lights on one object: source, solve, and what leaves the surface.

`Setup` holds all that stays when the lights move; `light` does the rest, from the last solution where there is one.
"""

from __future__ import annotations

import weakref
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from time import perf_counter
from typing import Any

import numpy as np

from clsss.device import Device
from clsss.diffusion import Coefficients, cell_points
from clsss.fields import Field, Load, channels
from clsss.fresnel import entering_gain
from clsss.heap import give_back
from clsss.interreflection import Interreflection, PatchCoupling
from clsss.layer import Layer
from clsss.mesh import Mesh
from clsss.multigrid import Convergence, Multigrid
from clsss.octree import Octree
from clsss.rays import RayCaster
from clsss.single import split
from clsss.source import Deposit, light_unit, make_source
from clsss.stowed import Stowed, stow
from clsss.surface import Shares

Progress = Callable[[str, float], None]
CHUNK = 1 << 14  # cells at a time, so that what is reckoned with takes little memory


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
    """Fluence in the cells of one solution: on the device until it makes room for another's, then stowed.

    Attributes
    ----------
    field : Field or None
        On the device.
    """

    def __init__(self, field: Field):
        self.field: Field | None = field
        self._stowed: Stowed | None = None  # all rows of the field

    def leave(self) -> None:
        """From now on be stowed."""
        if self.field and not self._stowed:
            whole = self.field.whole
            self._stowed = Stowed(whole.shape, whole.dtype, whole.get)
        self.field = None  # only now: Ctrl-C may come before

    def copy(self, device: Device, octree: Octree, scale: float | np.ndarray = 1.0) -> Field:
        """A copy on the device of what is stowed, times `scale` by channels; ghosts are stale."""
        assert self._stowed
        field = Field(device, octree)
        factor = channels(np.broadcast_to(np.asarray(scale, device.real), 3))
        for first, part in self._stowed.parts():
            field.whole.set(part * factor, first)
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
    flux : Stowed (n_cut, 3) real
        J.n at the boundary of the cut cells: what leaves them for good.
    exitance : Stowed (n_cut, 3) real
        All scattered light that comes out there.
    once : Stowed (n_cut, 3) float64, or None
        The part of the exitance that was scattered once, where it is traced.
    leaving : (p, 3) float64
        B of each patch of the exchange.
    moment : Stowed (n_cut, 3) float64, or None
        First moment at the boundary of all its sources, light from other parts of the surface included, where the
        energy balance of a fitted layer needs it.
    source : Deposit
    convergence : Convergence
    """

    unit: float
    phi: Fluence
    flux: Stowed
    exitance: Stowed
    once: Stowed | None
    leaving: np.ndarray
    moment: Stowed | None
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
    fields : (n_cut, 6 or 9) real
        Exitance, fluence of diffuse light just inside the surface and, where it is traced, exitance of what was
        scattered once, in multiples of the solution's unit.
    """
    device, octree, medium = setup.device, setup.octree, setup.medium
    unit = light_unit(list(lights), setup.mesh.size)
    setup.vacate()
    tidy(octree, last)
    with timed("source", seconds, tell), setup.multigrid.lent() as room:
        source = make_source(
            device, octree, medium, list(lights), unit, setup.shadows, lambda f: tell("source", f),
            (Load(device, octree), setup.multigrid.e, room),
        )
    once: np.ndarray | None = None
    kept: np.ndarray | None = None
    if setup.split:
        with timed("single", seconds, tell):
            once, kept, source = split(device, octree, medium, list(lights), unit, source, setup.shadows,
                                       setup.tolerance, lambda f: tell("single", f))  # fmt: skip
    tidy(octree, last)
    with timed("solve", seconds, tell):
        coupling, residual = setup.coupling, setup.multigrid.residual
        residual.wall = source.wall
        brighter = np.zeros(3)
        if last is not None:
            # As bright as the lights are now, by channels: where nothing is deposited no residual is told.
            before, now = last.source.deposited / last.unit, source.deposited / unit
            np.divide(now, before, out=brighter, where=before > 0)
        phi = last.phi.copy(device, octree, brighter) if last else Field(device, octree)
        follower = Interreflection(coupling, residual, source, phi) if coupling else None
        if follower and last:
            follower.start_from(last.leaving * brighter)
        tidy(octree, last)
        convergence = setup.multigrid.solve(
            source.b, phi, setup.tolerance, progress=lambda f: tell("solve", f), follower=follower,
            from_zero=last is None,
        )  # fmt: skip
        deposit, moment = Deposit(source.wall, source.deposited, source.incident, source.lost), source.moment
        moments = moment.get() if setup.layer else None
        del source  # its right-hand side has served
        tidy(octree, last)
        if follower:
            flux, entering = follower.surface(phi)
        else:
            flux = residual.boundary_flux(phi, moment, moment)
            entering = np.zeros_like(flux)
    leaving = follower.leaving if follower else np.zeros((0, 3))
    balance = None if moments is None else stow(moments - entering_gain(medium.eta) * entering)
    stowed = stow(flux)
    _turn_into_light(medium, flux, entering, kept)
    traced = None if once is None else stow(once)
    solution = Solution(unit, Fluence(phi), stowed, stow(flux), traced, leaving, balance, deposit, convergence)
    setup.hold(solution.phi)
    parts = [flux, entering] if once is None else [flux, entering, once]
    fields = np.concatenate(parts, axis=1, dtype=flux.dtype)
    del flux, entering, once, parts
    tidy(octree, last)
    return solution, fields


def tidy(octree: Octree, last: Solution | None) -> None:
    """Give back what the device no longer needs of the host's memory: after set-up, or where it is worth the time."""
    if last:
        give_back(octree.n_cells)
    else:
        give_back()


def _turn_into_light(medium: Coefficients, flux: np.ndarray, entering: np.ndarray, kept: np.ndarray | None) -> None:
    """Put exitance and fluence (n_cut, 3), of what leaves, enters and is kept inside, in the place of the first two."""
    gain = entering_gain(medium.eta)
    for first in range(0, len(flux), CHUNK):
        leaves, enters = flux[first : first + CHUNK], entering[first : first + CHUNK]
        held = enters if kept is None else enters + kept[first : first + CHUNK]
        fluence = 2 * medium.fresnel_A * leaves + gain * held
        leaves += enters
        enters[:] = fluence


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
