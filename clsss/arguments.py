"""What callers may give `simulate` alone, and whether the machine can hold it: one clear sentence where not."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from clsss.diffusion import PHASES
from clsss.errors import DeviceError, InputError
from clsss.mesh import Mesh, opaque_triangles, require_volume
from clsss.problem import check_object

BYTES_PER_CELL = 450  # host and device together, at the peak
BYTES_PER_GRID_CELL = 4  # of the dense box, while the octree is built


def check(mesh: Any, medium: Any, resolution: Any, tolerance: Any, phase: Any, scattering: Any,
          blockers: Any) -> None:  # fmt: skip
    """Refuse arguments of `simulate` that are of the wrong kind or out of range.

    Raises
    ------
    InputError
    """
    check_object(mesh, medium)
    require_volume(mesh)
    check_solver(resolution, tolerance)
    if phase not in PHASES:
        raise InputError(f"phase: unknown value {phase!r}; use {', '.join(PHASES)}")
    if scattering not in ("all", "split"):
        raise InputError(f"scattering: unknown value {scattering!r}; use all or split")
    opaque_triangles(blockers)


def check_solver(resolution: Any, tolerance: Any) -> None:
    """Refuse a resolution or a tolerance of the wrong kind or out of range.

    Raises
    ------
    InputError
    """
    whole = isinstance(resolution, (int, float, np.number)) and not isinstance(resolution, bool)
    if not whole or not np.isfinite(resolution) or resolution != int(resolution) or resolution < 4:
        raise InputError(f"resolution: needs a whole number of at least 4 cells, got {resolution!r}")
    if not isinstance(tolerance, (float, np.floating)) or not 0 < tolerance < 1:
        raise InputError(f"tolerance: needs a number between 0 and 1, got {tolerance!r}")


def needed_bytes(mesh: Mesh, resolution: int) -> float:
    """Memory that a bake takes at its peak, estimated from volume and area."""
    h = mesh.size / resolution
    area, volume = mesh.area_and_volume[0] / h**2, mesh.area_and_volume[1] / h**3
    box = np.prod(np.ptp(mesh.bounds, axis=0) / h + 8)
    return BYTES_PER_CELL * (min(volume, 12 * area) + 2 * area) + BYTES_PER_GRID_CELL * box


def check_memory(mesh: Mesh, resolution: int) -> None:
    """Refuse what cannot fit, before anything is allocated.

    Raises
    ------
    DeviceError
        Names the largest resolution that fits.
    """
    import psutil

    free = psutil.virtual_memory().available
    needed = needed_bytes(mesh, resolution)
    if needed <= free:
        return
    fits, too_large = 1, resolution
    while too_large - fits > 1:
        middle = (fits + too_large) // 2
        fits, too_large = (middle, too_large) if needed_bytes(mesh, middle) <= 0.9 * free else (fits, middle)
    raise DeviceError(
        f"resolution {resolution} needs about {needed / 2**30:.1f} GB of memory and {free / 2**30:.1f} GB are free; "
        f"use {fits} or less"
    )


def reporter(progress: bool | Callable[[str, float], None] | None) -> Callable[[str, float], None]:
    """What to call with ``(stage, fraction)``: a caller's own, one that prints, or one that does nothing."""
    if callable(progress):
        return progress
    if progress:
        return lambda stage, fraction: print(f"{stage}: {100 * fraction:.0f} %", flush=True)
    return lambda stage, fraction: None
