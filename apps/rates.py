"""What convergence.py measures with: the discrete equation in a solid, rates of cycles, errors of solutions."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import problems

from clsss import Emission, Mesh, cutcell, diffusion, octree, source
from clsss.device import Device
from clsss.fields import Field, Load, PerLevel
from clsss.fresnel import fresnel_A
from clsss.multigrid import Convergence, Multigrid
from clsss.refinement import varies
from clsss.residual import Residual
from clsss.source import Source
from clsss.surface import boundary_points, fluence_at

LAST = 5  # cycles that a rate is the geometric mean of


@dataclass
class Bench:
    """What every group of measurements gets: the device, the scale, and where pictures' data go."""

    device: Device
    quick: bool
    curves: dict[str, Any]

    @property
    def n(self) -> int:
        """Width of the shapes in cells."""
        return 32 if self.quick else 64

    def multigrid(self, mesh: Mesh, medium: Any, resolution: int, adaptive: bool = False,
                  device: Device | None = None) -> Multigrid:  # fmt: skip
        """The discrete equation in a solid."""
        device = device or self.device
        grid = cutcell.make_grid(mesh.bounds, resolution)
        refine = varies(medium) if adaptive else None
        tree = octree.build(device, grid, cutcell.sample_surface(device, grid, mesh), refine)
        sampled = diffusion.sample_medium(device, tree, medium, fresnel_A(medium.eta))
        return Multigrid(device, diffusion.make_operator(device, tree, sampled))


class TwoPoint(Residual):
    """Residual of the symmetric part that multigrid inverts: no gradients, ghosts are plain copies."""

    def __call__(self, phi: Field, b: Load, r: Load) -> None:
        """Overwrite `r` with b - A x on the leaves."""
        run, op, levels = self.device.run, self.op, self.op.octree.levels
        for coarse, x, fine in zip(levels[-2::-1], phi[-2::-1], phi[:0:-1], strict=True):
            m = coarse.covered.shape[0]
            run(self._average, m, m, coarse.covered, coarse.child, fine, x)
        copy = self.device.kernel("prolong", "copy_ghosts")
        for k, level in enumerate(levels[1:]):
            run(copy, level.n_ghost, level.n_ghost, level.n, level.parent, phi[k], phi[k + 1])
        last = levels[-1]
        run(self._residual, last.n, last.n, last.nbr, *op.two_point(-1), b[-1], phi[-1], r[-1])
        for k, level in enumerate(levels[:-1]):
            run(self._of_leaves, level.n, level.n, level.nbr, level.is_leaf, *op.two_point(k), b[k], phi[k], r[k])
            fine, m = levels[k + 1], level.interface.shape[0]
            run(self._reflux, m, m, fine.n, level.interface, level.interface_start, fine.ghost_face,
                op.T[k + 1].row, op.T[k + 1].values, phi[k + 1], r[k])  # fmt: skip


def fill_leaves(mg: Multigrid, out: PerLevel, values: Callable[[int], np.ndarray]) -> None:
    """Set a field to values(level) (n, 3) on the leaves."""
    for k, (level, x) in enumerate(zip(mg.op.octree.levels, out, strict=True)):
        host = np.zeros(x.shape)
        host[: level.n, :3] = values(k) * level.leaf[:, None]
        x.set(host)


def plain_cycles(mg: Multigrid, residual: Residual, b: Load, phi: Field, cycles: int, sweeps: int | None = None,
                 tolerance: float = 0.0) -> np.ndarray:  # fmt: skip
    """Residual norms (up to cycles + 1, 3) of e <- V(r) without acceleration, from the start to the tolerance.

    `sweeps` before and after the coarser level on every level; by default what the solver does.
    """
    smooth, norms = mg.smooth, []
    if sweeps is not None:
        mg.smooth = lambda k, _=None, from_zero=False: smooth(k, sweeps, from_zero)  # type: ignore[method-assign]
    while len(norms) <= cycles and (len(norms) < 2 or (norms[-1] > tolerance * norms[0]).any()):
        residual(phi, b, mg.r)
        norms.append(np.sqrt(mg.inner_product(mg.r, mg.r)))
        mg.v_cycle(len(mg.e) - 1)
        mg.combine(1, mg.e, 1, phi)
    mg.smooth = smooth  # type: ignore[method-assign]
    return np.array(norms)


def rate(mg: Multigrid, residual: Residual, sweeps: int | None = None, cycles: int = 20) -> np.ndarray:
    """Asymptotic residual reduction (3,) per cycle, from a random start with b = 0."""
    rng, levels = np.random.default_rng(0), mg.op.octree.levels
    phi = Field(mg.device, mg.op.octree)
    fill_leaves(mg, phi, lambda k: rng.uniform(-1, 1, (levels[k].n, 3)))
    norms = plain_cycles(mg, residual, Load(mg.device, mg.op.octree), phi, cycles, sweeps)
    return (norms[-1] / norms[-1 - LAST]) ** (1 / LAST)


def cycles_needed(mg: Multigrid, tolerance: float = 1e-8) -> tuple[np.ndarray, np.ndarray]:
    """Residuals (cycles + 1,) of the worst channel for q0 = 1: of plain cycles, and of `Multigrid.solve`."""
    volumes = mg.op.octree.volumes()
    b = Load(mg.device, mg.op.octree)
    fill_leaves(mg, b, lambda k: np.repeat(volumes[k][:, None], 3, axis=1))
    plain = plain_cycles(mg, mg.residual, b, Field(mg.device, mg.op.octree), 80, tolerance=tolerance)
    solved = mg.solve(b, Field(mg.device, mg.op.octree), tolerance, max_cycles=80)
    assert solved.converged, solved.residuals[-1]
    return (plain / plain[0]).max(axis=1), np.array([r.max() for r in solved.residuals])


def solve(mg: Multigrid, lights: list[Any], tolerance: float = 1e-9) -> tuple[Field, Source, Convergence]:
    """Fluence of a lit solid."""
    found = source.make_source(mg.device, mg.op.octree, mg.op.medium, lights, 1.0)
    phi = Field(mg.device, mg.op.octree)
    return phi, found, mg.solve(found.b, phi, tolerance)


def errors(bench: Bench, exact: problems.Exact, n: int, adaptive: bool = False) -> dict[str, np.ndarray]:
    """Relative errors (3,) of a solution with `n` cells along the diameter, and the number of leaves."""
    mesh = problems.round_ball(exact.radius)
    mg = bench.multigrid(mesh, exact.medium, n, adaptive)
    tree = mg.op.octree
    phi, found, convergence = solve(mg, [Emission(exact.q0)])
    assert convergence.converged
    values, wanted, weights = [], [], []
    for level, points, volume, x in zip(tree.levels, diffusion.cell_points(tree), tree.volumes(), phi, strict=True):
        values.append(x.get()[: level.n, :3][level.leaf])
        wanted.append(exact.phi(points[level.leaf]))
        weights.append(volume[level.leaf])
    out = {"leaves": np.full(3, tree.n_leaves)}
    out["phi L2"], out["phi Linf"] = norms(*map(np.concatenate, (values, wanted, weights)))
    phi_B = mg.residual.boundary_value(phi, found.moment)
    points, area = boundary_points(tree)[0], tree.cut.boundary.get()[:, 3]

    def on_sphere(points: np.ndarray) -> np.ndarray:
        return exact.phi(exact.radius * points / np.linalg.norm(points, axis=1, keepdims=True))

    out["surface L2"], out["surface Linf"] = norms(phi_B.get(), on_sphere(points), area)
    fitted = fluence_at(bench.device, tree, phi_B, mesh.vertices, mesh.normals)
    out["vertex L2"], out["vertex Linf"] = norms(fitted, on_sphere(mesh.vertices), np.ones(len(fitted)))
    return out


def norms(values: np.ndarray, exact: np.ndarray, weight: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Relative L2 and Linf errors (3,) of (n, 3)."""
    w = weight[:, None]
    mean = np.sqrt((w * (values - exact) ** 2).sum(axis=0) / (w * exact**2).sum(axis=0))
    return mean, np.abs(values - exact).max(axis=0) / np.abs(exact).max(axis=0)
