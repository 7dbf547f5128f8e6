"""Where results are doubtful: media that absorb as they scatter, objects too thin for diffusion, and for the grid.

    albedo = sigma_s' / sigma_tr     mean free path = 1 / sigma_tr     thickness = 4 V / S

The thickness is the mean chord of the solid (Cauchy), V its volume and S its surface. Input: a mesh and a medium.
"""

from __future__ import annotations

import warnings

import numpy as np

from clsss.materials import Medium
from clsss.mesh import Mesh

LEAST_ALBEDO = 0.9
LEAST_PATHS = 3.0  # mean free paths that the object must be thick
# How many cells parts should be thick, and the share of the surface that may lie over thinner ones: they turn out a
# tenth too dark at one cell, a third to a half at .8, and more below (docs/numerics.md, "Limits").
THIN = {"cell": (1.0, 0.05), "half_a_cell": (0.5, 0.01)}
FINEST = 2048  # resolution
WIDEST_CELL = 20.0  # diffusion lengths that a cell may be wide: what is fitted within it bears no more
_CHANNELS = ("red", "green", "blue")
_SAMPLES = 1000


class DiffusionWarning(UserWarning):
    """The result may be off: diffusion describes this medium or this object badly."""


def doubts(mesh: Mesh, medium: Medium) -> str:
    """Why diffusion is doubtful here, with numbers, or nothing."""
    sigma_a, sigma_s_prime = _mean(mesh, medium)
    albedo, path = sigma_s_prime / (sigma_a + sigma_s_prime), 1 / (sigma_a + sigma_s_prime)
    reasons = []
    if (low := albedo < LEAST_ALBEDO).any():
        numbers = ", ".join(f"{albedo[c]:.2g} in {_CHANNELS[c]}" for c in np.flatnonzero(low))
        reasons.append(f"the reduced albedo is {numbers}; it should be {LEAST_ALBEDO:g} or more")
    thickness, longest = thickness_of(mesh), int(np.argmax(path))
    if thickness < LEAST_PATHS * path[longest]:
        reasons.append(
            f"the object is {thickness:.2g} mm thick on average, {thickness / path[longest]:.2g} mean free paths "
            f"of {path[longest]:.2g} mm in {_CHANNELS[longest]}; it should be {LEAST_PATHS:g} or more"
        )
    return "diffusion is only approximate here: " + "; ".join(reasons) if reasons else ""


class ResolutionWarning(UserWarning):
    """The cells are too wide for parts of the object, or for how far light diffuses in it."""


def too_wide(mesh: Mesh, medium: Medium, resolution: int) -> str:
    """Why light that diffuses within the cells is lost sight of, and which resolution would do, or nothing."""
    sigma_a, sigma_s_prime = _mean(mesh, medium)
    widths = np.sqrt(3 * sigma_a * (sigma_a + sigma_s_prime)) * mesh.size / resolution
    worst = int(np.argmax(widths))
    if widths[worst] <= WIDEST_CELL:
        return ""
    enough = 10 * int(np.ceil(resolution * widths[worst] / WIDEST_CELL / 10))
    advice = f"resolution {enough} will do" if enough <= FINEST else f"is the object {mesh.size:.3g} mm large?"
    return (
        f"cells of {mesh.size / resolution:.2g} mm are {widths[worst]:.2g} diffusion lengths wide in "
        f"{_CHANNELS[worst]}, which comes out too bright beyond {WIDEST_CELL:g}: {advice}"
    )


def unresolved(thickness: np.ndarray, h: float, resolution: int) -> str:
    """Why the cells are too wide, and which resolution would do, or nothing.

    Parameters
    ----------
    thickness : (k,) float64
        Below places of the surface, even by area [cells].
    h : float
        Width of a cell [mm].
    resolution : int
        Cells along the longest side.
    """
    shares = thin_shares(thickness)
    if all(shares[name] <= most for name, (_, most) in THIN.items()):
        return ""
    text = f"{100 * shares['cell']:.3g} % of the surface lies over parts thinner than a cell of {h:.2g} mm, too dark"
    if shares["half_a_cell"] > 0:
        text += f", and {100 * shares['half_a_cell']:.3g} % over less than half of one, nearly black"
    ordered = np.sort(thickness)
    widest = min(ordered[int(most * len(ordered))] / limit for limit, most in THIN.values())
    enough = 10 * int(np.ceil(resolution / max(widest, 1e-3) / 10))
    advice = f"resolution {enough} resolves all but little" if enough <= FINEST else "they need to be thicker"
    return f"{text}: {advice}"


def thin_shares(thickness: np.ndarray) -> dict[str, float]:
    """Shares of the surface that lie over parts thinner than a cell and than half of one; `thickness` in cells."""
    return {name: float((thickness < limit).mean()) for name, (limit, _) in THIN.items()}


def warn_unresolved(thickness: np.ndarray, h: float, resolution: int) -> None:
    """Issue a `ResolutionWarning` where parts are `unresolved`."""
    if text := unresolved(thickness, h, resolution):
        warnings.warn(text, ResolutionWarning, stacklevel=4)


class ConvergenceWarning(UserWarning):
    """A solve stopped short of its tolerance."""


def warn(mesh: Mesh, medium: Medium, resolution: int) -> None:
    """Issue a `DiffusionWarning` where there are `doubts`, a `ResolutionWarning` where cells are `too_wide`."""
    if text := doubts(mesh, medium):
        warnings.warn(text, DiffusionWarning, stacklevel=4)
    if text := too_wide(mesh, medium, resolution):
        warnings.warn(text, ResolutionWarning, stacklevel=4)


def thickness_of(mesh: Mesh) -> float:
    """Mean chord 4 V / S of the solid [mm]."""
    area, volume = mesh.area_and_volume
    return 4 * volume / area


def _mean(mesh: Mesh, medium: Medium) -> tuple[np.ndarray, np.ndarray]:
    """sigma_a and sigma_s' (3,), on average just inside the surface, where the light is."""
    used = np.flatnonzero(mesh.normals.any(axis=1))
    some = used[:: max(1, len(used) // _SAMPLES)]
    points = mesh.vertices[some] - mesh.normals[some] * thickness_of(mesh) / 8
    sigma_a, sigma_s = medium.coefficients(points)
    return sigma_a.mean(axis=0), (1 - medium.g) * sigma_s.mean(axis=0)
