"""Saved files read back: the numbers, the colours, and what is refused."""

from __future__ import annotations

import json
import os
import struct
from types import SimpleNamespace

import numpy as np
import pytest

from clsss import export
from clsss.errors import InputError
from clsss.srgb import srgb_encode


def read_glb(path):
    """The JSON tree of a GLB and a reader of its accessors."""
    data = path.read_bytes()
    magic, version, length, json_length, _ = struct.unpack_from("<4sIIII", data)
    assert (magic, version, length) == (b"glTF", 2, len(data))
    tree = json.loads(data[20 : 20 + json_length])
    blob = data[28 + json_length :]

    def accessor(index):
        entry = tree["accessors"][index]
        view = tree["bufferViews"][entry["bufferView"]]
        dtype = {5126: "<f4", 5125: "<u4"}[entry["componentType"]]
        start = view.get("byteOffset", 0) + entry.get("byteOffset", 0)
        columns = {"SCALAR": 1, "VEC3": 3}[entry["type"]]
        return np.frombuffer(blob, dtype, entry["count"] * columns, start).reshape(-1, columns)

    return tree, accessor


@pytest.fixture
def result():
    """A unit square with a gradient, one unused vertex that is NaN, and one overexposed corner."""
    vertices = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [9, 9, 9]], float)
    normals = np.tile([0.0, 0, 1], (5, 1))
    normals[4] = 0
    radiosity = np.array([[0.1, 0.2, 0.3], [0.5, 0.5, 0.5], [1, 2, 4], [0, 0.001, 0.002], [np.nan] * 3])
    mesh = SimpleNamespace(
        vertices=vertices, faces=np.array([[0, 1, 2], [0, 2, 3]], np.int32), normals=normals, name="plätt"
    )
    medium = SimpleNamespace(
        name="milk",
        homogeneous=True,
        g=0.5,
        eta=1.3,
        coefficients=lambda points: (np.full((len(points), 3), 0.01), np.full((len(points), 3), 2.0)),
    )
    return SimpleNamespace(
        mesh=mesh,
        medium=medium,
        vertex_radiosity=radiosity,
        vertex_fluence=2 * radiosity,
        vertex_radiosity_single=None,
        report={"clsss": "x"},
    )


def shown(result, exposure=0.0):
    """Displayed linear colour of the used vertices."""
    scale = export.display_scale(result.mesh, result.vertex_radiosity) * 2**exposure
    return np.clip(result.vertex_radiosity[:4] * scale, 0, 1)


def test_glb_has_linear_colours_and_raw_floats(result, tmp_path):
    export.save(result, tmp_path / "a.glb")
    assert len(pytest.importorskip("trimesh").load(tmp_path / "a.glb", force="mesh").faces) == 2
    tree, accessor = read_glb(tmp_path / "a.glb")
    primitive = tree["meshes"][0]["primitives"][0]
    attributes = primitive["attributes"]
    assert set(attributes) == {"POSITION", "NORMAL", "COLOR_0", "_RADIOSITY", "_FLUENCE"}
    np.testing.assert_allclose(accessor(attributes["POSITION"]), result.mesh.vertices)
    np.testing.assert_array_equal(accessor(primitive["indices"]).reshape(-1, 3), result.mesh.faces)
    np.testing.assert_allclose(accessor(attributes["COLOR_0"])[:4], shown(result), rtol=1e-6)
    np.testing.assert_allclose(accessor(attributes["_RADIOSITY"]), result.vertex_radiosity, rtol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(accessor(attributes["NORMAL"]), axis=1), 1, rtol=1e-6)
    material = tree["materials"][primitive["material"]]
    assert "KHR_materials_unlit" in material["extensions"]
    assert "KHR_materials_unlit" in tree["extensionsUsed"]
    assert material["extras"]["clsss"]["sigma_s"] == [2.0] * 3
    assert tree["nodes"][tree["scenes"][tree["scene"]]["nodes"][0]] is not None


def test_ply_has_srgb_bytes_and_raw_floats(result, tmp_path):
    trimesh = pytest.importorskip("trimesh")
    export.save(result, tmp_path / "a.ply")
    mesh = trimesh.load(tmp_path / "a.ply", process=False)
    np.testing.assert_allclose(mesh.vertices, result.mesh.vertices)
    np.testing.assert_array_equal(mesh.faces, result.mesh.faces)
    expected = np.rint(255 * srgb_encode(shown(result)))
    np.testing.assert_array_equal(mesh.visual.vertex_colors[:4, :3], expected)
    raw = mesh.metadata["_ply_raw"]["vertex"]["data"]
    for i, channel in enumerate("rgb"):
        for name, values in (("radiosity", result.vertex_radiosity), ("fluence", result.vertex_fluence)):
            np.testing.assert_allclose(raw[f"{name}_{channel}"].ravel(), values[:, i], rtol=1e-6)


def test_obj_has_srgb_colours(result, tmp_path):
    trimesh = pytest.importorskip("trimesh")
    export.save(result, tmp_path / "a.obj")
    mesh = trimesh.load(tmp_path / "a.obj", process=False, maintain_order=True)
    np.testing.assert_array_equal(mesh.faces, result.mesh.faces)
    lines = [line.split() for line in (tmp_path / "a.obj").read_text().splitlines() if line.startswith("v ")]
    table = np.array([line[1:] for line in lines], float)
    np.testing.assert_allclose(table[:, :3], result.mesh.vertices)
    np.testing.assert_allclose(table[:4, 3:], srgb_encode(shown(result)), atol=1e-5)


def test_npz_keeps_everything(result, tmp_path):
    export.save(result, tmp_path / "a.npz")
    with np.load(tmp_path / "a.npz") as saved:
        for name, values in (
            ("vertices", result.mesh.vertices),
            ("faces", result.mesh.faces),
            ("normals", result.mesh.normals),
            ("radiosity", result.vertex_radiosity),
            ("fluence", result.vertex_fluence),
        ):
            np.testing.assert_array_equal(saved[name], values)
        assert json.loads(str(saved["report"])) == result.report


def test_vtu_has_point_data(result, tmp_path):
    meshio = pytest.importorskip("meshio")
    export.save(result, tmp_path / "a.vtu")
    mesh = meshio.read(tmp_path / "a.vtu")
    np.testing.assert_allclose(mesh.points, result.mesh.vertices)
    np.testing.assert_array_equal(mesh.cells_dict["triangle"], result.mesh.faces)
    np.testing.assert_array_equal(mesh.point_data["radiosity"], result.vertex_radiosity)
    np.testing.assert_array_equal(mesh.point_data["fluence"], result.vertex_fluence)


@pytest.mark.parametrize("suffix", export.SUFFIXES)
def test_any_name_and_nothing_left_over(result, tmp_path, suffix):
    path = tmp_path / f"größe und 空白{suffix.upper()}"
    export.save(result, path, exposure=1)
    assert [p.name for p in tmp_path.iterdir()] == [path.name]
    (tmp_path / "other").touch()
    assert path.stat().st_mode == (tmp_path / "other").stat().st_mode  # readable by whom all new files are


def test_exposure_is_in_stops(result, tmp_path):
    export.save(result, tmp_path / "a.glb", exposure=-2)
    tree, accessor = read_glb(tmp_path / "a.glb")
    colour = accessor(tree["meshes"][0]["primitives"][0]["attributes"]["COLOR_0"])
    np.testing.assert_allclose(colour[:4], shown(result, -2), rtol=1e-6)


@pytest.mark.parametrize("name", ["a.stl", "a", "missing/a.glb", "folder.glb"])
def test_refused_in_one_sentence(tmp_path, name):
    (tmp_path / "folder.glb").mkdir()
    with pytest.raises(InputError, match=r"^[^\n]+$"):
        export.check_output(tmp_path / name)


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write anywhere")
def test_unwritable_folder(tmp_path):
    tmp_path.chmod(0o500)
    with pytest.raises(InputError, match="permission"):
        export.check_output(tmp_path / "a.glb")


def test_failed_write_keeps_the_old_file(result, tmp_path, monkeypatch):
    def full_disk(*_):
        raise OSError(28, "No space left on device")

    path = tmp_path / "a.ply"
    path.write_text("old")
    monkeypatch.setattr(os, "replace", full_disk)
    with pytest.raises(InputError, match="No space left"):
        export.save(result, path)
    assert [p.read_text() for p in tmp_path.iterdir()] == ["old"]


def test_display_scale_is_independent_of_units_and_survives_darkness(result):
    mesh, radiosity = result.mesh, np.nan_to_num(result.vertex_radiosity)
    assert export.display_scale(mesh, 1e-7 * radiosity) == pytest.approx(1e7 * export.display_scale(mesh, radiosity))
    assert export.display_scale(mesh, 0 * radiosity) == 1.0


def test_exposure_looks_from_where_the_camera_is():
    """A wall that is bright on one side: from there nothing is over-exposed, from behind its dark side shows."""
    corners = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], float)
    vertices = np.concatenate([np.hstack([corners, np.full((4, 1), z)]) for z in (0.0, 1.0)])
    faces = np.array([[0, 2, 1], [0, 3, 2], [4, 5, 6], [4, 6, 7]])
    wall = SimpleNamespace(vertices=vertices, faces=faces)
    radiosity = np.repeat([[0.01] * 3, [1.0] * 3], 4, axis=0)
    assert export.display_scale(wall, radiosity, np.array([0, 0, 1.0])) == pytest.approx(1, rel=0.01)
    assert export.display_scale(wall, radiosity, np.array([0, 0, -1.0])) == pytest.approx(100, rel=0.01)


@pytest.mark.parametrize("towards", [(0, 0, 1.0), (0, 1.0, 0), (-0.6, 0, 0.8), (0.48, -0.6, -0.64)])
def test_exposure_weighs_triangles_by_the_area_that_is_seen(towards):
    """Triangles of one brightness each; white is where the brightest 1 % of the seen area begins."""
    rng, towards = np.random.default_rng(1), np.array(towards)
    corners = rng.normal(size=(500, 3, 3)) + 20
    level = rng.permutation(np.linspace(0.5, 1, 500))
    mesh = SimpleNamespace(vertices=corners.reshape(-1, 3), faces=np.arange(1500).reshape(-1, 3).astype(np.int32))
    seen = np.maximum(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) @ towards, 0)
    order = np.argsort(level)
    white = level[order][np.searchsorted(np.cumsum(seen[order]), 0.99 * seen.sum())]
    radiosity = np.repeat(level, 3)[:, None] * (0.2, 1.0, 0.5)
    assert export.display_scale(mesh, radiosity, towards) == pytest.approx(1 / white)
    radiosity[0, 0] = np.nan
    assert export.display_scale(mesh, radiosity, towards) == pytest.approx(1 / white)


@pytest.mark.parametrize(("dark", "stops"), [(0.9, 0), (0.4, 0), (0.2, 0.5), (0.1, 1), (0.025, 2), (1e-9, 2)])
def test_exposure_brings_up_what_is_lit_from_behind(dark, stops):
    """White and, on 60 % of the surface, dark: half the stops from there to 0.4 of white, two at most."""
    mesh = SimpleNamespace(vertices=np.tile([[0, 0, 0], [1, 0, 0], [0, 1, 0]], (10, 1)).astype(float),
                           faces=np.arange(30).reshape(-1, 3))  # fmt: skip
    radiosity = np.repeat([3.0] * 4 + [3.0 * dark] * 6, 3)[:, None] * np.ones(3)
    assert export.display_scale(mesh, radiosity) == pytest.approx(2**stops / 3)


def test_far_from_the_origin_the_shape_survives(result, tmp_path):
    """Scans in world coordinates: single precision has steps of 0.5 mm there."""
    trimesh = pytest.importorskip("trimesh")
    near = result.mesh.vertices[:4] * 0.3
    result.mesh.vertices = result.mesh.vertices * 0.3 + np.array([5e6, 4e6, 1e3])
    for suffix in ("ply", "obj", "glb"):
        export.save(result, tmp_path / f"far.{suffix}")
        read = trimesh.load_scene(tmp_path / f"far.{suffix}", process=False).to_mesh().vertices[:4]
        np.testing.assert_allclose(read - (5e6, 4e6, 1e3), near, atol=1e-6)


@pytest.mark.parametrize("suffix", [".glb", ".ply", ".npz", ".vtu"])
def test_what_was_scattered_once_is_kept_beside(result, tmp_path, suffix):
    result.vertex_radiosity_single = 0.25 * result.vertex_radiosity
    path = tmp_path / f"a{suffix}"
    export.save(result, path)
    if suffix == ".glb":
        tree, accessor = read_glb(path)
        found = accessor(tree["meshes"][0]["primitives"][0]["attributes"]["_RADIOSITY_SINGLE"])
    elif suffix == ".ply":
        raw = pytest.importorskip("trimesh").load(path, process=False).metadata["_ply_raw"]["vertex"]["data"]
        found = np.stack([raw[f"radiosity_single_{channel}"].ravel() for channel in "rgb"], axis=1)
    elif suffix == ".npz":
        found = np.load(path)["radiosity_single"]
    else:
        found = pytest.importorskip("meshio").read(path).point_data["radiosity_single"]
    np.testing.assert_allclose(found, result.vertex_radiosity_single, rtol=1e-6)
