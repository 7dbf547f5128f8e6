"""Exact solutions as data for order-of-accuracy tests, and the fitted order.

Every case is a sphere about the origin: a medium and lights that `clsss.simulate` takes as they are, and the
fluence that solves

    -div(D grad phi) + sigma_a phi = q0     phi + 2 A D dphi/dn = robin (0 unless the case says otherwise)
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from clsss.analytic_sphere import sphere, sphere_beam
from clsss.fresnel import fresnel_A, fresnel_transmittance
from clsss.lights import DirectionalLight, Emission
from clsss.materials import Material

Points = np.ndarray


@dataclass(frozen=True)
class Case:
    """A medium in a sphere of `radius` [mm], what lights it, the exact fluence at points (n, 3) -> (n,)."""

    name: str
    radius: float
    medium: Any
    lights: list[Any]
    phi: Callable[[Points], np.ndarray]
    q0: Callable[[Points], np.ndarray] | None = None
    robin: Callable[[Points], np.ndarray] = field(default=lambda points: np.zeros(len(points)))

    @property
    def A(self) -> float:
        return fresnel_A(self.medium.eta)

    def D(self, points: Points) -> np.ndarray:
        sigma_a, sigma_s = self.medium.coefficients(points)
        return 1 / (3 * (sigma_a + (1 - self.medium.g) * sigma_s))[:, 0]

    def sigma_a(self, points: Points) -> np.ndarray:
        return self.medium.coefficients(points)[0][:, 0]


@dataclass(frozen=True)
class Diffusing:
    """A medium given by D(points) [mm] and one sigma_a [1/mm]."""

    D: Callable[[Points], np.ndarray]
    absorption: float
    eta: float = 1.0
    g: float = 0.0
    homogeneous: bool = False

    def coefficients(self, points: Points) -> tuple[np.ndarray, np.ndarray]:
        sigma_a = np.full((len(points), 3), self.absorption)
        return sigma_a, 1 / (3 * self.D(points))[:, None] - sigma_a


def uniform_source(radius: float = 10.0, sigma_a: float = 0.01, sigma_s: float = 1.0, eta: float = 1.37) -> Case:
    """Sphere with q0 = 1 everywhere: phi = (1 - c sinh(k r) / r) / sigma_a."""
    exact = sphere(radius, sigma_a, sigma_s, fresnel_A(eta), q0=1.0)
    return Case(
        "uniform source",
        radius,
        Material(sigma_a, sigma_s, eta=eta),
        [Emission(1.0)],
        lambda points: exact(np.linalg.norm(points, axis=1)),
        lambda points: np.ones(len(points)),
    )


def beam(radius: float = 10.0, sigma_a: float = 0.01, sigma_s: float = 1.0, eta: float = 1.37) -> Case:
    """Sphere lit by a parallel beam along -z that enters with Fresnel's share and goes straight on."""
    exact = sphere_beam(radius, sigma_a, sigma_s, fresnel_A(eta), lambda mu: fresnel_transmittance(mu, eta))

    def phi(points: Points) -> np.ndarray:
        r = np.linalg.norm(points, axis=1)
        return exact(r, points[:, 2] / np.maximum(r, 1e-12))

    return Case("beam", radius, Material(sigma_a, sigma_s, eta=eta), [DirectionalLight((0, 0, -1))], phi)


def layered(eta: float = 1.37) -> Case:
    """D and sigma_a jump at half the radius, both parts shine: phi is continuous, its slope is not."""
    radii, sigma_a, sigma_s, q0 = (
        np.array([5.0, 10.0]),
        np.array([0.05, 0.005]),
        np.array([2.0, 0.5]),
        (0.2, 1.0),
    )
    exact = sphere(radii, sigma_a, sigma_s, fresnel_A(eta), q0=q0)

    def pick(values: Any, points: Points) -> np.ndarray:
        return np.where(np.linalg.norm(points, axis=1) < radii[0], *values)

    @dataclass(frozen=True)
    class Layers:
        eta: float
        g: float = 0.0
        homogeneous: bool = False

        def coefficients(self, points: Points) -> tuple[np.ndarray, np.ndarray]:
            return tuple(np.repeat(pick(v, points)[:, None], 3, axis=1) for v in (sigma_a, sigma_s))

    def source(points: Points) -> np.ndarray:
        return pick(q0, points)

    return Case("layered", 10.0, Layers(eta), [Emission(source)], lambda p: exact(np.linalg.norm(p, axis=1)), source)


def manufactured(
    radius: float = 10.0, D0: float = 0.4, sigma_a: float = 0.02, eta: float = 1.37, tilt: float = 0.3
) -> Case:
    """Variable D, no symmetry, homogeneous Robin data: a polynomial phi that meets them exactly.

    With x, y, r in radii: phi = (1 + t x (1 - r^2/3)) (1 + b - r^2), whose radial slope at r = 1 is
    -2 (1 + 2 t x / 3) and whose value there is b (1 + 2 t x / 3); so b = 4 A D0 / radius.
    D = D0 (1 + (1 - r^2)(1 + y/2) / 2) is D0 on the surface. q0 follows from the equation and is positive.
    """
    b = 4 * fresnel_A(eta) * D0 / radius

    def parts(points: Points) -> tuple[np.ndarray, ...]:
        x = points / radius
        return x, x[:, 0], x[:, 1], np.sum(x * x, axis=1)

    def D(points: Points) -> np.ndarray:
        _, _, y, r2 = parts(points)
        return D0 * (1 + (1 - r2) * (1 + y / 2) / 2)

    def phi(points: Points) -> np.ndarray:
        _, x, _, r2 = parts(points)
        return (1 + tilt * x * (1 - r2 / 3)) * (1 + b - r2)

    def q0(points: Points) -> np.ndarray:
        position, x, y, r2 = parts(points)
        e_x, e_y = np.eye(3)[:2]
        s, p = 1 + tilt * x * (1 - r2 / 3), 1 + b - r2
        grad_s = tilt * ((1 - r2 / 3)[:, None] * e_x - (2 * x / 3)[:, None] * position)
        grad_p = -2 * position
        laplace_s, laplace_p = -tilt * 10 * x / 3, -6.0
        grad_phi = s[:, None] * grad_p + p[:, None] * grad_s
        laplace = s * laplace_p + 2 * np.sum(grad_s * grad_p, axis=1) + p * laplace_s
        grad_D = D0 / 2 * (-2 * (1 + y / 2)[:, None] * position + ((1 - r2) / 2)[:, None] * e_y)
        spread = D(points) * laplace + np.sum(grad_D * grad_phi, axis=1)
        return -spread / radius**2 + sigma_a * phi(points)

    return Case("manufactured", radius, Diffusing(D, sigma_a, eta), [Emission(q0)], phi, q0)


def manufactured_robin(radius: float = 10.0, sigma_a: float = 0.02, eta: float = 1.37) -> Case:
    """D varies on the surface too, and the Robin data are not 0: phi = 2 + cos(x) sin(y + z), in radii."""

    def D(points: Points) -> np.ndarray:
        return 0.4 * (1 + 0.3 * points[:, 0] / radius)

    def parts(points: Points) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        x, y, z = points.T / radius
        w = np.cos(y + z)
        grad = np.stack([-np.sin(x) * np.sin(y + z), np.cos(x) * w, np.cos(x) * w], axis=1) / radius
        return 2 + np.cos(x) * np.sin(y + z), grad, -3 * np.cos(x) * np.sin(y + z) / radius**2

    def q0(points: Points) -> np.ndarray:
        phi, grad, laplace = parts(points)
        return -D(points) * laplace - 0.12 / radius * grad[:, 0] + sigma_a * phi

    def robin(points: Points) -> np.ndarray:
        phi, grad, _ = parts(points)
        n = points / np.linalg.norm(points, axis=1)[:, None]
        return phi + 2 * fresnel_A(eta) * D(points) * np.sum(grad * n, axis=1)

    return Case(
        "manufactured, Robin data",
        radius,
        Diffusing(D, sigma_a, eta),
        [Emission(q0)],
        lambda p: parts(p)[0],
        q0,
        robin,
    )


def order(h: Any, errors: Any) -> float:
    """Order p of errors ~ h^p, by least squares over all h."""
    return float(np.polyfit(np.log(h), np.log(errors), 1)[0])
