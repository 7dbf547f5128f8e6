"""The triangles of a surface as the device takes them: some at a time, and none much larger than a few cells."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from clsss.device import Device

LONGEST_EDGE = 8.0  # in cells; longer triangles are split so that no work-item has much more to do than others
CHUNK = 1 << 16  # triangles at a time, so that the device need not hold much


def _is_long(triangles: np.ndarray, longest: float) -> np.ndarray:
    return np.linalg.norm(triangles - np.roll(triangles, -1, axis=1), axis=2).max(axis=1) > longest


def split_long(triangles: np.ndarray, longest: float) -> np.ndarray:
    """Split triangles (m, 3, 3) at their edges' midpoints until no edge is longer than `longest`."""
    done = []
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
    triangles : (m, 9) real
        [cells]
    """

    def __init__(self, device: Device, triangles: np.ndarray):
        self._device, self._triangles = device, triangles
        self._held = device.empty((min(len(triangles), CHUNK), 9))
        if len(triangles) <= CHUNK:
            self._held.set(triangles)

    def run(self, kernel: Any, before: tuple[Any, ...], after: tuple[Any, ...]) -> None:
        """Enqueue `kernel` with ``(n, *before, triangles, *after)``."""
        for first in range(0, len(self._triangles), CHUNK):
            part = self._triangles[first : first + CHUNK]
            if len(self._triangles) > CHUNK:
                self._held.rows(0, len(part)).set(part)
            self._device.run(kernel, len(part), len(part), *before, self._held, *after)


def whole_and_pieces(device: Device, to_cells: Callable[[np.ndarray], np.ndarray],
                     triangles: np.ndarray) -> tuple[Triangles, Triangles]:  # fmt: skip
    """Triangles (m, 3, 3) [mm] as kernels take them, as they are and split where they are long."""
    whole, is_long = np.empty((len(triangles), 9), device.real), np.zeros(len(triangles), bool)
    split: list[np.ndarray] = []
    for first in range(0, len(triangles), CHUNK):
        part = slice(first, first + CHUNK)
        some = to_cells(triangles[part])
        whole[part], is_long[part] = some.reshape(-1, 9), _is_long(some, LONGEST_EDGE)
        if is_long[part].any():
            split.append(split_long(some[is_long[part]], LONGEST_EDGE).reshape(-1, 9).astype(device.real))
    surface = Triangles(device, whole)
    return surface, Triangles(device, np.concatenate([whole[~is_long], *split])) if split else surface
