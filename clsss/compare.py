"""Ours, the dipole and Monte Carlo side by side: how far each is from the truth, and what it costs.

    rms = |x - x_mc| / |x_mc|     largest = max |x - x_mc| / rms(x_mc)     bias = sum(x - x_mc) / sum(x_mc)
    beyond noise = sqrt(rms^2 - noise^2)

over points and channels. Input: a `Result`. Output: a `Comparison`, as a table here, as a picture from
comparison_picture.py. Where photons are counted around points, the others are averaged over the same surface.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from clsss.device import Device
from clsss.dipole import dipole
from clsss.errors import InputError
from clsss.halfedges import areas
from clsss.mesh import Mesh
from clsss.montecarlo import check_counts, estimate
from clsss.subdivision import owners

if TYPE_CHECKING:
    from clsss.simulate import Result

Progress = Callable[[str, float], None]

OURS, DIPOLE = "clsss", "dipole"


@dataclass(frozen=True)
class Score:
    """How far one method is from Monte Carlo, relative (see the module), and its time [s]."""

    name: str
    rms: float
    largest: float
    bias: float
    seconds: float


@dataclass(frozen=True, eq=False)
class Comparison:
    """What was compared.

    Attributes
    ----------
    mesh : Mesh
        The solid.
    radiosity : dict of (v, 3) float64
        Of each method at the vertices [W/mm^2], ours first.
    points : (n,) int64
        Vertices that Monte Carlo was run at.
    truth, stderr : (n, 3) float64
        Its radiosity there and standard error [W/mm^2].
    scores : list of Score
        Of each method.
    noise, bias_noise, seconds : float
        Monte Carlo's own error, relative as rms and as bias are, and time [s].
    doubt : float
        How far the square of a method's rms may be off by that noise, at two standard deviations.
    left_out : str
        Why a method is missing, or empty.
    """

    mesh: Mesh
    radiosity: dict[str, np.ndarray]
    points: np.ndarray
    truth: np.ndarray
    stderr: np.ndarray
    scores: list[Score]
    noise: float
    bias_noise: float
    doubt: float
    seconds: float
    left_out: str = ""

    def beyond(self, score: Score) -> tuple[float, bool]:
        """The rms that noise does not explain and whether it can be told from none; if not, a bound of it."""
        excess = score.rms**2 - self.noise**2
        told = excess > self.doubt
        return float(np.sqrt(excess if told else max(excess, 0) + self.doubt)), told

    def table(self) -> str:
        """The scores as lines of text."""
        lines = [f"{'method':<12}{'rms':>8}{'beyond noise':>15}{'largest':>10}{'bias':>9}{'seconds':>10}"]
        hidden = []
        for s in self.scores:
            beyond, told = self.beyond(s)
            hidden += [] if told else [s.name]
            text = f"{'' if told else '< '}{beyond:.2%}"
            lines.append(f"{s.name:<12}{s.rms:>8.2%}{text:>15}{s.largest:>10.1%}{s.bias:>+9.2%}{s.seconds:>10.1f}")
        bias = f"+-{self.bias_noise:.2%}"
        lines.append(f"{'Monte Carlo':<12}{self.noise:>8.2%}{'':>25}{bias:>9}{self.seconds:>10.1f}")
        lines.append(f"against Monte Carlo at {len(self.points)} points, whose own rms is noise")
        for name in hidden:
            lines.append(f"Monte Carlo's noise hides how far {name} is off; four times the paths halve it")
        return "\n".join([*lines, self.left_out] if self.left_out else lines)


def compare(
    result: Result, n_points: int = 1000, n_paths: int = 1000, seed: int = 0, progress: Progress | None = None
) -> Comparison:
    """Run the dipole and Monte Carlo on what was simulated.

    Parameters
    ----------
    result : Result
        From `clsss.simulate`.
    n_points : int
        Vertices to run Monte Carlo at, spread over the surface by area; all where there are fewer.
    n_paths : int
        Paths per point and channel.
    seed : int
        Of the points and paths.
    progress : callable, optional
        Called with a stage and the fraction of it that is done.

    Raises
    ------
    InputError
        There is nothing to sample, or a number makes no sense.
    """
    check_counts(seed, n_points=n_points, n_paths=n_paths)
    mesh, medium, lights, blockers = result.mesh, result.medium, result.lights, result.blockers
    device = Device(result.report["device"], "single")
    radiosity = {OURS: result.vertex_radiosity}
    seconds = {OURS: float(result.report["seconds"]["total"])}
    left_out = ""
    try:
        started = time.perf_counter()
        radiosity[DIPOLE] = dipole(mesh, medium, lights, device=device, progress=progress, blockers=blockers)
        seconds[DIPOLE] = time.perf_counter() - started
    except InputError as error:
        left_out = f"no dipole: {error}"
    weight = vertex_areas(mesh)
    points = _spread(weight, n_points, seed)
    share = float(np.sqrt(weight.sum() / (np.pi * len(points))))
    truth = estimate(
        mesh, medium, lights, n_paths, mesh.vertices[points], mesh.normals[points],
        seed=seed, radius=share, device=device, progress=progress, blockers=blockers,
    )  # fmt: skip
    good = np.isfinite(truth.radiosity).all(axis=1)
    scores = []
    for name, values in radiosity.items():
        around = _averaged(mesh, values, weight, points, truth.radius)
        scores.append(_score(name, around[good], truth.radiosity[good], seconds[name]))
    known, stderr = truth.radiosity[good], truth.stderr[good]
    noise = noise_of(known, stderr)
    return Comparison(mesh, radiosity, points[good], known, stderr, scores, *noise, truth.seconds, left_out)


def noise_of(truth: np.ndarray, stderr: np.ndarray) -> tuple[float, float, float]:
    """Monte Carlo's `noise`, `bias_noise` and `doubt` (see `Comparison`); its channels may share their paths."""
    tiny = np.finfo(float).tiny
    scale = max(np.sum(truth**2), tiny)
    variance = np.sum(stderr**2, axis=1) / scale
    bias = np.sqrt(np.sum(np.sum(stderr, axis=1) ** 2)) / max(truth.sum(), tiny)
    return float(np.sqrt(variance.sum())), float(bias), float(2 * np.sqrt(2 * np.sum(variance**2)))


def vertex_areas(mesh: Mesh) -> np.ndarray:
    """A third of the area of its faces, for every vertex (v,) [mm^2]."""
    area = areas(mesh.vertices, mesh.faces)
    return np.bincount(mesh.faces.ravel(), np.repeat(area / 3, 3), minlength=len(mesh.vertices))


def _spread(weight: np.ndarray, n_points: int, seed: int) -> np.ndarray:
    used = np.flatnonzero(weight > 0)
    if len(used) <= n_points:
        return used
    share = weight[used] / weight[used].sum()
    return np.sort(np.random.default_rng(seed).choice(used, n_points, replace=False, p=share))


def _averaged(mesh: Mesh, values: np.ndarray, weight: np.ndarray, points: np.ndarray, radius: float) -> np.ndarray:
    """Values at the vertices averaged over each point's part of the surface, up to `radius` from it."""
    if radius == 0:
        return values[points]
    facing = mesh.normals[points]
    owner = owners(mesh.vertices, mesh.normals, mesh.vertices[points], facing, radius)
    near = (owner >= 0) & (weight > 0)
    owner, weight = owner[near], weight[near]
    sums = [np.bincount(owner, weight * values[near, c], len(points)) for c in range(3)]
    with np.errstate(invalid="ignore"):
        return np.stack(sums, axis=1) / np.bincount(owner, weight, len(points))[:, None]


def _norm(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def _score(name: str, values: np.ndarray, truth: np.ndarray, seconds: float) -> Score:
    off, scale = values - truth, max(_norm(truth), np.finfo(float).tiny)
    bias = off.sum() / max(truth.sum(), np.finfo(float).tiny)
    return Score(name, _norm(off) / scale, float(np.abs(off).max()) / scale, float(bias), seconds)
