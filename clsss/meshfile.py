"""Read the vertices and triangles of a mesh file, exactly as the file gives them.

PLY and OBJ are read here because the solver gives one colour back per vertex of the file: general readers
split or reorder vertices at texture seams, refuse PLY files that mix triangles with quads, wrap indices out
of range, and take truncated text for a smaller mesh. All other formats go through trimesh.
"""

from __future__ import annotations

import gc
import gzip
import io
import zlib
from array import array
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from clsss.errors import InputError

_PLY_TYPES = {
    "char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4", "float": "f4",
    "double": "f8", "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4",
    "uint32": "u4", "int64": "i8", "uint64": "u8", "float32": "f4", "float64": "f8",
}  # fmt: skip
_PLY_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
_INDICES = ("vertex_indices", "vertex_index")


def read(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and triangles of a mesh file, in the file's order and units.

    Parameters
    ----------
    path : Path
        Any format trimesh reads, also compressed with gzip (``.ply.gz``).

    Returns
    -------
    vertices : (v, 3) float64
        Every vertex of the file [file units].
    faces : (f, 3) int32
        Indices into `vertices`; polygons are split into fans.

    Raises
    ------
    InputError
        The file is missing, truncated, not a mesh, or its indices or numbers make no sense.
    """
    data, suffix = _contents(path)
    if suffix == ".ply" and b"tristrips" not in data[:4000]:
        vertices, faces = _read_ply(data, path.name)
    elif suffix == ".obj":
        vertices, faces = _read_obj(data, path.name)
    else:
        vertices, faces = _read_with_trimesh(path, data, suffix)
    return _checked(vertices, faces, path.name)


def from_trimesh(mesh: Any, name: str) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and triangles of a `trimesh.Trimesh` or scene, as `read` gives those of a file."""
    try:
        mesh = mesh.to_mesh() if hasattr(mesh, "to_mesh") else mesh
        vertices, faces = np.array(mesh.vertices, np.float64), np.asarray(mesh.faces, np.int64)
    except (AttributeError, TypeError, ValueError) as error:
        kind = type(mesh).__name__
        raise InputError(f"mesh: a {kind} is neither a path nor a trimesh.Trimesh with triangles") from error
    return _checked(vertices.reshape(-1, 3), faces.reshape(-1, 3), name)


def _checked(vertices: np.ndarray, faces: np.ndarray, name: str) -> tuple[np.ndarray, np.ndarray]:
    if not len(faces):
        raise InputError(f"{name}: there are no triangles in it; clsss needs a surface mesh")
    if faces.min() < 0 or faces.max() >= len(vertices):
        bad = int(np.flatnonzero(((faces < 0) | (faces >= len(vertices))).any(axis=1))[0])
        index = int(next(i for i in faces[bad] if not 0 <= i < len(vertices)))
        known = f"there are only {len(vertices)} vertices, counted from 0"
        raise InputError(f"{name}: triangle {bad} names vertex {index}, but {known}")
    return vertices, np.array(faces, np.int32)


def _contents(path: Path) -> tuple[bytes, str]:
    """The uncompressed bytes of a file and its suffix without ``.gz``."""
    if not path.exists():
        raise InputError(f"{path}: there is no such file")
    if not path.is_file():
        raise InputError(f"{path}: not a file; give the path of a mesh file")
    try:
        data = path.read_bytes()
        if data[:2] == b"\x1f\x8b":
            data = gzip.decompress(data)
    except (OSError, EOFError, zlib.error) as error:
        raise InputError(f"{path.name}: cannot be read ({' '.join(str(error).split())})") from error
    suffixes = [s.lower() for s in path.suffixes if s.lower() != ".gz"]
    if not data:
        raise InputError(f"{path.name}: the file is empty")
    return data, suffixes[-1] if suffixes else ""


def _fan(polygon: list[int]) -> list[int]:
    """Corners of the triangles of a polygon, a fan from its first vertex."""
    return [corner for k in range(1, len(polygon) - 1) for corner in (polygon[0], polygon[k], polygon[k + 1])]


def _read_obj(data: bytes, name: str) -> tuple[np.ndarray, np.ndarray]:
    """Positions and faces of a Wavefront OBJ file; texture coordinates and normals do not split vertices."""
    vertices, faces = array("d"), array("q")
    text = io.BytesIO(data.replace(b"\\\r\n", b" ").replace(b"\\\n", b" "))
    for number, line in enumerate(io.TextIOWrapper(text, "utf-8-sig", "replace"), 1):
        fields = line.split()
        if not fields or fields[0] not in ("v", "f"):
            continue
        try:
            if fields[0] == "v":
                x, y, z = fields[1:4]
                vertices.extend((float(x), float(y), float(z)))
            else:
                corners = [int(corner.partition("/")[0]) for corner in fields[1:]]
                if 0 in corners:
                    raise InputError(f"{name}: line {number} uses index 0, but OBJ indices start at 1")
                # negative indices count back from the vertices read so far
                faces.extend(_fan([c - 1 if c > 0 else len(vertices) // 3 + c for c in corners]))
        except InputError:
            raise
        except (ValueError, OverflowError) as error:
            hint = " (decimal commas? write decimal points)" if "," in line else ""
            raise InputError(f"{name}: line {number} is not valid OBJ: {line.strip()[:60]!r}{hint}") from error
    return np.array(vertices).reshape(-1, 3), np.array(faces).reshape(-1, 3)


def _ply_header(data: bytes, name: str) -> tuple[str, list[tuple[str, int, list[tuple[str, ...]]]], int]:
    """Byte order, elements (name, count, properties) and length of a PLY header."""
    if not data.startswith(b"ply"):
        raise InputError(f"{name}: not a PLY file, though its name says so")
    end = data.find(b"end_header")
    stop = data.find(b"\n", end) + 1
    if end < 0 or stop == 0:
        raise InputError(f"{name}: the PLY header has no end; the file is truncated")
    order: str | None = None
    elements: list[tuple[str, int, list[tuple[str, ...]]]] = []
    try:
        for line in data[:end].decode("utf-8", "replace").splitlines()[1:]:
            match line.split():
                case ["format", kind, *_]:
                    order = _PLY_ORDERS[kind]
                case ["element", element, count]:
                    elements.append((element, int(count), []))
                case ["property", "list", counts, items, label]:
                    elements[-1][2].append((label, _PLY_TYPES[items], _PLY_TYPES[counts]))
                case ["property", kind, label]:
                    elements[-1][2].append((label, _PLY_TYPES[kind]))
    except (KeyError, ValueError, IndexError) as error:
        raise InputError(f"{name}: the PLY header line {line.strip()!r} makes no sense") from error
    if order is None or any(count < 0 for _, count, _ in elements):
        raise InputError(f"{name}: the PLY header has no valid format or counts")
    return order, elements, stop


def _read_ply(data: bytes, name: str) -> tuple[np.ndarray, np.ndarray]:
    """Positions and polygons of a PLY file, text or binary of either byte order, polygons of any size."""
    order, elements, position = _ply_header(data, name)
    body = _PlyBody(data, order, position)
    if order == "":
        try:
            body = _PlyBody(_numbers(data, position), order, 0)
        except ValueError as error:
            raise InputError(f"{name}: the text of the PLY file has something other than numbers") from error
    vertices, faces = np.zeros((0, 3)), np.zeros((0, 3), np.int64)
    for element, count, properties in elements:
        try:
            columns = body.read(count, properties) if count else {}
        except (ValueError, OverflowError) as error:
            promise = f"its header promises {count} of {element!r}, more than the file holds"
            raise InputError(f"{name}: the file is truncated: {promise}") from error
        if element == "vertex" and count:
            if any(axis not in columns for axis in "xyz"):
                raise InputError(f"{name}: the PLY vertices have no x, y, z")
            vertices = np.stack([columns[axis] for axis in "xyz"], axis=1, dtype=np.float64)
        elif element == "face" and count:
            lists = next((columns[label] for label in _INDICES if label in columns), None)
            with np.errstate(invalid="ignore"):  # what is no index in a text becomes one out of range
                if isinstance(lists, np.ndarray) and lists.shape[1] == 3:
                    faces = lists if lists.dtype.kind in "iu" else lists.astype(np.int64)
                elif lists is not None:
                    rows = (np.asarray(row).astype(np.int64).tolist() for row in lists)
                    faces = np.array([corner for row in rows for corner in _fan(row)], np.int64).reshape(-1, 3)
    return vertices, faces


def _numbers(data: bytes, position: int) -> np.ndarray:
    """The numbers of a text from `position` on, some lines at a time: words take six times as much as their text."""
    text = io.BytesIO(data)
    text.seek(position)
    lines = iter(lambda: text.readlines(1 << 20), [])
    return np.concatenate([np.zeros(0), *(np.array(b"".join(some).split(), np.float64) for some in lines)])


@dataclass
class _PlyBody:
    """What follows a PLY header: bytes, or the numbers of a text file, read from `position` on."""

    data: Any
    order: str
    position: int

    def read(self, count: int, properties: list[tuple[str, ...]]) -> dict[str, Any]:
        """Columns of the next element by label; ValueError where the body ends early.

        Lists of one length become (count, length) arrays, others a list of rows.
        """
        self._require(count, self._row_type(properties, [0] * len(properties)))  # before allocating
        lengths = self._lengths(properties)
        kind = self._row_type(properties, lengths)
        start = self.position
        try:
            table = self._rows(count, kind)
            if all((table[f"n{k}"] == lengths[k]).all() for k, p in enumerate(properties) if len(p) == 3):
                return {label: table[f"p{k}"] for k, (label, *_) in enumerate(properties)}
        except ValueError:
            pass  # the first row's lists may be longer than the others
        self.position = start
        ragged: dict[str, Any] = {label: [] for label, *_ in properties}
        for _ in range(count):
            row = self._rows(1, self._row_type(properties, self._lengths(properties)))
            for k, (label, *_) in enumerate(properties):
                ragged[label].append(row[f"p{k}"][0])
        return ragged

    def _row_type(self, properties: list[tuple[str, ...]], lengths: list[int]) -> np.dtype:
        """Layout of a row whose lists have these lengths: p0, p1, ..., before each list its length n0, ..."""
        fields: list[Any] = []
        for k, (_, kind, *counts) in enumerate(properties):
            if counts:
                fields.append((f"n{k}", self.order + counts[0] if self.order else "f8"))
            shape = [(lengths[k],)] if counts else []
            fields.append((f"p{k}", self.order + kind if self.order else "f8", *shape))
        return np.dtype(fields)

    def _require(self, count: int, kind: np.dtype) -> int:
        """Where `count` rows end; ValueError beyond the end of the body."""
        end = self.position + count * kind.itemsize // (1 if self.order else 8)
        if end > len(self.data):
            raise ValueError("fewer rows than promised")
        return end

    def _rows(self, count: int, kind: np.dtype) -> np.ndarray:
        end = self._require(count, kind)
        table = np.frombuffer(self.data, kind, count, self.position * (1 if self.order else 8))
        self.position = end
        return table

    def _lengths(self, properties: list[tuple[str, ...]]) -> list[int]:
        """Lengths of the lists of the row at `position`, 0 for what is no list."""
        lengths, start = [0] * len(properties), self.position
        for k in range(len(properties)):
            if len(properties[k]) == 3:
                row = self._rows(1, self._row_type(properties[: k + 1], lengths))
                self.position, lengths[k] = start, int(row[f"n{k}"][0])
                if not 0 <= lengths[k] <= len(self.data):
                    raise ValueError("a list longer than the file")
        return lengths


def _read_with_trimesh(path: Path, data: bytes, suffix: str) -> tuple[np.ndarray, np.ndarray]:
    import trimesh

    _check_stl(path.name, data, suffix)
    if suffix.lstrip(".") not in trimesh.available_formats():
        raise InputError(f"{path.name}: not a mesh format clsss can read; try .ply, .obj, .stl, .off or .glb")
    compressed = path.suffix.lower() == ".gz"
    try:
        scene = trimesh.load_scene(
            io.BytesIO(data) if compressed else path, file_type=suffix[1:], process=False, skip_materials=True
        )
        mesh = scene.to_mesh()
        vertices, faces = np.array(mesh.vertices, np.float64), np.array(mesh.faces, np.int64)
        del scene, mesh
        gc.collect()  # they refer to one another, and would stay with several times the file's size
    except BaseException as error:  # readers of damaged files may raise anything
        if isinstance(error, (KeyboardInterrupt, SystemExit, MemoryError)):
            raise
        reason = " ".join(str(error).split())[:120] or type(error).__name__
        raise InputError(
            f"{path.name}: cannot be read as {suffix[1:].upper()} ({reason}); is it damaged or truncated?"
        ) from error
    return vertices.reshape(-1, 3), faces.reshape(-1, 3)


def _check_stl(name: str, data: bytes, suffix: str) -> None:
    """A binary STL is told by its size, not by the word it starts with, which exporters get wrong."""
    if suffix != ".stl" or (b"facet" in data[:2000] and b"\0" not in data[:2000]):
        return
    promised = int.from_bytes(data[80:84], "little")
    if len(data) != 84 + 50 * promised:
        raise InputError(
            f"{name}: the STL header promises {promised} triangles, but the file holds "
            f"{max(0, len(data) - 84) // 50}; export it again"
        )
