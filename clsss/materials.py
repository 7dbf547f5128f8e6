"""Optical coefficients of the medium.

    sigma_s' = (1 - g) sigma_s     sigma_tr = sigma_a + sigma_s'     D = 1 / (3 sigma_tr)

Input: coefficients [1/mm], scalar or red, green, blue. Everything that can fill a mesh is a `Medium`: here
`Material`, in media.py what varies in space.
"""

from __future__ import annotations

import difflib
import functools
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from clsss.errors import InputError
from clsss.fresnel import fresnel_A

TABLE = Path(__file__).parent / "materials.json"


class Medium(Protocol):
    """What fills a mesh: `Material`, `Mix`, `Grid`, or anything with these members."""

    @property
    def homogeneous(self) -> bool:
        """Whether the coefficients are the same everywhere."""

    @property
    def g(self) -> float:
        """Mean cosine of the scattering angle."""

    @property
    def eta(self) -> float:
        """Index of refraction relative to the outside."""

    def coefficients(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """sigma_a and sigma_s [1/mm], (n, 3) each, at points (n, 3) [mm]."""


def rgb(name: str, value: Any) -> np.ndarray:
    """One number or three as a read-only (3,) array, or an InputError that names the field."""
    try:
        array = np.array(np.broadcast_to(np.asarray(value, float), (3,)))
    except (TypeError, ValueError):
        raise InputError(f"{name}: needs one number or three (red, green, blue), got {value!r}") from None
    array.setflags(write=False)
    return array


def numbers(name: str, values: Any) -> np.ndarray:
    """A copy of the values as an array of float64, or an InputError that names the field."""
    try:
        return np.array(values, float)
    except (TypeError, ValueError):
        raise InputError(f"{name}: needs an array of numbers, got {repr(values)[:60]}") from None


def check_coefficients(sigma_a: np.ndarray, sigma_s: np.ndarray, name_s: str = "sigma_s") -> None:
    """InputError unless sigma_a >= 0 and sigma_s > 0, all finite."""
    for name, array in (("sigma_a", sigma_a), (name_s, sigma_s)):
        if not np.all(np.isfinite(array)):
            raise InputError(f"{name}: must be finite, got {array[~np.isfinite(array)].flat[0]}")
        if array.min() < 0:
            raise InputError(f"{name}: must not be negative, got {array.min():g} 1/mm")
    if sigma_s.min() == 0:
        raise InputError(
            f"{name_s}: must be above 0 in every channel; light does not diffuse where nothing scatters"
        )


def number(name: str, value: Any) -> float:
    """A finite number, or an InputError that names the field."""
    try:
        result = float(value)
    except (TypeError, ValueError):
        raise InputError(f"{name}: needs one number, got {value!r}") from None
    if not np.isfinite(result):
        raise InputError(f"{name}: must be finite, got {value!r}")
    return result


def check_boundary(g: Any, eta: Any) -> tuple[float, float]:
    """The two as numbers, or an InputError that names the one out of range."""
    g, eta = number("g", g), number("eta", eta)
    if not -1 < g < 1:
        raise InputError(f"g: must lie between -1 and 1, got {g:g}")
    if eta <= 0:
        raise InputError(f"eta: must be above 0, got {eta:g}")
    return g, eta


@dataclass(frozen=True, eq=False)
class Material:
    """A homogeneous medium.

    Parameters
    ----------
    sigma_a : float or (3,) array_like
        Absorption coefficient [1/mm]; may be 0.
    sigma_s : float or (3,) array_like
        Scattering coefficient [1/mm], above 0. Tables that list sigma_s' go to `from_reduced`.
    g : float
        Mean cosine of the scattering angle, in (-1, 1).
    eta : float
        Index of refraction relative to the outside.
    name, source : str
        What it is called, and where the numbers come from.

    Raises
    ------
    InputError
        A value is negative, not finite, out of range or of the wrong shape.
    """

    sigma_a: np.ndarray
    sigma_s: np.ndarray
    g: float = 0.0
    eta: float = 1.0
    name: str = ""
    source: str = ""

    def __post_init__(self) -> None:
        g, eta = check_boundary(self.g, self.eta)
        sigma_a, sigma_s = rgb("sigma_a", self.sigma_a), rgb("sigma_s", self.sigma_s)
        check_coefficients(sigma_a, sigma_s)
        for field, value in (("sigma_a", sigma_a), ("sigma_s", sigma_s), ("g", g), ("eta", eta)):
            object.__setattr__(self, field, value)

    @classmethod
    def from_reduced(
        cls,
        sigma_a: Any,
        sigma_s_prime: Any,
        eta: float = 1.0,
        g: float = 0.0,
        name: str = "",
        source: str = "",
    ) -> Material:
        """A material from sigma_s' = (1 - g) sigma_s, which is what tables of measured materials list.

        Parameters
        ----------
        sigma_a, sigma_s_prime : float or (3,) array_like
            Absorption and reduced scattering coefficients [1/mm].
        eta, g : float
            As in `Material`; without a known g, 0 keeps diffusion exact.
        name, source : str
            As in `Material`.
        """
        g, eta = check_boundary(g, eta)
        reduced = rgb("sigma_s_prime", sigma_s_prime)
        check_coefficients(rgb("sigma_a", sigma_a), reduced, "sigma_s_prime")
        return cls(sigma_a, reduced / (1 - g), g, eta, name, source)

    @property
    def homogeneous(self) -> bool:
        """True: the coefficients are the same everywhere."""
        return True

    @property
    def sigma_s_prime(self) -> np.ndarray:
        """Reduced scattering (1 - g) sigma_s [1/mm], (3,)."""
        return (1 - self.g) * self.sigma_s

    @property
    def sigma_t(self) -> np.ndarray:
        """Extinction sigma_a + sigma_s [1/mm], (3,)."""
        return self.sigma_a + self.sigma_s

    @property
    def sigma_tr(self) -> np.ndarray:
        """Transport coefficient sigma_a + sigma_s' [1/mm], (3,)."""
        return self.sigma_a + self.sigma_s_prime

    @property
    def sigma_eff(self) -> np.ndarray:
        """Effective attenuation sqrt(3 sigma_a sigma_tr) [1/mm], (3,): 1 over the diffusion length."""
        return np.sqrt(3 * self.sigma_a * self.sigma_tr)

    @property
    def D(self) -> np.ndarray:
        """Diffusion coefficient 1 / (3 sigma_tr) [mm], (3,)."""
        return 1 / (3 * self.sigma_tr)

    @property
    def albedo(self) -> np.ndarray:
        """Reduced albedo sigma_s' / sigma_tr, (3,)."""
        return self.sigma_s_prime / self.sigma_tr

    @property
    def diffuse_reflectance(self) -> np.ndarray:
        """Share of perpendicular light, once inside, that a half space gives back, (3,)."""
        return diffuse_reflectance(self.albedo, self.eta)

    def coefficients(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """sigma_a and sigma_s [1/mm], (n, 3) each, at points (n, 3) [mm]."""
        shape = (len(points), 3)
        return np.broadcast_to(self.sigma_a, shape), np.broadcast_to(self.sigma_s, shape)


@functools.lru_cache(maxsize=1)
def _table() -> dict[str, Any]:
    return json.loads(TABLE.read_text(encoding="utf-8"))


def materials() -> list[str]:
    """Names of the materials that `material` knows, in the order of the table."""
    return list(_table()["materials"])


def material(name: str) -> Material:
    """A measured material by name, such as "marble".

    Case, blanks, hyphens and underscores do not matter. Rows whose g was measured per channel carry one g,
    weighted by scattering; sigma_s' is the measured one in every channel.

    Parameters
    ----------
    name : str
        One of `materials`, or an alias such as "milk".

    Raises
    ------
    InputError
        No such material; the message names the nearest ones.

    References
    ----------
    Jensen et al. 2001, table 1; Narasimhan et al. 2006; each row's own `source`.
    """
    table = _table()

    def plain(text: str) -> str:
        return "".join(c for c in str(text).lower() if c.isalnum())

    known = {plain(n): n for n in table["materials"]} | {plain(a): n for a, n in table["aliases"].items()}
    if plain(name) not in known:
        near = difflib.get_close_matches(plain(name), known)
        names = list(dict.fromkeys(known[n] for n in near)) or materials()[:12]
        raise InputError(f"material: unknown name {name!r}; among those known are {', '.join(names)}")
    row = table["materials"][known[plain(name)]]
    return Material.from_reduced(
        row["sigma_a"], row["sigma_s_prime"], row["eta"], row["g"], known[plain(name)], row["source"]
    )


def diffuse_reflectance(albedo: Any, eta: float) -> np.ndarray:
    """Share of perpendicular light, once inside, that a half space of this reduced albedo gives back.

    The diffusion equation solved in a half space, with q0 = sigma_s' exp(-sigma_tr z):
    R = albedo / ((1 + s) (1 + 2 A s / 3)), s = sqrt(3 (1 - albedo)).
    """
    albedo = np.asarray(albedo, float)
    s = np.sqrt(3 * (1 - albedo))
    return albedo / ((1 + s) * (1 + 2 * fresnel_A(eta) * s / 3))
