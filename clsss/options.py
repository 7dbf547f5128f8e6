"""What the user may say on a command line, shared by `clsss.view` and `clsss.cli`.

Parsing imports nothing heavy, so help and wrong usage are told at once; request.py makes the mesh, the medium
and the lights from what was parsed.
"""

from __future__ import annotations

import argparse
import math
import re
import sys
from dataclasses import dataclass

DEMO = "demo"
DEFAULT_MATERIAL = "marble"
DEFAULT_LIGHTS = ("directional:-0.25,-0.45,0.85:1", "directional:0.7,-0.6,-0.5:0.15")
_TO_MM = {"": 1.0, "mm": 1.0, "cm": 10.0, "m": 1000.0, "in": 25.4, "um": 1e-3}

WINDOW_HELP = (
    "left drag\torbit",
    "wheel\tzoom",
    "right drag\tpan",
    "+ -\texposure",
    "L\tleft drag turns the light, or again the camera",
    "S\tsave a picture",
    "R\treset camera and exposure",
    "H\tthis help",
    "Esc\tquit",
)
LIGHT_HELP = """lights (--light, repeatable; several add up):
  directional:DX,DY,DZ[:E]   parallel light that travels along DX,DY,DZ; E in W/mm^2, one number or R,G,B (1)
  point:X,Y,Z[:I]            lamp at X,Y,Z mm of the mesh's frame; I in W/sr, one number or R,G,B
  point:X,Y,Zb[:I]           the same in half-sides of the bounding box from its centre: 0,1.5,0b is above it;
                             without I, a lamp gives 1 W/mm^2 at the centre of the box
  env:FILE.hdr               light from all around, an equirectangular picture (.hdr .png .jpg), W/mm^2/sr
  env:L or env:R,G,B         the same light from everywhere
without --light: a light from behind and a weak one from the front

material file (--material FILE.toml), coefficients in 1/mm, one number or [R, G, B]:
  name = "wax"   sigma_a = [0.001, 0.002, 0.01]   sigma_s_prime = 1.5   (or sigma_s and g)   eta = 1.4
"""


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
        wanted = " or ".join({1: "one number", 2: "two numbers", 3: "three numbers"}[n] for n in counts)
        raise argparse.ArgumentTypeError(f"{text!r} is not {wanted}" + ", separated by commas" * (max(counts) > 1))
    return values


def stops(text: str) -> float:
    """An exposure in stops, within what a picture can use."""
    (value,) = numbers(text, 1)
    if abs(value) > 60:
        raise argparse.ArgumentTypeError(f"{text!r} is out of range; give stops within -60 and 60")
    return value


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
    try:
        return name, length(scale) if scale else None, int(seed) if seed else 0
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r}: the seed {seed!r} is no whole number") from None


def add_mesh(parser: argparse.ArgumentParser) -> None:
    """The mesh and its size."""
    parser.add_argument("mesh", metavar="MESH", help=f"mesh file; '{DEMO}' is a built-in one of 20 mm")
    parser.add_argument(
        "--size",
        type=length,
        metavar="MM",
        help="longest side of the bounding box: 20, 20mm, 2cm, 0.1m, 1in (the file's units as mm)",
    )


def add_shared(parser: argparse.ArgumentParser) -> None:
    """The options that view, bake and compare share."""
    add_mesh(parser)
    group = parser.add_argument_group("material")
    group.add_argument("--material", metavar="NAME|FILE.toml", help=f"see `clsss materials` ({DEFAULT_MATERIAL})")
    group.add_argument("--sigma-a", type=channels, metavar="R[,G,B]", help="absorption [1/mm]")
    group.add_argument("--sigma-s", type=channels, metavar="R[,G,B]", help="scattering [1/mm]")
    group.add_argument("--g", type=float, metavar="G", help="mean cosine of scattering (0)")
    group.add_argument("--eta", type=float, metavar="ETA", help="relative index of refraction (1)")
    group.add_argument(
        "--mix",
        type=mixture,
        metavar="NAME[:SCALE[:SEED]]",
        help="blend with another material in noise of this feature size (a quarter of the mesh)",
    )
    group = parser.add_argument_group("light and picture")
    group.add_argument("--light", type=light, action="append", metavar="LIGHT", help="see below; repeatable")
    group.add_argument(
        "--exposure",
        type=stops,
        default=0.0,
        metavar="EV",
        help="stops brighter than the automatic exposure (0)",
    )
    group.add_argument("--up", choices=("y", "z"), default="y", help="axis that points up (y)")
    group = parser.add_argument_group("solver")
    group.add_argument(
        "--resolution", type=int, default=128, metavar="N", help="finest cells along the longest side (128)"
    )
    group.add_argument("--tolerance", type=float, default=1e-4, metavar="T", help="relative residual (1e-4)")
    group.add_argument("--no-adaptive", dest="adaptive", action="store_false", help="the finest cells everywhere")
    group.add_argument("--precision", choices=("single", "double"), default="single")
    group.add_argument("--device", metavar="NAME", help="part of an OpenCL device's name (the best that works)")
    parser.add_argument("--quiet", action="store_true", help="say nothing but errors")


def parse(parser: argparse.ArgumentParser, argv: list[str] | None) -> argparse.Namespace:
    """Parse, taking values such as ``-30,15`` for what they are; argparse alone takes them for options."""
    joined: list[str] = []
    for word in sys.argv[1:] if argv is None else argv:
        if joined and re.fullmatch(r"--[a-z-]+", joined[-1]) and re.match(r"-[0-9.][^=]*,", word):
            joined[-1] += f"={word}"
        else:
            joined.append(word)
    args = parser.parse_args(joined)
    if "sigma_a" in args and not args.material and (args.sigma_a is None) != (args.sigma_s is None):
        parser.error("--sigma-a and --sigma-s go together, unless --material gives the other")
    return args
