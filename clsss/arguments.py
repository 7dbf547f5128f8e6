"""What callers may give `simulate`, and whether the machine can hold it: one clear sentence where not."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from clsss.diffusion import PHASES
from clsss.errors import DeviceError, InputError
from clsss.lights import DirectionalLight, Emission, EnvironmentLight, PointLight
from clsss.mesh import Mesh, opaque_triangles, require_volume

BYTES_PER_CELL = 450  # host and device together, at the peak
BYTES_PER_GRID_CELL = 4  # of the dense box, while the octree is built


def check(mesh: Any, medium: Any, resolution: Any, tolerance: Any, phase: Any, scattering: Any,
          blockers: Any) -> None:  # fmt: skip
    """Refuse arguments of `simulate` that are of the wrong kind or out of range.

    Raises
    ------
    InputError
    """
    if not isinstance(mesh, Mesh):
        raise InputError(f"mesh: needs a mesh from clsss.load_mesh, got {mesh!r}")
    require_volume(mesh)
    if not hasattr(medium, "coefficients"):
        raise InputError(f"medium: needs a Material, Mix or Grid (clsss.material('marble') is one), got {medium!r}")
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


def checked_lights(lights: Any) -> tuple[Any, ...]:
    """The lights as a tuple.

    Raises
    ------
    InputError
        There is none, or one is no light.
    """
    kinds = (DirectionalLight, PointLight, EnvironmentLight, Emission)
    found = tuple(lights) if isinstance(lights, Sequence) and not isinstance(lights, str) else (lights,)
    if not found:
        raise InputError("lights: give at least one light")
    for light in found:
        if not isinstance(light, kinds):
            names = ", ".join(kind.__name__ for kind in kinds)
            raise InputError(f"lights: {light!r} is no light; use {names}")
    return found


def checked_points(points: Any) -> np.ndarray:
    """Points as (n, 3) float64.

    Raises
    ------
    InputError
        They have another shape, or are not finite numbers.
    """
    try:
        array = np.asarray(points, float)
    except (TypeError, ValueError):
        raise InputError(f"points: needs finite numbers of shape (n, 3), got {points!r}") from None
    if array.ndim != 2 or array.shape[1] != 3 or not np.isfinite(array).all():
        raise InputError(f"points: needs finite numbers of shape (n, 3), got shape {array.shape}")
    return array


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
