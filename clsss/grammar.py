"""What the values of options look like as text: lengths, numbers, lights, mixtures, cameras.

Every function takes a text and gives a value, or an argparse.ArgumentTypeError of one sentence.
"""

from __future__ import annotations

import argparse
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass

PAINT = "paint"
_TO_MM = {"": 1.0, "mm": 1.0, "cm": 10.0, "m": 1000.0, "in": 25.4, "um": 1e-3}


def length(text: str) -> float:
    """Millimetres from "20", "20mm", "2cm", "0.1m" or "1in"."""
    match = re.fullmatch(r"\s*([0-9.eE+-]+)\s*([a-z]*)\s*", text)
    try:
        value = float(match[1]) * _TO_MM[match[2]] if match else 0.0
    except (ValueError, KeyError):
        value = 0.0
    if not 0 < value < float("inf"):
        raise argparse.ArgumentTypeError(f"{text!r} is no length above 0; write 20, 20mm, 2cm, 0.1m or 1in")
    return value


def numbers(text: str, *counts: int) -> tuple[float, ...]:
    """Comma-separated numbers, as many as one of `counts`."""
    try:
        values = tuple(float(part) for part in text.split(","))
    except ValueError:
        values = ()
    if len(values) not in counts or not all(map(math.isfinite, values)):
        words = {1: "one number", 2: "two numbers", 3: "three numbers", 5: "five numbers"}
        wanted = " or ".join(words[n] for n in counts)
        raise argparse.ArgumentTypeError(f"{text!r} is not {wanted}" + ", separated by commas" * (max(counts) > 1))
    return values


def stops(text: str) -> float:
    """An exposure in stops, within what a picture can use."""
    (value,) = numbers(text, 1)
    if abs(value) > 60:
        raise argparse.ArgumentTypeError(f"{text!r} is out of range; give stops within -60 and 60")
    return value


def whole(text: str) -> int:
    """A whole number."""
    try:
        return int(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is no whole number") from None


def count(text: str) -> int:
    """A whole number of 1 or more."""
    if (value := whole(text)) < 1:
        raise argparse.ArgumentTypeError(f"needs 1 or more, got {value}")
    return value


def number(text: str) -> float:
    """One number."""
    return numbers(text, 1)[0]


def channels(text: str) -> tuple[float, ...]:
    """One number, or three as red, green, blue."""
    return numbers(text, 1, 3)


@dataclass(frozen=True)
class LightOption:
    """A parsed ``--light``; `lights_from` makes the light once the mesh is known."""

    kind: str
    vector: tuple[float, ...] = ()
    strength: tuple[float, ...] = ()
    in_box: bool = False
    file: str = ""

    def __str__(self) -> str:
        parts = (self.file, joined(self.vector) + "b" * self.in_box, joined(self.strength))
        return ":".join([self.kind, *filter(None, parts)])


def joined(values: Sequence[float]) -> str:
    """Numbers with commas between, as `numbers` reads them, exactly."""
    return ",".join(f"{v:g}" if float(f"{v:g}") == v else repr(float(v)) for v in values)


def light(text: str) -> LightOption:
    """Parse ``directional:DX,DY,DZ[:E]``, ``point:X,Y,Z[b][:I]`` or ``env:FILE``."""
    kind, _, rest = text.partition(":")
    if kind == "env" and rest:
        try:
            return LightOption("env", strength=channels(rest))
        except argparse.ArgumentTypeError:
            return LightOption("env", file=rest)
    if kind not in ("directional", "point") or not rest:
        raise argparse.ArgumentTypeError(
            f"{text!r} is no light; write directional:DX,DY,DZ[:E], point:X,Y,Z[b][:I] or env:FILE.hdr"
        )
    vector, _, strength = rest.partition(":")
    in_box = kind == "point" and vector.endswith("b")
    values = numbers(vector.removesuffix("b") if in_box else vector, 3)
    if kind == "directional" and not any(values):
        raise argparse.ArgumentTypeError(f"{text!r} travels nowhere; give a direction that is not 0,0,0")
    return LightOption(kind, values, channels(strength) if strength else (), in_box)


def mixture(text: str) -> tuple[str, float | None, int]:
    """Parse ``NAME[:SCALE[:SEED]]``."""
    name, _, rest = text.partition(":")
    scale, _, seed = rest.partition(":")
    return name, length(scale) if scale else None, whole(seed) if seed else 0


def vertex_colours(text: str) -> tuple[str, ...]:
    """Parse ``MATERIAL_A:MATERIAL_B`` to both names, and ``paint`` to none."""
    if text == PAINT:
        return ()
    dark, _, bright = text.partition(":")
    if not (dark and bright):
        raise argparse.ArgumentTypeError(
            f"{text!r}: write {PAINT}, or two materials, of black and white, as marble:ketchup"
        )
    return dark, bright


def window_size(text: str) -> tuple[int, int]:
    """Pixels from ``1280x720``."""
    match = re.fullmatch(r"(\d+)x(\d+)", text)
    size = (int(match[1]), int(match[2])) if match else (0, 0)
    if not (min(size) >= 16 and max(size) <= 16384):
        raise argparse.ArgumentTypeError(f"{text!r} is no size; write 1280x720 (16 to 16384 each)")
    return size


def camera(text: str) -> tuple[float, ...]:
    """Azimuth, elevation and zoom from ``-25,12,1``, and how far it is moved aside from ``-25,12,1,0.2,-0.1``."""
    values = numbers(text, 2, 3, 5)
    values = values if len(values) > 2 else (*values, 1.0)
    if not (-89 <= values[1] <= 89 and values[2] > 0):
        raise argparse.ArgumentTypeError(f"{text!r}: the elevation lies within -89 and 89, the zoom above 0")
    return values
