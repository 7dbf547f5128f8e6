"""Closed-form solutions of the diffusion equation in spheres, expanded in Legendre polynomials.

    phi(r, gamma) = sum over l of phi_l(r) P_l(cos gamma), with phi_l from i_l(k r) and k_l(k r) in each layer

Input: coefficients [1/mm], one number or one per concentric layer, the boundary constant A, the source.
Output: fluence phi(r, cos gamma) [W/mm^2]. `sphere` has sources inside, `sphere_beam` is lit from outside.
"""

from __future__ import annotations

from collections.abc import Callable
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


def sphere(
    radii: Any,
    sigma_a: Any,
    sigma_s_prime: Any,
    fresnel_A: float = 1.0,
    q0: Any = 0.0,
    power: float = 0.0,
    source_radius: float = 0.0,
    degrees: int = 80,
) -> Fluence:
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
    n = len(radii)
    sigma_a, sigma_tr, q0 = (
        np.broadcast_to(np.asarray(v, float), (n,)) for v in (sigma_a, np.add(sigma_a, sigma_s_prime), q0)
    )
    if sigma_a.min() <= 0:
        raise InputError("sigma_a: must be above 0 in every layer of this solution")
    D = 1 / (3 * sigma_tr)
    k = np.sqrt(sigma_a / D)
    home = int(np.searchsorted(radii, source_radius))
    at = max(source_radius, 1e-6 * radii[home])

    def terms(degree: int, i: int, r: Any) -> tuple[np.ndarray, np.ndarray]:
        """Value and D times derivative of the two solutions of layer i and of its source: (3, ...) each."""
        r = np.asarray(r, float)
        inner = radii[max(i - 1, 0)]
        parts = [_bessel(degree, k[i], r, radii[i], "i"), _bessel(degree, k[i], r, inner, "k")]
        source = np.full(r.shape, q0[i] / sigma_a[i] if degree == 0 else 0.0), np.zeros(r.shape)
        if i == home and power and (degree == 0 or source_radius > 0):
            x, outside = k[i] * at, r > at
            c = power * _i(degree, x) * _k(degree, x) * np.exp(-x) / (4 * np.pi * D[i] * at)
            below, above = _bessel(degree, k[i], r, at, "i"), _bessel(degree, k[i], r, at, "k")
            source = (
                source[0] + c * np.where(outside, above[0], below[0]),
                c * np.where(outside, above[1], below[1]),
            )
        parts.append(source)
        return np.array([p[0] for p in parts]), D[i] * np.array([p[1] for p in parts])

    def coefficients(degree: int) -> np.ndarray:
        """Of i_l and k_l in each layer, (n, 2); the second of the innermost is 0."""
        rows, right = np.zeros((2 * n, 2 * n)), np.zeros(2 * n)
        rows[0, 1] = 1
        for i in range(n - 1):
            pairs = zip(terms(degree, i, radii[i]), terms(degree, i + 1, radii[i]), strict=True)
            for row, (left, other) in zip((2 * i + 1, 2 * i + 2), pairs, strict=True):
                rows[row, 2 * i : 2 * i + 4] = [left[0], left[1], -other[0], -other[1]]
                right[row] = other[2] - left[2]
        value, slope = terms(degree, n - 1, radii[-1])
        rows[-1, -2:], right[-1] = (value + 2 * fresnel_A * slope)[:2], -(value + 2 * fresnel_A * slope)[2]
        return np.linalg.solve(rows, right).reshape(n, 2)

    highest = degrees if power and source_radius > 0 else 0
    solved = [coefficients(degree) for degree in range(highest + 1)]

    def phi(r: Any, cos_gamma: Any = 1.0) -> np.ndarray:
        from scipy.special import eval_legendre

        r, cos_gamma = np.broadcast_arrays(np.asarray(r, float), np.asarray(cos_gamma, float))
        r = np.maximum(r, 1e-6 * radii[-1])
        out = np.zeros(r.shape)
        layer = np.minimum(np.searchsorted(radii, r), n - 1)
        for i in range(n):
            m = layer == i
            for degree, c in enumerate(solved):
                value = terms(degree, i, r[m])[0]
                regular = (
                    c[i, 0] * value[0] + (c[i, 1] * value[1] if i else 0) + (degree == 0) * q0[i] / sigma_a[i]
                )
                out[m] += regular * eval_legendre(degree, cos_gamma[m])
        m = layer == home
        apart = np.sqrt(r[m] ** 2 + source_radius**2 - 2 * r[m] * source_radius * cos_gamma[m])
        if power:  # the singular part as it stands, not as its slowly converging series
            out[m] += power * np.exp(-k[home] * apart) / (4 * np.pi * D[home] * apart)
        return out

    return phi


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
    k = np.sqrt(sigma_a / D)
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

        def green(x: Any, degree: int = degree) -> tuple[np.ndarray, ...]:
            u, du = _bessel(degree, k, x, radius, "i")
            w, dw = _bessel(degree, k, x, radius, "k")
            ends = [_bessel(degree, k, radius, radius, kind)[1] for kind in "ik"]
            gamma = -(1 + 2 * fresnel_A * D * ends[1]) / (1 + 2 * fresnel_A * D * ends[0])
            return u, du, w + gamma * u, dw + gamma * du

        u, _, w, _ = green(r)
        below = np.concatenate([[0.0], np.cumsum((u * q_l).sum(axis=1))])
        above = (w * q_l).sum(axis=1)
        above = np.concatenate([np.cumsum(above[::-1])[::-1], [0.0]])
        u, du, w, dw = green(edges)
        wronskian = edges[-1] ** 2 * (du[-1] * w[-1] - u[-1] * dw[-1])
        values[degree] = (w * below + u * above) / (D * wronskian)
        slopes[degree] = (dw * below + du * above) / (D * wronskian)
    spline = CubicHermiteSpline(edges, values, slopes, axis=1)

    def phi(at: Any, cos_gamma: Any) -> np.ndarray:
        at, cos_gamma = np.broadcast_arrays(np.asarray(at, float), np.asarray(cos_gamma, float))
        polynomials = np.array([eval_legendre(degree, cos_gamma) for degree in range(degrees + 1)])
        return np.sum(spline(np.clip(at, edges[0], radius)) * polynomials, axis=0)

    return phi
