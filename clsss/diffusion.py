"""The discrete diffusion equation on the octree: coefficients of every level.

    sum_f G_f + A_B phi_B / (2A) + sigma_a V phi = Q,     G_f = T_f (phi_i + g_i . tau_i - phi_j - g_j . tau_j)

The unknown is the fluence at the centroids of the (cut) cells. Two-point fluxes between centroids make the
symmetric part that multigrid inverts; gradients g carry both values along the face to its centroid, which makes
the whole second order at cut cells and between levels.

References
----------
Haber et al. 2005, eq. (4), (5), (7), (8), with the signs and factors of 4 pi set right.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from clsss.around import Around, list_around
from clsss.coarsening import octants
from clsss.device import Buffer, Device
from clsss.fields import CHANNELS, channels
from clsss.heap import give_back
from clsss.jumps import Jumps, find_jumps
from clsss.level import Level
from clsss.octree import Octree
from clsss.rows import Kept, keep

CHUNK = 1 << 15  # cells whose neighbours or children the host lists at a time
RESOLVED, FITTED = 0.05, 0.075  # (k h)^2 up to which no exponential is fitted, and from which on it is all
WIDEST = 400.0  # (k h)^2 that float32's exponentials bear


@dataclass(frozen=True, eq=False)
class Coefficients:
    """A medium on the cells of an octree: per level, or one value where it is homogeneous.

    Attributes
    ----------
    D : list of (n, 3) real, on the host or (`on_device`) the device, or of REAL4
        Diffusion coefficient [mm] of each level.
    sigma_a, sigma_s : likewise
        Absorption, and scattering out of the beam, sigma_s* = (1 - f) sigma_s [1/mm].
    D_cut : (n_cut, 3) real, device, or REAL4
        D of the cut cells, which is all that a solve needs.
    fitted : (n, 3) real, device, or REAL4
        (k h)^2 of the finest level's cells as far as exponentials are fitted (`fitted_widths`); empty where none is.
    g : float
        Mean cosine g* = (g - f) / (1 - f) of that scattering.
    fresnel_A : float
        Boundary constant A.
    eta : float
        Relative index of refraction.
    jumps : Jumps or None
        Where D jumps between finest cells.
    """

    homogeneous: bool
    D: list[Any]
    sigma_a: list[Any]
    sigma_s: list[Any]
    D_cut: Any
    fitted: Any
    g: float
    fresnel_A: float
    eta: float
    jumps: Jumps | None = None

    @property
    def defines(self) -> tuple[str, ...]:
        """What kernels are built with."""
        if self.homogeneous:
            return ()
        return ("HETEROGENEOUS", "FITTED") if self.fitted.shape[0] else ("HETEROGENEOUS",)

    @property
    def any_fitted(self) -> bool:
        """Whether exponentials are fitted anywhere."""
        return any(self.fitted.tolist()) if self.homogeneous else self.fitted.shape[0] > 0

    def on_device(self, device: Device) -> Coefficients:
        """The same with D, sigma_a and sigma_s of all cells on the device, as long as that is kept."""
        if self.homogeneous or isinstance(self.D[0], Buffer):
            return self
        D, sigma_a, sigma_s = ([device.array(v) for v in values] for values in (self.D, self.sigma_a, self.sigma_s))
        return replace(self, D=D, sigma_a=sigma_a, sigma_s=sigma_s)


@dataclass(frozen=True, eq=False)
class Operator:
    """The operator of every level (kernels/coefficients.cl), and what gradients on cut cells take.

    Attributes
    ----------
    T : list of Kept, (n, 6) real, or (n, 6, 3)
        Transmissibility of each face: [mm] where the medium is homogeneous and the equation scaled by 1/D,
        otherwise [mm^2].
    absorb : list of Kept, (n, 4) real, or (n, 3)
        Absorption and exitance per fluence, in the same scale.
    weight : list of (n_black, 4) uint8, device
        Weights of the prolongation to the black cells of each level but the coarsest (weight.h).
    share : list of (m,) real, or (m, 4), device
        Shares of `Level.junction_cell` in the transmissibility of their junction's face.
    irregular : (m,) int32, device
        Finest cells with a face whose flux has second-order terms.
    around : Around
        The cells that the gradients of cut cells are fitted to.
    """

    octree: Octree
    medium: Coefficients
    T: list[Kept]
    absorb: list[Kept]
    weight: list[Buffer | None]
    share: list[Buffer]
    irregular: Buffer
    around: Around

    def two_point(self, k: int) -> tuple[Any, ...]:
        """The coefficients of level `k` as kernels take them (rows.h)."""
        T, absorb = self.T[k], self.absorb[k]
        return T.row, absorb.last, T.values, absorb.values


def cell_points(octree: Octree) -> list[np.ndarray]:
    """Centroids of the cells of each level (n, 3) [mm]."""
    ijk, cut = octree.positions(), octree.cut.cell.get()
    local = ijk[-1][cut] + octree.cut.centroid.get()[:, :3].astype(float)
    points = [octree.grid.to_mm((p + 0.5) * 2**level.depth) for p, level in zip(ijk, octree.levels, strict=True)]
    points[-1][cut] = octree.grid.to_mm(local)
    return points


PHASES = ("similarity", "delta-eddington", "p1")


def forward_fraction(phase: str, g: float) -> float:
    """Fraction f of scattering that is taken as unscattered: g, g^2 or 0 for the three phases of `PHASES`."""
    return {"similarity": g, "delta-eddington": g * g, "p1": 0.0}[phase]


def fitted_widths(h: float, D: np.ndarray, sigma_a: np.ndarray) -> np.ndarray:
    """(k h)^2, k^2 = sigma_a / D, as far as exponentials are fitted: not where cells resolve the diffusion length."""
    width2 = sigma_a / D * h**2
    t = np.clip((width2 - RESOLVED) / (FITTED - RESOLVED), 0, 1)
    return np.minimum(width2 * t * t * (3 - 2 * t), WIDEST)


def sample_medium(device: Device, octree: Octree, medium: Any, fresnel_A: float,
                  phase: str = "similarity") -> Coefficients:  # fmt: skip
    """Coefficients of a medium at the cells of an octree.

    D = 1 / (3 sigma_tr), sigma_tr = sigma_a + (1 - g) sigma_s, for every phase; beams lose sigma_a + (1 - f) sigma_s.
    """
    n_levels = len(octree.levels)
    f = forward_fraction(phase, medium.g)
    beam_g = (medium.g - f) / (1 - f)
    if medium.homogeneous:
        sigma_a, sigma_s = medium.coefficients(np.zeros((1, 3)))
        values = 1 / (3 * (sigma_a[0] + (1 - medium.g) * sigma_s[0])), sigma_a[0], (1 - f) * sigma_s[0]
        one = [[device.vector(channels(v))] * n_levels for v in values]
        width = device.vector(channels(fitted_widths(octree.grid.h, values[0], values[1])))
        return Coefficients(True, one[0], one[1], one[2], one[0][0], width, beam_g, fresnel_A, medium.eta)
    D: list[np.ndarray] = []
    absorption: list[np.ndarray] = []
    scattering: list[np.ndarray] = []

    def transport(points: np.ndarray) -> np.ndarray:
        sigma_a, sigma_s = medium.coefficients(points)
        return sigma_a + (1 - medium.g) * sigma_s

    for points in cell_points(octree):
        sigma_a, sigma_s = medium.coefficients(points)
        sigma_tr = sigma_a + (1 - medium.g) * sigma_s
        D.append((1 / (3 * sigma_tr)).astype(device.real))
        absorption.append(sigma_a.astype(device.real))
        scattering.append(((1 - f) * sigma_s).astype(device.real))
    widths = fitted_widths(octree.grid.h, 1 / (3 * sigma_tr), sigma_a)
    fitted, D_cut = device.array(widths if widths.any() else widths[:0]), device.array(D[-1][octree.cut.cell.get()])
    jumps = find_jumps(device, octree, points, sigma_tr, transport)
    return Coefficients(False, D, absorption, scattering, D_cut, fitted, beam_g, fresnel_A, medium.eta, jumps)


def make_operator(device: Device, octree: Octree, medium: Coefficients) -> Operator:
    """Assemble the operator on every level, finest first."""
    cut, A, defines = octree.cut, float(medium.fresnel_A), medium.defines
    lent = medium.on_device(device)
    D, sigma_a = lent.D, lent.sigma_a
    per_face = (6,) if medium.homogeneous else (6, CHANNELS)
    T = [device.empty((level.n, *per_face)) for level in octree.levels]
    absorb = [device.empty((level.n, CHANNELS)) for level in octree.levels]
    finest = octree.finest
    kernel = device.kernel("coefficients", "finest_coefficients", *defines)
    device.run(kernel, finest.n, finest.n, finest.h, A, D[-1], D[-2], sigma_a[-1],
               medium.fitted, finest.nbr, finest.parent, octree.cut_index, cut.centroid, cut.boundary, cut.normal,
               cut.aperture.on_device(device), cut.face_centroid, T[-1], absorb[-1])  # fmt: skip
    if medium.jumps is not None:
        m = medium.jumps.face.shape[0]
        device.run(device.kernel("jump", "cross_jumps"), m, m, medium.jumps.face, medium.jumps.share, T[-1])
    kernel = device.kernel("coefficients", "coarse_coefficients", *defines)
    for k in range(len(T) - 2, -1, -1):
        level = octree.levels[k]
        device.run(kernel, level.n, level.n, level.h, D[k], D[max(k - 1, 0)], sigma_a[k], level.nbr, level.parent,
                   level.is_leaf, _every_child(device, level), level.chain, octree.levels[k + 1].n,
                   octree.levels[k + 1].nbr, T[k + 1], absorb[k + 1], T[k], absorb[k])  # fmt: skip
    kernel = device.kernel("interpolation", "interpolation_weights", *defines)
    weight: list[Buffer | None] = [None]
    for level, position, t in zip(octree.levels[1:], octree.lend_positions()[1:], T[1:], strict=True):
        first, n = level.colour_start[1], level.n - level.colour_start[1]
        weight.append(device.empty((n, 4), np.uint8))
        octant = device.array(octants(position.get(first, n)))
        device.run(kernel, n, first, n, level.n, octant, level.nbr, t, weight[-1])
    share = _shares(device, octree, medium, T)
    del lent, D, sigma_a, position, t
    kept: list[tuple[Kept, Kept]] = []
    while T:  # what a level had goes before the next one's comes
        kept.insert(0, keep(device, T.pop(), absorb.pop()))
    irregular, around = _irregular(device, octree), list_around(device, octree)
    give_back()
    return Operator(octree, medium, [t for t, _ in kept], [a for _, a in kept], weight, share, irregular, around)


def _every_child(device: Device, level: Level) -> Buffer:
    """`Level.child` with a row (n, 8) for each cell, of -1 for leaves."""
    assert level.child is not None
    covered, out = level.covered.get(), device.empty((level.n, 8), np.int32)
    for first in range(0, level.n, CHUNK):
        some = np.full((min(CHUNK, level.n - first), 8), -1, np.int32)
        start, end = np.searchsorted(covered, (first, first + CHUNK))
        some[covered[start:end] - first] = level.child.get(start, end - start)
        out.rows(first, len(some)).set(some)
    return out


def _shares(device: Device, octree: Octree, medium: Coefficients, T: list[Buffer]) -> list[Buffer]:
    """Shares of the cells behind junctions, level by level from the finest."""
    levels = octree.levels
    share = [device.empty((level.junction_cell.shape[0], *T[0].shape[2:])) for level in levels]
    kernel = device.kernel("junction", "junction_shares", *medium.defines)
    for k in range(len(levels) - 2, -1, -1):
        level, fine = levels[k], levels[k + 1]
        m = level.junction_face.shape[0]
        if not m:
            continue
        device.run(kernel, m, m, level.junction_face, level.junction_start, level.junction_cell,
                   _every_child(device, level), level.chain, fine.n + fine.n_ghost, fine.nbr, fine.parent, T[k + 1],
                   fine.junction_start, fine.junction_cell, share[k + 1], share[k])  # fmt: skip
    return share


def _irregular(device: Device, octree: Octree) -> Buffer:
    """Cut cells and their face neighbours."""
    n, cut = octree.finest.n, octree.cut.cell.get()
    flag = np.zeros(n + octree.finest.n_ghost, bool)
    flag[cut] = True
    for first in range(0, n, CHUNK):
        start, end = np.searchsorted(cut, (first, first + CHUNK))
        flag[octree.finest.nbr.get(first, min(CHUNK, n - first))[cut[start:end] - first]] = True
    return device.array(np.flatnonzero(flag[:n]).astype(np.int32))
