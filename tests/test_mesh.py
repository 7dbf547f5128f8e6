"""Loading and repairing meshes, and rays against them: every refusal and every repair on a small case."""

import gzip
import json
import os
import struct
import tracemalloc
import warnings
from pathlib import Path

import numpy as np
import pytest
import trimesh

from clsss.errors import InputError
from clsss.mesh import RayCaster, contains, load_mesh
from clsss.rays import winding

SHARED = os.environ.get("CLSSS_SHARED")
PLY = """ply
format ascii 1.0
element vertex 4
property float x
property float y
property float z
element face {count}
property list uchar int vertex_indices
end_header
0 0 0
1 0 0
0 1 0
0 0 1
"""
LISTS = "element face 0\nproperty list uchar int vertex_indices\n"
TETRAHEDRON = ["3 0 2 1", "3 0 1 3", "3 0 3 2", "3 1 2 3"]


@pytest.fixture(autouse=True)
def no_warnings():
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        yield


def ply(*rows, count=None):
    return PLY.format(count=len(rows) if count is None else count) + "\n".join(rows) + "\n"


def sphere(subdivisions=2, centre=(0, 0, 0), radius=1.0):
    mesh = trimesh.creation.icosphere(subdivisions=subdivisions, radius=radius)
    return mesh.apply_translation(centre)


def volume(mesh):
    a, b, c = np.moveaxis(mesh.triangles, 1, 0)
    return np.einsum("ij,ij", a, np.cross(b, c)) / 6


def as_trimesh(vertices, faces):
    return trimesh.Trimesh(vertices, faces, process=False)


def together(*meshes):
    return trimesh.util.concatenate(meshes)


def is_cycle(mesh):
    """Whether every directed edge of the solid's triangles is matched by its reverse."""
    _, corner = np.unique(np.round(mesh.triangles.reshape(-1, 3), 7), axis=0, return_inverse=True)
    corner = corner.reshape(-1, 3)
    edges = np.concatenate([corner, np.roll(corner, -1, axis=1)]).reshape(2, -1).T
    key = np.sort(edges[:, 0] * 10**7 + edges[:, 1])
    return np.array_equal(key, np.sort(edges[:, 1] * 10**7 + edges[:, 0]))


# ---- what a clean mesh gives


def test_clean_mesh_is_scaled_and_nothing_else():
    source = sphere()
    mesh = load_mesh(source, size=10)
    np.testing.assert_allclose(mesh.vertices, source.vertices * 10 / np.ptp(source.vertices, axis=0).max())
    np.testing.assert_array_equal(mesh.faces, source.faces)
    assert mesh.faces.dtype == np.int32
    assert mesh.report == {
        "faces": len(source.faces),
        "vertices": len(source.vertices),
        "closed": True,
        "repairs": [],
        "size_mm": pytest.approx(10),
        "scale": pytest.approx(10 / np.ptp(source.vertices, axis=0).max()),
        "seconds": mesh.report["seconds"],
    }
    assert mesh.report["seconds"] > 0
    assert mesh.closed
    assert is_cycle(mesh)
    assert mesh.size == pytest.approx(10)
    np.testing.assert_allclose(mesh.bounds, 10 * source.bounds / np.ptp(source.bounds, axis=0).max())


def test_without_a_size_units_are_mm_and_places_stay():
    source = sphere(centre=(100, -50, 7))
    np.testing.assert_array_equal(load_mesh(source).vertices, source.vertices)


def test_normals_point_outward_and_are_shared_across_seams():
    mesh = load_mesh(as_trimesh(sphere().triangles.reshape(-1, 3), np.arange(960).reshape(-1, 3)))
    assert len(mesh.vertices) == 960
    assert mesh.closed
    np.testing.assert_allclose(mesh.normals, mesh.vertices, atol=0.02)


def test_normals_are_weighted_by_angle():
    """At the corner of a cube they lie along the diagonal however its sides are split."""
    box = load_mesh(trimesh.creation.box())
    np.testing.assert_allclose(box.normals, np.sign(box.vertices) / np.sqrt(3), atol=1e-12)


def test_unused_vertices_stay_and_do_not_count():
    vertices = np.concatenate([[[100.0, 0, 0]], sphere().vertices])
    mesh = load_mesh(as_trimesh(vertices, sphere().faces + 1), size=2)
    assert len(mesh.vertices) == len(vertices)
    np.testing.assert_allclose(mesh.size, 2)
    np.testing.assert_array_equal(mesh.normals[0], 0)


@pytest.mark.parametrize("scale", [1e-150, 1e-12, 1e12, 1e150])
def test_any_scale(scale):
    source = sphere()
    mesh = load_mesh(as_trimesh(source.vertices * scale, source.faces), size=10)
    assert volume(mesh) == pytest.approx(volume(load_mesh(source, size=10)), rel=1e-6)


def test_far_from_the_origin():
    offset = np.array([5e6, -4e6, 1e6])
    mesh = load_mesh(as_trimesh(sphere().vertices + offset, sphere().faces), size=10)
    assert mesh.closed
    assert mesh.report["repairs"] == []
    assert is_cycle(load_mesh(as_trimesh(sphere().vertices + offset, sphere().faces)))
    single = (sphere().vertices + offset).astype(np.float32)
    assert "rounded" in load_mesh(as_trimesh(single, sphere().faces), size=10).report["repairs"][-1]


# ---- repairs


@pytest.mark.parametrize("noise", [0.0, 1e-7])
def test_triangles_of_their_own_are_welded(noise):
    corners = sphere(3).triangles.reshape(-1, 3)
    corners = corners + noise * np.random.default_rng(0).uniform(-1, 1, corners.shape)
    mesh = load_mesh(as_trimesh(corners, np.arange(len(corners)).reshape(-1, 3)))
    assert mesh.closed
    assert mesh.report["closed"]
    assert len(mesh.vertices) == len(corners)
    assert mesh.report["repairs"] == ["welded 3840 vertices into 642 positions"]


def test_degenerate_triangles_are_dropped():
    source = sphere()
    a, b = source.faces[0, :2]
    middle = source.vertices[[a, b]].mean(axis=0)
    vertices = np.concatenate([source.vertices, [middle, middle]])
    n = len(source.vertices)
    faces = np.concatenate([[[a, a, b], [n, n + 1, a], [a, b, n]], source.faces])
    mesh = load_mesh(as_trimesh(vertices, faces))
    np.testing.assert_array_equal(mesh.faces, source.faces)
    assert is_cycle(mesh)
    assert np.isfinite(mesh.normals).all()


def test_duplicates_are_dropped_whichever_way_they_wind():
    source = sphere()
    faces = np.concatenate([source.faces, source.faces[:40], source.faces[60:80, ::-1]])
    mesh = load_mesh(as_trimesh(source.vertices, faces))
    assert "dropped 60 duplicate triangles" in mesh.report["repairs"]
    assert volume(mesh) == pytest.approx(source.volume)
    assert is_cycle(mesh)


def test_wall_between_two_boxes_vanishes():
    left = trimesh.creation.box()
    right = left.copy().apply_translation([1, 0, 0])
    mesh = load_mesh(together(left, right))
    assert volume(mesh) == pytest.approx(2)
    assert contains(mesh, [[0.5, 0.1, 0.1]]).all()


def test_whole_surface_inside_out():
    source = sphere()
    mesh = load_mesh(as_trimesh(source.vertices, source.faces[:, ::-1]))
    assert mesh.report["repairs"] == ["turned the whole surface inside out"]
    assert volume(mesh) == pytest.approx(source.volume)
    np.testing.assert_allclose(mesh.normals, mesh.vertices, atol=0.02)


def test_some_triangles_flipped():
    source = sphere(3)
    faces = source.faces.copy()
    flipped = np.random.default_rng(0).random(len(faces)) < 0.2
    faces[flipped] = faces[flipped][:, ::-1]
    mesh = load_mesh(as_trimesh(source.vertices, faces))
    assert volume(mesh) == pytest.approx(source.volume)
    assert f"turned {flipped.sum()} triangles" in mesh.report["repairs"][0]
    assert is_cycle(mesh)


def test_walls_that_nearly_touch_stay_apart():
    """By four millionths of the size, which single precision still tells apart."""
    blocks = trimesh.creation.box(), trimesh.creation.box((2, 1, 1)).apply_translation((1.500012, 0, 0))
    mesh = load_mesh(together(*blocks))
    assert mesh.report["repairs"] == []
    assert volume(mesh) == pytest.approx(3)


def test_each_body_is_oriented_by_itself():
    other = sphere(centre=(3, 0, 0))
    other.invert()
    mesh = load_mesh(together(sphere(), other))
    assert volume(mesh) == pytest.approx(2 * sphere().volume)
    assert mesh.report["repairs"] == ["turned 1 of 2 components inside out"]


@pytest.mark.parametrize("inverted", [False, True])
def test_cavity_stays_a_cavity(inverted):
    """A core in a cavity in a shell; as it should be, or all of it inside out."""
    shell, cavity, core = sphere(radius=3), sphere(radius=2), sphere(radius=1)
    cavity.invert()
    source = together(shell, cavity, core)
    if inverted:
        source.invert()
    mesh = load_mesh(source)
    assert volume(mesh) == pytest.approx((27 - 8 + 1) * sphere().volume)
    points = np.array([[0.1, 0, 0], [0, 1.5, 0], [0, 0, 2.5], [3.5, 0, 0]])
    np.testing.assert_array_equal(contains(mesh, points), [True, False, True, False])


def test_overlapping_bodies_are_one():
    mesh = load_mesh(together(sphere(), sphere(centre=(1, 0, 0))))
    assert contains(mesh, [[0.5, 0.01, 0.02]]).all()


def test_holes_are_capped():
    source = sphere(3)
    faces = np.delete(source.faces, [3, 200, 201, 700, 1000], axis=0)
    mesh = load_mesh(as_trimesh(source.vertices, faces))
    assert mesh.closed
    assert not mesh.report["closed"]
    assert is_cycle(mesh)
    assert len(mesh.faces) == len(faces)
    assert len(mesh.triangles) > len(faces)
    assert volume(mesh) == pytest.approx(source.volume, rel=1e-2)


def test_bowl_is_filled():
    source = sphere(3)
    below = source.triangles_center[:, 2] < 0.3
    with pytest.warns(UserWarning, match="2[6-9] % of its surface are caps"):
        mesh = load_mesh(as_trimesh(source.vertices, source.faces[below]))
    assert is_cycle(mesh)
    numbers = winding(np.array([[0, 0, 0.1], [0, 0, 0.6]]), mesh.triangles)
    np.testing.assert_allclose(numbers, [1, 0], atol=1e-9)


def test_bowl_beside_a_body_is_filled_as_well():
    """Too deep for a sheet: its rim is shorter than that of any flat piece of its area."""
    angle = np.radians(np.linspace(0, 66, 12))
    cap = trimesh.creation.revolve(np.stack([np.sin(angle), np.cos(angle)], axis=1), sections=64)
    mesh = load_mesh(together(cap, sphere(3, centre=(5, 0, 0))))
    assert "capped 1 hole of 64 open edges" in mesh.report["repairs"]
    height = 1 - np.cos(angle[-1])
    assert volume(mesh) == pytest.approx(sphere(3).volume + np.pi * height**2 * (3 - height) / 3, rel=0.02)


def test_with_many_holes_nothing_is_capped():
    """A ball that lacks a sixth of its triangles: the inside is where the rest winds round."""
    holed = sphere(3)
    holed.update_faces(np.random.default_rng(0).random(len(holed.faces)) > 1 / 6)
    mesh = load_mesh(holed)
    assert mesh.report["repairs"][0].startswith("too many edges are open to cap holes")
    assert not mesh.closed
    assert contains(mesh, np.array([[0, 0, 0.7], [0, 0, 1.3]])).tolist() == [True, False]


def test_holes_that_touch_in_one_vertex():
    source = sphere(3)
    around = np.flatnonzero((source.faces == 50).any(axis=1))
    mesh = load_mesh(as_trimesh(source.vertices, np.delete(source.faces, around[[0, 3]], axis=0)))
    assert is_cycle(mesh)


def test_fin_is_drawn_but_bounds_nothing():
    box = trimesh.creation.box()
    vertices = np.concatenate([box.vertices, [[0.0, 2.0, 0.0]]])
    a, b = box.faces[0, :2]
    mesh = load_mesh(as_trimesh(vertices, np.concatenate([box.faces, [[a, b, 8]]])))
    assert mesh.report["repairs"] == ["left 1 loose triangle out of the solid"]
    assert len(mesh.faces) == 13
    assert len(mesh.triangles) == 12
    assert np.linalg.norm(mesh.normals[8]) == pytest.approx(1)


@pytest.mark.parametrize("shift", [(1, 1, 0), (1, 1, 1)])
def test_boxes_that_share_an_edge_or_a_vertex(shift):
    mesh = load_mesh(together(trimesh.creation.box(), trimesh.creation.box().apply_translation(shift)))
    assert mesh.closed
    assert volume(mesh) == pytest.approx(2)
    assert len(mesh.triangles) == 24


def test_soup_is_left_open_and_still_has_an_inside():
    source = sphere(3)
    rng = np.random.default_rng(3)
    triangles = source.triangles + rng.normal(scale=5e-3, size=(len(source.faces), 1, 3))
    mesh = load_mesh(as_trimesh(triangles.reshape(-1, 3), np.arange(3 * len(triangles)).reshape(-1, 3)))
    assert not mesh.closed
    np.testing.assert_array_equal(contains(mesh, [[0, 0, 0.5], [0, 0, 1.5]]), [True, False])


def test_patches_that_do_not_meet_are_left_open():
    """The six sides of a cube, each meshed by itself with its own number of rows."""
    sides = []
    for axis in range(3):
        for sign in (-1, 1):
            n = 2 + len(sides)
            rows = np.linspace(-1, 1, n)
            u, v = np.repeat(rows, n), np.tile(rows, n)
            vertices = np.roll(np.column_stack([np.full(n * n, float(sign)), u, v]), axis, axis=1)
            k = np.arange(n * n).reshape(n, n)
            a, b, c, d = (x.ravel() for x in (k[:-1, :-1], k[1:, :-1], k[1:, 1:], k[:-1, 1:]))
            faces = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
            sides.append(as_trimesh(vertices, faces if sign > 0 else faces[:, ::-1]))
    mesh = load_mesh(together(*sides))
    assert not mesh.closed
    np.testing.assert_array_equal(contains(mesh, [[0.9, 0.8, -0.7], [1.1, 0, 0]]), [True, False])


def test_body_with_many_holes_beside_a_larger_one_stays():
    holed = sphere(3)
    holed.update_faces(np.random.default_rng(0).random(len(holed.faces)) > 0.04)
    mesh = load_mesh(together(holed, sphere(3, centre=(5, 0, 0), radius=2)))
    assert volume(mesh) == pytest.approx(9 * sphere(3).volume, rel=2e-2)


# ---- files


def test_polygons_and_all_styles_of_obj(tmp_path):
    square = ((0, 0), (1, 0), (1, 1), (0, 1))
    box = "".join(f"v {x} {y} {z} 0.5 0.5 0.5\r\n" for z in (0, 1) for x, y in square)
    faces = "f 4/1/1 3/2/1 2/3/1 1/4/1\nf 5//1 6//1 7//1 8//1\nf 1/1 2/1 6/2 5/3\n"
    faces += "f -7 -6 -2 -3\nf 3 4 8 7\nf 4 1 5 8"
    path = tmp_path / "bóx with spaces.obj"
    text = box + "mtllib none.mtl\no box\nvn 0 0 1\nvt 0 0\nusemtl x\n" + faces
    path.write_text(text, encoding="utf-8-sig")  # some editors begin files with a mark
    mesh = load_mesh(path, size=1)
    assert len(mesh.vertices) == 8
    assert len(mesh.faces) == 12
    assert volume(mesh) == pytest.approx(1)
    assert mesh.name == path.name


@pytest.mark.parametrize("kind", ["ascii", "little", "big"])
@pytest.mark.parametrize("mixed", [False, True])
def test_ply_of_every_kind_keeps_every_vertex(tmp_path, kind, mixed):
    """With extra properties, wide list counts, and triangles beside quads."""
    points = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0.5, 0.5, 1), (9, 9, 9)]
    faces = [[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]]
    faces += [[3, 2, 1, 0]] if mixed else [[3, 2, 1], [3, 1, 0]]
    name = {"ascii": "ascii", "little": "binary_little_endian", "big": "binary_big_endian"}[kind]
    header = (
        f"ply\nformat {name} 1.0\ncomment x\nelement vertex {len(points)}\nproperty double x\n"
        f"property double y\nproperty double z\nproperty uchar red\nelement face {len(faces)}\n"
        "property list ushort uint vertex_index\nproperty int flags\nend_header\n"
    ).encode()
    if kind == "ascii":
        rows = [(*p, 7) for p in points] + [(len(f), *f, 0) for f in faces]
        body = "\n".join(" ".join(map(str, row)) for row in rows).encode()
    else:
        order = "<" if kind == "little" else ">"
        body = b"".join(struct.pack(order + "3dB", *p, 7) for p in points)
        body += b"".join(struct.pack(f"{order}H{len(f)}Ii", len(f), *f, 0) for f in faces)
    path = tmp_path / "pyramid.ply"
    path.write_bytes(header + body)
    mesh = load_mesh(path)
    assert len(mesh.vertices) == 6
    assert volume(mesh) == pytest.approx(1 / 3)
    path.write_bytes(header + body[:-9])
    with pytest.raises(InputError, match=r"pyramid\.ply: the file is truncated"):
        load_mesh(path)


@pytest.mark.parametrize("suffix", ["stl", "off", "glb", "ply", "obj"])
def test_formats_plain_and_compressed(tmp_path, suffix):
    path = tmp_path / f"ball.{suffix}"
    sphere().export(path)
    packed = tmp_path / f"packed.{suffix}.gz"
    packed.write_bytes(gzip.compress(path.read_bytes()))
    for file in (path, packed):
        mesh = load_mesh(file, size=2)
        assert mesh.closed
        assert len(mesh.faces) == 320


def test_stl_is_told_by_its_size(tmp_path):
    path = tmp_path / "ball.stl"
    data = trimesh.exchange.stl.export_stl(sphere())
    path.write_bytes(b"solid".ljust(80) + data[80:])
    assert load_mesh(path).closed
    path.write_bytes(data[:80] + struct.pack("<I", 999) + data[84:])
    with pytest.raises(InputError, match="promises 999 triangles, but the file holds 320"):
        load_mesh(path)
    path.write_text(trimesh.exchange.stl.export_stl_ascii(sphere()))
    assert load_mesh(path).closed


@pytest.mark.parametrize(("suffix", "most_kept", "most"), [("ply", 2.5, 9), ("obj", 1.5, 6), ("stl", 4.5, 15)])
def test_memory_of_loading(tmp_path, suffix, most_kept, most):
    """Positions, triangles and normals are kept, of triangles some at a time while they are made."""
    path = tmp_path / f"ball.{suffix}"
    sphere(6).export(path)
    load_mesh(path)  # imports what reads it
    tracemalloc.start()
    mesh = load_mesh(path)
    kept, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert len(mesh.faces) == 81920
    assert kept < most_kept * path.stat().st_size
    assert peak < most * path.stat().st_size


def test_scene_is_merged():
    mesh = load_mesh(trimesh.Scene([sphere(), sphere(centre=(3, 0, 0))]))
    assert len(mesh.faces) == 640


REFUSED = {
    "empty.ply": (b"", "empty"),
    "picture.ply": (b"\x89PNG\r\n\x1a\n" + bytes(100), "not a PLY file"),
    "cut.ply": (b"ply\nformat ascii 1.0\nelement ver", "header has no end"),
    "type.ply": (ply(*TETRAHEDRON).replace("float x", "string x"), "makes no sense"),
    "format.ply": (ply(*TETRAHEDRON).replace("format ascii 1.0\n", ""), "no valid format"),
    "words.ply": (ply(*TETRAHEDRON).replace("1 0 0", "one 0 0"), "other than numbers"),
    "flat.ply": (ply(*TETRAHEDRON).replace("float z", "float w"), "no x, y, z"),
    "nothing.ply": (ply(count=0), "no triangles"),
    "points.ply": (ply(count=0).replace(LISTS, ""), "no triangles"),
    "short.ply": (ply(*TETRAHEDRON[:3], count=4), "promises 4 of 'face'"),
    "promise.ply": (ply(*TETRAHEDRON, count=4_000_000_000), "promises 4000000000 of 'face'"),
    "range.ply": (ply(*TETRAHEDRON, "3 0 1 99"), "triangle 4 names vertex 99"),
    "negative.ply": (ply(*TETRAHEDRON, "3 0 1 -3"), "triangle 4 names vertex -3"),
    "word.ply": (ply(*TETRAHEDRON, "3 0 1 nan"), "triangle 4 names vertex -"),
    "endless.ply": (ply(*TETRAHEDRON, "inf 0 1 2"), "promises 5 of 'face'"),
    "nan.ply": (ply(*TETRAHEDRON).replace("0 1 0\n", "0 nan 0\n"), "vertex 2 .*not a finite number"),
    "inf.ply": (ply(*TETRAHEDRON).replace("0 1 0\n", "0 inf 0\n"), "vertex 2 .*not a finite number"),
    "single.ply": (ply("3 0 1 2"), "no volume"),
    "sheet.ply": (ply("3 0 1 2", "3 2 1 0"), "no volume"),
    "line.ply": (ply("3 0 1 2").replace("0 1 0\n", "2 0 0\n"), "no volume"),
    "point.obj": ("v 5 5 5\nv 5 5 5\nv 5 5 5\nf 1 2 3\n", "at one point"),
    "vast.obj": ("v -1e308 0 0\nv 1e308 0 0\nv 0 1 0\nf 1 2 3\n", "too far apart"),
    "zero.obj": ("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 0 1 2\n", "line 4 uses index 0"),
    "range.obj": ("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 4\n", "names vertex 3"),
    "back.obj": ("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 -4\n", "names vertex -1"),
    "comma.obj": ("# x\nv 0,5 0 0\nv 1,5 0 0\nv 0 1,5 0\nf 1 2 3\n", "line 2 .*decimal commas"),
    "short.obj": ("v 0 0\n", "line 1 is not valid OBJ"),
    "points.obj": ("v 0 0 0\n", "no triangles"),
    "text.stl": ("hello", "STL"),
    "text.txt": ("hello", "not a mesh format"),
    "bare": ("hello", "not a mesh format"),
    "broken.glb": (b"glTF" + bytes(40), "cannot be read as GLB"),
    "scene.gltf": ('{"asset": {"version": "2.0"}, "scenes": [{"nodes": []}], "scene": 0}', "no triangles"),
    "broken.ply.gz": (gzip.compress(ply(*TETRAHEDRON).encode())[:-12], "cannot be read"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_refused_in_one_sentence_that_names_the_file(tmp_path, name):
    content, reason = REFUSED[name]
    path = tmp_path / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(InputError, match=reason) as caught:
        load_mesh(path)
    assert str(caught.value).startswith(name)
    assert "\n" not in str(caught.value)


def test_no_file(tmp_path):
    with pytest.raises(InputError, match=r"gone\.ply: there is no such file"):
        load_mesh(tmp_path / "gone.ply")
    with pytest.raises(InputError, match="not a file"):
        load_mesh(tmp_path)
    with pytest.raises(InputError, match="neither a path nor"):
        load_mesh(None)
    with pytest.raises(InputError, match="no triangles"):
        load_mesh(trimesh.Scene())


@pytest.mark.parametrize("size", [0, -1, 1e-12, 1e30, np.nan, np.inf, "wide", [1.0]])
def test_size_must_be_a_length(size):
    with pytest.raises(InputError, match=r"size: .* is not a length"):
        load_mesh(sphere(), size=size)


def test_one_sided_surfaces_are_refused():
    n = 60
    angle = np.linspace(0, 2 * np.pi, n, endpoint=False)
    middle = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    across = np.cos(angle / 2)[:, None] * middle + np.sin(angle / 2)[:, None] * [0, 0, 1]
    vertices = np.concatenate([middle - 0.3 * across, middle + 0.3 * across])
    k = np.arange(n - 1)
    faces = np.concatenate([np.stack([k, k + 1, k + n], 1), np.stack([k + 1, k + n + 1, k + n], 1)])
    faces = np.concatenate([faces, [[n - 1, n, 2 * n - 1], [n, 0, 2 * n - 1]]])
    with pytest.raises(InputError, match="one-sided"):
        load_mesh(as_trimesh(vertices, faces))


# ---- rays


@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e6])
def test_nearest_hit(scale):
    triangles = trimesh.creation.box().triangles * scale + scale * np.array([10.0, 20.0, 30.0])
    caster = RayCaster(triangles)
    centre = scale * np.array([10.0, 20.0, 30.0])
    origins = centre + scale * np.array([[0, 0.1, 0.2], [-7000.0, 0.1, 0.2], [5.0, 0, 0], [0, 3.0, 0.1]])
    t, index = caster.hit(origins, [[1.0, 0, 0], [2.0, 0, 0], [1.0, 0, 0], [0, -1.0, 0]])
    np.testing.assert_allclose(t, np.array([0.5, 3499.75, np.inf, 2.5]) * scale, rtol=1e-12)
    assert (index[[0, 1, 3]] >= 0).all()
    assert index[2] == -1
    np.testing.assert_allclose(triangles[index[1]][:, 0], scale * 9.5)


def test_occlusion_within_a_distance():
    caster = RayCaster(trimesh.creation.box().triangles)
    origins = np.array([[-3.0, 0.1, 0.2], [-3.0, 0.1, 0.2], [-3.0, 0.1, 0.2], [0.0, 5.0, 0.0]])
    blocked = caster.occluded(origins, [[1.0, 0, 0]], np.array([2.4, 2.6, np.inf, 10.0]))
    np.testing.assert_array_equal(blocked, [False, True, True, False])
    np.testing.assert_array_equal(caster.occluded(origins, [[2.0, 0, 0]], 1.3), [True, True, True, False])


def test_no_rays_and_no_points():
    mesh = load_mesh(sphere())
    t, index = RayCaster(mesh.triangles).hit(np.zeros((0, 3)), np.zeros((0, 3)))
    assert len(t) == len(index) == len(contains(mesh, np.zeros((0, 3)))) == 0


def test_inside_on_a_grid_through_the_vertices():
    """Points in line with edges and vertices, where a single ray's crossings cannot be trusted."""
    mesh = load_mesh(trimesh.creation.box(extents=(2, 2, 2)).subdivide())
    steps = np.linspace(-1.5, 1.5, 13)
    points = np.stack(np.meshgrid(steps, steps, steps), axis=-1).reshape(-1, 3)
    points = points[np.abs(np.abs(points).max(axis=1) - 1) > 1e-9]
    np.testing.assert_array_equal(contains(mesh, points), np.abs(points).max(axis=1) < 1)


def test_winding_number_of_a_corner():
    """One octant's worth of solid angle: three mutually perpendicular unit vectors see 1/8 of the sphere."""
    np.testing.assert_allclose(winding(np.zeros((1, 3)), np.eye(3)[None]), [1 / 8])


# ---- the reference meshes


def shared_cases(kind):
    if not SHARED:
        return []
    manifest = json.loads((Path(SHARED) / "meshes" / "manifest.json").read_text())
    return [case for case in manifest["meshes"] if case["set"] == kind and (case["tris"] or 0) < 250_000]


MUST_REFUSE = {
    "nan_vertex", "inf_vertex", "flat_double_sheet", "single_triangle", "collinear", "all_same_point",
    "empty", "header_only", "points_only", "truncated_faces", "truncated_header", "index_out_of_range",
    "negative_index", "not_a_mesh", "huge_count_header", "zero_index", "comma_decimals", "mobius",
    "klein_bottle", "binary_wrong_count",
}  # fmt: skip


@pytest.mark.skipif(not SHARED, reason="CLSSS_SHARED names no folder of reference meshes")
@pytest.mark.parametrize("case", shared_cases("nasty"), ids=lambda case: case["name"])
def test_nasty_meshes(case):
    path = Path(SHARED) / "meshes" / case["name"]
    if path.stem in MUST_REFUSE:
        with pytest.raises(InputError, match=r"^[^\n]+$") as caught:
            load_mesh(path, size=10)
        assert path.name in str(caught.value)
        return
    mesh = load_mesh(path, size=10)
    assert len(mesh.vertices) == case["verts"]
    assert mesh.closed
    assert volume(mesh) > 0
    assert np.isfinite(mesh.normals).all()
    if "same result as spot" in case["expect"] or path.stem.startswith("spot_soup"):
        spot = load_mesh(Path(SHARED) / "meshes" / "spot_6k.ply", size=10)
        assert volume(mesh) == pytest.approx(volume(spot), rel=1e-4)


@pytest.mark.skipif(not SHARED, reason="CLSSS_SHARED names no folder of reference meshes")
@pytest.mark.parametrize("case", shared_cases("bench"), ids=lambda case: case["name"])
def test_bench_meshes(case):
    mesh = load_mesh(Path(SHARED) / "meshes" / case["name"], size=case["longest_side"])
    assert mesh.closed
    if case["watertight"]:
        assert mesh.report["repairs"] == []
        assert len(mesh.triangles) == case["tris"]
        assert volume(mesh) == pytest.approx(case["volume"], rel=1e-6)
