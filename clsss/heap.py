"""What freed arrays leave with the C library."""

from __future__ import annotations

import contextlib
import ctypes

MANY = 200_000  # cells whose free memory is worth a millisecond or two


def give_back(n_cells: int = MANY) -> None:
    """Return it to the system, with glibc: it keeps more than a large mesh takes, or all levels of an octree.

    For an octree of fewer than `MANY` cells nothing is done.
    """
    if n_cells >= MANY:
        with contextlib.suppress(AttributeError, OSError, TypeError):  # other C libraries
            ctypes.CDLL(None).malloc_trim(0)
