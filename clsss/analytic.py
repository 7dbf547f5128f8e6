"""Closed-form solutions of the diffusion equation, to check the solver against.

    div J + sigma_a phi = q0     J = -D grad phi + 3 D q1     phi = 2 A J.n on the surface, n outward

Input: coefficients [1/mm], one number or one per layer, and the source. Output: fluence phi [W/mm^2] as a
function of place; the exitance is M = J.n = phi / (2 A). Spheres are in analytic_sphere.py.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from clsss.errors import InputError


def scaled(sigma_s: Any, g: Any, phase: str) -> tuple[np.ndarray, np.ndarray]:
    """sigma_s* = (1 - f) sigma_s and g* = (g - f) / (1 - f): what is left when f counts as unscattered.

    Parameters
    ----------
    sigma_s, g : array_like
        Scattering coefficient [1/mm] and mean cosine.
    phase : {"similarity", "delta-eddington", "p1"}
        f = g, f = g^2 or f = 0.

    References
    ----------
    Joseph, Wiscombe and Weinman 1976, "The delta-Eddington approximation for radiative flux transfer".
    """
    sigma_s, g = np.asarray(sigma_s, float), np.asarray(g, float)
    fractions = {"similarity": g, "delta-eddington": g * g, "p1": 0 * g}
    if phase not in fractions:
        raise InputError(f"phase: unknown value {phase!r}; use one of {', '.join(fractions)}")
    f = fractions[phase]
    return (1 - f) * sigma_s, (g - f) / (1 - f)


@dataclass(frozen=True, eq=False)
class Slab:
    """Solution in a slab, from `slab`.

    Attributes
    ----------
    d, start : (n,) and (n + 1,) float64
        Thickness of each layer, depths where layers start and end [mm].
    k, D, extinction, moment, C, entering : (n,) float64
        As in `slab`; `moment` is 3 D g* sigma_s*, `entering` the beam where each layer starts.
    A : float
        Boundary constant.
    ab : (n, 2) float64
        Coefficients of the two solutions of the equation without source.
    """

    d: np.ndarray
    start: np.ndarray
    k: np.ndarray
    D: np.ndarray
    extinction: np.ndarray
    moment: np.ndarray
    C: np.ndarray
    entering: np.ndarray
    A: float
    ab: np.ndarray

    def _layer(self, z: Any) -> np.ndarray:
        return np.clip(np.searchsorted(self.start, np.asarray(z, float), side="right") - 1, 0, len(self.d) - 1)

    def beam(self, z: Any) -> np.ndarray:
        """Irradiance of the unscattered beam at depth z [mm]."""
        i = self._layer(z)
        return self.entering[i] * np.exp(-self.extinction[i] * (np.asarray(z, float) - self.start[i]))

    def terms(self, i: Any, z: Any) -> tuple[np.ndarray, np.ndarray]:
        """Phi and J of layer i at depth z: of the solutions that a and b multiply, and of the beam; (3, ...)."""
        x, k, D, d = np.asarray(z, float) - self.start[i], self.k[i], self.D[i], self.d[i]
        F = self.entering[i] * np.exp(-self.extinction[i] * x)
        e, rise = np.exp(-k * x), np.exp(-k * (d - x)) / np.expm1(-2 * k * d)
        sinh, cosh = rise * np.expm1(-2 * k * x), -rise * (1 + np.exp(-2 * k * x))
        flux = (D * self.extinction[i] * self.C[i] + self.moment[i]) * F
        return np.array([e, sinh, self.C[i] * F]), np.array([D * k * e, -D * k * cosh, flux])

    def _value(self, z: Any, which: int) -> np.ndarray:
        i = self._layer(z)
        part = self.terms(i, z)[which]
        return self.ab[i, 0] * part[0] + self.ab[i, 1] * part[1] + part[2]

    def phi(self, z: Any) -> np.ndarray:
        """Fluence of the scattered light at depth z [mm]."""
        return self._value(z, 0)

    def flux(self, z: Any) -> np.ndarray:
        """Net flux of the scattered light along +z."""
        return self._value(z, 1)

    @property
    def reflectance(self) -> float:
        """Scattered power that leaves at z = 0."""
        return float(self.phi(0.0)) / (2 * self.A)

    @property
    def transmittance(self) -> float:
        """Scattered power that leaves at the far end."""
        return float(self.phi(self.start[-1])) / (2 * self.A)

    @property
    def unscattered(self) -> float:
        """Power of the beam that passes through."""
        return float(self.beam(self.start[-1]))


def slab(
    thickness: Any,
    sigma_a: Any,
    sigma_s: Any,
    g: Any = 0.0,
    fresnel_A: float = 1.0,
    phase: str = "similarity",
) -> Slab:
    """Layered slab lit perpendicularly at z = 0 by a beam of unit irradiance, counted inside the surface.

    In a layer phi = a e^(-k x) + b sinh(k x) / sinh(k d) + C F(z), with F the beam, x the depth in the layer,
    k = sqrt(sigma_a / D) and C = (sigma_s* + 3 D g* sigma_s* sigma_t*) / (sigma_a - D sigma_t*^2). a and b
    follow from phi and J.z being continuous and from phi = 2 A J.n at both ends.

    Parameters
    ----------
    thickness, sigma_a, sigma_s, g : float or (n,) array_like
        Thickness [mm], coefficients [1/mm] and mean cosine of each layer.
    fresnel_A : float
        Boundary constant of both ends.
    phase : {"similarity", "delta-eddington", "p1"}
        As in `scaled`.

    References
    ----------
    Ishimaru 1978, "Wave Propagation and Scattering in Random Media", ch. 9 (the diffusion approximation).
    """
    d, sigma_a, sigma_s, g = (np.ravel(v).astype(float) for v in np.broadcast_arrays(thickness, sigma_a, sigma_s, g))
    n, D = len(d), 1 / (3 * (sigma_a + (1 - g) * sigma_s))
    k = np.maximum(np.sqrt(sigma_a / D), 1e-7 / d)  # the limit k -> 0 without its 0/0
    s, g = scaled(sigma_s, g, phase)
    extinction, moment = sigma_a + s, 3 * D * g * s
    C = (s + moment * extinction) / (sigma_a - D * extinction**2)
    start = np.concatenate([[0.0], np.cumsum(d)])
    entering = np.exp(-np.concatenate([[0.0], np.cumsum(extinction * d)])[:-1])
    layers = Slab(d, start, k, D, extinction, moment, C, entering, fresnel_A, np.zeros((n, 2)))
    rows, right = np.zeros((2 * n, 2 * n)), np.zeros(2 * n)
    for row, i, z, sign in ((0, 0, 0.0, 1), (2 * n - 1, n - 1, start[n], -1)):
        phi, flux = layers.terms(i, z)
        equation = phi + sign * 2 * fresnel_A * flux
        rows[row, 2 * i : 2 * i + 2], right[row] = equation[:2], -equation[2]
    for i in range(n - 1):
        pairs = zip(layers.terms(i, start[i + 1]), layers.terms(i + 1, start[i + 1]), strict=True)
        for row, (left, other) in zip((2 * i + 1, 2 * i + 2), pairs, strict=True):
            rows[row, 2 * i : 2 * i + 4] = [left[0], left[1], -other[0], -other[1]]
            right[row] = other[2] - left[2]
    return replace(layers, ab=np.linalg.solve(rows, right).reshape(n, 2))


def half_space(
    rho: Any, z: Any, depth: float, sigma_a: float, sigma_s_prime: float, fresnel_A: float = 1.0
) -> np.ndarray:
    """Fluence of a unit isotropic point source at `depth` below the plane z = 0; the medium is z > 0.

    phi = (f(r1) + f(r2) - (2 / z_b) int_0^inf e^(-l / z_b) f(r(l)) dl) / (4 pi D), f(r) = e^(-k r) / r,
    z_b = 2 A D: the image of the source and a line of sinks behind it meet the Robin condition exactly.

    Parameters
    ----------
    rho, z : array_like
        Distance from the axis and depth [mm].
    depth, sigma_a, sigma_s_prime, fresnel_A : float
        Of the source [mm], coefficients [1/mm], boundary constant.

    References
    ----------
    Carslaw and Jaeger 1959, "Conduction of Heat in Solids", 14.9 (radiation at the surface of a half space).
    """
    D = 1 / (3 * (sigma_a + sigma_s_prime))
    k, z_b = np.sqrt(sigma_a / D), 2 * fresnel_A * D
    rho, z = (np.asarray(v, float)[..., None] for v in np.broadcast_arrays(rho, z))

    def f(height: Any) -> np.ndarray:
        r = np.sqrt(rho**2 + height**2)
        return np.exp(-k * r) / r

    node, weight = np.polynomial.laguerre.laggauss(80)
    sinks = f(z + depth + z_b * node) @ weight
    return ((f(z - depth) + f(z + depth))[..., 0] - 2 * sinks) / (4 * np.pi * D)
