"""Media that vary in space: two materials mixed, and voxel arrays.

    sigma_a(x) = (1 - w(x)) sigma_a,1 + w(x) sigma_a,2, and sigma_s' alike

Input: points (n, 3) [mm] in the mesh's frame; output: sigma_a and sigma_s (n, 3) [1/mm].
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from clsss.errors import InputError
from clsss.materials import Medium, check_boundary, check_coefficients, number, numbers, rgb


@dataclass(frozen=True, eq=False)
class Mix:
    """Two media, blended by a weight that varies in space: (1 - w) a + w b.

    sigma_a and sigma_s' are blended. g and eta, of which the model has one each, are the means of the two.

    Parameters
    ----------
    a, b : Medium
        `Material`, `Grid` or another `Mix`.
    weight : callable
        Points (n, 3) [mm] to (n,) in 0..1; `Perlin` is one. Values outside are clipped.
    """

    a: Medium
    b: Medium
    weight: Callable[[np.ndarray], np.ndarray]

    def __post_init__(self) -> None:
        for field in ("a", "b"):
            if not hasattr(getattr(self, field), "coefficients"):
                raise InputError(f"{field}: needs a Material, Mix or Grid, got {getattr(self, field)!r}")
        if not callable(self.weight):
            raise InputError(f"weight: needs a callable of points, such as Perlin(scale=5), got {self.weight!r}")

    @property
    def homogeneous(self) -> bool:
        """False: the coefficients vary in space."""
        return False

    @property
    def g(self) -> float:
        """Mean cosine of the scattering angle."""
        return (self.a.g + self.b.g) / 2

    @property
    def eta(self) -> float:
        """Index of refraction relative to the outside."""
        return (self.a.eta + self.b.eta) / 2

    def coefficients(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """sigma_a and sigma_s [1/mm], (n, 3) each, at points (n, 3) [mm]."""
        weight = numbers("weight", self.weight(points))
        if weight.shape != (len(points),) or not np.all(np.isfinite(weight)):
            raise InputError(f"weight: must give {len(points)} finite numbers, gave shape {weight.shape}")
        w = np.clip(weight, 0, 1)[:, None]
        (a_a, a_s), (b_a, b_s) = self.a.coefficients(points), self.b.coefficients(points)
        reduced = (1 - w) * (1 - self.a.g) * a_s + w * (1 - self.b.g) * b_s
        return (1 - w) * a_a + w * b_a, reduced / (1 - self.g)


@dataclass(frozen=True)
class Perlin:
    """Improved Perlin noise, mapped to 0..1: a smooth random weight for `Mix`.

    Parameters
    ----------
    scale : float
        Size of the features [mm]: the width of the noise's lattice cells.
    seed : int
        Chooses the permutation; the same seed gives the same noise.

    References
    ----------
    Perlin 2002, "Improving noise".
    """

    scale: float = 1.0
    seed: int = 0

    def __post_init__(self) -> None:
        if number("scale", self.scale) <= 0:
            raise InputError(f"scale: must be above 0, got {self.scale:g} mm")
        if not isinstance(self.seed, (int, np.integer)) or self.seed < 0:
            raise InputError(f"seed: needs a whole number, 0 or more, got {self.seed!r}")

    def __call__(self, points: np.ndarray) -> np.ndarray:
        """The weight (n,) in 0..1 at points (n, 3) [mm]."""
        table = np.random.default_rng(self.seed).permutation(256)
        edges = np.array([e for e in np.ndindex(3, 3, 3) if np.count_nonzero(np.array(e) - 1) == 2]) - 1
        scaled = np.asarray(points, float) / self.scale
        corner = np.floor(scaled).astype(np.int64)
        inside = scaled - corner
        fade = inside**3 * (inside * (6 * inside - 15) + 10)
        noise = np.zeros(len(scaled))
        for offset in np.ndindex(2, 2, 2):
            i, j, k = ((corner + offset) & 255).T
            gradient = edges[table[(table[(table[i] + j) & 255] + k) & 255] % len(edges)]
            share = np.prod(np.where(offset, fade, 1 - fade), axis=1)
            noise += share * np.einsum("ij,ij->i", gradient, inside - offset)
        return np.clip(0.5 + 0.5 * noise, 0, 1)


def _check_frame(origin: Any, spacing: Any) -> tuple[np.ndarray, np.ndarray]:
    origin, spacing = rgb("origin", origin), rgb("spacing", spacing)
    if not (np.all(np.isfinite(origin)) and np.all(np.isfinite(spacing)) and spacing.min() > 0):
        raise InputError("origin, spacing: must be finite, spacing above 0 mm")
    return origin, spacing


def _trilinear(values: np.ndarray, origin: np.ndarray, spacing: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Voxels (nx, ny, nz) at points (n, 3): between voxel centres, and constant beyond the outermost."""
    from scipy.ndimage import map_coordinates

    index = ((np.asarray(points, float) - origin) / spacing - 0.5).T
    return map_coordinates(values, index, order=1, mode="nearest")


@dataclass(frozen=True, eq=False)
class Voxels:
    """A weight for `Mix` from voxels, trilinear between voxel centres and constant beyond the outermost.

    Parameters
    ----------
    values : (nx, ny, nz) array_like
        In 0..1.
    origin, spacing : (3,) array_like, float or (3,) array_like
        As in `Grid` [mm].
    """

    values: np.ndarray
    origin: np.ndarray
    spacing: np.ndarray

    def __post_init__(self) -> None:
        values = numbers("values", self.values)
        if values.ndim != 3 or values.size == 0 or not np.all(np.isfinite(values)):
            raise InputError(f"values: needs finite numbers of shape (nx, ny, nz), got shape {values.shape}")
        if values.min() < 0 or values.max() > 1:
            raise InputError(f"values: a weight lies within 0 and 1, got {values.min():g} to {values.max():g}")
        origin, spacing = _check_frame(self.origin, self.spacing)
        for field, value in (("values", values), ("origin", origin), ("spacing", spacing)):
            object.__setattr__(self, field, value)

    def __call__(self, points: np.ndarray) -> np.ndarray:
        """The weight (n,) at points (n, 3) [mm]."""
        return _trilinear(self.values, self.origin, self.spacing, points)


def _voxels(name: str, values: Any) -> np.ndarray:
    array = numbers(name, values)
    if array.ndim == 3:
        array = np.repeat(array[..., None], 3, axis=3)
    if array.ndim != 4 or array.shape[3] != 3 or array.size == 0:
        raise InputError(f"{name}: needs shape (nx, ny, nz) or (nx, ny, nz, 3), got {array.shape}")
    array.setflags(write=False)
    return array


@dataclass(frozen=True, eq=False)
class Grid:
    """Coefficients from voxels, trilinear between voxel centres and constant beyond the outermost.

    Parameters
    ----------
    sigma_a, sigma_s : (nx, ny, nz) or (nx, ny, nz, 3) array_like
        Coefficients [1/mm], in the mesh's frame.
    origin : (3,) array_like
        Lower corner of the first voxel [mm]; its centre is half a spacing further.
    spacing : float or (3,) array_like
        Size of a voxel [mm].
    g, eta : float
        As in `Material`.
    """

    sigma_a: np.ndarray
    sigma_s: np.ndarray
    origin: np.ndarray
    spacing: np.ndarray
    g: float = 0.0
    eta: float = 1.0

    def __post_init__(self) -> None:
        g, eta = check_boundary(self.g, self.eta)
        origin, spacing = _check_frame(self.origin, self.spacing)
        sigma_a, sigma_s = _voxels("sigma_a", self.sigma_a), _voxels("sigma_s", self.sigma_s)
        if sigma_a.shape != sigma_s.shape:
            raise InputError(f"sigma_s: has shape {sigma_s.shape} but sigma_a has {sigma_a.shape}")
        check_coefficients(sigma_a, sigma_s)
        fields = ("sigma_a", "sigma_s", "origin", "spacing", "g", "eta")
        for field, value in zip(fields, (sigma_a, sigma_s, origin, spacing, g, eta), strict=True):
            object.__setattr__(self, field, value)

    @property
    def homogeneous(self) -> bool:
        """False: the coefficients vary in space."""
        return False

    def coefficients(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """sigma_a and sigma_s [1/mm], (n, 3) each, at points (n, 3) [mm]."""

        def sample(values: np.ndarray) -> np.ndarray:
            channels = [_trilinear(values[..., c], self.origin, self.spacing, points) for c in range(3)]
            return np.stack(channels, axis=1)

        return sample(self.sigma_a), sample(self.sigma_s)
