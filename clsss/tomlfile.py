"""TOML files that users write: tables whose unknown keys are told with the key that was meant."""

from __future__ import annotations

import difflib
import sys
from collections.abc import Collection
from pathlib import Path
from typing import Any

from clsss.errors import InputError

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib


def read(path: str | Path, keys: Collection[str]) -> dict[str, Any]:
    """The table of a TOML file.

    Parameters
    ----------
    path : str or Path
        The file.
    keys : collection of str
        All that may stand in it.

    Raises
    ------
    InputError
        The file cannot be read, is no TOML, or has another key; the message names one like it, or all.
    """
    try:
        table = tomllib.loads(Path(path).read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from error
    except ValueError as error:  # not TOML, or not UTF-8
        raise InputError(f"{path}: is no TOML file: {error}") from error
    for key in table:
        if key not in keys:
            near = difflib.get_close_matches(key, keys, 1)
            hint = f"did you mean {near[0]!r}?" if near else f"known are {', '.join(keys)}"
            raise InputError(f"{path}: unknown key {key!r}; {hint}")
    return table
