"""The demonstration mesh: a jade elephant, generated.

It has what translucency shows best on: a thick body with a closed cavity in it, ears a fortieth of its size,
and a trunk that curls back to the forehead, so that light passes through a loop. The surface is the zero of a
signed distance function made of smooth unions (Quilez, "Distance functions"), polygonised by manifold3d.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    import trimesh

EDGE = 0.029  # of the polygonisation
RELAXATIONS = 3
_BOX = np.array([[-1.00, -0.04, -0.83], [1.47, 1.49, 0.83]])

# centre lines (x, y, z) and radii; the trunk goes from the face forward, up, and back to the forehead
_TRUNK = np.array(
    [
        [0.61, 0.89, 0, 0.180], [0.83, 0.74, 0, 0.154], [1.02, 0.60, 0, 0.122], [1.21, 0.60, 0, 0.102],
        [1.33, 0.73, 0, 0.088], [1.34, 0.92, 0, 0.077], [1.26, 1.10, 0, 0.068], [1.12, 1.22, 0, 0.061],
        [0.95, 1.27, 0, 0.057], [0.79, 1.23, 0, 0.068],
    ]
)  # fmt: skip
_TAIL = np.array(
    [
        [-0.70, 0.86, 0, 0.060], [-0.86, 0.75, 0, 0.042], [-0.92, 0.58, 0, 0.034], [-0.91, 0.44, 0, 0.050],
        [-0.94, 0.33, 0, 0.026],
    ]
)  # fmt: skip
_TUSK = np.array(
    [
        [0.78, 0.82, 0.13, 0.055], [0.96, 0.67, 0.205, 0.047], [1.12, 0.64, 0.25, 0.038],
        [1.25, 0.70, 0.27, 0.026],
    ]
)  # fmt: skip


def demo_mesh() -> trimesh.Trimesh:
    """The elephant: closed, of genus 1, with a cavity in its body.

    Returns
    -------
    trimesh.Trimesh
        Some 57,000 triangles, y up, facing between +x and +z, feet on y = 0; about 2 units long.
    """
    import trimesh

    vertices, faces = _polygonise()
    for _ in range(RELAXATIONS):
        vertices = _relaxed(vertices, faces)
    turn = np.deg2rad(-52.0)  # a three-quarter view for a camera that looks along -z
    cosine, sine = np.cos(turn), np.sin(turn)
    x, y, z = vertices.T
    vertices = np.stack([cosine * x + sine * z, y, cosine * z - sine * x], axis=1)
    return trimesh.Trimesh(vertices, faces, process=False)


def _polygonise() -> tuple[np.ndarray, np.ndarray]:
    """Vertices and triangles of the zero of `_distance`.

    manifold3d asks for one distance at a time, in the same order every time: a first pass collects the
    points, so that all distances are computed at once.
    """
    from manifold3d import Manifold

    box = [*_BOX[0], *_BOX[1]]
    asked: list[tuple[float, float, float]] = []

    def collect(x: float, y: float, z: float) -> float:
        asked.append((x, y, z))
        return -1.0

    Manifold.level_set(collect, box, EDGE)
    answers = iter((-_distance(np.array(asked))).tolist())
    surface = Manifold.level_set(lambda x, y, z: next(answers), box, EDGE).to_mesh64()
    return np.asarray(surface.vert_properties)[:, :3], np.asarray(surface.tri_verts).astype(np.int64)


def _relaxed(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Vertices moved along the surface towards the mean of their neighbours, and back onto the surface."""
    from scipy.sparse import coo_matrix

    n = len(vertices)
    tail, head = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    links = coo_matrix((np.ones(len(tail)), (tail, head)), shape=(n, n)).tocsr()
    mean = links @ vertices / (links @ np.ones(n))[:, None]
    step = 1e-3
    value = _distance(vertices)
    offsets = step * np.eye(3)
    gradient = np.stack([_distance(vertices + o) - value for o in offsets], axis=1) / step
    squared = np.maximum(np.einsum("ij,ij->i", gradient, gradient), 0.05)[:, None]
    move = 0.6 * (mean - vertices)
    move -= gradient * np.einsum("ij,ij->i", gradient, move)[:, None] / squared
    back = np.clip(value, -0.3 * EDGE, 0.3 * EDGE)[:, None] * gradient / squared
    return vertices + move - back


def _blend(a: np.ndarray, b: np.ndarray, width: float) -> np.ndarray:
    """Union of two distances, rounded over `width`."""
    overlap = np.maximum(width - np.abs(a - b), 0.0) / width
    return np.minimum(a, b) - overlap**2 * width / 4


def _ellipsoid(p: np.ndarray, centre: tuple[float, ...], radii: tuple[float, ...]) -> np.ndarray:
    scaled = (p - centre) / radii
    length = np.linalg.norm(scaled, axis=1)
    return length * (length - 1.0) / np.maximum(np.linalg.norm(scaled / radii, axis=1), 1e-9)


def _cone(p: np.ndarray, start: np.ndarray, end: np.ndarray, r0: float, r1: float) -> np.ndarray:
    """Distance to a rod from `start` to `end` whose radius goes from r0 to r1."""
    axis = end - start
    t = np.clip((p - start) @ axis / (axis @ axis), 0.0, 1.0)
    return np.linalg.norm(p - start - t[:, None] * axis, axis=1) - (r0 + t * (r1 - r0))


def _tube(p: np.ndarray, line: np.ndarray) -> np.ndarray:
    """Distance to a bent rod: a spline through `line` (x, y, z, radius)."""
    from scipy.interpolate import CubicSpline
    from scipy.spatial import cKDTree

    knots = np.linspace(0, len(line) - 1, 60 * len(line))
    samples = CubicSpline(np.arange(len(line)), line)(knots)
    if line is _TRUNK:  # wrinkles in its lower half
        samples[:, 3] -= 0.004 * np.cos(11.0 * knots) * np.sin(np.pi * np.clip(knots / 6.0, 0.0, 1.0)) ** 2
    reach, nearest = cKDTree(samples[:, :3]).query(p)
    return reach - samples[nearest, 3]


def _ear(p: np.ndarray) -> np.ndarray:
    """Distance to the ear on the side z > 0: a bent, rippled sheet that thins towards its rim."""
    root = np.array([0.46, 1.02, 0.20])
    outward, up = np.array([-0.50, 0.0, 0.866]), np.array([0.0, 1.0, 0.0])
    u, v, w = ((p - root) @ axis for axis in (outward, up, np.cross(outward, up)))
    radius = np.hypot(u - 0.27, v - 0.06)
    angle = np.arctan2(v - 0.06, u - 0.27)
    # a fan: broad above, drawn down to a lobe below
    rim = 0.33 + 0.05 * np.cos(angle - 0.9) + 0.10 * np.exp(-(((angle + 1.75) / 0.45) ** 2))
    w = w + 0.30 * (u - 0.10) ** 2 - 0.05 * v + 0.018 * np.sin(3.0 * angle) * (radius / 0.33) ** 2
    half = 0.035 - 0.009 * np.clip(radius / 0.36, 0.0, 1.0)
    beyond = np.maximum(radius - rim + half, 0.0)
    return 0.85 * (np.hypot(beyond, w) - half)


def _step(x: np.ndarray, width: float) -> np.ndarray:
    """From 0 where x < -width to 1 where x > width, smoothly."""
    t = np.clip(x / width * 0.5 + 0.5, 0.0, 1.0)
    return t * t * (3.0 - 2.0 * t)


def _body(side: np.ndarray) -> np.ndarray:
    """Distance to the trunkless body in a saddle cloth, and its legs; z >= 0 stands for both sides."""
    out = _ellipsoid(side, (-0.16, 0.70, 0.0), (0.64, 0.43, 0.42))
    out = _blend(out, _ellipsoid(side, (-0.46, 0.66, 0.0), (0.36, 0.38, 0.37)), 0.15)
    out = _blend(out, _ellipsoid(side, (0.22, 0.78, 0.0), (0.34, 0.36, 0.35)), 0.15)
    edge = np.minimum(side[:, 1] - 0.66, 0.27 - np.abs(side[:, 0] + 0.20))
    hem = np.exp(-(((edge - 0.035) / 0.03) ** 2))
    out -= 0.016 * _step(edge, 0.02) + 0.014 * hem
    for x, lean in ((0.20, 0.05), (-0.52, -0.03)):
        foot = np.array([x + lean, 0.06, 0.245])
        out = _blend(out, _cone(side, np.array([x, 0.55, 0.22]), foot, 0.165, 0.138), 0.10)
        out = _blend(out, _cone(side, foot, foot - [0.0, 0.05, 0.0], 0.140, 0.158), 0.05)
        for turn in (-0.7, 0.0, 0.7):
            nail = foot + np.array([0.150 * np.cos(turn), -0.045, 0.150 * np.sin(turn)])
            out = _blend(out, np.linalg.norm((side - nail) / [1.0, 1.4, 1.0], axis=1) - 0.030, 0.015)
    return out


def _head(side: np.ndarray) -> np.ndarray:
    """Distance to the head with brows, eyes, lower lip and tusks; z >= 0 stands for both sides."""
    out = _ellipsoid(side, (0.56, 1.00, 0.0), (0.29, 0.31, 0.26))
    out = _blend(out, _ellipsoid(side, (0.53, 1.20, 0.09), (0.17, 0.13, 0.13)), 0.10)
    out = _blend(out, _ellipsoid(side, (0.70, 0.70, 0.0), (0.13, 0.07, 0.09)), 0.08)
    out = _blend(out, _tube(side, _TUSK), 0.03)
    return _blend(out, _ellipsoid(side, (0.75, 1.04, 0.185), (0.036, 0.036, 0.028)), 0.015)


def _distance(p: np.ndarray) -> np.ndarray:
    """Signed distance (n,) to the elephant at points (n, 3), negative inside; it faces +x, y is up."""
    side = np.column_stack([p[:, 0], p[:, 1], np.abs(p[:, 2])])
    out = _body(side)
    parts = (
        (_head, 0.14, (0.2, 0.5), 0.5),
        (lambda q: _tube(q, _TRUNK), 0.07, (0.4, 0.4), 0.4),
        (lambda q: _tube(q, _TAIL), 0.06, (-1.1, 0.2), 0.3),
        (_ear, 0.06, (-0.2, 0.4), 1.0),
    )
    for part, width, (x, y), z in parts:
        near = (side[:, 0] > x) & (side[:, 1] > y) & (side[:, 2] < z)
        if part is not _head:
            near &= side[:, 0] < x + 1.2
        out[near] = _blend(out[near], part(side[near]), width)
    out = -_blend(-out, p[:, 1], 0.03)  # stands flat
    return np.maximum(out, -_ellipsoid(p, (-0.16, 0.72, 0.0), (0.34, 0.20, 0.20)))
