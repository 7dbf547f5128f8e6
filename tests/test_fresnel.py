"""Reflectance, and the constants of the boundary condition."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import quad

from clsss.fresnel import entering_gain, fresnel_A, fresnel_moments, fresnel_reflectance, fresnel_transmittance


@pytest.mark.parametrize(
    ("eta", "A"), [(1, 1), (1.3, 2.34053), (1.33, 2.51536), (1.37, 2.75857), (1.4, 2.94849), (1.5, 3.62793)]
)
def test_boundary_constant(eta, A):
    assert fresnel_A(eta) == pytest.approx(A, abs=6e-6)


@pytest.mark.parametrize("eta", [0.7, 0.99, 1.0001, 1.1, 1.5, 2.4])
def test_moments_against_adaptive_quadrature(eta):
    critical = [np.sqrt(1 - 1 / eta**2)] if eta > 1 else None
    for moment, n in zip(fresnel_moments(eta), (1, 2), strict=True):
        exact = quad(lambda mu, n=n: (n + 1) * mu**n * fresnel_reflectance(mu, eta), 0, 1, points=critical, limit=300)
        assert moment == pytest.approx(exact[0], abs=1e-7)


def test_fresnel_limits_and_reciprocity():
    assert fresnel_transmittance(1.0, 1.5) == pytest.approx(0.96)
    np.testing.assert_allclose(fresnel_transmittance([0.0, 0.3, 1.0], 1.0), 1)
    cos_o = np.linspace(0.05, 1, 9)
    cos_i = np.sqrt(1 - (1 - cos_o**2) / 1.5**2)
    np.testing.assert_allclose(1 - fresnel_transmittance(cos_o, 1.5), fresnel_reflectance(cos_i, 1.5), atol=1e-14)


@pytest.mark.parametrize("eta", [0.8, 1.0, 1.3, 1.5])
def test_gain_of_diffuse_light_from_outside(eta):
    """Radiance grows by eta^2 as it enters: so does the fluence 4 H of diffuse light, net of what is reflected."""
    critical = [np.sqrt(1 - eta**2)] if eta < 1 else None
    enters = quad(lambda mu: 2 * mu * fresnel_transmittance(mu, eta), 0, 1, points=critical, limit=300)[0]
    assert entering_gain(eta) * enters == pytest.approx(4 * eta**2, rel=1e-6)
