"""What callers may give every method, ours and those it is compared with: one clear sentence where it is wrong."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from clsss.errors import InputError
from clsss.lights import DirectionalLight, Emission, EnvironmentLight, PointLight
from clsss.mesh import Mesh


def check_object(mesh: Any, medium: Any, name: str = "medium") -> None:
    """Refuse what is no mesh, or no medium to fill it; `name` is what callers know that by.

    Raises
    ------
    InputError
    """
    if not isinstance(mesh, Mesh):
        raise InputError(f"mesh: needs a mesh from clsss.load_mesh, got {mesh!r}")
    if not hasattr(medium, "coefficients"):
        raise InputError(f"{name}: needs a Material, Mix or Grid (clsss.material('marble') is one), got {medium!r}")


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


def checked_points(points: Any, name: str = "points") -> np.ndarray:
    """Points, or other vectors, as (n, 3) float64.

    Raises
    ------
    InputError
        They have another shape, or are not finite numbers.
    """
    try:
        array = np.asarray(points, float)
    except (TypeError, ValueError):
        raise InputError(f"{name}: needs finite numbers of shape (n, 3), got {points!r}") from None
    if array.ndim != 2 or array.shape[1] != 3 or not np.isfinite(array).all():
        raise InputError(f"{name}: needs finite numbers of shape (n, 3), got shape {array.shape}")
    return array
