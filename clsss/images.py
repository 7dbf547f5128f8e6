"""Pictures of light: files to linear radiance, top row first.

Radiance .hdr (RGBE, plain or run-length encoded) and OpenEXR keep their values; other pictures are sRGB from 0 to 1.
"""

from __future__ import annotations

import os
import re
from pathlib import Path

import numpy as np

from clsss.errors import InputError
from clsss.srgb import srgb_decode

EXR = b"v/1\x01"  # what OpenEXR files begin with


def read_radiance(path: str | os.PathLike[str]) -> np.ndarray:
    """Linear RGB of a picture.

    Parameters
    ----------
    path : str or path-like
        A Radiance ``.hdr`` or OpenEXR ``.exr`` file, or anything Pillow reads.

    Returns
    -------
    (h, w, 3) float64 ndarray
        Top row first.

    Raises
    ------
    InputError
        The file cannot be read or is no picture, or the package for its format is missing.

    References
    ----------
    Ward 1991, "Real pixels"; the file format of Radiance's reference manual.
    """
    try:
        data = Path(path).read_bytes()
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from error
    if data.startswith((b"#?RADIANCE", b"#?RGBE")):
        try:
            return _rgbe(data)
        except (ValueError, IndexError) as error:
            raise InputError(f"{path}: is no complete Radiance picture: {error}") from error
    if data.startswith(EXR):
        return _exr(Path(path))
    return _pillow(Path(path))


def _exr(path: Path) -> np.ndarray:
    """The channels R, G and B of the first part, or Y as grey."""
    try:
        import OpenEXR

        with OpenEXR.File(str(path), separate_channels=True) as file:
            channels = {name: channel.pixels.astype(float) for name, channel in file.channels().items()}
    except ImportError as error:
        raise InputError(f"{path}: needs a package for this format: pip install 'clsss[exr]'") from error
    except Exception as error:  # a damaged file may raise anything
        raise InputError(f"{path}: is no complete OpenEXR picture: {error}") from error
    names = "RGB" if {"R", "G", "B"} <= set(channels) else "YYY"
    if names[0] not in channels:
        raise InputError(f"{path}: needs the channels R, G and B, or Y, has {', '.join(channels)}")
    return np.stack([channels[name] for name in names], axis=2)


def _pillow(path: Path) -> np.ndarray:
    from PIL import Image

    try:
        with Image.open(path) as picture:
            if picture.mode in ("I", "F"):  # Pillow would clip them to bytes, and greys of 16 bits, too
                raise InputError(f"{path}: has numbers of 32 bits; save it as .hdr or .exr")
            is_deep = picture.mode.startswith("I;16")
            x = np.asarray(picture if is_deep else picture.convert("RGB"), float)
    except Image.DecompressionBombError as error:
        raise InputError(f"{path}: is far larger than light from all around needs; scale it down") from error
    except OSError as error:
        raise InputError(f"{path}: is no picture that can be read (.hdr, .exr, .png and .jpg are)") from error
    return srgb_decode(np.repeat(x[..., None], 3, axis=2) / 65535 if is_deep else x / 255)


def _rgbe(data: bytes) -> np.ndarray:
    header = re.search(rb"\n\n-Y (\d+) \+X (\d+)\n", data)
    if header is None:
        raise ValueError("its rows must run from the top down ('-Y height +X width')")
    height, width = int(header[1]), int(header[2])
    if height * width > 16 * len(data):  # two bytes stand for 127 numbers at most
        raise ValueError(f"it promises {width} x {height} pixels, more than it holds")
    at = header.end()
    pixels = np.empty((height, width, 4), np.uint8)
    for row in pixels:
        if data[at : at + 4] == bytes((2, 2, width >> 8, width & 255)):
            at = _run_lengths(data, at + 4, row)
        else:
            row[:] = np.frombuffer(data, np.uint8, 4 * width, at).reshape(width, 4)
            at += 4 * width
    mantissa, exponent = pixels[..., :3].astype(float), pixels[..., 3:].astype(int)
    return np.where(exponent == 0, 0.0, np.ldexp(mantissa, exponent - 136))


def _run_lengths(data: bytes, at: int, row: np.ndarray) -> int:
    """Decode one row, channel by channel; returns where the next one begins."""
    for channel in range(4):
        x = 0
        while x < len(row):
            count = data[at]
            is_run = count > 128
            count -= 128 if is_run else 0
            values = np.frombuffer(data, np.uint8, 1 if is_run else count, at + 1)
            if not 0 < count <= len(row) - x:
                raise ValueError("a run of pixels is longer than its row")
            row[x : x + count, channel] = values
            x, at = x + count, at + 1 + len(values)
    return at
