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
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy import sparse
from scipy.spatial import cKDTree

from clsss.fresnel import entering_gain, fresnel_A, fresnel_transmittance, unit_quadrature
from clsss.octree import Octree
from clsss.rays import LINING, RayCaster
from clsss.surface import boundary_points, tangent_frame

PROBES = 8  # rays that tell how much of the object a patch sees
RAYS = 32  # rays of those that see it wherever they look, twice as many of others: for patches two cells wide, and in
# proportion to their width, for on fine grids they cost little of the whole
PATCHES = 64  # patches along the longest side of the grid, at least
NEAREST = 6  # patches around a cut cell, of which its share is blended: all but the one that weighs least
CHUNK = 1 << 14  # rays at a time, of which both host and device hold much
SUMMED = 1 << 14  # hits that are added to the matrices at once
SOME = 1 << 13  # cut cells at a time
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
    mu, weight = unit_quadrature(64)
    return float(2 * (weight * mu * _shape(mu, eta)).sum())


def patch_depth(octree: Octree) -> int:
    """How many levels above the finest cells are as wide as patches."""
    return max(1, round(np.log2(max(octree.grid.dims) / PATCHES)))


def _patches(octree: Octree, normals: np.ndarray, areas: np.ndarray) -> tuple[np.ndarray, sparse.csr_matrix]:
    """Cut cells of one ancestor whose normals share their main axis, and their area-weighted mean."""
    depth = patch_depth(octree)
    coarse = octree.cut_positions().astype(np.int64) >> depth
    axis = np.abs(normals).argmax(axis=1)
    side = normals[np.arange(len(normals)), axis] > 0
    dims = np.array(octree.grid.dims) // 2**depth + 1
    key = ((coarse[:, 2] * dims[1] + coarse[:, 1]) * dims[0] + coarse[:, 0]) * 6 + 2 * axis + side
    _, patch = np.unique(key, return_inverse=True)
    total = np.bincount(patch, areas)
    weight = areas / np.maximum(total[patch], 1e-300)
    patch = patch.astype(np.int32)
    return patch, sparse.csr_matrix((weight, (patch, np.arange(len(patch)))), shape=(len(total), len(patch)))


def _blend(share: sparse.csr_matrix, points: np.ndarray, normals: np.ndarray) -> sparse.csr_matrix:
    centres, facing = share @ points, share @ normals
    tree, n, k = cKDTree(centres), len(points), min(NEAREST, len(centres))
    weight, near = np.empty((n, k - 1)), np.empty((n, k - 1), np.int32)
    for first in range(0, n, SOME):
        part = slice(first, first + SOME)
        distance, found = (x.reshape(-1, k) for x in tree.query(points[part], k=k, workers=-1))
        reach = distance[:, -1:] * (1 + 1e-9) + 1e-300
        alike = np.maximum(1e-6, np.einsum("nd,nkd->nk", normals[part], facing[found]))
        shares = alike**2 * (1 - (distance / reach) ** 2 + 1e-3)
        kept = np.arange(k) != shares.argmin(axis=1)[:, None]
        shares = shares[kept].reshape(-1, k - 1)
        weight[part], near[part] = shares / shares.sum(axis=1, keepdims=True), found[kept].reshape(-1, k - 1)
    start = np.arange(n + 1) * (k - 1)
    blend = sparse.csr_matrix((weight.ravel(), near.ravel(), start), shape=share.shape[::-1])
    blend.sort_indices()
    return blend


def _together(found: Iterable[tuple[np.ndarray, ...]]) -> Iterator[tuple[np.ndarray, ...]]:
    """What rays found, `SUMMED` of them or more at a time."""
    some: list[tuple[np.ndarray, ...]] = []
    for part in found:
        some.append(part)
        if sum(len(own) for own, *_ in some) >= SUMMED:
            yield tuple(np.concatenate(values) for values in zip(*some, strict=True))
            some.clear()
    if some:
        yield tuple(np.concatenate(values) for values in zip(*some, strict=True))


def _transport(found: Iterable[tuple[np.ndarray, ...]], rays: np.ndarray, area: np.ndarray,
               eta: float) -> tuple[sparse.csr_matrix, sparse.csr_matrix]:  # fmt: skip
    """H and H_t (p, p) from what so many rays of each patch find, added up as they come, and the patches' areas."""
    H = H_t = sparse.csr_matrix((len(area), len(area)))
    for own, other, mu, mu_other in _together(found):
        here, there = np.concatenate([own, other]), np.concatenate([other, own])
        balance = area[there] / (rays[here] * area[there] + rays[there] * area[here])
        flow = balance * leaving_shape(np.concatenate([mu_other, mu]), eta)
        entering = flow * fresnel_transmittance(np.concatenate([mu, mu_other]), eta)
        more, more_t = (sparse.coo_matrix((v, (here, there)), shape=H.shape).tocsr() for v in (flow, entering))
        H, H_t = H + more, H_t + more_t
    return H, H_t


class _Tracer:
    """Rays from patches to the patches that they hit, through the cells of the octree (kernels/seen.cl)."""

    def __init__(self, octree: Octree, patch: np.ndarray, points: np.ndarray, normals: np.ndarray,
                 blockers: RayCaster | None):  # fmt: skip
        self.blockers, self.octree, self.patch, self.points = blockers, octree, patch, points
        flat = np.linalg.norm(normals, axis=1) < 0.5  # two sheets that cancel have no normal
        self.normals = np.where(flat[:, None], [0.0, 0.0, 1.0], normals) if flat.any() else normals
        self.tangents, self.bitangents = tangent_frame(self.normals)
        order = np.argsort(patch, kind="stable")
        self.members, self.first = order, np.searchsorted(patch[order], np.arange(patch.max() + 2))
        self.rays, self._body = 0, octree.lend_body(leaves=False)

    def trace(self, patches: np.ndarray, numbers: range) -> Iterator[tuple[np.ndarray, ...]]:
        """Rays of such numbers from each of `patches`, some at a time: as `_trace`."""
        some = max(1, CHUNK // len(numbers))
        for first in range(0, len(patches), some):
            own = patches[first : first + some]
            yield self._trace(np.repeat(own, len(numbers)), np.tile(numbers, len(own)))

    def _trace(self, patches: np.ndarray, k: np.ndarray) -> tuple[np.ndarray, ...]:
        """Rays number `k` of `patches`: the patches of those that hit, the patches hit, and the cosines at both."""
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
        return patches[hit], self.patch[other], mu[hit, 0], arriving

    def _first_met(self, origin: np.ndarray, direction: np.ndarray) -> np.ndarray:
        """The cut cell that each ray meets first, -1 where none."""
        octree, device, n = self.octree, self.octree.device, len(origin)
        kernel, opaque, met = device.kernel("seen", "first_met"), device.vector([HUGE] * 4), device.empty(n, np.int32)
        device.run(kernel, -(-n // device.lanes), n, *self._body, opaque, device.array(octree.grid.to_cells(origin)),
                   device.array(direction), met)  # fmt: skip
        return met.get()

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
    points, normals = boundary_points(octree)
    areas = octree.cut.boundary.get()[:, 3].astype(float) * octree.grid.h**2
    patch, share = _patches(octree, normals, areas)
    area = np.bincount(patch, areas)
    n = len(area)
    tracer = _Tracer(octree, patch, points, normals, blockers)
    everywhere, seen, active = np.arange(n, dtype=np.int32), np.zeros(n, int), np.zeros(n, bool)
    for own, other, _, _ in tracer.trace(everywhere, range(-PROBES, 0)):
        seen += np.bincount(own, minlength=n)
        active[own] = active[other] = True
    if not active.any():
        return None
    # patches that neither see nor are seen count as if they were traced, too: nothing would be found
    rays = np.where(2 * seen > PROBES, RAYS, 2 * RAYS) << (patch_depth(octree) - 1)

    def found() -> Iterator[tuple[np.ndarray, ...]]:
        for each in np.unique(rays[active]).tolist():
            # without the probes: how many rays there are depends on what those found
            for part in tracer.trace(everywhere[active & (rays == each)], range(each)):
                if progress is not None:
                    progress((tracer.rays - n * PROBES) / rays[active].sum())
                yield part

    H, H_t = _transport(found(), rays, area, eta)
    blend = _blend(share, points, normals)
    return Exchange(share, blend, H, H_t, entering_gain(eta), tracer.rays, time.perf_counter() - start)
