"""What is found of an object once, and kept for as long as the object lives."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import TypeVar
from weakref import WeakKeyDictionary

Owner = TypeVar("Owner")
Found = TypeVar("Found")


def kept(find: Callable[[Owner], Found]) -> Callable[[Owner], Found]:
    """`find`, called once for each object; what it finds must not hold the object."""
    known: WeakKeyDictionary[Owner, Found] = WeakKeyDictionary()

    @functools.wraps(find)
    def look_up(owner: Owner) -> Found:
        if owner not in known:
            known[owner] = find(owner)
        return known[owner]

    return look_up
