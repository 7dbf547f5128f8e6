"""What the solve keeps of a level's coefficients: rows of numbers, and which row is whose (kernels/rows.h).

In a homogeneous medium full cells among their like have one transmissibility and absorb alike; towards leaves of other
levels they have few others. Only what differs from that is kept for each cell. In a heterogeneous one all do, of three
channels.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from clsss.device import Buffer, Device

SAMPLES = 2**14  # values among which frequent ones are sought
CHUNK = 2**14  # cells at a time, so that what is found of each takes little memory
CHANNELS = 4
MIXED = np.array([0x9E3779B97F4A7C15, 0xC2B2AE3D27D4EB4F, 0x165667B19E3779F9, 0xD6E8FEB86659FD93], np.uint64)
FREQUENT = 4  # transmissibilities of which cells may share rows


@dataclass(frozen=True, eq=False)
class Kept:
    """Values of cells by row.

    Attributes
    ----------
    values : (m, ...) real, device
    row : (n,) int32, device, or None
        Of each cell; rows beyond the last of `values` are the last. None: each cell has its own, of three channels.
    """

    values: Buffer
    row: Buffer | None

    @property
    def last(self) -> int:
        """The last row."""
        return self.values.shape[0] - 1

    def get(self) -> np.ndarray:
        """A copy on the host, of each cell (n, ...), with a spare fourth channel."""
        return np.concatenate(list(self.parts()))

    def parts(self) -> Iterator[np.ndarray]:
        """The same, some cells at a time."""
        values = None if self.row is None else self.values.get()
        for first, m in _chunks((self.row or self.values).shape[0]):
            if values is None or self.row is None:
                yield self.values.get(first, m)[..., [0, 1, 2, 2]]
            else:
                yield values[np.minimum(self.row.get(first, m), self.last)]


def _chunks(n: int) -> Iterator[tuple[int, int]]:
    """The first of each `CHUNK` of n cells, and how many there are."""
    return ((first, min(CHUNK, n - first)) for first in range(0, n, CHUNK))


def _frequent(values: Buffer, count: int, width: int) -> np.ndarray:
    """The rows of `width` numbers that are found most often among up to `SAMPLES`: (count, width) or fewer."""
    n = values.shape[0] * values.shape[1] // width
    step, sampled, before = max(1, -(-n // SAMPLES)), [], 0
    for first, m in _chunks(values.shape[0]):
        some = values.get(first, m).reshape(-1, width)
        sampled.append(some[-before % step :: step])
        before += len(some)
    rows = np.concatenate(sampled)
    # numpy sorts rows ten times slower than numbers; where two rows have the same, it matters little
    key = rows[:, 0] if width == 1 else rows.view(f"u{rows.itemsize}").astype(np.uint64) @ MIXED[:width]
    _, place, times = np.unique(key, return_index=True, return_counts=True)
    return rows[place[np.argsort(-times, kind="stable")[:count]]]


def _packed(device: Device, values: Buffer) -> Buffer:
    """Three of four channels."""
    n, *rest, _ = values.shape
    out = device.empty((n, *rest, 3))
    for first, m in _chunks(n):
        out.rows(first, m).set(values.get(first, m)[..., :3])
    return out


def _rows(T: Buffer, absorb: Buffer) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Row of each cell (n,), cells that rows are of, and which cells absorb unlike the most: they have the first."""
    n = T.shape[0]
    frequent, usual = _frequent(T, FREQUENT, 1), _frequent(absorb, 1, CHANNELS)
    place, sinks, common = np.empty(n, np.int16), np.empty(n, bool), np.zeros(n, bool)
    first_with = np.full(FREQUENT**6, n)
    for first, m in _chunks(n):
        part, some = slice(first, first + m), T.get(first, m)
        sinks[part] = (absorb.get(first, m) != usual).any(axis=1)
        digit, found = np.zeros(some.shape, np.int16), np.zeros(some.shape, bool)
        for k, value in enumerate(frequent):
            alike = some == value
            found |= alike
            digit += k * alike.view(np.int8)
        number = digit @ FREQUENT ** np.arange(6, dtype=np.int16)
        place[part], common[part] = number, found.all(axis=1) & ~sinks[part]
        np.minimum.at(first_with, number[common[part]], first + np.flatnonzero(common[part]))
    patterns = np.flatnonzero(first_with < n)
    n_own = np.count_nonzero(sinks)
    rows = np.zeros(FREQUENT**6, np.int32)
    rows[patterns] = n_own + np.arange(len(patterns), dtype=np.int32)
    kept = np.concatenate([np.flatnonzero(sinks), first_with[patterns], np.flatnonzero(~(common | sinks))])
    row = rows[place]
    row[kept] = np.arange(len(kept), dtype=np.int32)
    return row, kept, sinks


def _taken(values: Buffer, cells: np.ndarray) -> np.ndarray:
    """Rows of some cells."""
    out, order = np.empty((len(cells), *values.shape[1:]), values.dtype), np.argsort(cells)
    for first, m in _chunks(values.shape[0]):
        start, end = np.searchsorted(cells, (first, first + m), sorter=order)
        here = order[start:end]
        out[here] = values.get(first, m)[cells[here] - first]
    return out


def keep(device: Device, T: Buffer, absorb: Buffer) -> tuple[Kept, Kept]:
    """Transmissibilities (n, 6) or (n, 6, 4) and absorption (n, 4) of a level's cells."""
    if len(T.shape) == 3:
        return Kept(_packed(device, T), None), Kept(_packed(device, absorb), None)
    row, kept, sinks = _rows(T, absorb)
    own = np.flatnonzero(sinks)
    usual = kept[min(len(own), len(kept) - 1)]
    shared = device.array(row)
    del row, sinks
    absorption = device.array(_taken(absorb, np.append(own, usual)))
    return Kept(device.array(_taken(T, kept)), shared), Kept(absorption, shared)
