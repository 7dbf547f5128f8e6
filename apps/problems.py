"""Shapes, media and exact solutions that apps/convergence.py measures the solver on.

Lengths in shapes are in cells of the finest grid, h = 1 mm at the resolution `cells_along` gives; exact
solutions are fluences [W/mm^2] of -div(D grad phi) + sigma_a phi = q0 with phi = 2 A J.n on the surface.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import numpy as np
import trimesh

from clsss import Material, Mesh, load_mesh
from clsss.analytic_sphere import sphere as exact_sphere
from clsss.fresnel import fresnel_A

TILT = trimesh.transformations.euler_matrix(0.4, 0.7, 1.1)
AXIS = np.array([1.0, 0.3, 0.2]) / np.linalg.norm([1.0, 0.3, 0.2])


def cells_along(mesh: Mesh) -> int:
    """Resolution whose cells are as close to 1 mm as whole numbers allow."""
    return max(4, round(mesh.size))


def ball(radius: float, centre: np.ndarray | float = 0.0, subdivisions: int = 5) -> trimesh.Trimesh:
    """A geodesic sphere with the volume of the round one."""
    mesh = trimesh.creation.icosphere(subdivisions=subdivisions)
    mesh.apply_scale(radius * (4 / 3 * np.pi / mesh.volume) ** (1 / 3))
    return mesh.apply_translation(np.broadcast_to(centre, 3))


def disc(width: float, thickness: float, height: float = 0.0) -> trimesh.Trimesh:
    """A round plate, tilted against the grid."""
    mesh = trimesh.creation.cylinder(radius=width / 2, height=thickness, sections=96)
    return mesh.apply_translation([0, 0, height]).apply_transform(TILT)


def shell(n: float, thickness: float) -> list[trimesh.Trimesh]:
    """A hollow sphere."""
    inner = ball(n / 2 - thickness)
    inner.invert()
    return [ball(n / 2), inner]


def two_balls(n: float, gap: float) -> list[trimesh.Trimesh]:
    """Two balls that nearly touch, oblique to the grid."""
    return [ball(n / 4, side * (n / 4 + gap / 2) * AXIS) for side in (-1, 1)]


SHAPES: dict[str, Callable[[float], list[trimesh.Trimesh]]] = {
    "sphere": lambda n: [ball(n / 2)],
    "torus": lambda n: [trimesh.creation.torus(0.35 * n, 0.15 * n, major_sections=128, minor_sections=64)],
    "shell 2h": lambda n: shell(n, 2.0),
    "plate 1.5h": lambda n: [disc(n, 1.5)],
    "plate 2h": lambda n: [disc(n, 2.0)],
    "plate 3h": lambda n: [disc(n, 3.0)],
    "plate 5h": lambda n: [disc(n, 5.0)],
    "balls, gap .3h": lambda n: two_balls(n, 0.3),
    "balls, gap 1h": lambda n: two_balls(n, 1.0),
    "stack 2.2h": lambda n: [disc(n, 2.2, 4.4 * k) for k in range(4)],
}


def shape(name: str, n: float) -> Mesh:
    """One of `SHAPES`, `n` cells wide."""
    return load_mesh(trimesh.util.concatenate(SHAPES[name](n)))


def plate(width: float, thickness: float) -> Mesh:
    """A round plate about the origin, tilted against the grid."""
    return load_mesh(disc(width, thickness))


@cache
def round_ball(radius: float, subdivisions: int = 6) -> Mesh:
    """A sphere whose facets are finer than what is measured on it."""
    return load_mesh(ball(radius, subdivisions=subdivisions))


def layer(sigma_tr: np.ndarray, albedo: np.ndarray | float, eta: float = 1.3) -> Material:
    """A material by sigma_tr [1/mm] and reduced albedo, by channel."""
    sigma_tr = np.asarray(sigma_tr, float)
    return Material(sigma_tr * (1 - np.asarray(albedo)), sigma_tr * albedo, eta=eta)


@dataclass(frozen=True)
class Varying:
    """A medium whose sigma_tr [1/mm] depends on the place, sigma_a a fixed part of it."""

    sigma_tr: Callable[[np.ndarray], np.ndarray]
    absorbed: float = 1e-3
    eta: float = 1.3
    g: float = 0.0
    homogeneous: bool = False

    def coefficients(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """sigma_a and sigma_s (n, 3) [1/mm] at points (n, 3) [mm]."""
        sigma_tr = np.repeat(self.sigma_tr(np.asarray(points, float))[:, None], 3, axis=1)
        return self.absorbed * sigma_tr, (1 - self.absorbed) * sigma_tr


def smooth_medium(mean: float, contrast: float, period: float) -> Varying:
    """sigma_tr that swings by `contrast` around `mean` [1/mm] with a `period` [mm] along all three axes."""

    def sigma_tr(points: np.ndarray) -> np.ndarray:
        wave = np.sin(2 * np.pi * points / period).prod(axis=1)
        return mean * contrast ** (wave / 2)

    return Varying(sigma_tr)


def sharp_medium(mean: float, contrast: float, period: float) -> Varying:
    """A checkerboard of two sigma_tr [1/mm] in the ratio `contrast`, blocks of half a `period` [mm]."""

    def sigma_tr(points: np.ndarray) -> np.ndarray:
        colour = np.floor(2 * points / period + 0.17).sum(axis=1).astype(int) & 1
        return mean * contrast ** (colour - 0.5)

    return Varying(sigma_tr)


@dataclass(frozen=True)
class Exact:
    """A problem in a sphere about the origin and its solution, three channels at once.

    Attributes
    ----------
    radius : float
        [mm]
    medium : Material or other medium
    phi, q0 : callable
        Fluence and source density (n, 3) at points (n, 3) [mm].
    """

    radius: float
    medium: object
    phi: Callable[[np.ndarray], np.ndarray]
    q0: Callable[[np.ndarray], np.ndarray]


def uniform_source(diameters: tuple[float, float, float], absorbed: tuple[float, float, float], eta: float) -> Exact:
    """Sphere of radius 10 mm with q0 = 1; channels by sigma_tr diameter and sigma_a / sigma_tr."""
    sigma_tr, absorbed_part = np.array(diameters) / 20, np.array(absorbed)
    solutions = [exact_sphere(10.0, p * s, (1 - p) * s, fresnel_A(eta), q0=1.0)
                 for s, p in zip(sigma_tr, absorbed_part, strict=True)]  # fmt: skip

    def phi(points: np.ndarray) -> np.ndarray:
        r = np.linalg.norm(points, axis=1)
        return np.stack([solution(r) for solution in solutions], axis=1)

    return Exact(10.0, layer(sigma_tr, 1 - absorbed_part, eta), phi, lambda points: np.ones((len(points), 3)))


def core_and_rind() -> Exact:
    """D jumps by 10 at half the radius; both parts shine."""
    radii, sigma_tr, absorbed, eta = np.array([5.0, 10.0]), np.array([3.0, 0.3]), 1e-2, 1.3
    solution = exact_sphere(radii, absorbed * sigma_tr, (1 - absorbed) * sigma_tr, fresnel_A(eta), q0=(0.2, 1.0))

    def pick(values: tuple[float, float] | np.ndarray, points: np.ndarray) -> np.ndarray:
        return np.where(np.linalg.norm(points, axis=1) < radii[0], values[0], values[1])

    def three(values: np.ndarray) -> np.ndarray:
        return np.repeat(values[:, None], 3, axis=1)

    return Exact(10.0, Varying(lambda points: pick(sigma_tr, points), absorbed, eta),
                 lambda points: three(solution(np.linalg.norm(points, axis=1))),
                 lambda points: three(pick((0.2, 1.0), points)))  # fmt: skip


def manufactured(eta: float = 1.37) -> Exact:
    """A solution without symmetry for a D that varies by 2, meeting phi = 2 A J.n on the surface exactly.

    In radii, phi = (1 + t x (1 - r^2/3)) (1 + b - r^2) with b = 4 A D0 / radius, D = D0 on the surface. The
    source is the divergence by central differences, whose error (1e-7) is far below what is measured.
    """
    radius, D0, sigma_a, t = 10.0, 0.4, 0.02, 0.3
    b = 4 * fresnel_A(eta) * D0 / radius

    def D(points: np.ndarray) -> np.ndarray:
        x = points / radius
        return D0 * (1 + (1 - (x * x).sum(axis=1)) * (1 + x[:, 1] / 2) / 2)

    def phi(points: np.ndarray) -> np.ndarray:
        x = points / radius
        r2 = (x * x).sum(axis=1)
        return (1 + t * x[:, 0] * (1 - r2 / 3)) * (1 + b - r2)

    def q0(points: np.ndarray) -> np.ndarray:
        step, out = 1e-3 * radius, sigma_a * phi(points)
        for e in np.concatenate([np.eye(3), -np.eye(3)]):
            out -= D(points + e * step / 2) * (phi(points + e * step) - phi(points)) / step**2
        return out

    @dataclass(frozen=True)
    class Medium:
        eta: float
        g: float = 0.0
        homogeneous: bool = False

        def coefficients(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            absorption = np.full((len(points), 3), sigma_a)
            return absorption, 1 / (3 * D(points))[:, None] - absorption

    def three(f: Callable[[np.ndarray], np.ndarray]) -> Callable[[np.ndarray], np.ndarray]:
        return lambda points: np.repeat(f(points)[:, None], 3, axis=1)

    return Exact(radius, Medium(eta), three(phi), three(q0))


def plate_fluence(thickness: float, medium: Material) -> np.ndarray:
    """Fluence (3,) at either side of an endless plate with q0 = 1: sigma_a phi = 1 - C cosh(k z)."""
    A, k, D = fresnel_A(medium.eta), np.sqrt(medium.sigma_a / medium.D), medium.D
    cosh, sinh = np.cosh(k * thickness / 2), np.sinh(k * thickness / 2)
    return (1 - cosh / (cosh + 2 * A * D * k * sinh)) / medium.sigma_a
