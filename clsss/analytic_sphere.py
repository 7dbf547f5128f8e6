"""Closed-form solutions of the diffusion equation in spheres, expanded in Legendre polynomials.

    phi(r, gamma) = sum over l of phi_l(r) P_l(cos gamma), with phi_l from i_l(k r) and k_l(k r) in each layer

Input: coefficients [1/mm], one number or one per concentric layer, the boundary constant A, the source.
Output: fluence phi(r, cos gamma) [W/mm^2]. `sphere` has sources inside, `sphere_beam` is lit from outside.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from clsss.errors import InputError

Fluence = Callable[..., np.ndarray]


def _i(degree: int, x: np.ndarray) -> np.ndarray:
    """(2l+1)!! i_l(x) / x^l, which is 1 at x = 0."""
    from scipy.special import hyp0f1

    return hyp0f1(degree + 1.5, x * x / 4)


def _k(degree: int, x: np.ndarray) -> np.ndarray:
    """x^(l+1) e^x k_l(x) / (2l-1)!!, which is 1 at x = 0 (k_0(x) = e^-x / x)."""
    before, value = 1 + 0 * x, 1 + x
    for m in range(2, degree + 1):
        before, value = value, value + x * x / ((2 * m - 1) * (2 * m - 3)) * before
    return value if degree else before


def _bessel(degree: int, k: Any, r: Any, ref: Any, kind: str) -> tuple[np.ndarray, np.ndarray]:
    """i_l(k r) / i_l(k ref) (`kind` "i") or k_l(k r) / k_l(k ref) ("k"), and its derivative by r.

    In terms of `_i` and `_k`, because i_l itself underflows and k_l overflows for small arguments.
    """
    x, y = np.asarray(k * r, float), np.asarray(k * ref, float)
    with np.errstate(over="ignore"):
        if kind == "i":
            scale = (x / y) ** degree / _i(degree, y)
            value, following = scale * _i(degree, x), scale * x / (2 * degree + 3) * _i(degree + 1, x)
        else:
            scale = (y / x) ** (degree + 1) * np.exp(y - x) / _k(degree, y)
            value, following = scale * _k(degree, x), -scale * (2 * degree + 1) / x * _k(degree + 1, x)
        return value, k * (following + degree / x * value)


@dataclass(frozen=True, eq=False)
class Layers:
    """Concentric layers with their sources; called with (r, cos_gamma), it gives phi [W/mm^2].

    Attributes
    ----------
    radii, sigma_a, D, k, q0 : (n,) float64
        Of each layer, from the innermost.
    A : float
        Boundary constant of the outermost surface.
    power, source_radius : float
        Of the point source [W], and how far from the centre it is [mm].
    highest : int
        Highest degree of the expansion.
    """

    radii: np.ndarray
    sigma_a: np.ndarray
    D: np.ndarray
    k: np.ndarray
    q0: np.ndarray
    A: float
    power: float
    source_radius: float
    highest: int

    @property
    def home(self) -> int:
        """The layer that the point source is in."""
        return int(np.searchsorted(self.radii, self.source_radius))

    def terms(self, degree: int, i: int, r: Any) -> tuple[np.ndarray, np.ndarray]:
        """Value and D times slope in layer i of i_l, of k_l, and of what the sources add: (3, ...) each."""
        r, k = np.asarray(r, float), self.k[i]
        i_l = _bessel(degree, k, r, self.radii[i], "i")
        k_l = _bessel(degree, k, r, self.radii[max(i - 1, 0)], "k")
        own = np.full(r.shape, self.q0[i] / self.sigma_a[i] if degree == 0 else 0.0)
        slope = np.zeros(r.shape)
        if i == self.home and self.power and (degree == 0 or self.source_radius > 0):
            at = max(self.source_radius, 1e-6 * self.radii[i])
            x = k * at
            c = self.power * _i(degree, x) * _k(degree, x) * np.exp(-x) / (4 * np.pi * self.D[i] * at)
            below, above = _bessel(degree, k, r, at, "i"), _bessel(degree, k, r, at, "k")
            own = own + c * np.where(r > at, above[0], below[0])
            slope = c * np.where(r > at, above[1], below[1])
        return np.array([i_l[0], k_l[0], own]), self.D[i] * np.array([i_l[1], k_l[1], slope])

    def coefficients(self, degree: int) -> np.ndarray:
        """Of i_l and k_l in each layer, (n, 2); the second of the innermost is 0."""
        n = len(self.radii)
        rows, right = np.zeros((2 * n, 2 * n)), np.zeros(2 * n)
        rows[0, 1] = 1
        for i, r in enumerate(self.radii[:-1]):
            pairs = zip(self.terms(degree, i, r), self.terms(degree, i + 1, r), strict=True)
            for row, (left, other) in zip((2 * i + 1, 2 * i + 2), pairs, strict=True):
                rows[row, 2 * i : 2 * i + 4] = [left[0], left[1], -other[0], -other[1]]
                right[row] = other[2] - left[2]
        value, slope = self.terms(degree, n - 1, self.radii[-1])
        equation = value + 2 * self.A * slope
        rows[-1, -2:], right[-1] = equation[:2], -equation[2]
        return np.linalg.solve(rows, right).reshape(n, 2)

    def __call__(self, r: Any, cos_gamma: Any = 1.0) -> np.ndarray:
        """Fluence at radius r [mm] and at this cosine of the angle from the point source."""
        from scipy.special import eval_legendre

        r, cos_gamma = np.broadcast_arrays(np.asarray(r, float), np.asarray(cos_gamma, float))
        r = np.maximum(r, 1e-6 * self.radii[-1])
        layer = np.minimum(np.searchsorted(self.radii, r), len(self.radii) - 1)
        out = np.array((self.q0 / self.sigma_a)[layer])
        for degree in range(self.highest + 1):
            c, legendre = self.coefficients(degree), eval_legendre(degree, cos_gamma)
            for i in range(len(self.radii)):
                m = layer == i
                i_l, k_l, _ = self.terms(degree, i, r[m])[0]
                out[m] += (c[i, 0] * i_l + (c[i, 1] * k_l if i else 0)) * legendre[m]
        if self.power:  # the singular part as it stands, not as its slowly converging series
            m, i, s = layer == self.home, self.home, self.source_radius
            apart = np.sqrt(r[m] ** 2 + s**2 - 2 * r[m] * s * cos_gamma[m])
            out[m] += self.power * np.exp(-self.k[i] * apart) / (4 * np.pi * self.D[i] * apart)
        return out


def sphere(
    radii: Any,
    sigma_a: Any,
    sigma_s_prime: Any,
    fresnel_A: float = 1.0,
    q0: Any = 0.0,
    power: float = 0.0,
    source_radius: float = 0.0,
    degrees: int = 80,
) -> Layers:
    """Concentric layers with a uniform source in each and a point source anywhere.

    Parameters
    ----------
    radii : float or (n,) array_like
        Outer radius of each layer [mm], increasing.
    sigma_a, sigma_s_prime : float or (n,) array_like
        Coefficients of each layer [1/mm]; sigma_a above 0.
    fresnel_A : float
        Boundary constant of the outermost surface.
    q0 : float or (n,) array_like
        Isotropic source density of each layer [W/mm^3].
    power, source_radius : float
        Power [W] of an isotropic point source and its distance from the centre [mm].
    degrees : int
        Highest l. The series converges like (source_radius / r)^l: keep the source out of the last tenth.

    Returns
    -------
    callable
        phi(r, cos_gamma=1.0) [W/mm^2], gamma measured from the point source.

    References
    ----------
    Arridge, Cope and Delpy 1992, "The theoretical basis for the determination of optical pathlengths in
    tissue": the Green's function of the sphere; layers by continuity of phi and J.
    """
    radii = np.atleast_1d(np.asarray(radii, float))
    sigma_a, sigma_tr, q0 = (
        np.broadcast_to(np.asarray(v, float), radii.shape) for v in (sigma_a, np.add(sigma_a, sigma_s_prime), q0)
    )
    if sigma_a.min() <= 0:
        raise InputError("sigma_a: must be above 0 in every layer of this solution")
    D = 1 / (3 * sigma_tr)
    highest = degrees if power and source_radius > 0 else 0
    return Layers(radii, sigma_a, D, np.sqrt(sigma_a / D), q0, fresnel_A, power, source_radius, highest)


def sphere_beam(
    radius: float,
    sigma_a: float,
    sigma_s_prime: float,
    fresnel_A: float = 1.0,
    transmittance: Callable[[np.ndarray], np.ndarray] | None = None,
    degrees: int = 120,
) -> Fluence:
    """Homogeneous sphere in a parallel beam of unit irradiance; q0 = sigma_s' T exp(-sigma_tr depth).

    The ray goes straight on (no refraction). Each degree of the source is integrated against the radial
    Green's function u(r<) w(r>) / (D W), u regular at the centre and w meeting the Robin condition.

    Parameters
    ----------
    radius, sigma_a, sigma_s_prime, fresnel_A : float
        Radius [mm], coefficients [1/mm] (sigma_a above 0), boundary constant.
    transmittance : callable, optional
        T of the cosine of incidence where the ray enters; 1 by default.
    degrees : int
        Highest l; the terms fall like l^-4 (the shadow's edge is a kink of the source).

    Returns
    -------
    callable
        phi(r, cos_gamma) [W/mm^2]; cos_gamma = 1 faces the light, which travels along -1.
    """
    from scipy.interpolate import CubicHermiteSpline
    from scipy.special import eval_legendre

    if sigma_a <= 0:
        raise InputError("sigma_a: must be above 0 in this solution")
    sigma_tr = sigma_a + sigma_s_prime
    D = 1 / (3 * sigma_tr)
    edges = radius * np.maximum(1 - np.linspace(1, 0, 241) ** 2, 5e-3)  # graded towards the surface
    node, weight = np.polynomial.legendre.leggauss(4)
    half = np.diff(edges)[:, None] / 2
    r = edges[:-1, None] + half * (node + 1)
    t, dt = np.polynomial.legendre.leggauss(160)
    mu, dmu = t * abs(t), 2 * abs(t) * dt  # graded towards the shadow's edge
    chord = np.sqrt(radius**2 - r[..., None] ** 2 * (1 - mu**2))
    q = sigma_s_prime * np.exp(-sigma_tr * (chord - r[..., None] * mu))
    if transmittance is not None:
        q = q * transmittance(chord / radius)
    values, slopes = np.empty((2, degrees + 1, len(edges)))
    for degree in range(degrees + 1):
        q_l = (2 * degree + 1) / 2 * (q @ (dmu * eval_legendre(degree, mu))) * r**2 * weight * half
        u, _, w, _ = _green(degree, D, sigma_a, fresnel_A, radius, r)
        below = np.concatenate([[0.0], np.cumsum((u * q_l).sum(axis=1))])
        above = np.concatenate([np.cumsum((w * q_l).sum(axis=1)[::-1])[::-1], [0.0]])
        u, du, w, dw = _green(degree, D, sigma_a, fresnel_A, radius, edges)
        wronskian = radius**2 * (du[-1] * w[-1] - u[-1] * dw[-1])
        values[degree] = (w * below + u * above) / (D * wronskian)
        slopes[degree] = (dw * below + du * above) / (D * wronskian)
    spline = CubicHermiteSpline(edges, values, slopes, axis=1)

    def phi(at: Any, cos_gamma: Any) -> np.ndarray:
        at, cos_gamma = np.broadcast_arrays(np.asarray(at, float), np.asarray(cos_gamma, float))
        polynomials = np.array([eval_legendre(degree, cos_gamma) for degree in range(degrees + 1)])
        return np.sum(spline(np.clip(at, edges[0], radius)) * polynomials, axis=0)

    return phi


def _green(
    degree: int, D: float, sigma_a: float, A: float, radius: float, r: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Solution u, regular at the centre, and its slope; w, with w + 2 A D w' = 0 at the surface, and its."""
    k = np.sqrt(sigma_a / D)
    u, du = _bessel(degree, k, r, radius, "i")
    w, dw = _bessel(degree, k, r, radius, "k")
    ends = [_bessel(degree, k, radius, radius, kind)[1] for kind in "ik"]
    gamma = -(1 + 2 * A * D * ends[1]) / (1 + 2 * A * D * ends[0])
    return u, du, w + gamma * u, dw + gamma * du
