"""What the solver is compared with: the dipole, and Monte Carlo path tracing.

Input: mesh, medium, lights, as for `clsss.simulate`. Output: radiosity [W/mm^2].
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from clsss.dipole import dipole
from clsss.materials import Medium
from clsss.mesh import Mesh
from clsss.montecarlo import Estimate, PathWarning, estimate

__all__ = ["Estimate", "PathWarning", "dipole", "estimate", "monte_carlo"]


def monte_carlo(
    mesh: Mesh,
    material: Medium,
    lights: Sequence[Any],
    n_paths: int = 1000,
    points: Any = None,
    normals: Any = None,
    seed: int = 0,
    blockers: Sequence[Mesh] = (),
) -> tuple[np.ndarray, np.ndarray]:
    """Radiosity at points on the surface by random walks; `estimate` splits it by orders of scattering.

    Parameters
    ----------
    mesh : Mesh
        The solid.
    material : Medium
        What fills it.
    lights : sequence
        Directional, point and environment lights, and emission.
    n_paths : int
        Paths per point and channel.
    points, normals : (n, 3) array_like, optional
        Points on the surface [mm], by default the mesh's vertices, and outward normals.
    seed : int
        Of the random numbers.
    blockers : sequence of Mesh
        Opaque black surfaces, closed or open, in the light's way.

    Returns
    -------
    radiosity, stderr : (n, 3) float64
        Of light scattered at least once and of emission, and its standard error [W/mm^2].
    """
    result = estimate(mesh, material, lights, n_paths, points, normals, seed, blockers=blockers)
    return result.radiosity, result.stderr
