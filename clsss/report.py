"""What a bake did, as data: mesh, octree, convergence, energy, seconds, memory.

Its energy balances: absorbed + exited = deposited.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from clsss import __version__
from clsss.lighting import Setup, Solution
from clsss.octree import Octree
from clsss.validity import thin_shares

CHUNK = 1 << 15  # cells at a time, so that what is reckoned with takes little memory


def account(setup: Setup, solution: Solution, seconds: dict[str, float]) -> dict[str, Any]:
    """The report of a bake just made, of which the device still holds the fluence; `seconds` are of its stages."""
    tree, convergence = setup.octree, solution.convergence
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
            "exited_W": (_exited(tree, solution) * solution.unit).tolist(),
        },
        "seconds": {key.replace(" ", ""): round(value, 4) for key, value in seconds.items()},
        "memory_mb": {
            "device": (setup.device.peak - setup.bytes_before) / 2**20,
            "peak_rss": _peak_rss_mb(),
        },
    }


def _exited(tree: Octree, solution: Solution) -> np.ndarray:
    """Power (3,) that leaves for good, in multiples of `unit`."""
    exited = np.zeros(3)
    for first, flux in solution.flux.parts():
        exited += tree.cut.boundary.get(first, len(flux))[:, 3].astype(float) @ flux
    return exited * tree.grid.h**2


def _absorbed(setup: Setup, solution: Solution) -> np.ndarray:
    """Power absorbed (3,), in multiples of `unit`: by the cells, and in a fitted layer on the way from and to them."""
    tree, medium, layer = setup.octree, setup.medium, setup.layer
    absorbed = solution.source.lost / solution.unit
    rate = np.array(medium.sigma_a[-1].tolist())[:3] if medium.homogeneous else np.ones(3)
    for level, x, sigma_a in zip(tree.levels, setup.hold(solution.phi), medium.sigma_a, strict=True):
        for first in range(0, level.n, CHUNK):
            n = min(CHUNK, level.n - first)
            some = x.get(first, n).astype(float)[:, :3]  # four numbers convert in half the time of three
            if not medium.homogeneous:
                some *= sigma_a[first : first + n, :3]
            if layer and level is tree.finest:
                absorbed += rate * (layer.volume.rows(first, n) * some).sum(axis=0)
                continue
            volume = tree.volume(level, first, n)
            absorbed += rate * ((volume * level.is_leaf.get(first, n) if level.child else volume) @ some)
    if layer and solution.moment is not None:
        absorbed -= (layer.conductance.get() * (layer.swell.get() - 1) * solution.moment.get()).sum(axis=0)
    return absorbed


def _peak_rss_mb() -> float:
    """Most memory that this process has held [MB]; `getrusage` may count its parent's."""
    try:
        with open("/proc/self/status", encoding="ascii") as status:
            return next(float(line.split()[1]) / 2**10 for line in status if line.startswith("VmHWM"))
    except (OSError, StopIteration):
        import resource

        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**10
