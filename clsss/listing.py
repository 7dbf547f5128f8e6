"""The measured materials in words and colours, and where diffusion describes them badly."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterable

import numpy as np

from clsss.materials import Material, material, materials
from clsss.srgb import srgb_encode
from clsss.validity import LEAST_ALBEDO, LEAST_PATHS

_LEGEND = f"""path: longest mean free path 1/sigma_tr [mm] of the channels; objects should be {LEAST_PATHS:g} thick
albedo: lowest reduced albedo of the three; ! marks those under {LEAST_ALBEDO:g}, where diffusion is only approximate
reflectance: what a thick block gives back of white light, also as sRGB"""


def table() -> str:
    """All materials, a line each."""
    reduced = "sigma_s' [1/mm]"
    head = f"{'':<27}{'sigma_a [1/mm]':>22}{reduced:>26}{'eta':>11}{'path':>8}{'albedo':>8}{'reflectance':>15}   colour"
    lines = [head]
    for name in materials():
        entry = material(name)
        mark = "!" if entry.albedo.min() < LEAST_ALBEDO else " "
        lines.append(
            f"{name:<27}{_three(entry.sigma_a, 8, 3)}{_three(entry.sigma_s_prime, 10, 3)}{entry.eta:6.2f}"
            f"{(1 / entry.sigma_tr).max():8.3g}{entry.albedo.min():7.3f}{mark}"
            f"{''.join(f'{value:5.2f}' for value in entry.diffuse_reflectance)}  {_swatch(entry)}"
        )
    return "\n".join([*lines, _LEGEND])


def one(name: str) -> str:
    """Everything about one material."""
    entry = material(name)
    rows = [
        ("absorption sigma_a", entry.sigma_a, "1/mm"),
        ("reduced scattering sigma_s'", entry.sigma_s_prime, "1/mm"),
        ("mean free path 1/sigma_tr", 1 / entry.sigma_tr, "mm"),
        ("attenuation sigma_eff", entry.sigma_eff, "1/mm"),
        ("reduced albedo", entry.albedo, ""),
        ("diffuse reflectance", entry.diffuse_reflectance, _swatch(entry)),
    ]
    lines = [entry.name, *(f"  {name:<28}{_three(values, 10, 4)}  {unit}".rstrip() for name, values, unit in rows)]
    lines += [f"  g {entry.g:g}, eta {entry.eta:g}", f"  source: {entry.source}"]
    if entry.albedo.min() < LEAST_ALBEDO:
        lines.append(f"  warning: a reduced albedo under {LEAST_ALBEDO:g}: diffusion is only approximate")
    thick = LEAST_PATHS / entry.sigma_tr.min()
    return "\n".join([*lines, f"  for objects of {thick:.2g} mm or more, {LEAST_PATHS:g} mean free paths"])


def _three(values: Iterable[float], width: int, digits: int) -> str:
    return "".join(f"{value:{width}.{digits}g}" for value in values)


def _swatch(entry: Material) -> str:
    red, green, blue = np.rint(255 * srgb_encode(entry.diffuse_reflectance)).astype(int)
    text = f"#{red:02x}{green:02x}{blue:02x}"
    return f"\x1b[48;2;{red};{green};{blue}m    \x1b[0m {text}" if _shows_colours() else text


def _shows_colours() -> bool:
    """Whether the terminal says that it shows 24-bit colours, and nobody said no (no-color.org)."""
    truecolour = os.environ.get("COLORTERM", "").lower() in ("truecolor", "24bit")
    return truecolour and sys.stdout.isatty() and not os.environ.get("NO_COLOR")
