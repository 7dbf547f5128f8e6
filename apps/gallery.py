"""What does each feature look like? One row of pictures for each, of the demonstration mesh or your own.

    python apps/gallery.py [--mesh FILE] [--only NAME] [--resolution N] [--quick] [--out FOLDER]

Draws FOLDER/NAME.png (docs/gallery by default), panels at one exposure a row. Five minutes on two cores. The row of
forward scattering shows the dragon of the folder CLSSS_SHARED, where that is set.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import trimesh
from PIL import Image, ImageDraw, ImageFont
from scipy.spatial import cKDTree

import clsss
from clsss.baker import seen_from
from clsss.camera import Camera, fitted
from clsss.demo import demo_mesh
from clsss.exposure import display_scale
from clsss.mesh import contains
from clsss.opengl import standalone_context
from clsss.renderer import Renderer

SIZE, BAND = (420, 340), 30
BACK = clsss.DirectionalLight((0.45, -0.35, 0.8), irradiance=1.0)
FRONT = clsss.DirectionalLight((0.3, -0.5, -0.8), irradiance=0.15)
Panel = tuple[str, np.ndarray]


class Baker:
    """The mesh at hand, its camera, and bakes of it."""

    def __init__(self, source: str | None, resolution: int):
        self.source, self.resolution = source, resolution
        self.mesh = self.load(20.0)
        toward = Camera(np.zeros(3), 1.0, azimuth=-25, elevation=12)
        self.camera = fitted(self.mesh.vertices, toward, SIZE[0] / SIZE[1])

    def load(self, size: float) -> clsss.Mesh:
        """The mesh, `size` mm long."""
        return clsss.load_mesh(self.source or demo_mesh(), size=size)

    def bake(self, medium: object, lights: list[object], **options: object) -> clsss.Result:
        """Bake the mesh of 20 mm."""
        return clsss.simulate(self.mesh, medium, lights, resolution=self.resolution, **options)

    def panels(self, rows: dict[str, tuple[object, list[object]]], **options: object) -> list[Panel]:
        """A panel of each medium and its lights."""
        return [(text, self.bake(*what, **options).vertex_radiosity) for text, what in rows.items()]


def sizes(baker: Baker) -> Iterator[Panel]:
    """The same skin in three sizes: translucency is a matter of scale."""
    for size in (10.0, 20.0, 40.0):
        result = clsss.simulate(baker.load(size), clsss.material("skin1"), [BACK, FRONT], resolution=baker.resolution)
        yield f"skin, {size:.0f} mm", result.vertex_radiosity


def mixtures(baker: Baker) -> list[Panel]:
    """Two materials blended by noise."""
    marble = clsss.material("marble")
    dense = clsss.Material(sigma_a=10 * marble.sigma_a, sigma_s=10 * marble.sigma_s, eta=marble.eta)
    lights = [BACK, FRONT]
    return baker.panels({
        "marble": (marble, lights),
        "marble, density 1 to 10": (clsss.Mix(marble, dense, clsss.Perlin(scale=4.0, seed=2)), lights),
        "marble with ketchup": (clsss.Mix(marble, clsss.material("ketchup"), clsss.Perlin(scale=5.0, seed=1)), lights),
    })  # fmt: skip


def given(baker: Baker) -> list[Panel]:
    """What the inside is made of, given as voxels, as a function of place, and as colours of the surface."""
    low, high = baker.mesh.bounds
    milk = clsss.material("skimmilk")
    cocoa = clsss.Material.from_reduced((0.03, 0.11, 0.26), 2.0, eta=milk.eta)
    middle, size = (low + high) / 2, baker.mesh.size
    rings = 0.5 + 0.5 * np.sin(np.linspace(0, 12 * np.pi, 96))[:, None, None] * np.ones((96, 4, 4))
    voxels = clsss.Voxels(rings, low, (high - low) / rings.shape)

    def core(points: np.ndarray) -> np.ndarray:
        return np.clip(2.2 - np.linalg.norm(points - middle, axis=1) / (0.16 * size), 0, 1)

    height = (baker.mesh.vertices[:, 1] - low[1]) / (high - low)[1]
    colours = np.stack([0.9 - 0.6 * height, 0.35 + 0.1 * height, 0.2 + 0.7 * height], axis=1)
    painted = clsss.Inward.painted(baker.mesh.vertices, colours, clsss.material("marble"))
    lights = [BACK, FRONT]
    return baker.panels({
        "voxels: rings of cocoa in milk": (clsss.Mix(milk, cocoa, voxels), lights),
        "a function: a core of cocoa": (clsss.Mix(milk, cocoa, core), lights),
        "colours of the surface, inward": (painted, lights),
    })  # fmt: skip


def anisotropy(baker: Baker) -> list[Panel]:
    """The same scattering, more and more of it forward: light goes deeper."""
    return baker.panels({
        f"g = {g}": (clsss.Material((0.002, 0.004, 0.007), 6.0, g=g, eta=1.3), [BACK, FRONT]) for g in (0.0, 0.5, 0.9)
    })  # fmt: skip


def mismatch(baker: Baker) -> list[Panel]:
    """Light that meets the surface from inside is reflected back, the more the higher its index."""
    return baker.panels({
        f"eta = {eta}": (clsss.Material((0.002, 0.004, 0.007), 2.5, eta=eta), [BACK, FRONT]) for eta in (1.0, 1.3, 1.6)
    })  # fmt: skip


def lights(baker: Baker) -> list[Panel]:
    """A lamp, a sky, the material's own glow, and all of them in one solve."""
    high = baker.mesh.bounds[1]
    lamp = clsss.PointLight((0.0, high[1] + 6.0, 6.0), 100.0)
    middle = baker.mesh.bounds.mean(axis=0)

    def embers(points: np.ndarray) -> np.ndarray:
        near = np.exp(-((np.linalg.norm(points - middle, axis=1) / 3.5) ** 2))
        return near[:, None] * np.array([0.5, 0.22, 0.06])

    picture = np.linspace(1.0, 0.0, 16)[:, None, None] ** 2 * np.array([0.25, 0.5, 1.0]) * np.ones((16, 32, 1))
    picture[9:11, 20:24] = (6.0, 2.5, 0.8)  # low in the sky, a sun
    each = {"a lamp": lamp, "a sky": clsss.EnvironmentLight(picture), "embers inside": clsss.Emission(embers)}
    milk = clsss.material("skimmilk")
    return baker.panels({**{name: (milk, [light]) for name, light in each.items()},
                         "all three": (milk, list(each.values()))})  # fmt: skip


def visibility(baker: Baker) -> list[Panel]:
    """What stands in the light: the object itself, its own light between its parts, another body."""
    marble, side = clsss.material("marble"), clsss.DirectionalLight((-1.0, -0.4, -0.1))
    low, high = baker.mesh.bounds
    board = trimesh.creation.box((0.5, 0.5 * (high - low)[1], 30.0))
    board.apply_translation((high[0] + 3.0, low[1] + 0.75 * (high - low)[1], 0.0))
    plain = baker.bake(marble, [side])
    slats = [trimesh.creation.box((2.2, 1e-9, 60.0)) for _ in range(9)]
    for k, slat in enumerate(slats):
        slat.apply_transform(trimesh.transformations.rotation_matrix(1.2, (0, 0, 1)))
        slat.apply_translation((high[0] + 3.0, low[1] + 3.2 * k, 0.0))
    blind = clsss.load_mesh(trimesh.util.concatenate(slats), solid=False)
    shaded, striped = (baker.bake(marble, [side], blockers=[b]) for b in (clsss.load_mesh(board), blind))
    return [("light from the side", plain.vertex_radiosity), ("a board before it", shaded.vertex_radiosity),
            ("a blind of flat cards", striped.vertex_radiosity)]  # fmt: skip


def hollow(baker: Baker) -> Iterator[Panel]:
    """A cavity lets light through unattenuated and gives back what falls on its wall; lined with black, it does not."""
    whole = baker.mesh
    bubble = _bubble(whole)
    lining = clsss.load_mesh(bubble, solid=False)
    inner = trimesh.Trimesh(bubble.vertices, bubble.faces[:, ::-1], process=False)
    outer = trimesh.Trimesh(whole.vertices, whole.faces, process=False)
    shell = clsss.load_mesh(trimesh.util.concatenate([outer, inner]))
    n, options = len(whole.vertices), {"resolution": baker.resolution}
    skin = clsss.material("skin2")
    yield "whole", baker.bake(skin, [BACK, FRONT]).vertex_radiosity
    yield "hollow", clsss.simulate(shell, skin, [BACK, FRONT], **options).vertex_radiosity[:n]
    dark = clsss.simulate(shell, skin, [BACK, FRONT], blockers=[lining], **options)
    yield "lined with black", dark.vertex_radiosity[:n]


def _bubble(mesh: clsss.Mesh) -> trimesh.Trimesh:
    """About the largest ball that leaves a thin wall around it."""
    points = np.random.default_rng(0).uniform(*mesh.bounds, (20_000, 3))
    points = points[contains(mesh, points)]
    deep, _ = cKDTree(mesh.vertices).query(points)
    bubble = trimesh.creation.icosphere(4, 0.85 * deep.max())
    return bubble.apply_translation(points[deep.argmax()])


def single(baker: Baker) -> list[Panel]:
    """Radiance towards this camera: what is scattered once depends on the view."""
    waxy = clsss.Material((0.05, 0.1, 0.2), 1.2, g=0.3, eta=1.3)
    result = baker.bake(waxy, [BACK, FRONT], scattering="split", phase="p1")
    assert result.vertex_radiosity_single is not None
    multiple = result.vertex_radiosity - result.vertex_radiosity_single
    return [
        ("scattered once", result.vertex_radiosity_single),
        ("scattered again", multiple),
        ("both, towards the camera", seen_from(result, baker.camera.eye)),
    ]


ROWS: list[Callable[[Baker], object]] = [
    sizes, mixtures, given, anisotropy, mismatch, lights, visibility, hollow, single,
]  # fmt: skip


def draw(baker: Baker, renderer: Renderer, panels: list[Panel]) -> Image.Image:
    """Panels side by side at the exposure of the brightest but for lone highlights."""
    scale = min(display_scale(baker.mesh, values, baker.camera.axes()[2]) for _, values in panels)
    sheet = Image.new("RGB", (SIZE[0] * len(panels), SIZE[1] + BAND), (24, 24, 24))
    pen, font = ImageDraw.Draw(sheet), ImageFont.load_default(17)
    for column, (text, values) in enumerate(panels):
        renderer.set_radiosity(values, scale)
        sheet.paste(Image.fromarray(renderer.picture(SIZE, baker.camera)), (column * SIZE[0], BAND))
        pen.text((column * SIZE[0] + 12, 8), text, (220, 220, 220), font)
    return sheet


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--mesh")
    parser.add_argument("--only", choices=[row.__name__ for row in ROWS])
    parser.add_argument("--resolution", type=int, default=112)
    parser.add_argument("--quick", action="store_true", help="coarse, and only the row of sizes")
    parser.add_argument("--out", type=Path, default=Path("docs/gallery"))
    args = parser.parse_args()
    resolution = 32 if args.quick else args.resolution
    dragon = Path(os.environ.get("CLSSS_SHARED", ""), "meshes", "dragon_201k_clean.ply")
    args.out.mkdir(parents=True, exist_ok=True)
    renderer = Renderer(standalone_context())
    for row in ROWS:
        if row.__name__ == (args.only or ("sizes" if args.quick else row.__name__)):
            shown = args.mesh or (str(dragon) if row is anisotropy and dragon.exists() else None)
            baker = Baker(shown, resolution)
            renderer.set_mesh(baker.mesh)
            path = args.out / f"{row.__name__}.png"
            draw(baker, renderer, list(row(baker))).save(path, optimize=True)
            print(f"{path}: {row.__doc__}", flush=True)


if __name__ == "__main__":
    main()
