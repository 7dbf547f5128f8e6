"""A baked result on disk: vertex colours for other programs, and the numbers they came from.

Every format but OBJ keeps radiosity, of it what was scattered once where a bake splits that off, and fluence as raw
floats [W/mm^2]. Colours are made for the eye, ``clip(radiosity * display_scale * 2**exposure, 0, 1)``: linear floats
in GLB (as glTF asks), sRGB in PLY (bytes) and in OBJ (0 to 1), as the programs that read them expect. Lengths are mm
in every format.
"""

from __future__ import annotations

import io
import json
import os
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from clsss.errors import InputError
from clsss.exposure import display_scale
from clsss.srgb import srgb_encode

if TYPE_CHECKING:
    from clsss.mesh import Mesh
    from clsss.simulate import Result

_PLY_NAMES = {"u1": "uchar", "<f4": "float", "<f8": "double"}
SUFFIXES = (".glb", ".ply", ".obj", ".npz", ".vtu")


def check_output(path: str | os.PathLike[str]) -> Path:
    """The path, once it is known that a result can be saved there.

    Parameters
    ----------
    path : str or path-like
        Output file; its suffix chooses the format.

    Returns
    -------
    Path

    Raises
    ------
    InputError
        The suffix is unknown, or the folder is missing or cannot be written to.
    """
    path = Path(path)
    if path.suffix.lower() not in SUFFIXES:
        raise InputError(
            f"{path}: cannot save as {path.suffix or 'a file without suffix'!r}; use one of " + " ".join(SUFFIXES)
        )
    return check_writable(path)


def check_writable(path: str | os.PathLike[str]) -> Path:
    """The path, once it is known that its folder exists and takes new files; see `check_output`."""
    path = Path(path)
    if not path.parent.is_dir():
        raise InputError(f"{path}: the folder {path.parent} does not exist; create it first")
    if path.is_dir():
        raise InputError(f"{path}: is a folder; give a file name")
    if not os.access(path.parent, os.W_OK | os.X_OK):
        raise InputError(f"{path}: no permission to write in the folder {path.parent}")
    if path.exists() and not os.access(path, os.W_OK):
        raise InputError(f"{path}: there is a file of this name that is write-protected; give another")
    return path


def write_atomically(path: str | os.PathLike[str], content: bytes) -> None:
    """Write a whole file or nothing: to a temporary name in the same folder, then moved.

    Raises
    ------
    InputError
        The folder is missing or not writable, or the disk is full.
    """
    path = check_writable(path)
    try:
        handle, temporary = tempfile.mkstemp(prefix=".clsss-", dir=path.parent)
        try:
            with os.fdopen(handle, "wb") as file:
                file.write(content)
            umask = os.umask(0)
            os.umask(umask)
            os.chmod(temporary, 0o666 & ~umask)  # mkstemp makes private files
            os.replace(temporary, path)
        except BaseException:
            os.unlink(temporary)
            raise
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror}") from error


def save(
    result: Result, path: str | os.PathLike[str], exposure: float = 0.0, towards: np.ndarray | None = None
) -> None:
    """Save a result; the suffix chooses the format.

    Parameters
    ----------
    result : Result
        What `simulate` returned.
    path : str or path-like
        ``.glb`` ``.ply`` ``.obj`` ``.npz`` or ``.vtu``.
    exposure : float
        Stops added to the automatic exposure of the colours; raw floats are never scaled.
    towards : (3,) ndarray, optional
        Where the automatic exposure looks from, as in `display_scale`.

    Raises
    ------
    InputError
        The suffix is unknown or the file cannot be written.
    """
    path = check_output(path)
    scale = display_scale(result.mesh, result.vertex_radiosity, towards) * 2.0**exposure
    encode = {".glb": _glb, ".ply": _ply, ".obj": _obj, ".npz": _npz, ".vtu": _vtu}[path.suffix.lower()]
    write_atomically(path, encode(result, scale))


def _colour(result: Result, scale: float) -> np.ndarray:
    return np.clip(np.nan_to_num(result.vertex_radiosity) * scale, 0, 1)


def _fields(result: Result) -> dict[str, np.ndarray]:
    """The raw floats."""
    once = result.vertex_radiosity_single
    single = {} if once is None else {"radiosity_single": once}
    return {"radiosity": result.vertex_radiosity, "fluence": result.vertex_fluence, **single}


def _offset(mesh: Mesh) -> np.ndarray:
    """The middle (3,) of a mesh so far from the origin that single precision would round its shape, else 0."""
    used = mesh.vertices[mesh.faces]
    low, high = used.min(axis=(0, 1)), used.max(axis=(0, 1))
    return (low + high) / 2 if np.abs(low + high).max() > 1e3 * (high - low).max() else np.zeros(3)


def _glb(result: Result, scale: float) -> bytes:
    import trimesh

    mesh = result.mesh
    unused = ~mesh.normals.any(axis=1, keepdims=True)  # glTF wants unit normals everywhere
    attributes = {
        "_NORMAL": np.where(unused, (0.0, 0.0, 1.0), mesh.normals),
        "_COLOR_0": _colour(result, scale),
        **{f"_{name.upper()}": values for name, values in _fields(result).items()},
    }
    offset = _offset(mesh)
    shape = trimesh.Trimesh(
        mesh.vertices - offset,
        mesh.faces,
        process=False,
        validate=False,
        vertex_attributes={name: np.float32(values) for name, values in attributes.items()},
    )

    def unlit(tree: dict[str, Any]) -> None:
        primitive = tree["meshes"][0]["primitives"][0]
        for name in ("NORMAL", "COLOR_0"):  # trimesh prefixes what it does not know
            primitive["attributes"][name] = primitive["attributes"].pop(f"_{name}")
        primitive["material"] = 0
        tree["extensionsUsed"] = ["KHR_materials_unlit"]
        tree["materials"] = [
            {
                "name": getattr(result.medium, "name", "") or "clsss",
                "doubleSided": True,
                "pbrMetallicRoughness": {"metallicFactor": 0.0, "roughnessFactor": 1.0},
                "extensions": {"KHR_materials_unlit": {}},
                "extras": {"clsss": _coefficients(result.medium) | {"display_scale": scale, "length_unit": "mm"}},
            }
        ]

    scene = trimesh.Scene()
    scene.add_geometry(shape, geom_name=mesh.name, transform=trimesh.transformations.translation_matrix(offset))
    return trimesh.exchange.gltf.export_glb(scene, include_normals=False, tree_postprocessor=unlit)


def _coefficients(medium: Any) -> dict[str, Any]:
    if not medium.homogeneous:
        return {"medium": "heterogeneous"}
    sigma_a, sigma_s = medium.coefficients(np.zeros((1, 3)))
    return {
        "sigma_a": sigma_a[0].tolist(),
        "sigma_s": sigma_s[0].tolist(),
        "g": float(medium.g),
        "eta": float(medium.eta),
    }


def _ply(result: Result, scale: float) -> bytes:
    mesh = result.mesh
    groups = {
        ("x", "y", "z"): mesh.vertices,
        ("nx", "ny", "nz"): mesh.normals,
        ("red", "green", "blue"): np.rint(255 * srgb_encode(_colour(result, scale))),
        **{tuple(f"{name}_{c}" for c in "rgb"): values for name, values in _fields(result).items()},
    }
    columns = {name: values[:, i] for names, values in groups.items() for i, name in enumerate(names)}
    place = "<f8" if _offset(mesh).any() else "<f4"
    kinds = {**dict.fromkeys("xyz", place), **dict.fromkeys(("red", "green", "blue"), "u1")}
    types = {name: kinds.get(name, "<f4") for name in columns}
    vertices = np.empty(len(mesh.vertices), list(types.items()))
    for name, values in columns.items():
        vertices[name] = values
    faces = np.empty(len(mesh.faces), [("count", "u1"), ("corners", "<i4", 3)])
    faces["count"], faces["corners"] = 3, mesh.faces
    properties = [f"property {_PLY_NAMES[kind]} {name}" for name, kind in types.items()]
    header = [
        "ply",
        "format binary_little_endian 1.0",
        "comment clsss: colours are sRGB, lengths mm, radiosity and fluence W/mm^2",
        f"comment display_scale {scale!r}",
        f"element vertex {len(vertices)}",
        *properties,
        f"element face {len(faces)}",
        "property list uchar int vertex_indices",
        "end_header\n",
    ]
    return "\n".join(header).encode() + vertices.tobytes() + faces.tobytes()


def _obj(result: Result, scale: float) -> bytes:
    mesh = result.mesh
    out = io.StringIO()
    out.write("# clsss: v x y z r g b, lengths mm, colours sRGB 0..1\n")
    np.savetxt(
        out,
        np.hstack([mesh.vertices, srgb_encode(_colour(result, scale))]),
        "v %.14g %.14g %.14g %.5f %.5f %.5f",
    )
    np.savetxt(out, mesh.normals, "vn %.5f %.5f %.5f")
    np.savetxt(out, np.repeat(mesh.faces + 1, 2, axis=1), "f %d//%d %d//%d %d//%d")
    return out.getvalue().encode()


def _npz(result: Result, scale: float) -> bytes:
    mesh = result.mesh
    out = io.BytesIO()
    arrays: dict[str, Any] = {"vertices": mesh.vertices, "faces": mesh.faces, "normals": mesh.normals}
    arrays |= {**_fields(result), "display_scale": np.float64(scale), "report": np.str_(json.dumps(result.report))}
    np.savez_compressed(out, **arrays)
    return out.getvalue()


def _vtu(result: Result, scale: float) -> bytes:
    import meshio

    mesh = result.mesh
    points = {
        **_fields(result),
        "normals": mesh.normals,
        "colour": _colour(result, scale),
    }
    with tempfile.TemporaryDirectory(prefix="clsss-") as folder:  # meshio writes to paths alone
        file = Path(folder, "result.vtu")
        meshio.Mesh(mesh.vertices, [("triangle", mesh.faces)], point_data=points).write(file)
        return file.read_bytes()
