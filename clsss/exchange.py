"""Light that leaves one part of the surface, crosses a cavity or a concavity, and enters another.

    H = F B,   B = J.n + H,   J.n = (phi_B - 4 H_t / (1 - R_phi)) / (2A)

H is the irradiance that arrives from the rest of the surface, H_t the part that the boundary lets in, B all that
leaves. The exchange F between patches of cut cells is traced with rays from both ends of each pair, through the empty
cells of the octree, weighted so that what one patch sends is what the other receives.

References
----------
Partial-current balance of Haskell et al. 1994 with incoming light; Veach and Guibas 1995 (balance heuristic).
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy import sparse
from scipy.spatial import cKDTree

from clsss.fresnel import entering_gain, fresnel_A, fresnel_transmittance
from clsss.octree import Octree
from clsss.rays import LINING, RayCaster
from clsss.surface import boundary_points, tangent_frame

PROBES = 8  # rays that tell whether a patch sees the object at all
RAYS = 32  # rays of those that do
PATCHES = 64  # patches along the longest side of the grid, at least
NEAREST = 6  # patches that a cut cell's share is blended from
CHUNK = 1 << 18  # rays at a time
HELD = 1 << 15  # of which the device holds so many at once
HUGE = 1e30  # extinction of the object, for rays that go around it
GOLDEN = np.array([0.8191725134, 0.6710436067, 0.5497004779])  # R3 low-discrepancy sequence


@dataclass(frozen=True, eq=False)
class Exchange:
    """Transport between patches of the surface.

    Attributes
    ----------
    share : (p, n_cut) sparse
        Area-weighted mean over the cut cells of each patch.
    blend : (n_cut, p) sparse
        Mean over the patches around each cut cell that face the same way.
    arriving, entering : (p, p) sparse
        H and H_t per B.
    gain : float
        4 / (1 - R_phi): what H_t adds to the fluence at the boundary.
    rays : int
        Rays traced.
    seconds : float
    """

    share: sparse.csr_matrix
    blend: sparse.csr_matrix
    arriving: sparse.csr_matrix
    entering: sparse.csr_matrix
    gain: float
    rays: int
    seconds: float


def leaving_shape(mu: np.ndarray, eta: float) -> np.ndarray:
    """Radiance leaving at outside cosine `mu`, relative to that of a Lambertian surface of the same exitance.

    L = (1 - R) (phi_B + 3 J cos theta_i) / (4 pi eta^2) with phi_B = 2 A J.
    """
    return _shape(mu, eta) / _lambertian(eta)


def _shape(mu: np.ndarray, eta: float) -> np.ndarray:
    inner = np.sqrt(np.maximum(0, 1 - (1 - mu * mu) / eta**2))
    return fresnel_transmittance(mu, eta) * (2 * fresnel_A(eta) + 3 * inner)


@lru_cache(maxsize=64)
def _lambertian(eta: float) -> float:
    """2 int_0^1 shape mu dmu."""
    x, weight = np.polynomial.legendre.leggauss(64)
    nodes = (x + 1) / 2
    return float((weight * nodes * _shape(nodes, eta)).sum())


def patch_depth(octree: Octree) -> int:
    """How many levels above the finest cells are as wide as patches."""
    return max(1, round(np.log2(max(octree.grid.dims) / PATCHES)))


def _patches(octree: Octree, normals: np.ndarray, areas: np.ndarray) -> tuple[np.ndarray, sparse.csr_matrix]:
    """Cut cells of one ancestor whose normals share their main axis, and their area-weighted mean."""
    depth = patch_depth(octree)
    coarse = octree.finest.ijk[octree.cut.cell.get()].astype(np.int64) >> depth
    axis = np.abs(normals).argmax(axis=1)
    side = normals[np.arange(len(normals)), axis] > 0
    dims = np.array(octree.grid.dims) // 2**depth + 1
    key = ((coarse[:, 2] * dims[1] + coarse[:, 1]) * dims[0] + coarse[:, 0]) * 6 + 2 * axis + side
    _, patch = np.unique(key, return_inverse=True)
    total = np.bincount(patch, areas)
    weight = areas / np.maximum(total[patch], 1e-300)
    return patch, sparse.csr_matrix((weight, (patch, np.arange(len(patch)))), shape=(len(total), len(patch)))


def _blend(share: sparse.csr_matrix, points: np.ndarray, normals: np.ndarray) -> sparse.csr_matrix:
    centres, facing = share @ points, share @ normals
    k = min(NEAREST, len(centres))
    distance, near = cKDTree(centres).query(points, k=k, workers=-1)
    distance, near = distance.reshape(-1, k), near.reshape(-1, k)
    reach = distance[:, -1:] * (1 + 1e-9) + 1e-300
    alike = np.maximum(1e-6, np.einsum("nd,nkd->nk", normals, facing[near]))
    weight = alike**2 * (1 - (distance / reach) ** 2 + 1e-3)
    weight /= weight.sum(axis=1, keepdims=True)
    rows = np.repeat(np.arange(len(points)), k)
    return sparse.csr_matrix((weight.ravel(), (rows, near.ravel())), shape=share.shape[::-1])


class _Tracer:
    """Rays from patches to the patches that they hit, through the cells of the octree (kernels/seen.cl)."""

    def __init__(self, octree: Octree, patch: np.ndarray, blockers: RayCaster | None):
        self.blockers, self.octree, self.patch = blockers, octree, patch
        self.points, self.normals = boundary_points(octree)
        flat = np.linalg.norm(self.normals, axis=1) < 0.5  # two sheets that cancel have no normal
        self.normals[flat] = [0, 0, 1]
        self.tangents, self.bitangents = tangent_frame(self.normals)
        order = np.argsort(patch, kind="stable")
        self.members, self.first = order, np.searchsorted(patch[order], np.arange(patch.max() + 2))
        self.rays, self._body = 0, octree.lend_body()

    def trace(self, patches: np.ndarray, k: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Rays number `k` of `patches`: which of them hit, the patch hit, and the cosines at both ends."""
        self.rays += len(patches)
        turn = (patches[:, None] * np.array([0.7548776662, 0.5698402910, 0.3819660113])) % 1
        u = (turn + (k[:, None] + 0.5) * GOLDEN) % 1
        count = self.first[patches + 1] - self.first[patches]
        cell = self.members[self.first[patches] + np.minimum((u[:, 2] * count).astype(int), count - 1)]
        n, s, t = self.normals[cell], self.tangents[cell], self.bitangents[cell]
        radius, angle, mu = np.sqrt(u[:, :1]), 2 * np.pi * u[:, 1:2], np.sqrt(1 - u[:, :1])
        direction = radius * (np.cos(angle) * s + np.sin(angle) * t) + mu * n
        origin = self.points[cell] + 0.1 * self.octree.grid.h * n
        met = self._first_met(origin, direction)
        hit = np.flatnonzero((met >= 0) & (self.patch[met] != patches))
        if self.blockers:
            # from inside to inside: what lines a wall is in the way, on whichever side of it rounding puts it
            start = self.points[cell[hit]] - LINING * self.octree.grid.h * n[hit]
            end = self._ends(origin[hit], direction[hit], met[hit])
            hit = hit[~self.blockers.occluded(start, end - start, 1.0)]
        other = met[hit]
        arriving = np.clip(-np.einsum("ij,ij->i", self.normals[other], direction[hit]), 0.05, 1.0)
        return hit, self.patch[other], mu[hit, 0], arriving

    def _first_met(self, origin: np.ndarray, direction: np.ndarray) -> np.ndarray:
        """The cut cell that each ray meets first, -1 where none."""
        octree, device, n = self.octree, self.octree.device, len(origin)
        kernel, opaque, found = device.kernel("seen", "first_met"), device.vector([HUGE] * 4), np.empty(n, np.int32)
        for first in range(0, n, HELD):
            part = slice(first, min(first + HELD, n))
            m = part.stop - first
            met = device.empty(m, np.int32)
            start = device.array(octree.grid.to_cells(origin[part]))
            device.run(kernel, -(-m // device.lanes), m, *self._body, opaque, start, device.array(direction[part]),
                       met)  # fmt: skip
            found[part] = met.get()
        return found

    def _ends(self, origin: np.ndarray, direction: np.ndarray, met: np.ndarray) -> np.ndarray:
        """Where rays meet the planes of the cut cells `met`, just under them."""
        h, normal, away = self.octree.grid.h, self.normals[met], self.points[met] - origin
        slope = np.minimum(np.einsum("ij,ij->i", normal, direction), -1e-3)
        nearest = np.einsum("ij,ij->i", away, direction)
        reach = np.clip(np.einsum("ij,ij->i", away, normal) / slope, nearest - h, nearest + h)
        return origin + reach[:, None] * direction - LINING * h * normal


def trace_exchange(octree: Octree, eta: float, blockers: RayCaster | None = None,
                   progress: Callable[[float], None] | None = None) -> Exchange | None:  # fmt: skip
    """The exchange between the parts of a surface, or None where no part sees another.

    Parameters
    ----------
    octree : Octree
    eta : float
        Relative index of refraction.
    blockers : RayCaster, optional
        Opaque black bodies.
    progress : callable, optional
        Called with the fraction done.
    """
    start = time.perf_counter()
    _, normals = boundary_points(octree)
    areas = octree.cut.boundary.get()[:, 3].astype(float) * octree.grid.h**2
    patch, share = _patches(octree, normals, areas)
    area = np.bincount(patch, areas)
    n = len(area)
    tracer = _Tracer(octree, patch, blockers)
    probes = np.repeat(np.arange(n), PROBES)
    found = [(probes, *tracer.trace(probes, np.tile(np.arange(PROBES), n)))]
    active = np.zeros(n, bool)
    active[probes[found[0][1]]] = active[found[0][2]] = True
    if not active.any():
        return None
    sources = np.repeat(np.flatnonzero(active), RAYS - PROBES)
    numbers = np.tile(np.arange(PROBES, RAYS), int(active.sum()))
    for first in range(0, len(sources), CHUNK):
        part = sources[first : first + CHUNK]
        found.append((part, *tracer.trace(part, numbers[first : first + CHUNK])))
        if progress is not None:
            progress(min(1.0, (first + CHUNK) / len(sources)))
    rows, columns, arriving, entering = [], [], [], []
    for patches, hit, other, mu, mu_other in found:
        own = patches[hit]
        balance = area[[own, other]] / (area[own] + area[other]) / RAYS
        for here, there, mu_in, mu_out, weight in ((own, other, mu, mu_other, balance[1]),
                                                   (other, own, mu_other, mu, balance[0])):  # fmt: skip
            flow = weight * leaving_shape(mu_out, eta)
            rows.append(here)
            columns.append(there)
            arriving.append(flow)
            entering.append(flow * fresnel_transmittance(mu_in, eta))
    where = (np.concatenate(rows), np.concatenate(columns))
    gain = entering_gain(eta)
    H, H_t = (sparse.coo_matrix((np.concatenate(v), where), shape=(n, n)).tocsr() for v in (arriving, entering))
    blend = _blend(share, tracer.points, normals)
    return Exchange(share, blend, H, H_t, gain, tracer.rays, time.perf_counter() - start)
