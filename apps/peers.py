"""Algebraic multigrid on the matrix that the two-point operator is, next to clsss's own solver.

On a uniform grid the operator (diffusion.py, coefficients.cl) is a symmetric 7-point matrix per channel. PyAMG gets
it as scipy's CSR, its hierarchy built and then solved by CG preconditioned with a V-cycle, channel by channel; clsss
builds its operator and levels from the same octree and solves its own second-order equation, all channels at once.
"""

from __future__ import annotations

import statistics
from dataclasses import dataclass
from time import perf_counter
from typing import Any

import numpy as np
import problems
from scipy import sparse

from clsss import Emission, cutcell, diffusion, octree, source
from clsss.device import Device
from clsss.fields import Field
from clsss.fresnel import fresnel_A
from clsss.multigrid import Multigrid

MEDIUM = problems.layer(np.array([2.0, 3.0, 4.0]), 0.998)
RADIUS = 10.0  # mm
RUNS = 3  # of clsss; the median counts


@dataclass(frozen=True)
class Comparison:
    """Seconds, set-up and solve together, to one tolerance; three channels.

    Attributes
    ----------
    cells : int
    tolerance : float
        Of the relative residual's 2-norm.
    precision : str
        Of clsss: single where that gets there.
    ours, cycles
        Of clsss.
    peers : dict
        Seconds (set-up, solve) of each, and its iterations.
    mismatch : float
        Greatest difference of the CSR matrix times a vector from what the kernel makes of it, relative.
    """

    cells: int
    tolerance: float
    precision: str
    ours: tuple[float, float]
    cycles: int
    peers: dict[str, tuple[float, float, int]]
    mismatch: float

    @property
    def speedup(self) -> float:
        """Of the fastest peer."""
        return min(set_up + solve for set_up, solve, _ in self.peers.values()) / sum(self.ours)

    def __str__(self) -> str:
        lines = [f"\nuniform ball, {self.cells} cells, three channels to {self.tolerance:g}, set-up + solve in seconds"]
        set_up, solve = self.ours
        lines.append(f"  clsss, {self.precision:<27} {set_up:>7.3f} + {solve:>7.3f}   {self.cycles} cycles")
        for name, (set_up, solve, iterations) in self.peers.items():
            lines.append(f"  {name:<34} {set_up:>7.3f} + {solve:>7.3f}   {iterations} iterations")
        lines.append(f"  {self.speedup:.1f} times the fastest; CSR against the kernel: {self.mismatch:.0e}")
        return "\n".join(lines)


def matrix(op: diffusion.Operator, channel: int) -> sparse.csr_matrix:
    """The two-point operator of one channel on the finest level."""
    level = op.octree.finest
    n, nbr = level.n, level.nbr.get()
    T = op.T[-1].get().astype(float).reshape(n, 6, -1)
    T = T[:, :, min(channel, T.shape[2] - 1)]
    rows = np.arange(n)
    diagonal = op.absorb[-1].get()[:, channel].astype(float) + T.sum(axis=1)
    beside = (nbr != rows[:, None]) & (nbr < n)
    coupled = sparse.coo_matrix((-T[beside], (np.repeat(rows, 6).reshape(n, 6)[beside], nbr[beside])), (n, n))
    return sparse.csr_matrix(coupled + sparse.diags(diagonal))


def _mismatch(device: Device, op: diffusion.Operator, A: sparse.csr_matrix) -> float:
    """Of A x and the kernel's, for a random x."""
    n, rng = op.octree.finest.n, np.random.default_rng(0)
    x = rng.uniform(size=(n, 4)).astype(device.real)
    r = device.empty((n, 3))
    finest = op.octree.finest
    device.run(device.kernel("residual", "residual", *op.medium.defines), n, n, finest.nbr, *op.two_point(-1),
               device.zeros((n, 3)), device.array(x), r)  # fmt: skip
    mine = -r.get()[:, 0].astype(float)
    return float(np.abs(A @ x[:, 0].astype(float) - mine).max() / np.abs(A.diagonal()).max())


def _solve_ours(device: Device, tree: octree.Octree, tolerance: float) -> tuple[Any, ...]:
    """Median seconds (set-up, solve); the convergence, operator and right-hand side."""
    times: list[tuple[float, float]] = []
    for _ in range(RUNS + 1):
        device.finish()
        start = perf_counter()
        medium = diffusion.sample_medium(device, tree, MEDIUM, fresnel_A(MEDIUM.eta))
        op = diffusion.make_operator(device, tree, medium)
        mg = Multigrid(device, op)
        device.finish()
        ready = perf_counter()
        b = source.make_source(device, tree, medium, [Emission(1.0)], 1.0).b
        phi = Field(device, tree)
        device.finish()
        begin = perf_counter()
        convergence = mg.solve(b, phi, tolerance)
        device.finish()
        times.append((ready - start, perf_counter() - begin))
    median = sorted(times[1:], key=sum)[RUNS // 2]
    return median, convergence, op, b


def compare(resolution: int, tolerance: float) -> Comparison:
    """Solve in a uniform ball of `resolution` cells across."""
    import pyamg

    mesh = problems.round_ball(RADIUS, 6)
    for precision in ("single", "double"):
        device = Device(precision=precision)
        grid = cutcell.make_grid(mesh.bounds, resolution)
        tree = octree.build(device, grid, cutcell.sample_surface(device, grid, mesh))
        ours, convergence, op, b = _solve_ours(device, tree, tolerance)
        if convergence.converged:
            break
    n = tree.finest.n
    right = b[-1].get()[:n].astype(float)
    systems = [matrix(op, channel) for channel in range(3)]
    peers = {}
    for name, build in (("PyAMG, Ruge-Stueben, CG", pyamg.ruge_stuben_solver),
                        ("PyAMG, smoothed aggregation, CG", pyamg.smoothed_aggregation_solver)):  # fmt: skip
        set_up, solve, counts = 0.0, 0.0, []
        for channel, A in enumerate(systems):
            start = perf_counter()
            hierarchy = build(A)
            ready = perf_counter()
            residuals: list[float] = []
            x = hierarchy.solve(right[:, channel], tol=tolerance, accel="cg", residuals=residuals)
            solve += perf_counter() - ready
            set_up += ready - start
            counts.append(len(residuals) - 1)
            reached = np.linalg.norm(right[:, channel] - A @ x) / np.linalg.norm(right[:, channel])
            assert reached <= 2 * tolerance, (name, reached)
        peers[name] = (set_up, solve, round(statistics.mean(counts)))
    mismatch = _mismatch(device, op, systems[0])
    return Comparison(n, tolerance, device.precision, ours, convergence.cycles, peers, mismatch)
