"""The mesh, the medium and the lights that parsed options stand for (grammar.py parses them)."""

from __future__ import annotations

import argparse
import os
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from clsss import tomlfile
from clsss.errors import InputError
from clsss.grammar import LightOption
from clsss.options import DEFAULT_MATERIAL, DEMO, default_lights

if TYPE_CHECKING:
    import numpy as np

    from clsss.camera import Camera
    from clsss.lights import Light
    from clsss.materials import Material, Medium
    from clsss.mesh import Mesh

DEMO_SIZE = 20.0
_MATERIAL_SUFFIX = ".toml"
_OUTPUTS = ("output", "report", "picture", "json", "screenshot", "save_scene")
_MATERIAL_KEYS = ("name", "source", "sigma_a", "sigma_s", "sigma_s_prime", "g", "eta")


def check(args: argparse.Namespace) -> None:
    """Refuse what is wrong whatever the mesh is, so that it is told before the mesh is read.

    Raises
    ------
    InputError
        A file that the options name cannot be read or is to be written over, a number is out of range, or a material is
        unknown.
    DeviceError
        The device that the options name does not work.
    """
    _check_files(args)
    materials_from(args)
    import numpy as np

    for option in args.lights or ():
        if not option.file:
            _light(option, np.array([[0.0] * 3, [1.0] * 3]), args.up)  # any box will do
    from clsss.arguments import check_solver

    check_solver(args.resolution, args.tolerance)
    if args.device:
        from clsss.device import open_device

        open_device(args.device, args.precision)


def _check_files(args: argparse.Namespace) -> None:
    """Files that are read can be, and none of them is written over; but a scene may be, by what it becomes."""
    mesh = None if _is_demo(args) else args.mesh
    materials = (args.material, *(args.mix or ())[:1], *(args.vertex_colours or ()))
    own = (name for name in materials if name and name.lower().endswith(_MATERIAL_SUFFIX))
    files = [*filter(None, (mesh, *(args.blockers or ()), args.grid, *(o.file for o in args.lights or ()))), *own]
    for path in files:
        if not Path(path).exists():
            raise InputError(f"{path}: there is no such file")
        if not os.access(path, os.R_OK):
            raise InputError(f"{path}: no permission to read it")
    read, written = {Path(path).resolve() for path in files}, set()
    for key in filter(vars(args).get, _OUTPUTS):
        name, place = getattr(args, key), Path(getattr(args, key)).resolve()
        if place in read or (args.scene and key != "save_scene" and place == Path(args.scene).resolve()):
            raise InputError(f"{name}: is read and would be written over; give what is written a name of its own")
        if place in written:
            raise InputError(f"{name}: would be written over by a second output; give each a name of its own")
        written.add(place)


def _is_demo(args: argparse.Namespace) -> bool:
    return args.mesh == DEMO and not Path(DEMO).exists()


def mesh_from(args: argparse.Namespace) -> Mesh:
    """The mesh that the options name, at its size."""
    from clsss.mesh import load_mesh

    if _is_demo(args):
        from clsss.demo import demo_mesh

        return replace(load_mesh(demo_mesh(), size=args.size or DEMO_SIZE), name=DEMO)
    return load_mesh(args.mesh, size=args.size)


def eye_from(args: argparse.Namespace) -> np.ndarray:
    """The direction (3,) from the mesh to the camera."""
    return camera_from(args).axes()[2]


def camera_from(args: argparse.Namespace) -> Camera:
    """A camera that looks the way the options say, at the origin."""
    import numpy as np

    from clsss.camera import Camera

    azimuth, elevation = args.camera[:2]
    return Camera(np.zeros(3), 1.0, azimuth, elevation, args.up)


def blockers_from(args: argparse.Namespace, mesh: Mesh) -> list[Mesh]:
    """The meshes that keep light from the first, which were made in its frame and are scaled with it."""
    from clsss.mesh import load_mesh

    scale = mesh.report["scale"]
    blockers = [load_mesh(path, solid=False) for path in args.blockers or ()]
    return [replace(b, vertices=b.vertices * scale, centroids=b.centroids * scale) for b in blockers]


def size_note(args: argparse.Namespace, mesh: Mesh) -> str:
    """What size the object is taken to have, and why."""
    if args.size:
        origin = "as asked"
    elif mesh.name == DEMO:
        origin = "the demonstration mesh"
    else:
        origin = "from the file, whose units are taken as mm; --size says otherwise"
    return f"size: {mesh.size:.4g} mm ({origin})"


def medium_from(args: argparse.Namespace, mesh: Mesh) -> Medium:
    """The medium that the options describe."""
    materials = materials_from(args)
    if args.vertex_colours is not None:
        return _painted(args, mesh, materials)
    if args.grid:
        return _voxels(args, mesh, materials)
    if args.mix is None:
        return materials[0]
    from clsss.media import Mix, Perlin

    _, scale, seed = args.mix
    return Mix(materials[0], materials[1], Perlin(scale or mesh.size / 4, seed))


def materials_from(args: argparse.Namespace) -> list[Material]:
    """The one or two materials that the options name."""
    if args.vertex_colours:
        return [_override(_named(name), args) for name in args.vertex_colours]
    return [_base(args), *([_named(args.mix[0])] if args.mix else ())]


def _named(name: str) -> Material:
    """A measured material, or one from a file."""
    from clsss.materials import material

    return material_file(name) if name.lower().endswith(_MATERIAL_SUFFIX) else material(name)


def _base(args: argparse.Namespace) -> Material:
    from clsss.materials import Material

    if args.material is None and args.sigma_a is not None:
        return Material(
            args.sigma_a if len(args.sigma_a) == 3 else args.sigma_a[0],
            args.sigma_s if len(args.sigma_s) == 3 else args.sigma_s[0],
            0.0 if args.g is None else args.g,
            1.0 if args.eta is None else args.eta,
        )
    return _override(_named(args.material or DEFAULT_MATERIAL), args)


def _painted(args: argparse.Namespace, mesh: Mesh, materials: list[Material]) -> Medium:
    """What the mesh's file is painted with, extended inward."""
    from clsss.paint import Inward, read_colours

    if mesh.name == DEMO:
        raise InputError("the demonstration mesh has no colours for --vertex-colours")
    points, colours = read_colours(args.mesh)
    points = points * mesh.report["scale"]
    if not args.vertex_colours:
        return Inward.painted(points, colours, *materials)
    return Inward.blend(points, colours.mean(axis=1), *materials)


def _voxels(args: argparse.Namespace, mesh: Mesh, materials: list[Material]) -> Medium:
    """What a file of voxels describes."""
    from clsss.media import Grid, Mix, Voxels
    from clsss.volumes import place, read_volume

    volume = read_volume(args.grid)
    try:
        origin, spacing = place(volume, mesh)
        if volume.coefficients is None:
            assert volume.weight is not None
            if args.mix is None:
                raise InputError("holds one number a voxel, a weight; --mix NAME says of which material")
            return Mix(materials[0], materials[1], Voxels(volume.weight, origin, spacing))
        if any(option is not None for option in (args.material, args.sigma_a, args.sigma_s, args.mix)):
            raise InputError("holds coefficients; leave --material, --sigma-a, --sigma-s and --mix out")
        g = volume.g if args.g is None else args.g
        eta = volume.eta if args.eta is None else args.eta
        return Grid(*volume.coefficients, origin, spacing, g or 0.0, 1.0 if eta is None else eta)
    except InputError as error:
        raise InputError(f"{args.grid}: {error}") from None


def _override(base: Material, args: argparse.Namespace) -> Material:
    from clsss.materials import Material

    sigma_a = base.sigma_a if args.sigma_a is None else args.sigma_a
    g, eta = (base.g if args.g is None else args.g), (base.eta if args.eta is None else args.eta)
    if args.sigma_s is not None:
        return Material(sigma_a, args.sigma_s, g, eta, base.name)
    return Material.from_reduced(sigma_a, base.sigma_s_prime, eta, g, base.name)


def material_file(path: str) -> Material:
    """A material from a TOML file of sigma_a, sigma_s (or sigma_s_prime), g, eta and name.

    Raises
    ------
    InputError
        The file cannot be read, is no TOML, or has a key that is unknown, missing or of the wrong kind.
    """
    from clsss.materials import Material

    table = tomlfile.read(path, _MATERIAL_KEYS)
    if "sigma_a" not in table or ("sigma_s" in table) == ("sigma_s_prime" in table):
        raise InputError(f"{path}: needs sigma_a and one of sigma_s and sigma_s_prime, in 1/mm")
    name, g, eta = str(table.get("name", Path(path).stem)), table.get("g", 0.0), table.get("eta", 1.0)
    try:
        if "sigma_s" in table:
            return Material(table["sigma_a"], table["sigma_s"], g, eta, name)
        return Material.from_reduced(table["sigma_a"], table["sigma_s_prime"], eta, g, name)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


def lights_from(args: argparse.Namespace, mesh: Mesh) -> list[Light]:
    """The lights that the options describe, in the mesh's frame."""
    return [_light(option, mesh.bounds, args.up) for option in args.lights or default_lights(args.up)]


def _light(option: LightOption, bounds: np.ndarray, up: str) -> Light:
    import numpy as np

    from clsss.images import read_radiance
    from clsss.lights import DirectionalLight, EnvironmentLight, PointLight

    given = option.strength or (1.0,)
    strength: Any = given[0] if len(given) == 1 else given
    if option.kind == "env":
        radiance = read_radiance(option.file) if option.file else strength
        try:
            return EnvironmentLight(radiance, up)
        except InputError as error:
            raise InputError(f"{option.file}: {error}" if option.file else str(error)) from error
    vector = np.array(option.vector)
    if option.kind == "directional":
        return DirectionalLight(vector, strength)
    low, high = bounds
    centre = (low + high) / 2
    position = centre + vector * (high - low) / 2 if option.in_box else vector
    away = max(np.linalg.norm(position - centre), (high - low).min() / 2)
    return PointLight(position, strength if option.strength else away**2)
