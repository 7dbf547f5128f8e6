"""The triangles of a surface as the device takes them: some at a time, and none much larger than a few cells."""

from __future__ import annotations

from typing import Any

import numpy as np

from clsss.device import Device

LONGEST_EDGE = 8.0  # in cells; longer triangles are split so that no work-item has much more to do than others
SOME = 1 << 13  # triangles whose edges are measured at a time
CHUNK = 1 << 16  # triangles at a time, so that the device need not hold much


def _is_long(triangles: np.ndarray, longest: float) -> np.ndarray:
    return np.linalg.norm(triangles - np.roll(triangles, -1, axis=1), axis=2).max(axis=1) > longest


def split_long(triangles: np.ndarray, longest: float) -> np.ndarray:
    """Split triangles (m, 3, 3) at their edges' midpoints until no edge is longer than `longest`."""
    done = [triangles[:0]]
    while len(triangles):
        is_long = _is_long(triangles, longest)
        done.append(triangles[~is_long])
        a, b, c = np.moveaxis(triangles[is_long], 1, 0)
        ab, bc, ca = (a + b) / 2, (b + c) / 2, (c + a) / 2
        parts = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
        triangles = np.concatenate([np.stack(part, axis=1) for part in parts])
    return np.concatenate(done)


class Triangles:
    """Triangles that kernels run over, one a work-item; the device holds `CHUNK` of them at once.

    Parameters
    ----------
    device : Device
    points : (p, 3) float
        [cells]
    corners : (m, 3) int
        Of each triangle, as indices into `points`.
    """

    def __init__(self, device: Device, points: np.ndarray, corners: np.ndarray):
        self._device, self._points, self._corners = device, points.astype(device.real), corners
        self._held = device.empty((min(len(corners), CHUNK), 9))
        if len(corners) <= CHUNK:
            self._hold(corners)

    def _hold(self, corners: np.ndarray) -> None:
        self._held.rows(0, len(corners)).set(self._points[corners].reshape(-1, 9))

    def run(self, kernel: Any, before: tuple[Any, ...], after: tuple[Any, ...]) -> None:
        """Enqueue `kernel` with ``(n, *before, triangles, *after)``."""
        for first in range(0, len(self._corners), CHUNK):
            part = self._corners[first : first + CHUNK]
            if len(self._corners) > CHUNK:
                self._hold(part)
            self._device.run(kernel, len(part), len(part), *before, self._held, *after)


def whole_and_pieces(device: Device, points: np.ndarray, corners: np.ndarray) -> tuple[Triangles, Triangles]:
    """Triangles as kernels take them, as they are and split where they are long; arguments as of `Triangles`."""
    is_long, split = np.zeros(len(corners), bool), [points]
    for first in range(0, len(corners), SOME):
        part = slice(first, first + SOME)
        is_long[part] = _is_long(points[corners[part]], LONGEST_EDGE)
    for first in range(0, len(corners), CHUNK):
        part = slice(first, first + CHUNK)
        split.append(split_long(points[corners[part][is_long[part]]], LONGEST_EDGE).reshape(-1, 3))
    surface = Triangles(device, points, corners)
    if not is_long.any():
        return surface, surface
    pieces = np.concatenate(split)
    own = np.arange(len(points), len(pieces), dtype=corners.dtype).reshape(-1, 3)
    return surface, Triangles(device, pieces, np.concatenate([corners[~is_long], own]))
