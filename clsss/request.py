"""The mesh, the medium and the lights that parsed options stand for (options.py has the grammar)."""

from __future__ import annotations

import argparse
import difflib
import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from clsss.errors import InputError
from clsss.options import DEFAULT_LIGHTS, DEFAULT_MATERIAL, DEMO, LightOption, light

if TYPE_CHECKING:
    from clsss.lights import Light
    from clsss.materials import Material, Medium
    from clsss.mesh import Mesh

DEMO_SIZE = 20.0
_MATERIAL_KEYS = ("name", "source", "sigma_a", "sigma_s", "sigma_s_prime", "g", "eta")


def mesh_from(args: argparse.Namespace) -> Mesh:
    """The mesh that the options name, at its size."""
    from clsss.mesh import load_mesh

    if args.mesh == DEMO and not Path(DEMO).exists():
        from clsss.demo import demo_mesh

        return replace(load_mesh(demo_mesh(), size=args.size or DEMO_SIZE), name=DEMO)
    return load_mesh(args.mesh, size=args.size)


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
    from clsss.materials import Material, material

    if args.material is None and args.sigma_a is not None:
        base = Material(
            args.sigma_a if len(args.sigma_a) == 3 else args.sigma_a[0],
            args.sigma_s if len(args.sigma_s) == 3 else args.sigma_s[0],
            0.0 if args.g is None else args.g,
            1.0 if args.eta is None else args.eta,
        )
    else:
        name = args.material or DEFAULT_MATERIAL
        base = _override(material_file(name) if name.lower().endswith(".toml") else material(name), args)
    if args.mix is None:
        return base
    from clsss.media import Mix, Perlin

    name, scale, seed = args.mix
    return Mix(base, material(name), Perlin(scale or mesh.size / 4, seed))


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

    if sys.version_info >= (3, 11):
        import tomllib
    else:
        import tomli as tomllib
    try:
        table: dict[str, Any] = tomllib.loads(Path(path).read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from error
    except ValueError as error:  # not TOML, or not UTF-8
        raise InputError(f"{path}: is no TOML file: {error}") from error
    for key in table:
        if key not in _MATERIAL_KEYS:
            near = difflib.get_close_matches(key, _MATERIAL_KEYS, 1)
            hint = f"did you mean {near[0]}?" if near else f"known are {', '.join(_MATERIAL_KEYS)}"
            raise InputError(f"{path}: unknown key {key!r}; {hint}")
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
    if args.light:
        return [_light(option, mesh, args.up) for option in args.light]
    out = []
    for option in map(light, DEFAULT_LIGHTS):
        x, y, z = option.vector
        vector = (x, y, z) if args.up == "y" else (x, -z, y)
        out.append(_light(LightOption(option.kind, vector, option.strength), mesh, args.up))
    return out


def _light(option: LightOption, mesh: Mesh, up: str) -> Light:
    import numpy as np

    from clsss.images import read_radiance
    from clsss.lights import DirectionalLight, EnvironmentLight, PointLight

    strength = np.broadcast_to(option.strength or 1.0, 3)
    if option.kind == "env":
        return EnvironmentLight(read_radiance(option.file) if option.file else strength, up)
    vector = np.array(option.vector)
    if option.kind == "directional":
        return DirectionalLight(vector, strength)
    low, high = mesh.bounds
    centre = (low + high) / 2
    position = centre + vector * (high - low) / 2 if option.in_box else vector
    return PointLight(position, strength if option.strength else np.sum((position - centre) ** 2))
