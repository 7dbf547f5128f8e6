"""What the solve keeps of a level's coefficients: rows of numbers, and which row is whose (kernels/rows.h).

In a homogeneous medium full cells among their like have one transmissibility and absorb alike; towards leaves of other
levels they have few others. Only what differs from that is kept for each cell. In a heterogeneous one all do, of three
channels.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clsss.device import Buffer, Device

SAMPLES = 2**14  # values among which frequent ones are sought
CHUNK = 2**14  # cells at a time, so that what is found of each takes little memory
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
        values = self.values.get()
        return values[..., [0, 1, 2, 2]] if self.row is None else values[np.minimum(self.row.get(), self.last)]


def _frequent(values: np.ndarray, count: int) -> np.ndarray:
    """The rows (count, ...), or fewer, that are found most often among (n, ...)."""
    some = values[:: max(1, -(-len(values) // SAMPLES))]
    found, times = np.unique(some, axis=0, return_counts=True)
    return found[np.argsort(-times, kind="stable")[:count]]


def _patterns(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Which of the frequent values the rows (n, 6) have, as a number, and whether they have no others."""
    pattern, known = np.zeros(len(values), np.int16), np.zeros(len(values), bool)
    frequent = _frequent(values.ravel(), FREQUENT)
    for first in range(0, len(values), CHUNK):
        some, number = values[first : first + CHUNK], np.zeros(min(CHUNK, len(values) - first), np.int64)
        found = np.zeros(some.shape, bool)
        for k, value in enumerate(frequent):
            alike = some == value
            found |= alike
            number += k * alike @ FREQUENT ** np.arange(6)
        pattern[first : first + CHUNK], known[first : first + CHUNK] = number, found.all(axis=1)
    return pattern, known


def keep(device: Device, T: Buffer, absorb: Buffer) -> tuple[Kept, Kept]:
    """Transmissibilities (n, 6) or (n, 6, 4) and absorption (n, 4) of a level's cells."""
    T_host, absorb_host = T.get(), absorb.get()
    if T_host.ndim == 3:
        return Kept(device.array(T_host[..., :3]), None), Kept(device.array(absorb_host[:, :3]), None)
    sinks = (absorb_host != _frequent(absorb_host, 1)).any(axis=1)
    pattern, known = _patterns(T_host)
    common = np.flatnonzero(known & ~sinks)
    _, first, which = np.unique(pattern[common], return_index=True, return_inverse=True)
    own, others = np.flatnonzero(sinks), np.flatnonzero(~known & ~sinks)
    kept = np.concatenate([own, common[first], others])
    row = np.empty(len(T_host), np.int32)
    row[kept] = np.arange(len(kept), dtype=np.int32)
    row[common] = len(own) + which
    shared, usual = device.array(row), kept[min(len(own), len(kept) - 1)]
    return Kept(device.array(T_host[kept]), shared), Kept(device.array(absorb_host[np.append(own, usual)]), shared)
