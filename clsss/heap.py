"""What freed arrays leave with the C library."""

from __future__ import annotations

import contextlib
import ctypes


def give_back() -> None:
    """Return it to the system, with glibc: it keeps more than a large mesh takes, or all levels of an octree."""
    with contextlib.suppress(AttributeError, OSError, TypeError):  # other C libraries
        ctypes.CDLL(None).malloc_trim(0)
