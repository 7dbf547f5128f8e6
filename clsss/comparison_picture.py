"""The picture of a comparison: every method at one exposure, and below it how far it is from Monte Carlo.

    error = (M - M_mc) / (M_mc + mean M_mc / 100), averaged over the channels

Between the points that it was run at, Monte Carlo is interpolated. Input: a `Comparison` and a camera. Output:
an RGB picture of bytes.
"""

from __future__ import annotations

import numpy as np

from clsss.camera import Camera
from clsss.compare import Comparison
from clsss.exposure import display_scale
from clsss.renderer import Renderer
from clsss.srgb import srgb_decode

RANGE = 0.3  # relative error at the ends of the colour bar
NEIGHBOURS = 6  # points that Monte Carlo is interpolated between
BLUE, WHITE, RED = (0.09, 0.27, 0.66), (0.93, 0.93, 0.93), (0.72, 0.10, 0.10)
TEXT, GROUND = (235, 235, 235), (14, 14, 14)
BAND = 34  # pixels for a line of text


def picture(
    comparison: Comparison,
    renderer: Renderer,
    camera: Camera,
    size: tuple[int, int] = (480, 480),
    exposure: float = 0.0,
) -> np.ndarray:
    """Draw the comparison.

    Parameters
    ----------
    comparison : Comparison
        From `clsss.compare.compare`.
    renderer : Renderer
        To draw with; it is left showing the last error map.
    camera : Camera
        Where from.
    size : (int, int)
        Width and height of each panel in pixels.
    exposure : float
        Stops added to the automatic exposure, which is ours for all.

    Returns
    -------
    (h, w, 3) uint8
        Top row first.
    """
    from PIL import Image, ImageDraw, ImageFont

    mesh, truth = comparison.mesh, interpolated(comparison)
    renderer.set_mesh(mesh)
    names = list(comparison.radiosity)
    scale = display_scale(mesh, comparison.radiosity[names[0]])
    width, height = size
    sheet = Image.new("RGB", (width * (len(names) + 1), 2 * (height + BAND)), GROUND)
    draw, font = ImageDraw.Draw(sheet), ImageFont.load_default(16)

    def panel(column: int, row: int, text: str, values: np.ndarray, by: float, stops: float) -> None:
        renderer.set_radiosity(values, by)
        at = column * width, row * (height + BAND)
        sheet.paste(Image.fromarray(renderer.picture(size, camera, stops)), (at[0], at[1] + BAND))
        draw.text((at[0] + 12, at[1] + 8), text, TEXT, font)

    for column, (name, score) in enumerate(zip(names, comparison.scores, strict=True)):
        values = comparison.radiosity[name]
        panel(column, 0, f"{name}, {score.seconds:.1f} s", values, scale, exposure)
        error = ((values - truth) / (truth + truth.mean() / 100)).mean(axis=1)
        text = f"{name}: rms {score.rms:.1%}, bias {score.bias:+.1%}"
        panel(column, 1, text, 0.8 * srgb_decode(colours(error)), 1.0, 0.0)  # below the shoulder of the tone curve
    text = f"Monte Carlo, {comparison.seconds:.1f} s, noise {comparison.noise:.1%}"
    panel(len(names), 0, text, truth, scale, exposure)
    _bar(draw, font, (len(names) * width, height + BAND), size)
    return np.asarray(sheet)


def interpolated(comparison: Comparison) -> np.ndarray:
    """Monte Carlo's radiosity (v, 3) at every vertex, by inverse distance from the nearest points that face alike."""
    from scipy.spatial import cKDTree

    mesh = comparison.mesh
    place = np.hstack([mesh.vertices, mesh.size / 4 * mesh.normals])  # the two sides of thin parts are far apart
    k = min(NEIGHBOURS, len(comparison.points))
    distance, nearest = cKDTree(place[comparison.points]).query(place, k=[*range(1, k + 1)])
    weight = 1 / np.maximum(distance, 1e-9 * comparison.mesh.size) ** 2
    return np.einsum("vk,vkc->vc", weight, comparison.truth[nearest]) / weight.sum(axis=1)[:, None]


def colours(error: np.ndarray) -> np.ndarray:
    """Blue for too dark, red for too bright (..., 3), sRGB in 0..1."""
    x = np.clip(np.asarray(error) / RANGE, -1, 1)[..., None]
    return np.where(
        x < 0, (1 + x) * np.array(WHITE) - x * np.array(BLUE), (1 - x) * np.array(WHITE) + x * np.array(RED)
    )


def _bar(draw: object, font: object, at: tuple[int, int], size: tuple[int, int]) -> None:
    """The colour bar, in the panel that has no error map."""
    from PIL import ImageDraw

    assert isinstance(draw, ImageDraw.ImageDraw)
    left, right, top = at[0] + 40, at[0] + size[0] - 40, at[1] + BAND + size[1] // 2
    shown = np.round(0.906 * 255 * colours(np.linspace(-RANGE, RANGE, right - left))).astype(int)
    for x, colour in enumerate(shown):
        draw.line((left + x, top, left + x, top + 22), tuple(int(c) for c in colour))
    draw.text((left, top - 28), "relative error against Monte Carlo", TEXT, font)  # type: ignore[arg-type]
    for share in (-1, 0, 1):
        text = f"{share * RANGE:+.0%}" if share else "0"
        middle = left + (share + 1) * (right - left) / 2
        draw.text((middle, top + 28), text, TEXT, font, anchor="ma")  # type: ignore[arg-type]
