"""What a bake did, as data: mesh, octree, convergence, energy, seconds, memory.

Its energy balances: absorbed + exited = deposited.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from clsss import __version__
from clsss.device import Buffer
from clsss.lighting import Setup, Solution
from clsss.validity import thin_shares

CHUNK = 1 << 16  # cells at a time, so that what is reckoned with takes little memory


def account(setup: Setup, solution: Solution, seconds: dict[str, float]) -> dict[str, Any]:
    """The report of a bake just made, of which the device still holds the fluence; `seconds` are of its stages."""
    tree, convergence = setup.octree, solution.convergence
    area = tree.cut.boundary.get()[:, 3].astype(float) * tree.grid.h**2
    exited = area @ solution.flux
    return {
        "clsss": __version__,
        "device": setup.device.name,
        "precision": setup.device.precision,
        "mesh": {key: setup.mesh.report[key] for key in ("faces", "vertices", "closed", "repairs", "size_mm")},
        "octree": {
            "levels": len(tree.levels),
            "cells": tree.n_cells,
            "leaves": tree.n_leaves,
            "cut_cells": tree.cut.n,
            "cells_per_level": [level.n for level in tree.levels],
            "h_mm": tree.grid.h,
            "thinner_than": thin_shares(tree.thickness),
        },
        "solve": {
            "cycles": convergence.cycles,
            "residuals": [r.tolist() for r in convergence.residuals],
            "converged": convergence.converged,
            "factor": convergence.factor,
        },
        "exchange": {
            "patches": setup.coupling.patches if setup.coupling else 0,
            "rays": setup.coupling.rays if setup.coupling else 0,
        },
        "energy": {
            "incident_W": solution.source.incident.tolist(),
            "deposited_W": solution.source.deposited.tolist(),
            "absorbed_W": (_absorbed(setup, solution) * solution.unit).tolist(),
            "exited_W": (exited * solution.unit).tolist(),
        },
        "seconds": {key.replace(" ", ""): round(value, 4) for key, value in seconds.items()},
        "memory_mb": {
            "device": (setup.device.peak - setup.bytes_before) / 2**20,
            "peak_rss": _peak_rss_mb(),
        },
    }


def _weighted(values: Buffer, weights: np.ndarray, sigma_a: np.ndarray | None) -> np.ndarray:
    """Sum (3,) over cells of values (n, 4), times weights (n,) or (n, 3) and, where it varies, sigma_a (n, 3)."""
    summed = np.zeros(3)
    for first in range(0, len(weights), CHUNK):
        weight = weights[first : first + CHUNK]
        some = values.get(first, len(weight))[:, :3].astype(float)
        if sigma_a is not None:
            some *= sigma_a[first : first + CHUNK, :3]
        summed += weight @ some if weight.ndim == 1 else (weight * some).sum(axis=0)
    return summed


def _absorbed(setup: Setup, solution: Solution) -> np.ndarray:
    """Power absorbed (3,), in multiples of `unit`: by the cells, and in a fitted layer on the way from and to them."""
    tree, medium, layer = setup.octree, setup.medium, setup.layer
    absorbed = solution.source.lost / solution.unit
    rate = np.array(medium.sigma_a[-1].tolist())[:3] if medium.homogeneous else np.ones(3)
    for level, x, sigma_a in zip(tree.levels, setup.hold(solution.phi), medium.sigma_a, strict=True):
        volume = layer.volume if layer and level is tree.finest else tree.volume(level) * level.leaf
        absorbed += rate * _weighted(x, volume, None if medium.homogeneous else sigma_a)
    if layer and solution.moment is not None:
        absorbed -= (layer.conductance * (layer.swell - 1) * solution.moment).sum(axis=0)
    return absorbed


def _peak_rss_mb() -> float:
    """Most memory that this process has held [MB]; `getrusage` may count its parent's."""
    try:
        with open("/proc/self/status", encoding="ascii") as status:
            return next(float(line.split()[1]) / 2**10 for line in status if line.startswith("VmHWM"))
    except (OSError, StopIteration):
        import resource

        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**10
