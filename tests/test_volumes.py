"""Voxels from files: every format gives the same medium at the same place; what cannot be read is said."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from clsss import request
from clsss.errors import InputError
from clsss.media import Grid, Mix, Voxels
from clsss.volumes import place, read_volume

SHAPE = (4, 5, 6)
WEIGHT = np.random.default_rng(0).random(SHAPE)
CORNER, STEP = np.array([10.0, 20.0, 30.0]), np.array([0.5, 1.0, 2.0])
MESH = SimpleNamespace(bounds=np.array([CORNER, CORNER + STEP * SHAPE]), report={"scale": 1.0}, size=12.0, name="m")


def options(path, **given):
    names = ("material", "sigma_a", "sigma_s", "g", "eta", "mix", "vertex_colours")
    return SimpleNamespace(**{**dict.fromkeys(names), "grid": str(path), **given})


def nrrd_file(path, values=WEIGHT, directions=None, corner=None):
    nrrd = pytest.importorskip("nrrd")
    first = CORNER + STEP / 2 if corner is None else corner
    directions = np.diag(STEP) if directions is None else directions
    nrrd.write(str(path), values, {"space dimension": 3, "space directions": directions, "space origin": first})
    return path


def nifti_file(path, values, affine):
    nibabel = pytest.importorskip("nibabel")
    nibabel.save(nibabel.Nifti1Image(values, affine), path)
    return path


def affine(frame, first):
    out = np.eye(4)
    out[:3, :3], out[:3, 3] = frame, first
    return out


def check_weight(volume):
    np.testing.assert_allclose(volume.weight, WEIGHT, atol=1e-6)
    np.testing.assert_allclose(volume.origin, CORNER)
    np.testing.assert_allclose(volume.spacing, STEP)


def test_npz_weight(tmp_path):
    np.savez(tmp_path / "w.npz", weight=WEIGHT, origin=CORNER, spacing=STEP)
    check_weight(read_volume(tmp_path / "w.npz"))


def test_nrrd_weight(tmp_path):
    check_weight(read_volume(nrrd_file(tmp_path / "größe.nrrd")))


def test_nifti_axes_are_put_upright(tmp_path):
    last = CORNER + STEP * SHAPE - STEP / 2
    flipped = affine(np.diag(-STEP), last)
    check_weight(read_volume(nifti_file(tmp_path / "a.nii", WEIGHT[::-1, ::-1, ::-1], flipped)))
    turned = affine(np.diag(STEP)[:, [2, 0, 1]], CORNER + STEP / 2)
    check_weight(read_volume(nifti_file(tmp_path / "b.nii.gz", WEIGHT.transpose(2, 0, 1), turned)))


def test_npy_fills_the_box(tmp_path):
    np.save(tmp_path / "w.npy", WEIGHT)
    volume = read_volume(tmp_path / "w.npy")
    origin, spacing = place(volume, MESH)
    np.testing.assert_allclose(origin, CORNER)
    np.testing.assert_allclose(spacing, STEP)


def test_place_follows_the_scale_of_the_mesh(tmp_path):
    np.savez(tmp_path / "w.npz", weight=WEIGHT, origin=CORNER, spacing=STEP)
    mesh = SimpleNamespace(bounds=3 * MESH.bounds, report={"scale": 3.0})
    origin, spacing = place(read_volume(tmp_path / "w.npz"), mesh)
    np.testing.assert_allclose(origin, 3 * CORNER)
    np.testing.assert_allclose(spacing, 3 * STEP)


def test_a_weight_mixes(tmp_path):
    np.save(tmp_path / "w.npy", WEIGHT)
    medium = request.medium_from(options(tmp_path / "w.npy", material="skin1", mix=("ketchup", None, 0)), MESH)
    assert isinstance(medium, Mix)
    assert (medium.a.name, medium.b.name) == ("skin1", "ketchup")
    centres = CORNER + STEP * (np.array([[1, 2, 3], [0, 0, 0]]) + 0.5)
    np.testing.assert_allclose(medium.weight(centres), WEIGHT[[1, 0], [2, 0], [3, 0]])


@pytest.mark.parametrize("channels", [1, 3])
def test_coefficients_are_a_grid(tmp_path, channels):
    sigma = np.random.default_rng(1).random((2, *SHAPE, channels)) + 0.1
    np.save(tmp_path / "c.npy", np.concatenate(list(sigma), axis=3))
    shape = sigma[..., 0] if channels == 1 else sigma
    np.savez(tmp_path / "c.npz", sigma_a=shape[0], sigma_s=shape[1], g=0.5, eta=1.4)
    for name in ("c.npy", "c.npz"):
        medium = request.medium_from(options(tmp_path / name), MESH)
        assert isinstance(medium, Grid)
        np.testing.assert_allclose(medium.sigma_a, np.broadcast_to(sigma[0], (*SHAPE, 3)))
        np.testing.assert_allclose(medium.sigma_s, np.broadcast_to(sigma[1], (*SHAPE, 3)))
        assert (medium.g, medium.eta) == ((0.5, 1.4) if name == "c.npz" else (0.0, 1.0))
    assert request.medium_from(options(tmp_path / "c.npz", g=0.0, eta=1.2), MESH).eta == 1.2


def test_coefficients_in_a_vector_nrrd(tmp_path):
    values = np.stack([np.full(SHAPE, 0.1), np.full(SHAPE, 2.0)])
    path = nrrd_file(tmp_path / "c.nrrd", values, np.vstack([np.full(3, np.nan), np.diag(STEP)]))
    volume = read_volume(path)
    assert volume.weight is None
    np.testing.assert_allclose(volume.coefficients[1], np.full((*SHAPE, 3), 2.0))
    np.testing.assert_allclose(volume.origin, CORNER)


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("none.npz", "no such file"),
        ("x.vtk", "voxels are read from"),
        ("junk.npz", "cannot be read"),
        ("junk.npy", "cannot be read"),
        ("junk.nrrd", "cannot be read"),
        ("junk.nii", "cannot be read"),
        ("flat.npy", "needs shape"),
        ("unknown.npz", "unknown array 'sigma_t'"),
        ("half.npz", "needs the arrays"),
        ("plane.npz", "weight: needs shape (nx, ny, nz), got (4, 5)"),
        ("line.npz", "sigma_a: needs shape (nx, ny, nz[, 3]), got (5,)"),
        ("corner.npz", "go together"),
        ("beside.npz", "beside the mesh"),
        ("large.npy", "within 0 and 1"),
        ("weight.npy", "--mix NAME says"),
        ("turned.nrrd", "turned against x, y, z"),
    ],
)
def test_what_is_wrong_is_said(tmp_path, name, says):
    for junk in ("npz", "npy", "nrrd", "nii"):
        (tmp_path / f"junk.{junk}").write_text("hello")
    np.save(tmp_path / "flat.npy", WEIGHT[0])
    np.save(tmp_path / "large.npy", 255 * WEIGHT)
    np.save(tmp_path / "weight.npy", WEIGHT)
    np.savez(tmp_path / "unknown.npz", sigma_t=WEIGHT)
    np.savez(tmp_path / "half.npz", sigma_a=WEIGHT)
    np.savez(tmp_path / "plane.npz", weight=np.ones((4, 5)))
    np.savez(tmp_path / "line.npz", sigma_a=np.ones(5), sigma_s=np.ones(5))
    np.savez(tmp_path / "corner.npz", weight=WEIGHT, origin=0)
    np.savez(tmp_path / "beside.npz", weight=WEIGHT, origin=-900, spacing=1)
    if name.endswith("nrrd"):
        nrrd_file(tmp_path / "turned.nrrd", directions=[[1, 0.5, 0], [-0.5, 1, 0], [0, 0, 1]])
    if name.endswith("nii"):
        pytest.importorskip("nibabel")
    mix = None if name == "weight.npy" else ("ketchup", None, 0)
    with pytest.raises(InputError) as caught:
        request.medium_from(options(tmp_path / name, mix=mix), MESH)
    assert says in str(caught.value)
    assert name in str(caught.value)


def test_coefficients_take_no_material(tmp_path):
    np.savez(tmp_path / "c.npz", sigma_a=WEIGHT, sigma_s=1 + WEIGHT)
    with pytest.raises(InputError, match="holds coefficients"):
        request.medium_from(options(tmp_path / "c.npz", material="skin1"), MESH)


@pytest.mark.parametrize("values", [np.zeros((2, 2)), np.full((2, 2, 2), 1.5), np.full((2, 2, 2), np.nan)])
def test_bad_weights(values):
    with pytest.raises(InputError, match="values"):
        Voxels(values, 0, 1)
