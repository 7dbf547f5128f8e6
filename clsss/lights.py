"""Lights: what falls on the surface from outside, and what shines inside.

    beam: irradiance E perpendicular to its direction of travel     lamp: E = I / r^2
    environment: E = sum of L dw over beams whose solid angles sum to 4 pi

Input: directions, positions [mm] and strengths, scalar or red, green, blue.
"""

from __future__ import annotations

import heapq
from dataclasses import dataclass
from typing import Any

import numpy as np

from clsss.errors import InputError
from clsss.materials import numbers, rgb


def _strength(name: str, value: Any) -> np.ndarray:
    array = rgb(name, value)
    if not np.all(np.isfinite(array)) or array.min() < 0:
        raise InputError(f"{name}: must be finite and not negative, got {value!r}")
    return array


def _vector(name: str, value: Any) -> np.ndarray:
    try:
        array = np.array(value, float)
    except (TypeError, ValueError):
        array = np.empty(0)
    if array.shape != (3,) or not np.all(np.isfinite(array)):
        raise InputError(f"{name}: needs three finite numbers, got {value!r}")
    return array


@dataclass(frozen=True, eq=False)
class DirectionalLight:
    """A parallel beam that covers the whole object.

    Parameters
    ----------
    direction : (3,) array_like
        Direction of travel; kept as a unit vector.
    irradiance : float or (3,) array_like
        Irradiance perpendicular to the beam [W/mm^2].
    """

    direction: np.ndarray
    irradiance: np.ndarray = 1.0  # type: ignore[assignment]

    def __post_init__(self) -> None:
        direction = _vector("direction", self.direction)
        with np.errstate(over="ignore"):
            length = np.linalg.norm(direction)
        if not 0 < length < np.inf:
            raise InputError("direction: must not be zero nor endless; give the direction the light travels in")
        direction = direction / length
        direction.setflags(write=False)
        object.__setattr__(self, "direction", direction)
        object.__setattr__(self, "irradiance", _strength("irradiance", self.irradiance))


@dataclass(frozen=True, eq=False)
class PointLight:
    """A lamp that shines equally in all directions.

    Parameters
    ----------
    position : (3,) array_like
        Where it is [mm], in the mesh's frame.
    intensity : float or (3,) array_like
        Radiant intensity [W/sr].
    """

    position: np.ndarray
    intensity: np.ndarray = 1.0  # type: ignore[assignment]

    def __post_init__(self) -> None:
        position = _vector("position", self.position)
        position.setflags(write=False)
        object.__setattr__(self, "position", position)
        object.__setattr__(self, "intensity", _strength("intensity", self.intensity))


@dataclass(frozen=True, eq=False)
class Emission:
    """An isotropic source inside the medium.

    Parameters
    ----------
    q0 : float, (3,) array_like or callable
        Power per volume [W/mm^3]; a callable takes points (n, 3) [mm] and gives (n,) or (n, 3).
    """

    q0: Any

    def __post_init__(self) -> None:
        if not callable(self.q0):
            object.__setattr__(self, "q0", _strength("q0", self.q0))

    def density(self, points: np.ndarray) -> np.ndarray:
        """Power per volume [W/mm^3], (n, 3), at points (n, 3) [mm]."""
        shape = (len(points), 3)
        if not callable(self.q0):
            return np.broadcast_to(self.q0, shape)
        values = numbers("q0", self.q0(points))
        if values.shape == shape[:1]:
            values = values[:, None]
        if values.shape not in (shape, (len(points), 1)):
            raise InputError(f"q0: must give ({len(points)},) or {shape} numbers, gave shape {values.shape}")
        if not np.all(np.isfinite(values)) or (values.size and values.min() < 0):
            raise InputError("q0: must give finite numbers that are not negative")
        return np.broadcast_to(values, shape)


@dataclass(frozen=True, eq=False)
class EnvironmentLight:
    """Light from all around, infinitely far away.

    Parameters
    ----------
    radiance : float, (3,) or (h, w, 3) array_like
        Radiance [W/mm^2/sr]: the same everywhere, or an equirectangular image. Its top row is the sky above
        (`up`); its middle column lies towards -z for up="y", towards +y for up="z".
    up : {"y", "z"}
        The axis that points to the top of the image.

    References
    ----------
    Debevec 2005, "A median cut algorithm for light probe sampling"; Swinbank and Purser 2006 for the
    constant sky's Fibonacci lattice.
    """

    radiance: np.ndarray
    up: str = "y"

    def __post_init__(self) -> None:
        if self.up not in ("y", "z"):
            raise InputError(f"up: must be 'y' or 'z', got {self.up!r}")
        radiance = numbers("radiance", self.radiance)
        if radiance.ndim < 3:
            radiance = _strength("radiance", radiance)
        elif radiance.ndim != 3 or radiance.shape[2] != 3 or radiance.size == 0:
            raise InputError(f"radiance: an image needs shape (h, w, 3), got {radiance.shape}")
        elif not np.all(np.isfinite(radiance)) or radiance.min() < 0:
            raise InputError("radiance: the image holds values that are negative or not finite")
        radiance.setflags(write=False)
        object.__setattr__(self, "radiance", radiance)

    def beams(self, n: int) -> list[DirectionalLight]:
        """The environment as directional lights, each standing for a part of the sphere.

        Every part's radiance, integrated over its solid angle, is its beam's irradiance, so nothing is lost;
        parts of an image hold about the same power each and the beam comes from their brightest region.

        Parameters
        ----------
        n : int
            How many; a few hundred for a smooth result. An image gives fewer where it has black parts.
        """
        if n < 1:
            raise InputError(f"n: an environment needs at least one beam, got {n}")
        if self.radiance.ndim == 1:
            i = np.arange(n) + 0.5
            z, azimuth = 1 - 2 * i / n, np.pi * (1 + 5**0.5) * i
            towards = np.stack([np.sqrt(1 - z * z) * f(azimuth) for f in (np.cos, np.sin)] + [z], axis=1)
            return [DirectionalLight(-d, self.radiance * (4 * np.pi / n)) for d in towards]
        power, moment = _pixels(self.radiance)
        if self.up == "y":
            moment = moment[..., [0, 2, 1]] * (1, 1, -1)
        parts = _median_cut(power.sum(axis=2), n)
        sums = [(power[p].sum(axis=(0, 1)), moment[p].sum(axis=(0, 1))) for p in parts]
        return [DirectionalLight(-m, p) for p, m in sums if p.sum() > 0]


def _pixels(radiance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Power and its first moment, z up, per cell of at most 256 x 512: (h, w, 3) each, radiance times dw."""
    repeats = [max(1, -(-m // s)) for m, s in zip((64, 128), radiance.shape[:2], strict=True)]
    fine = np.repeat(np.repeat(radiance, repeats[0], axis=0), repeats[1], axis=1)
    rows, columns = fine.shape[:2]
    z = np.cos(np.linspace(0, np.pi, rows + 1))
    polar = np.pi * (np.arange(rows) + 0.5) / rows
    azimuth = 2 * np.pi * (np.arange(columns) + 0.5) / columns - np.pi
    power = fine * ((z[:-1] - z[1:]) * (2 * np.pi / columns))[:, None, None]
    luminous = power.sum(axis=2)
    across = np.sin(polar)[:, None] * luminous
    moment = np.stack([across * np.sin(azimuth), across * np.cos(azimuth), np.cos(polar)[:, None] * luminous], axis=2)

    def reduce(values: np.ndarray) -> np.ndarray:
        starts = [np.unique(np.linspace(0, s, m, endpoint=False).astype(int)) for s, m in ((rows, 256), (columns, 512))]
        return np.add.reduceat(np.add.reduceat(values, starts[0], axis=0), starts[1], axis=1)

    return reduce(power), reduce(moment)


def _median_cut(power: np.ndarray, n: int) -> list[tuple[slice, slice]]:
    """Cut an equirectangular image into n rectangles, always the one with the most power times width."""
    rows, columns = power.shape

    def entry(top: int, bottom: int, left: int, right: int) -> tuple[float, int, int, int, int, bool]:
        height = (bottom - top) * np.pi / rows
        width = (right - left) * 2 * np.pi / columns * np.sin(np.pi * (top + bottom) / 2 / rows)
        tall = bottom - top > 1 and (height >= width or right - left == 1)
        wide = right - left > 1
        extent = float(max(height, width)) if tall or wide else 0.0
        return -float(power[top:bottom, left:right].sum()) * extent, top, bottom, left, right, tall

    heap = [entry(0, rows, 0, columns)]
    while len(heap) < n and heap[0][0] < 0:
        _, top, bottom, left, right, tall = heapq.heappop(heap)
        first, last = (top, bottom) if tall else (left, right)
        sums = np.cumsum(power[top:bottom, left:right].sum(axis=1 if tall else 0))
        cut = first + int(np.clip(np.searchsorted(sums, sums[-1] / 2) + 1, 1, last - first - 1))
        if tall:
            halves = [(top, cut, left, right), (cut, bottom, left, right)]
        else:
            halves = [(top, bottom, left, cut), (top, bottom, cut, right)]
        for half in halves:
            heapq.heappush(heap, entry(*half))
    return [(slice(top, bottom), slice(left, right)) for _, top, bottom, left, right, _ in heap]


Light = DirectionalLight | PointLight | Emission | EnvironmentLight
