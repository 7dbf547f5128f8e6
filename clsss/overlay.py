"""Words and a progress bar as a picture to lay over the window."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np

TEXT, DIM, SHADE = (235, 235, 235, 255), (170, 170, 170, 255), (12, 12, 12, 190)


@functools.lru_cache(maxsize=4)
def _font(size: int) -> Any:
    from PIL import ImageFont

    return ImageFont.load_default(size)


def panel(lines: list[str], scale: float = 1.0, fraction: float | None = None) -> np.ndarray:
    r"""A dark panel with lines of text and, below them, a bar.

    Parameters
    ----------
    lines : list of str
        Each "key\tmeaning" becomes two columns.
    scale : float
        Pixels per point: 2 on a display of double density.
    fraction : float, optional
        How much of the bar is full, 0 to 1; no bar if not given.

    Returns
    -------
    (h, w, 4) uint8 ndarray
        RGBA, top row first.
    """
    from PIL import Image, ImageDraw

    size, gap = round(15 * scale), round(12 * scale)
    font, step = _font(size), round(22 * scale)
    columns = [line.split("\t") for line in lines]
    first = max((font.getlength(c[0]) for c in columns if len(c) == 2), default=0) + 2 * gap
    ends = [font.getlength(c[0]) if len(c) == 1 else first + font.getlength(c[1]) for c in columns]
    bar = round(8 * scale) if fraction is not None else 0
    width = 2 * gap + int(max(*ends, 320 * scale if bar else 0, 0))
    height = 2 * gap + step * len(lines) + (bar + gap // 2 if bar else 0)
    picture = Image.new("RGBA", (width, height), SHADE)
    draw = ImageDraw.Draw(picture)
    for i, column in enumerate(columns):
        draw.text((gap, gap + i * step), column[0], TEXT, font)
        if len(column) == 2:
            draw.text((gap + first, gap + i * step), column[1], DIM, font)
    if fraction is not None:
        top, right = height - gap - bar, gap + round(min(max(fraction, 0), 1) * (width - 2 * gap))
        draw.rectangle((gap, top, width - gap, top + bar), (70, 70, 70, 255))
        draw.rectangle((gap, top, right, top + bar), (226, 160, 92, 255))
    return np.asarray(picture)
