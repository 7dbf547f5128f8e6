"""Automatic exposure: from what leaves a surface, and from where it is seen, to how bright a picture of it is."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from clsss.halfedges import areas

if TYPE_CHECKING:
    from clsss.mesh import Mesh


def display_scale(mesh: Mesh, radiosity: np.ndarray, towards: np.ndarray | None = None) -> float:
    """Automatic exposure: the factor from radiosity to displayed linear colour.

    Of the area that is seen, 1 % may be brighter than the display's white in its strongest channel. Where half of
    it is darker than 0.4 of that (lit from behind), up to two stops more bring its median nearer.

    Parameters
    ----------
    mesh : Mesh
        What is drawn; its faces give the areas.
    radiosity : (v, 3) ndarray
        At the mesh's vertices [W/mm^2].
    towards : (3,) ndarray, optional
        From the mesh to the eye; by default the whole surface counts as seen.

    Returns
    -------
    float
        [mm^2/W]; 1 where nothing is lit.
    """
    area = areas(mesh.vertices, mesh.faces) if towards is None else np.maximum(_areas_seen(mesh, towards), 0)
    weight = np.bincount(mesh.faces.ravel(), np.repeat(area, 3), minlength=len(mesh.vertices))
    seen = np.flatnonzero(weight)
    if not len(seen):
        return 1.0
    red, green, blue = radiosity.T
    brightest = np.nan_to_num(np.fmax(np.fmax(red, green), blue)[seen])
    order = np.argsort(brightest)
    share = np.cumsum(weight[seen][order])
    median, white = brightest[order[np.searchsorted(share, [0.5 * share[-1], 0.99 * share[-1]])]]
    if not white > 0:
        return 1.0
    stops = np.clip(0.5 * np.log2(0.4 * white / max(median, 1e-6 * white)), 0, 2)
    return float(2**stops / white)


def _areas_seen(mesh: Mesh, towards: np.ndarray) -> np.ndarray:
    """Twice the areas (f,) that faces have in a picture, negative from behind.

    This runs whenever the camera moves: two coordinates to a corner take a fifth of the time of normals.
    """
    right = np.cross(np.eye(3)[np.abs(towards).argmin()], towards)
    up = np.cross(towards, right)
    x, y = (sum(a * b for a, b in zip(axis / np.linalg.norm(axis), mesh.vertices.T, strict=True))
            for axis in (right, up))  # fmt: skip
    a, b, c = mesh.faces.T
    return (x[b] - x[a]) * (y[c] - y[a]) - (y[b] - y[a]) * (x[c] - x[a])
