"""The dipole: diffusion in a half space, laid around any surface. The baseline, not the reference.

    M(x) = int over the surface of R_d(|x - y|) E(y) dA(y)

E is the light that enters: shadowed, times cosine and Fresnel transmittance. R_d is that of Jensen et al.
2001, with their own boundary constant, or of d'Eon's better dipole. Input: mesh, homogeneous material,
lights. Output: radiosity [W/mm^2] at the vertices.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from clsss import pointtree
from clsss.device import Device
from clsss.errors import InputError
from clsss.fresnel import fresnel_A, fresnel_moments, fresnel_transmittance
from clsss.lights import DirectionalLight, EnvironmentLight, PointLight
from clsss.materials import Material
from clsss.mesh import Mesh, RayCaster, opaque_triangles
from clsss.problem import check_object, checked_lights
from clsss.subdivision import areas, outward_normals, subdivide

SKY_BEAMS = 256
SPACING = 0.5  # of a transport mean free path: longest edge of a sample's triangle
SHADOW = 0.005  # of the mesh's size: shadows need no finer samples
SOLID_ANGLE = 0.02  # [sr] up to which a group of samples counts as one
LAUNCH_PAIRS, LAUNCH_POINTS = 2e7, 4096  # keep a launch short enough to be stopped

Progress = Callable[[str, float], None]


@dataclass(frozen=True)
class Pole:
    """One of the two sources: depth, strength and offset in R_d (see `profile`), each (3,)."""

    depth: np.ndarray
    strength: np.ndarray
    offset: np.ndarray


def groenhuis_A(eta: float) -> float:
    """Boundary constant of the classic dipole, from a polynomial for the diffuse Fresnel reflectance.

    References
    ----------
    Groenhuis, Ferwerda and ten Bosch 1983, as used by Jensen et al. 2001; it differs from `fresnel_A`.
    """
    if eta >= 1:
        reflectance = -1.440 / eta**2 + 0.710 / eta + 0.668 + 0.0636 * eta
    else:
        reflectance = -0.4399 + 0.7099 / eta - 0.3319 / eta**2 + 0.0636 / eta**3
    return (1 + reflectance) / (1 - reflectance)


def poles(material: Material, model: str) -> tuple[np.ndarray, Pole, Pole]:
    """Attenuation (3,) [1/mm], and the real and the virtual source.

    Parameters
    ----------
    material : Material
        Homogeneous.
    model : {"jensen", "better"}
        Jensen et al. 2001, all orders of scattering; or d'Eon 2012, which leaves out light scattered once.
    """
    sigma_tr, albedo = material.sigma_tr, material.albedo
    depth = 1 / sigma_tr
    if model == "jensen":
        image = depth * (1 + 4 / 3 * groenhuis_A(material.eta))
        strength = albedo / (4 * np.pi)
        return material.sigma_eff, Pole(depth, strength, 0 * depth), Pole(image, strength, 0 * depth)
    if model != "better":
        raise InputError(f"model: unknown value {model!r}; use jensen or better")
    D = (sigma_tr + material.sigma_a) / (3 * sigma_tr**2)
    R_phi, R_J = fresnel_moments(material.eta)
    of_phi, of_flux = (1 - R_phi) / 4, (1 - R_J) / 2
    image = depth + 4 * fresnel_A(material.eta) * D
    strength = albedo**2 / (4 * np.pi)
    # the virtual source is negative and lies outside, which turns the sign of its depth and of its strength
    virtual = Pole(image, strength * of_flux, -of_phi / (D * of_flux))
    return np.sqrt(material.sigma_a / D), Pole(depth, strength * of_flux, of_phi / (D * of_flux)), virtual


def profile(r: Any, material: Material, model: str = "jensen") -> np.ndarray:
    """R_d(r) [1/mm^2] (..., 3): power that leaves per area at distance r [mm] from where a unit enters.

    R_d = sum over both sources of strength (z (1 + sigma d) / d^2 + offset) exp(-sigma d) / d, with
    d^2 = r^2 + z^2 and z the source's depth.

    References
    ----------
    Jensen et al. 2001, eq. (4); d'Eon 2012, "A better dipole", eq. (8).
    """
    sigma, *both = poles(material, model)
    total = np.zeros((*np.shape(r), 3))
    for p in both:
        d = np.sqrt(np.square(r)[..., None] + p.depth**2)
        total += p.strength * (p.depth * (1 + sigma * d) / d**2 + p.offset) * np.exp(-sigma * d) / d
    return total


def entering(
    mesh: Mesh,
    places: np.ndarray,
    normals: np.ndarray,
    eta: float,
    lights: Sequence[Any],
    progress: Progress | None = None,
    blockers: Sequence[Mesh] = (),
) -> np.ndarray:
    """Irradiance that enters the surface (n, 3) [W/mm^2] at places with outward normals (n, 3).

    Raises
    ------
    InputError
        There is no light, or an `Emission`, which the dipole cannot take.
    """
    opaque, total = opaque_triangles(blockers), np.zeros((len(places), 3))
    caster = RayCaster(mesh.triangles if opaque is None else np.concatenate([mesh.triangles, opaque]))
    start = places + 1e-5 * mesh.size * normals
    beams: list[Any] = []
    for light in checked_lights(lights):
        beams += light.beams(SKY_BEAMS) if isinstance(light, EnvironmentLight) else [light]
    for k, light in enumerate(beams):
        if isinstance(light, PointLight):
            towards = light.position - start
            distance = np.linalg.norm(towards, axis=1, keepdims=True)
            towards, strength = towards / distance, light.intensity / distance**2
            reach: Any = distance[:, 0]
        elif isinstance(light, DirectionalLight):
            towards = np.broadcast_to(-light.direction, start.shape)
            strength, reach = np.broadcast_to(light.irradiance, start.shape), np.inf
        else:
            raise InputError(
                f"lights: the dipole takes beams, point lights and environments, not {type(light).__name__}"
            )
        cosine = np.einsum("ij,ij->i", normals, towards)
        lit = np.flatnonzero(cosine > 0)
        if len(lit):
            reached = reach if np.isscalar(reach) else reach[lit]
            lit = lit[~caster.occluded(start[lit], towards[lit], reached)]
        total[lit] += (cosine * fresnel_transmittance(np.clip(cosine, 0, 1), eta))[lit, None] * strength[lit]
        if progress:
            progress("light", (k + 1) / len(beams))
    return total


def dipole(
    mesh: Mesh,
    material: Material,
    lights: Sequence[Any],
    model: str = "jensen",
    hierarchical: bool = True,
    device: Device | None = None,
    progress: Progress | None = None,
    blockers: Sequence[Mesh] = (),
) -> np.ndarray:
    """Radiosity of the dipole at the mesh's vertices.

    Parameters
    ----------
    mesh : Mesh
        The solid.
    material : Material
        Homogeneous.
    lights : sequence
        Directional, point and environment lights; a sky counts as `SKY_BEAMS` beams.
    model : {"jensen", "better"}
        The classic dipole, of all orders of scattering, or d'Eon's, which leaves out light scattered once.
    hierarchical : bool
        Take far groups of samples as one; otherwise every vertex sums over every sample.
    device : Device, optional
        By default the best there is, in single precision.
    progress : callable, optional
        Called with "light" or "dipole" and the fraction done.
    blockers : sequence of Mesh
        Opaque surfaces, closed or open, in front of the lights.

    Returns
    -------
    (v, 3) float64
        Radiosity [W/mm^2]; 0 for vertices that no face uses.

    Raises
    ------
    InputError
        The medium varies in space, a light shines inside, there is none, or the model is unknown.

    References
    ----------
    Jensen et al. 2001, "A practical model for subsurface light transport"; Jensen and Buhler 2002, "A rapid
    hierarchical rendering technique for translucent materials"; d'Eon 2012, "A better dipole".
    """
    check_object(mesh, material, "material")
    if not material.homogeneous:
        raise InputError("material: the dipole needs the same coefficients everywhere; use a Material")
    sigma, *both = poles(material, model)
    spacing = SPACING / material.sigma_tr.max()
    coarse, _ = subdivide(mesh.triangles, max(spacing, SHADOW * mesh.size))
    lit = entering(mesh, coarse.mean(axis=1), outward_normals(coarse), material.eta, lights, progress, blockers)
    pieces, parent = subdivide(coarse, spacing)
    area = areas(pieces)
    power = area[:, None] * lit[parent]
    some = power.any(axis=1)
    pieces, area, power = pieces[some], area[some], power[some]
    used = np.flatnonzero(np.any(mesh.normals != 0, axis=1))
    out = np.zeros((len(mesh.vertices), 3))
    if not len(pieces):
        return out
    device = device or Device(precision="single")
    columns = [v for p in both for v in (p.depth, p.strength, p.offset)]
    shape = [device.vector(v) for v in (sigma, *columns)]
    centre = mesh.bounds.mean(axis=0)  # single precision is for the distances
    places = pieces.mean(axis=1) - centre
    sums = _tree(device, shape, places, area, power) if hierarchical else _pairs(device, shape, places, power)
    out[used] = _in_slices(device, sums, mesh.vertices[used] - centre, progress)
    return out


def _four(values: np.ndarray) -> np.ndarray:
    return np.concatenate([values, np.zeros((len(values), 1))], axis=1)


class _Sums(NamedTuple):
    """A kernel that sums over samples, its arguments but the points, and how many of these one launch takes."""

    kernel: Any
    arguments: tuple[Any, ...]
    points: int


def _pairs(device: Device, shape: list[Any], places: np.ndarray, power: np.ndarray) -> _Sums:
    """Every point against every sample."""
    arguments = len(places), *shape, device.array(_four(places)), device.array(_four(power))
    return _Sums(device.kernel("dipole", "gather"), arguments, max(64, int(LAUNCH_PAIRS / len(places))))


def _tree(device: Device, shape: list[Any], places: np.ndarray, area: np.ndarray, power: np.ndarray) -> _Sums:
    """Every point against groups of samples, finer where they are near."""
    tree = pointtree.build(places)
    places, area, power = places[tree.order], area[tree.order], power[tree.order]
    total, whole = tree.sums(power), tree.sums(area)
    weight = power.sum(axis=1)
    centre = tree.sums(weight[:, None] * places) / tree.sums(weight)[:, None]
    own = np.stack([tree.start, np.where(tree.leaf, tree.end, tree.start)], axis=1).astype(np.int32)
    extent = np.stack([tree.half_diagonal, whole], axis=1)
    arrays = tree.skip, own, extent, _four(centre), _four(places), _four(power), _four(total)
    arguments = len(tree.start), *shape, SOLID_ANGLE, *(device.array(v) for v in arrays)
    return _Sums(device.kernel("dipole", "gather_tree"), arguments, LAUNCH_POINTS)


def _in_slices(device: Device, sums: _Sums, points: np.ndarray, progress: Progress | None) -> np.ndarray:
    """Sums (n, 3) at points (n, 3), some at a time: Ctrl-C works in between."""
    out = np.empty((len(points), 3))
    for start in range(0, len(points), sums.points):
        some = _four(points[start : start + sums.points])
        radiosity = device.empty((len(some), 4))
        device.run(sums.kernel, len(some), len(some), *sums.arguments, device.array(some), radiosity)
        out[start : start + sums.points] = radiosity.get()[:, :3]
        if progress:
            progress("dipole", min(1.0, (start + sums.points) / len(points)))
    return out
