"""Arrays that are wanted now and then, in temporary files instead of memory in between.

The files have no name, so that they go with their last user, however that ends. What reads them back has their bits.
"""

from __future__ import annotations

import contextlib
import math
import tempfile
import threading
from collections.abc import Callable, Iterator
from io import FileIO
from typing import Any, cast
from weakref import WeakSet

import numpy as np

from clsss.device import Buffer, Device
from clsss.errors import DeviceError
from clsss.room import Room

SMALL = 1 << 18  # bytes that may as well stay in memory
PIECE = 1 << 19  # bytes at a time
MOST_FILES = 64  # open at once: a process may open no more than some hundreds
_in_files: WeakSet[Stowed] = WeakSet()


class Stowed:
    """An array in a temporary file; in memory if it is small, or where no file can be had or filled.

    Parameters
    ----------
    shape : tuple of int
    dtype : dtype
    part : callable
        ``part(first, n)`` gives `n` rows from `first` on.
    """

    def __init__(self, shape: tuple[int, ...], dtype: Any, part: Callable[[int, int], np.ndarray]):
        self.shape, self.dtype = shape, np.dtype(dtype)
        self._row, self._turn = math.prod(shape[1:]) * self.dtype.itemsize, threading.Lock()
        self._file: FileIO | None = None
        if shape[0] * self._row > SMALL and len(_in_files) < MOST_FILES:
            with contextlib.suppress(OSError):
                self._file = self._filled(part)
                _in_files.add(self)
        self._values = np.empty(shape if self._file is None else 0, self.dtype)
        if self._file is None:
            for first, n in self._pieces():
                self._values[first : first + n] = part(first, n)

    def _pieces(self) -> Iterator[tuple[int, int]]:
        rows = max(1, PIECE // self._row)
        return ((first, min(rows, self.shape[0] - first)) for first in range(0, self.shape[0], rows))

    def _filled(self, part: Callable[[int, int], np.ndarray]) -> FileIO:
        file = cast(FileIO, tempfile.TemporaryFile(buffering=0))  # noqa: SIM115 -- it stays open
        for first, n in self._pieces():
            rows = np.ascontiguousarray(part(first, n), self.dtype)
            left = rows.reshape(-1).view(np.uint8).data
            while left:
                left = left[file.write(left) :]
        return file

    def rows(self, first: int, n: int) -> np.ndarray:
        """The `n` rows from `first` on, not to be written to.

        Raises
        ------
        DeviceError
            The file cannot be read any more.
        """
        if self._file is None:
            return self._values[first : first + n]
        out = np.empty((n, *self.shape[1:]), self.dtype)
        left = out.reshape(-1).view(np.uint8).data
        with self._turn:
            self._file.seek(first * self._row)
            while left:
                done = self._file.readinto(left)
                if not done:
                    raise DeviceError(f"a temporary file in {tempfile.gettempdir()} cannot be read back")
                left = left[done:]
        return out

    def get(self) -> np.ndarray:
        """All of it, likewise."""
        return self.rows(0, self.shape[0])

    def parts(self) -> Iterator[tuple[int, np.ndarray]]:
        """All of it, some rows at a time, with the number of the first."""
        return ((first, self.rows(first, n)) for first, n in self._pieces())

    def on_device(self, where: Device | Room) -> Buffer:
        """A copy of it on a device."""
        out = where.empty(self.shape, self.dtype)
        for first, rows in self.parts():
            out.set(rows, first)
        return out


def stow(*arrays: np.ndarray) -> Stowed:
    """Stow an array, or several of the same kind as one; their memory is free once nothing else holds them."""
    starts = np.cumsum([0, *map(len, arrays)])

    def part(first: int, n: int) -> np.ndarray:
        own = zip(arrays, starts, strict=False)
        return np.concatenate([a[max(0, first - start) : max(0, first + n - start)] for a, start in own])

    return Stowed((int(starts[-1]), *arrays[0].shape[1:]), arrays[0].dtype, part)
