"""What a surface is painted with, extended inward: coefficients of the nearest point of the surface.

    R(albedo) = albedo / ((1 + s) (1 + 2 A s / 3)), s = sqrt(3 (1 - albedo)), inverted: colour -> albedo

Input: a mesh's file with colours at its vertices, or a texture; output: a medium.
"""

from __future__ import annotations

import functools
import gzip
import io
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from clsss.errors import InputError
from clsss.materials import Material, check_boundary, check_coefficients, diffuse_reflectance, numbers
from clsss.srgb import srgb_decode

_PAINTED = (0.01, 0.98)  # reflectance: no paint is blacker or whiter, and in pure white light would never end


@dataclass(frozen=True, eq=False)
class Inward:
    """Coefficients known on the surface, extended inward: those of the nearest point.

    Parameters
    ----------
    points : (n, 3) array_like
        Where they are known [mm], in the mesh's frame: its vertices.
    sigma_a, sigma_s : (n, 3) array_like
        Coefficients there [1/mm].
    g, eta : float
        As in `Material`.
    """

    points: np.ndarray
    sigma_a: np.ndarray
    sigma_s: np.ndarray
    g: float = 0.0
    eta: float = 1.0

    def __post_init__(self) -> None:
        g, eta = check_boundary(self.g, self.eta)
        fields = ("points", "sigma_a", "sigma_s")
        arrays = [numbers(field, getattr(self, field)) for field in fields]
        n = arrays[0].size // 3
        for field, array in zip(fields, arrays, strict=True):
            if not n or array.shape != (n, 3):
                raise InputError(f"{field}: needs shape ({n or 'n'}, 3), got {array.shape}")
            object.__setattr__(self, field, array)
        check_coefficients(self.sigma_a, self.sigma_s)
        if not np.all(np.isfinite(self.points)):
            raise InputError("points: must be finite")
        object.__setattr__(self, "g", g)
        object.__setattr__(self, "eta", eta)

    @classmethod
    def blend(cls, points: Any, weight: Any, a: Material, b: Material) -> Inward:
        """Two materials by a weight (n,) in 0..1 at the points: sigma_a and sigma_s' are blended."""
        w = np.clip(numbers("weight", weight), 0, 1).reshape(-1, 1)
        g, eta = (a.g + b.g) / 2, (a.eta + b.eta) / 2
        reduced = (1 - w) * a.sigma_s_prime + w * b.sigma_s_prime
        return cls(points, (1 - w) * a.sigma_a + w * b.sigma_a, reduced / (1 - g), g, eta)

    @classmethod
    def painted(cls, points: Any, colours: Any, material: Material) -> Inward:
        """A material as dense as the given one, sigma_tr, with the albedo that gives it the colours.

        Parameters
        ----------
        points : (n, 3) array_like
            Where it is painted [mm].
        colours : (n, 3) array_like
            Linear diffuse reflectance, 0..1, of a thick block in white light.
        material : Material
            Gives sigma_tr, g and eta.
        """
        s = np.linspace(np.sqrt(3), 0, 2001)  # finest where the albedo is near 1
        albedo = 1 - s * s / 3
        reflectance = diffuse_reflectance(albedo, material.eta)
        colours = np.clip(numbers("colours", colours), *_PAINTED)
        reduced = np.interp(colours, reflectance, albedo) * material.sigma_tr
        return cls(points, material.sigma_tr - reduced, reduced / (1 - material.g), material.g, material.eta)

    @property
    def homogeneous(self) -> bool:
        """False: the coefficients vary in space."""
        return False

    @functools.cached_property
    def _tree(self) -> Any:
        from scipy.spatial import cKDTree

        return cKDTree(self.points)

    def coefficients(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """sigma_a and sigma_s [1/mm], (n, 3) each, at points (n, 3) [mm]."""
        nearest = self._tree.query(np.asarray(points, float))[1]
        return self.sigma_a[nearest], self.sigma_s[nearest]


def read_colours(path: str | Path) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and the colours they are painted with, or have in the mesh's texture.

    Parameters
    ----------
    path : str or Path
        A mesh file with vertex colours (PLY, OBJ, GLB), a texture (OBJ, GLB) or base colours (GLB), also compressed
        with gzip. Parts of a scene that have none are white.

    Returns
    -------
    vertices : (n, 3) float64
        Positions [file units], in no order.
    colours : (n, 3) float64
        Linear, 0..1: those of PLY and OBJ and all textures are sRGB, those at the vertices of GLB linear.

    Raises
    ------
    InputError
        The file has no colours, or they cannot be read.
    """
    import trimesh

    path = Path(path)
    try:
        data = path.read_bytes()
        zipped = data[:2] == b"\x1f\x8b"
        suffix = [s.lower() for s in path.suffixes if s.lower() != ".gz"][-1][1:]
        source = io.BytesIO(gzip.decompress(data)) if zipped else path
        scene = trimesh.load_scene(source, file_type=suffix, process=False)
        vertices, colours = [], []
        for node in scene.graph.nodes_geometry:
            place, name = scene.graph[node]
            part: Any = scene.geometry[name]
            vertices.append(trimesh.transform_points(part.vertices, place))
            colours.append(_colours_of(part, suffix in ("glb", "gltf")))
    except Exception as error:  # readers of damaged files may raise anything
        raise InputError(f"{path}: its colours cannot be read: {error}") from error
    if all(found is None for found in colours):
        raise InputError(f"{path}: has neither vertex colours nor a texture; paint it, or use --material")
    white = [np.ones_like(at) if found is None else found for at, found in zip(vertices, colours, strict=True)]
    return np.concatenate(vertices), np.concatenate(white)


def _colours_of(part: Any, is_gltf: bool) -> np.ndarray | None:
    """Linear colours (n, 3) of a part of a scene: of its vertices, times its texture or else its base colour."""
    visual, factors = part.visual, []
    if visual.kind in ("vertex", "face"):
        own = visual.vertex_colors
        factors = [own if is_gltf else srgb_decode(own / 255)]
    elif visual.kind == "texture":
        material = visual.material
        image = getattr(material, "baseColorTexture", None) or getattr(material, "image", None)
        has_texture = image is not None and visual.uv is not None
        base = (
            srgb_decode(material.to_color(visual.uv) / 255)
            if has_texture
            else getattr(material, "baseColorFactor", None)
        )
        factors = [visual.vertex_attributes.get("color"), base]
    given = [np.asarray(f) / (np.iinfo(f.dtype).max if f.dtype.kind == "u" else 1) for f in factors if f is not None]
    shape = (len(part.vertices), 3)
    return np.prod([np.broadcast_to(f[..., :3], shape) for f in given], axis=0) if given else None
