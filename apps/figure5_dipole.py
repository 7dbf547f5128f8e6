"""How far are clsss and the dipole from Monte Carlo? A picture for each shape, and a table.

    python apps/figure5_dipole.py [--quick] [--only NAME] [--mesh FILE] [--out FOLDER]

Draws FOLDER/compare-NAME.png (docs/images by default) and prints the table of docs/compare.md. Exits with 1
where clsss is not closer to Monte Carlo than the dipole, or not twice as close where a shape is thin or hollow.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

import clsss
from clsss.camera import Camera, fitted
from clsss.compare import OURS, Comparison, compare
from clsss.comparison_picture import NEIGHBOURS, picture
from clsss.demo import demo_mesh
from clsss.errors import DeviceError, InputError
from clsss.opengl import standalone_context
from clsss.renderer import Renderer
from clsss.window import save_png

if TYPE_CHECKING:
    import trimesh

PANEL = (300, 300)
MARBLE = clsss.Material(sigma_a=0.0041, sigma_s=2.62)  # the green of Jensen et al. 2001; eta = 1: paths run backwards
SIDE = clsss.DirectionalLight((0.8, -0.45, -0.4))
BACK = clsss.DirectionalLight((0.45, -0.35, 0.8))


@dataclass(frozen=True)
class Case:
    """A shape, its light, the side it is seen from, its size if not in mm, and clsss's share of the dipole's rms."""

    shape: Callable[[], trimesh.Trimesh | str]
    light: clsss.DirectionalLight
    camera: Camera
    size: float | None = None
    share: float = 1.0


def looking(azimuth: float, elevation: float) -> Camera:
    """A camera from this side; `fitted` finds its distance."""
    return Camera(np.zeros(3), 1.0, azimuth, elevation)


def sphere() -> trimesh.Trimesh:
    """A ball 10 mm across."""
    from trimesh.creation import icosphere

    return icosphere(subdivisions=5, radius=5)


def torus() -> trimesh.Trimesh:
    """A ring 20 mm across that lies flat."""
    import trimesh

    ring = trimesh.creation.torus(7, 3, major_sections=128, minor_sections=64)
    return ring.apply_transform(trimesh.transformations.rotation_matrix(-np.pi / 2, (1, 0, 0)))


def plate() -> trimesh.Trimesh:
    """A plate 1 mm thick, tilted: along the solver's grid it would be a special case."""
    import trimesh

    mesh = trimesh.creation.box((20, 20, 1)).subdivide_to_size(0.5)
    return mesh.apply_transform(trimesh.transformations.euler_matrix(-0.2, 0.3, 0.1))


def cavity() -> trimesh.Trimesh:
    """A ball 20 mm across around a void of 16 mm, whose wall is wound inward."""
    from trimesh.creation import icosphere

    wall = icosphere(subdivisions=5, radius=8)
    wall.invert()
    return icosphere(subdivisions=5, radius=10) + wall


def cases(mesh: str | None) -> dict[str, Case]:
    """All of them by name; `mesh` stands in for the demonstration mesh."""

    def chosen() -> trimesh.Trimesh | str:
        return mesh or demo_mesh()

    front = looking(-25, 12)
    return {
        "sphere": Case(sphere, SIDE, looking(0, 15)),
        "torus": Case(torus, SIDE, looking(0, 40)),
        "plate": Case(plate, BACK, looking(-25, 15), share=0.5),
        "cavity": Case(cavity, SIDE, looking(0, 15), share=0.5),
        "mesh-20mm": Case(chosen, BACK, front, size=20.0),
        "mesh-40mm": Case(chosen, BACK, front, size=40.0),
    }


def compared(case: Case, quick: bool) -> Comparison:
    """Bake one shape and run the dipole and Monte Carlo on it."""
    mesh = clsss.load_mesh(case.shape(), size=case.size)
    result = clsss.simulate(mesh, MARBLE, [case.light], resolution=48 if quick else 128)
    return compare(result, *((150, 100) if quick else (250, 3000)))


def filled(found: Comparison) -> Comparison:
    """Monte Carlo at every vertex: its ratio to clsss, interpolated between points that face the same way.

    Points are too few to follow the light itself, and the two sides of thin parts differ.
    """
    from scipy.spatial import cKDTree

    mesh, ours, floor = found.mesh, found.radiosity[OURS], found.truth.mean() / 100
    place = np.hstack([mesh.vertices, mesh.size / 4 * mesh.normals])
    distance, near = cKDTree(place[found.points]).query(place, k=NEIGHBOURS)
    weight = 1 / np.maximum(distance, 1e-9 * mesh.size) ** 2
    weight /= weight.sum(axis=1, keepdims=True)
    ratio = (found.truth + floor) / (ours[found.points] + floor)
    truth = np.einsum("vk,vkc->vc", weight, ratio[near]) * (ours + floor) - floor
    return replace(found, points=np.arange(len(ours)), truth=truth)


def drawn(found: Comparison, renderer: Renderer, camera: Camera) -> np.ndarray:
    """The picture of a comparison from one side."""
    return picture(filled(found), renderer, fitted(found.mesh.vertices, camera, PANEL[0] / PANEL[1]), PANEL)


def rows(name: str, found: Comparison) -> list[str]:
    """Lines of the table."""
    lines = [
        f"| {name} | {s.name} | {s.rms:.1%} | {'' if told else '< '}{beyond:.1%} "
        f"| {s.largest:.0%} | {s.bias:+.1%} | {s.seconds:.1f} |"
        for s in found.scores
        for beyond, told in [found.beyond(s)]
    ]
    return [*lines, f"| {name} | Monte Carlo | {found.noise:.1%} | | | ±{found.bias_noise:.1%} | {found.seconds:.1f} |"]


def run(args: argparse.Namespace) -> list[str]:
    """Draw and print all that was asked for.

    Returns
    -------
    list of str
        A sentence for every bar that is missed.
    """
    renderer, missed = Renderer(standalone_context()), []
    args.out.mkdir(parents=True, exist_ok=True)
    print("| shape | method | rms | beyond noise | largest | bias | seconds |\n|---|---|---|---|---|---|---|")
    for name, case in cases(args.mesh).items():
        if args.only not in (None, name):
            continue
        found = compared(case, args.quick)
        save_png(drawn(found, renderer, case.camera), args.out / f"compare-{name}.png")
        print("\n".join(rows(name, found)), flush=True)
        ours, dipole = (score.rms for score in found.scores)
        if not (ours < dipole and ours <= case.share * dipole):
            missed.append(f"{name}: clsss is {ours / dipole:.0%} of the dipole's rms from Monte Carlo")
    return missed


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="coarse and noisy, in seconds")
    parser.add_argument("--only", choices=list(cases(None)))
    parser.add_argument("--mesh", help="in place of the demonstration mesh")
    parser.add_argument("--out", type=Path, default=Path("docs/images"))
    args = parser.parse_args()
    try:
        missed = run(args)
    except (InputError, DeviceError) as error:
        sys.exit(f"figure5_dipole: error: {error}")
    if missed:
        sys.exit("\n".join(f"FAIL {line}" for line in missed))


if __name__ == "__main__":
    main()
