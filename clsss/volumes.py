"""Voxels from files: a medium's coefficients, or the weight of a second material.

    (nx, ny, nz)       weight 0..1             (nx, ny, nz, 2)   sigma_a, sigma_s
    (nx, ny, nz, 6)    sigma_a, sigma_s, each red, green, blue [1/mm]

Input: .npz with keys, .npy, .nrrd, .nii; output: arrays with the lower corner and the voxel size of their frame.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from clsss.errors import InputError

if TYPE_CHECKING:
    from clsss.mesh import Mesh

SUFFIXES = (".npz", ".npy", ".nrrd", ".nii", ".nii.gz")
_KEYS = ("sigma_a", "sigma_s", "weight", "origin", "spacing", "g", "eta")


@dataclass(frozen=True, eq=False)
class Volume:
    """What a file of voxels holds.

    Attributes
    ----------
    coefficients : two of (nx, ny, nz) or (nx, ny, nz, 3) float64, or None
        sigma_a and sigma_s [1/mm].
    weight : (nx, ny, nz) float64, or None
        Share of a second material, if it holds no coefficients.
    origin, spacing : (3,) float64, or None
        Lower corner of the first voxel, size of a voxel [units of the mesh file]; None: it fills the mesh's box.
    g, eta : float or None
        As in `Material`.
    """

    coefficients: tuple[np.ndarray, np.ndarray] | None = None
    weight: np.ndarray | None = None
    origin: np.ndarray | None = None
    spacing: np.ndarray | None = None
    g: float | None = None
    eta: float | None = None


def read_volume(path: str | Path) -> Volume:
    """Read a file of voxels.

    Raises
    ------
    InputError
        The file cannot be read, its package is missing, or its shape or frame is none that is known.
    """
    path = Path(path)
    reader = {".npz": _npz, ".npy": _npy, ".nrrd": _nrrd, ".nii": _nifti, ".gz": _nifti}.get(path.suffix.lower())
    if reader is None or not path.name.lower().endswith(SUFFIXES):
        raise InputError(f"{path}: voxels are read from {' '.join(SUFFIXES)}")
    if not path.is_file():
        raise InputError(f"{path}: there is no such file")
    try:
        return reader(path)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    except ImportError as error:
        raise InputError(f"{path}: needs a package for this format: pip install 'clsss[volumes]'") from error
    except Exception as error:  # readers of damaged files may raise anything
        raise InputError(f"{path}: cannot be read: {error}") from error


def _npz(path: Path) -> Volume:
    with np.load(path) as file:
        unknown = set(file.files) - set(_KEYS)
        values = {key: np.asarray(file[key], float) for key in file.files if key in _KEYS}
    if unknown:
        raise InputError(f"unknown array {min(unknown)!r}; known are {', '.join(_KEYS)}")
    if ("weight" in values) == ("sigma_a" in values) or ("sigma_a" in values) != ("sigma_s" in values):
        raise InputError("needs the arrays sigma_a and sigma_s [1/mm], or weight")
    if ("origin" in values) != ("spacing" in values):
        raise InputError("origin and spacing go together; without them the voxels fill the mesh's box")
    for key in ("origin", "spacing"):
        if key in values and values[key].shape not in ((), (3,)):
            raise InputError(f"{key}: needs one number or three, got shape {values[key].shape}")
    for key, axes in (("weight", (3,)), ("sigma_a", (3, 4)), ("sigma_s", (3, 4))):
        if key in values and values[key].ndim not in axes:
            raise InputError(f"{key}: needs shape (nx, ny, nz{'[, 3]' * (len(axes) > 1)}), got {values[key].shape}")
    coefficients = (values["sigma_a"], values["sigma_s"]) if "sigma_a" in values else None
    origin, spacing = (np.broadcast_to(values[k], 3) if k in values else None for k in ("origin", "spacing"))
    g, eta = (values[k].item() if k in values else None for k in ("g", "eta"))
    return Volume(coefficients, values.get("weight"), origin, spacing, g, eta)


def _npy(path: Path) -> Volume:
    return _split(np.load(path))


def _nrrd(path: Path) -> Volume:
    import nrrd

    data, header = nrrd.read(str(path))
    directions = header.get("space directions")
    if directions is None:
        spacings = np.asarray(header.get("spacings", np.ones(data.ndim)), float)
        spatial = np.flatnonzero(np.isfinite(spacings))[: data.ndim]
        spatial = spatial[-3:] if data.shape[0] in (2, 6) else spatial[:3]
        frame = np.diag(spacings[spatial]) if len(spatial) == 3 else np.zeros((3, 3))
    else:
        rows = [np.full(3, np.nan) if row is None else np.asarray(row, float) for row in directions]
        spatial = np.flatnonzero([np.all(np.isfinite(row)) for row in rows])
        frame = np.array([rows[k] for k in spatial]).T
    if len(spatial) != 3:
        raise InputError("needs three axes in space")
    rest = [k for k in range(data.ndim) if k not in spatial]
    affine = np.eye(4)
    affine[:3, :3], affine[:3, 3] = frame, np.asarray(header.get("space origin", frame.sum(axis=1) / 2), float)
    return _split(*_upright(np.transpose(data, [*spatial, *rest]), affine))


def _nifti(path: Path) -> Volume:
    import nibabel

    image: Any = nibabel.load(path)
    data = np.asarray(image.dataobj).astype(float)
    return _split(*_upright(data.squeeze() if data.ndim > 4 else data, np.array(image.affine)))


def _upright(data: np.ndarray, affine: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Voxels with axes x, y, z that ascend, their lower corner and size; `affine` takes indices to centres."""
    frame = affine[:3, :3]
    axis = np.abs(frame).argmax(axis=0)  # of space, for every axis of the array
    step = frame[axis, range(3)]
    aligned = np.zeros((3, 3))
    aligned[axis, range(3)] = step
    if sorted(axis) != [0, 1, 2] or not np.all(step) or np.abs(frame - aligned).max() > 1e-3 * np.abs(step).min():
        raise InputError("its axes are turned against x, y, z; resample it to them first")
    corner = np.empty(3)
    for k in range(3):
        first = affine[axis[k], 3]
        if step[k] < 0:
            data, first = np.flip(data, k), first + (data.shape[k] - 1) * step[k]
        corner[axis[k]] = first - abs(step[k]) / 2
    order = np.argsort(axis)
    return np.transpose(data, [*order, *range(3, data.ndim)]), corner, np.abs(step)[order]


def _split(data: np.ndarray, origin: np.ndarray | None = None, spacing: np.ndarray | None = None) -> Volume:
    """What the voxels mean, by their shape."""
    data = np.asarray(data, float)
    if data.ndim == 4 and data.shape[3] == 1:
        data = data[..., 0]
    if data.ndim == 3:
        return Volume(weight=data, origin=origin, spacing=spacing)
    if data.ndim == 4 and data.shape[3] in (2, 6):
        half = data.shape[3] // 2
        sigma_a, sigma_s = (np.broadcast_to(part, (*data.shape[:3], 3)) for part in np.split(data, [half], axis=3))
        return Volume((sigma_a, sigma_s), origin=origin, spacing=spacing)
    raise InputError(f"needs shape (nx, ny, nz) of weights, or (nx, ny, nz, 2 or 6) of coefficients, got {data.shape}")


def place(volume: Volume, mesh: Mesh) -> tuple[np.ndarray, np.ndarray]:
    """Lower corner and voxel size [mm] of a volume in the frame of the mesh, scaled as the mesh was.

    Raises
    ------
    InputError
        It lies beside the mesh.
    """
    values = volume.weight if volume.coefficients is None else volume.coefficients[0]
    assert values is not None
    low, high = mesh.bounds
    if volume.origin is None or volume.spacing is None:
        return low, (high - low) / values.shape[:3]
    origin, spacing = (v * mesh.report["scale"] for v in (volume.origin, volume.spacing))
    if np.any(origin >= high) or np.any(origin + spacing * values.shape[:3] <= low):
        raise InputError("its voxels lie beside the mesh; both need one frame and unit of length")
    return origin, spacing
