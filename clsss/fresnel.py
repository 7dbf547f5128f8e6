"""Reflection at the boundary of the medium, and what it makes of the boundary condition of diffusion.

    R_phi = 2 int_0^1 R mu dmu     R_J = 3 int_0^1 R mu^2 dmu     A = (1 + R_J) / (1 - R_phi)
    J.n = (phi_B - 4 H_t / (1 - R_phi)) / (2A)

R is the Fresnel reflectance seen from inside, H_t the irradiance that enters from outside.

References
----------
Haskell et al. 1994, "Boundary conditions for the diffusion equation in radiative transfer".
"""

from __future__ import annotations

import functools
from typing import Any

import numpy as np


def fresnel_reflectance(cos_incidence: Any, eta: float) -> np.ndarray:
    """Unpolarised Fresnel reflectance, for light that meets a boundary beyond which the index is 1/eta.

    Parameters
    ----------
    cos_incidence : array_like
        Cosine of the angle of incidence, on the side the light comes from.
    eta : float
        Index of that side over the index of the other; 1 beyond the critical angle.
    """
    cos_i = np.asarray(cos_incidence, float)
    sin2_t = eta * eta * (1 - cos_i * cos_i)
    cos_t = np.sqrt(np.maximum(1 - sin2_t, 0))
    tiny = np.finfo(float).tiny
    r_s = (eta * cos_i - cos_t) / (eta * cos_i + cos_t + tiny)
    r_p = (eta * cos_t - cos_i) / (eta * cos_t + cos_i + tiny)
    return np.where((sin2_t >= 1) & (eta != 1), 1.0, (r_s * r_s + r_p * r_p) / 2)


def fresnel_transmittance(cos_incidence: Any, eta: float) -> np.ndarray:
    """Share of unpolarised light from outside, at this cosine of incidence, that enters the medium."""
    return 1 - fresnel_reflectance(cos_incidence, 1 / eta)


def unit_quadrature(n: int) -> tuple[np.ndarray, np.ndarray]:
    """Nodes and weights (n,) of Gauss and Legendre between 0 and 1."""
    x, weight = np.polynomial.legendre.leggauss(n)
    return (x + 1) / 2, weight / 2


@functools.lru_cache(maxsize=64)
def fresnel_moments(eta: float) -> tuple[float, float]:
    """R_phi = 2 int_0^1 R mu dmu and R_J = 3 int_0^1 R mu^2 dmu, R the reflectance seen from inside."""
    if eta == 1:
        return 0.0, 0.0
    # R is 1 below the cosine of the critical angle and has a square root there: mu = critical + (..) t^2
    critical = np.sqrt(1 - 1 / eta**2) if eta > 1 else 0.0
    t, weight = unit_quadrature(128)
    mu = critical + (1 - critical) * t * t
    weight = 2 * weight * t * (1 - critical) * fresnel_reflectance(mu, eta)
    return float(critical**2 + np.sum(weight * 2 * mu)), float(critical**3 + np.sum(weight * 3 * mu * mu))


def fresnel_A(eta: float) -> float:
    """Boundary constant A = (1 + R_J) / (1 - R_phi) of phi = 2 A J.n; 1 for eta = 1, 3.62793 for 1.5."""
    R_phi, R_J = fresnel_moments(float(eta))
    return (1 + R_J) / (1 - R_phi)


def entering_gain(eta: float) -> float:
    """4 / (1 - R_phi): fluence at the boundary per diffuse irradiance that enters there, for the same J.n.

    The balance of partial currents, phi / 4 - J.n / 2 = H_t + R_phi phi / 4 + R_J J.n / 2, solved for J.n.
    """
    return 4 / (1 - fresnel_moments(float(eta))[0])
