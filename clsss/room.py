"""Device memory that is lent: of buffers whose contents nobody needs for a while."""

from __future__ import annotations

from math import prod
from typing import Any

import numpy as np

from clsss.device import BEYOND, Buffer, Device


class Room:
    """Parts of buffers, handed out piece by piece; what does not fit has memory of its own.

    Parameters
    ----------
    device : Device
    parts : tuple of Buffer, int and int
        Buffers that are no views of others, and the rows of each to be overwritten: the first, in multiples of
        `Device.row_alignment`, and the one after the last.
    """

    def __init__(self, device: Device, *parts: tuple[Buffer, int, int]):
        self.device = device
        self._free: list[list[Any]] = []  # memory, first and end of what is free [B]
        for whole, first, end in parts:
            row = whole.nbytes // whole.shape[0]
            self._free.append([whole.data, first * row, end * row])

    def empty(self, shape: tuple[int, ...], dtype: Any = None) -> Buffer:
        """A buffer of unspecified contents; `dtype` defaults to `real`."""
        kind = np.dtype(dtype or self.device.real)
        size, step = prod(shape) * kind.itemsize, 4 * self.device.row_alignment
        for part in self._free:
            data, first, end = part
            if size and first + size <= end:
                part[1] += -(-size // step) * step
                return Buffer(self.device, shape, kind, data.get_sub_region(first, size + BEYOND))
        return self.device.empty(shape, kind)

    def rest(self) -> Room:
        """What is left of it, for as long as nothing else is taken."""
        room = Room(self.device)
        room._free = [part.copy() for part in self._free]
        return room

    def array(self, values: np.ndarray) -> Buffer:
        """A buffer with a copy of host values; floating ones become `real`."""
        out = self.empty(values.shape, self.device.real if values.dtype.kind == "f" else values.dtype)
        out.set(values)
        return out
