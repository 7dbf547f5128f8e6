"""Surface, medium and lights as the Monte Carlo kernels take them.

Channels whose coefficients and light colours are alike are traced once.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from clsss.bvh import build
from clsss.device import Buffer, Device
from clsss.errors import InputError
from clsss.lights import Emission, EnvironmentLight, PointLight
from clsss.materials import Medium
from clsss.problem import checked_lights

QUANTITIES = ("radiosity", "single", "multiple")
SKY_BEAMS = 1024
LAUNCH_SECONDS = 0.2
GRID_NODES = 96  # along the longest side, for media that vary in space


@dataclass(frozen=True, eq=False)
class Sources:
    """Beams and lamps, and what shines inside.

    Attributes
    ----------
    place : (l, 4) float64
        Direction of travel and 0, or position [mm] and 1.
    strength : (l, 3) float64
        Irradiance [W/mm^2] or intensity [W/sr].
    emission : tuple of Emission
        What shines inside.
    """

    place: np.ndarray
    strength: np.ndarray
    emission: tuple[Emission, ...]

    @property
    def lamps(self) -> np.ndarray:
        """Which of them are lamps, (l,) bool."""
        return self.place[:, 3] > 0

    @property
    def varies(self) -> bool:
        """Whether some emission is a function of the place."""
        return any(callable(light.q0) for light in self.emission)

    @property
    def even_emission(self) -> np.ndarray:
        """Power per volume (3,) [W/mm^3] of the emission that is the same everywhere."""
        return np.sum([np.zeros(3), *(light.q0 for light in self.emission if not callable(light.q0))], axis=0)


def gather(lights: Sequence[Any]) -> Sources:
    """Beams, lamps and emission of all lights; a sky becomes `SKY_BEAMS` beams.

    Raises
    ------
    InputError
        There is none, one is no light, or all are black.
    """
    place, strength, emission = [], [], []
    for light in checked_lights(lights):
        if isinstance(light, PointLight):
            place.append([*light.position, 1.0])
            strength.append(light.intensity)
        elif isinstance(light, Emission):
            emission += [light] if callable(light.q0) or np.any(light.q0) else []
        else:
            beams = light.beams(SKY_BEAMS) if isinstance(light, EnvironmentLight) else [light]
            place += [[*b.direction, 0.0] for b in beams]
            strength += [b.irradiance for b in beams]
    lit = np.any(np.reshape(strength, (-1, 3)), axis=1)
    found = Sources(np.reshape(place, (-1, 4))[lit], np.reshape(strength, (-1, 3))[lit], tuple(emission))
    if not (emission or lit.any()):
        raise InputError("lights: there is no light; give at least one that is not black")
    return found


@dataclass(frozen=True)
class Walk:
    """How paths are walked: see `clsss.montecarlo.estimate`; `cap` is the most collisions a path may have."""

    seed: int
    reenter: bool
    cap: int
    progress: Callable[[str, float], None] | None


@dataclass(frozen=True, eq=False)
class TracedScene:
    """What paths and photons are traced in.

    Attributes
    ----------
    centre, half : (3,) float64
        Centre and half the extent of the bounding box [mm]. On the device lengths count from the centre, so
        that single precision is not spent on how far the object is from the origin.
    radius : float
        Of the sphere about the box's centre that holds the solid [mm].
    reach : float
        Of the sphere that holds what blocks light, too [mm].
    channel : (3,) int
        For red, green and blue, the channel that is traced.
    scale : (3,) float64
        Each colour's strongest light: what results are to be multiplied by.
    strength : (l, c) float64
        Strengths of the lights in the channels traced, over the strongest.
    emission : (c,) float64
        The same of the emission that does not vary.
    places : (m,) int
        Where on the device each of the triangles is.
    n_places : int
        How many places there are.
    """

    device: Device
    centre: np.ndarray
    half: np.ndarray
    radius: float
    reach: float
    channel: np.ndarray
    scale: np.ndarray
    strength: np.ndarray
    emission: np.ndarray
    places: np.ndarray
    n_places: int
    leaf_size: int
    n_leaves: int
    g: float
    nodes: tuple[int, ...]
    origin: Any
    inverse_spacing: Any
    defines: tuple[str, ...]
    majorant: Buffer
    grid: Buffer
    boxes: Buffer
    triangles: Buffer
    opaque: Buffer
    lights: Buffer

    @property
    def n_channels(self) -> int:
        """How many channels are traced."""
        return self.strength.shape[1]

    @property
    def surface(self) -> tuple[Any, ...]:
        """Kernel arguments: the tree of boxes, its triangles, and which of them absorb all light."""
        return self.n_leaves, self.leaf_size, self.boxes, self.triangles, self.opaque

    @property
    def medium(self) -> tuple[Any, ...]:
        """Kernel arguments: mean cosine, grid and coefficients."""
        return self.g, self.nodes, self.origin, self.inverse_spacing, self.majorant, self.grid

    def traced(self, values: np.ndarray) -> np.ndarray:
        """Of red, green and blue (..., 3) the channels that are traced (..., c)."""
        return values[..., np.unique(self.channel, return_index=True)[1]]

    def rgb(self, values: np.ndarray) -> np.ndarray:
        """Results (..., c) of the channels traced as (..., 3)."""
        return values[..., self.channel] * self.scale


def make_scene(
    triangles: np.ndarray, medium: Medium, sources: Sources, device: Device, opaque: np.ndarray | None = None
) -> TracedScene:
    """Build the tree of boxes, sample the medium, copy both to the device; `opaque` (k, 3, 3) absorbs all light."""
    n, low, high = len(triangles), triangles.min(axis=(0, 1)), triangles.max(axis=(0, 1))
    values, spacing = _sampled(medium, low, high)
    centre = (low + high) / 2
    triangles = (triangles if opaque is None else np.concatenate([triangles, opaque])) - centre
    lights = sources.place - np.where(sources.lamps[:, None], [*centre, 0], 0)
    tree = build(triangles)
    places = np.unique(tree.order, return_index=True)[1]
    placed = np.repeat(triangles[tree.order][:, :1], 3, axis=1)  # second copies shrink to a point: never hit
    placed[places] = triangles
    far = np.linalg.norm(triangles, axis=2) * (1 + 1e-5)
    relative, scale = _relative(sources)
    tints = np.arange(3)[:, None] if sources.varies else relative.T  # a function may colour any place
    chosen, channel = _alike(np.concatenate([values.reshape(3, -1), relative.T, tints], axis=1))
    values, relative = values[chosen], relative[:, chosen]
    return TracedScene(
        device=device,
        centre=centre,
        half=(high - low) / 2,
        radius=float(far[:n].max()),
        reach=float(far.max()),
        channel=channel,
        scale=scale,
        strength=relative[:-1],
        emission=relative[-1],
        places=places[:n].astype(np.int32),
        n_places=len(placed),
        leaf_size=tree.leaf_size,
        n_leaves=tree.n_leaves,
        g=float(medium.g),
        nodes=(*values.shape[3:0:-1], int(np.prod(values.shape[1:4]))),
        origin=device.vector(low - centre),
        inverse_spacing=device.vector(1 / spacing),
        defines=() if medium.homogeneous else ("HETEROGENEOUS",),
        majorant=device.array(values.sum(axis=-1).reshape(len(values), -1).max(axis=1)),
        grid=device.array(values),
        boxes=device.array(tree.boxes),
        triangles=device.array(placed),
        opaque=device.array((tree.order >= n).astype(np.uint8), np.uint8),
        lights=device.array(lights if len(lights) else np.zeros((1, 4))),
    )


def _relative(sources: Sources) -> tuple[np.ndarray, np.ndarray]:
    """Strengths of lights and of even emission (l + 1, 3) over each colour's strongest, and that (3,)."""
    strengths = np.vstack([sources.strength, sources.even_emission])
    scale = strengths.max(axis=0)
    scale[scale == 0] = 1
    return strengths / scale, scale


def _alike(rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """First row of each kind, and each row's kind."""
    first = [next(k for k in range(len(rows)) if np.array_equal(rows[k], row)) for row in rows]
    return np.unique(first, return_inverse=True)


def _sampled(medium: Medium, low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """sigma_a, sigma_s (3, nz, ny, nx, 2) at the nodes of a grid over the box, and its spacing [mm]."""
    extent = np.maximum(high - low, 1e-6 * np.max(high - low))
    if medium.homogeneous:
        shape = np.ones(3, int)
    else:
        shape = np.maximum(np.ceil(extent / extent.max() * GRID_NODES), 2).astype(int)
    spacing = extent / np.maximum(shape - 1, 1)
    z, y, x = (v.ravel() for v in np.indices(tuple(shape[::-1])))
    sigma_a, sigma_s = medium.coefficients(low + np.stack([x, y, z], axis=1) * spacing)
    values = np.stack([sigma_a, sigma_s], axis=-1).transpose(1, 0, 2)
    return values.reshape(3, *shape[::-1], 2), spacing


def launches(total: int, progress: Callable[[str, float], None] | None, block: int = 1) -> Iterator[tuple[int, int]]:
    """Start and size of launches of about `LAUNCH_SECONDS`, in whole blocks: Ctrl-C works in between."""
    start, count = 0, -(-64 // block) * block
    while start < total:
        count = min(count, total - start)
        began = time.perf_counter()
        yield start, count
        spent = max(time.perf_counter() - began, 1e-4)
        start += count
        count = int(np.clip(count * min(4.0, LAUNCH_SECONDS / spent), block, 2**20)) // block * block
        if progress:
            progress("paths", start / total)
