"""What a bake did, as data: mesh, octree, convergence, energy, seconds, memory.

Its energy balances: absorbed + exited = deposited.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from clsss import __version__
from clsss.kept import kept
from clsss.lighting import Setup, Solution
from clsss.octree import Octree
from clsss.validity import thin_shares


def account(setup: Setup, solution: Solution, seconds: dict[str, float]) -> dict[str, Any]:
    """The report of a bake; `seconds` are those of its stages."""
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
            "patches": 0 if setup.exchange is None else setup.exchange.share.shape[0],
            "rays": 0 if setup.exchange is None else setup.exchange.rays,
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


@kept
def _leaf_volumes(tree: Octree) -> list[np.ndarray]:
    """Volume inside the object (n,) of the leaves of each level, zero of other cells [mm^3]."""
    return [volume * level.leaf for level, volume in zip(tree.levels, tree.volumes(), strict=True)]


def _absorbed(setup: Setup, solution: Solution) -> np.ndarray:
    """Power absorbed (3,), in multiples of `unit`: by the cells, and in a fitted layer on the way from and to them."""
    tree, medium, layer = setup.octree, setup.medium, setup.layer
    absorbed = solution.source.lost / solution.unit
    for level, x, volume, sigma_a in zip(tree.levels, solution.phi, _leaf_volumes(tree), medium.sigma_a, strict=True):
        values, rate = x[: level.n, :3].astype(float), np.ones(3)
        if medium.homogeneous:
            rate = np.array(sigma_a.tolist())[:3]
        else:
            values *= sigma_a[:, :3]
        if layer and level is tree.finest:
            absorbed += rate * (layer.volume * values).sum(axis=0)
        else:
            absorbed += rate * (volume @ values)
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
