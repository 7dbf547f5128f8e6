"""Device memory that is lent: of a buffer whose contents nobody needs for a while."""

from __future__ import annotations

from math import prod

from clsss.device import BEYOND, Buffer, Device


class Room:
    """A part of a buffer, handed out piece by piece; what does not fit has memory of its own.

    Parameters
    ----------
    device : Device
    whole : Buffer
        No view of another.
    first, end : int
        Rows of it to be overwritten; `first` in multiples of `Device.row_alignment`.
    """

    def __init__(self, device: Device, whole: Buffer, first: int, end: int):
        self.device, self._data = device, whole.data
        row = whole.nbytes // whole.shape[0]
        self._first, self._end = first * row, end * row

    def empty(self, shape: tuple[int, ...]) -> Buffer:
        """A buffer of type `real` and of unspecified contents."""
        size = prod(shape) * self.device.real.itemsize
        if not size or self._first + size > self._end:
            return self.device.empty(shape)
        data = self._data.get_sub_region(self._first, size + BEYOND)
        step = 4 * self.device.row_alignment
        self._first += -(-size // step) * step
        return Buffer(self.device, shape, self.device.real, data)
