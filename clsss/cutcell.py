"""The surface against the finest grid: which cells it cuts, and the moments of those cells.

Input is a closed triangle surface, output are kappa, alpha, alpha_B, x_C, x_B and n_B of every cut cell, from
signed distances at half-cell nodes near the surface. Lengths on the device are in cells, so that one float32
resolves a cell to some 1e-5 at any size of the object.

References
----------
Haber et al. 2005, section 3.1; Johansen and Colella 1998 (embedded boundaries).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clsss.device import Buffer, Device
from clsss.mesh import Mesh
from clsss.stowed import Stowed, stow
from clsss.thickness import LOOKED_AT, thickness_below
from clsss.triangles import Triangles, whole_and_pieces
from clsss.winding import winding_number

REACH = 0.87  # half the diagonal of a cell: no edge of a Kuhn tetrahedron of a subcell is longer
MARGIN = 2  # empty cells kept around the object


@dataclass(frozen=True)
class Grid:
    """The finest grid: `dims` cells (x, y, z) of width `h` [mm] from `origin` [mm]."""

    origin: np.ndarray
    h: float
    dims: tuple[int, int, int]

    def to_cells(self, points: np.ndarray) -> np.ndarray:
        """Points [mm] as grid coordinates [cells]."""
        cells = np.subtract(points, self.origin, dtype=float)
        cells /= self.h
        return cells

    def to_mm(self, points: np.ndarray) -> np.ndarray:
        """Grid coordinates [cells] as points [mm]."""
        return self.origin + self.h * np.asarray(points, float)

    @property
    def blocks(self) -> tuple[int, int, int]:
        """Number of 8x8x8 blocks (z, y, x)."""
        return self.dims[2] // 8, self.dims[1] // 8, self.dims[0] // 8


@dataclass(eq=False)
class Samples:
    """Signed distances around the surface, and the state of the cells that it touches.

    Attributes
    ----------
    cells : (n, 3) int32
        Cells that the surface touches.
    state : (n,) uint8
        0 outside, 1 inside, 2 cut.
    owners : (n, 8) int32
        For each cell, the slots in `distance` of the cells that own its 27 nodes.
    distance : (m, 8) real, device
        Signed distance [cells] at the nodes that each owner has.
    inside : (nz, ny, nx / 8) uint8
        Whether a cell's centre is inside, a bit each, that of the least x lowest.
    thickness : (k,) float64
        Below places of the surface, even by area [cells]; infinite where it is no less than one.
    """

    cells: np.ndarray
    state: np.ndarray
    owners: np.ndarray
    distance: Buffer
    inside: np.ndarray
    thickness: np.ndarray

    def use_up(self) -> None:
        """Let go of the distances: they take more than the cut cells that come of them."""
        self.owners, self.distance = self.owners[:0].copy(), self.distance.device.empty((0, 8))


@dataclass(frozen=True, eq=False)
class CutCells:
    """Moments of the cut cells, in unit cell coordinates (kernels/cutcell.cl), on the device unless said otherwise.

    Attributes
    ----------
    cell : (n,) int32
        Index of each in the finest level, ascending.
    centroid : (n, 4) real
        x_C and kappa.
    boundary : (n, 4) real
        x_B and alpha_B, the area of the surface inside the cell.
    normal : (n, 3) real
        Area vector of the surface (outward): alpha_B n_B where the surface is flat.
    aperture : Stowed (n, 3) real
        Open part of the faces +x +y +z; the others are those of the cells beyond (`Octree.apertures`).
        No solve needs it.
    face_centroid : (n, 3, 2) float64, or uint16 in single precision
        Centroid of the open part of each of these, in its two tangential coordinates (kernels/place.h).
    """

    cell: Buffer
    centroid: Buffer
    boundary: Buffer
    normal: Buffer
    aperture: Stowed
    face_centroid: Buffer

    @property
    def n(self) -> int:
        """How many cut cells there are."""
        return self.cell.shape[0]


def make_grid(bounds: np.ndarray, resolution: int) -> Grid:
    """The finest grid around a box, `resolution` cells along its longest side.

    It is shifted by part of a cell: faces of the object that are planes of the grid would sit on nodes.
    """
    low, high = np.asarray(bounds, float)
    h = float((high - low).max()) / resolution
    needed = np.ceil((high - low) / h).astype(int) + 2 * MARGIN + 1
    dims = -(-needed // 8) * 8
    shift = np.array([0.31, 0.37, 0.43])
    origin = (low + high) / 2 - h * (dims / 2 + (shift - 0.5) * (needed < dims))
    return Grid(origin, h, (int(dims[0]), int(dims[1]), int(dims[2])))


class _Bricks:
    """Cells of the finest grid near the surface, stored in bricks of 8x8x8."""

    def __init__(self, grid: Grid, mark: np.ndarray):
        self.grid = grid
        self.block = np.full(mark.size, -1, np.int32)
        self.used = np.flatnonzero(mark).astype(np.int32)
        self.block[self.used] = np.arange(len(self.used), dtype=np.int32)

    def entry(self, cells: np.ndarray) -> np.ndarray:
        _, by, bx = self.grid.blocks
        x, y, z = cells.T
        block = ((z >> 3) * by + (y >> 3)) * bx + (x >> 3)
        return self.block[block] * 512 + ((z & 7) * 8 + (y & 7)) * 8 + (x & 7)

    def cells(self, entry: np.ndarray) -> np.ndarray:
        _, by, bx = self.grid.blocks
        entry = entry.astype(np.int32)
        block, local = self.used[entry >> 9], entry & 511
        x, y, z = block % bx, (block // bx) % by, block // (bx * by)
        return np.stack([8 * x + (local & 7), 8 * y + ((local >> 3) & 7), 8 * z + (local >> 6)], axis=1)


def _starts(count: Buffer) -> np.ndarray:
    return np.concatenate([[0], np.cumsum(count.get().ravel(), dtype=np.int64)]).astype(np.int32)


def _lines(device: Device, grid: Grid, surface: Triangles) -> tuple[Buffer, Buffer]:
    """Signed crossings of triangles with the grid lines along x: first of each line, and (x, sign)."""
    ny, nz = 2 * grid.dims[1] + 1, 2 * grid.dims[2] + 1
    count = device.zeros(ny * nz, np.int32)
    surface.run(device.kernel("crossing", "count_crossings"), (ny, nz), (count,))
    start = _starts(count)
    cursor, crossing = device.array(start), device.empty((max(int(start[-1]), 1), 2))
    surface.run(device.kernel("crossing", "list_crossings"), (ny, nz), (cursor, crossing))
    return device.array(start), crossing


def _touch(device: Device, grid: Grid, surface: Triangles) -> tuple[_Bricks, Buffer, np.ndarray]:
    """Bricks near the triangles, their map on the device, and which of their cells triangles may meet."""
    mark = device.zeros(int(np.prod(grid.blocks)), np.uint8)
    surface.run(device.kernel("bin", "mark_blocks"), (grid.dims, 1.2), (mark,))
    bricks = _Bricks(grid, mark.get())
    block, touched = device.array(bricks.block), device.zeros(512 * len(bricks.used), np.uint8)
    surface.run(device.kernel("bin", "touch_cells"), (grid.dims, block), (touched,))
    return bricks, block, touched.get()


def _corners() -> np.ndarray:
    corner = np.arange(8, dtype=np.int32)
    return np.stack([corner & 1, (corner >> 1) & 1, corner >> 2], axis=1)


def sample_surface(device: Device, grid: Grid, mesh: Mesh) -> Samples:
    """Signed distances at the half-cell nodes around the surface, and which cells it cuts.

    Parameters
    ----------
    device : Device
    grid : Grid
    mesh : Mesh
        Its `triangles` bound the object. Where they are no closed cycle, the generalised winding number
        decides what is inside.

    Returns
    -------
    Samples
    """
    surface, pieces = whole_and_pieces(device, grid.to_cells(mesh.points), mesh.solid)
    bricks, block, touched = _touch(device, grid, pieces)
    cells = bricks.cells(np.flatnonzero(touched))
    needed, owners = np.zeros(len(touched), bool), np.empty((len(cells), 8), np.int32)
    for k, corner in enumerate(_corners()):
        owners[:, k] = bricks.entry(cells + corner)
        needed[owners[:, k]] = True
    owner_cells = bricks.cells(np.flatnonzero(needed))
    n = len(owner_cells)
    slot = np.where(needed, np.cumsum(needed, dtype=np.int32) - 1, np.int32(-1))
    for entries in owners.T:
        entries[:] = slot[entries]
    distance = device.empty((n, 8))
    distance.fill(REACH**2)
    kernel = device.kernel("distance", "distance_to_triangle")
    pieces.run(kernel, (grid.dims, REACH, block, device.array(slot)), (distance,))
    del slot
    lines = _lines(device, grid, surface) if mesh.closed else (None, None)
    packed = np.concatenate([owner_cells, np.zeros((n, 1), np.int32)], axis=1)
    kernel = device.kernel("distance", "distance_at_nodes")
    device.run(kernel, n, n, 2 * grid.dims[1] + 1, device.array(packed), *lines, distance)
    del packed
    if lines[0] is not None and lines[1] is not None:
        inside = _fill_rows(device, grid, *lines)
    else:
        triangles, nodes = grid.to_cells(mesh.triangles), owner_cells[:, None, :] + 0.5 * _corners()
        winding = winding_number(device, triangles, nodes.reshape(-1, 3)).reshape(n, 8)
        values = distance.get()
        distance.set(np.where(np.abs(winding) > 0.5, -values, values))
        inside = _fill_regions(device, grid, triangles, cells)
    state = device.empty(len(cells), np.uint8)
    kernel = device.kernel("distance", "classify")
    device.run(kernel, len(cells), len(cells), device.array(owners), distance, state)
    some = grid.to_cells(mesh.points[mesh.solid[:: -(-len(mesh.solid) // LOOKED_AT)]])
    thickness = thickness_below(device, grid.dims, block, len(touched), bricks.entry, some, pieces)
    return Samples(cells, state.get(), owners, distance, inside, thickness)


def _fill_rows(device: Device, grid: Grid, line_start: Buffer, crossing: Buffer) -> np.ndarray:
    """Which cell centres are inside, by crossings along x."""
    nx, ny, nz = grid.dims
    inside = device.empty((nz, ny, nx), np.int8)
    kernel = device.kernel("crossing", "interior")
    device.run(kernel, ny * nz, ny * nz, grid.dims, line_start, crossing, inside)
    return np.packbits(inside.get(), axis=2, bitorder="little")


def _fill_regions(device: Device, grid: Grid, triangles: np.ndarray, cells: np.ndarray) -> np.ndarray:
    """Which cells are inside, by the winding number of a few cells of each region the surface leaves whole."""
    from scipy import ndimage

    nx, ny, nz = grid.dims
    free = np.ones((nz, ny, nx), bool)
    free[cells[:, 2], cells[:, 1], cells[:, 0]] = False
    label, n_regions = ndimage.label(free)
    flat = label.ravel()
    where = np.flatnonzero(flat)
    order = where[np.argsort(flat[where], kind="stable")]
    first = np.concatenate([[0], np.cumsum(np.bincount(flat[where], minlength=n_regions + 1)[1:])])
    picks = np.linspace(first[:-1], first[1:] - 1, 9).round().astype(int)
    probe = order[picks]
    points = np.stack([probe % nx, (probe // nx) % ny, probe // (nx * ny)], axis=-1) + 0.5
    winding = winding_number(device, triangles, points.reshape(-1, 3)).reshape(probe.shape)
    is_inside = np.concatenate([[False], np.abs(np.median(winding, axis=0)) > 0.5])
    return np.packbits(is_inside[label], axis=2, bitorder="little")


def cut_moments(device: Device, samples: Samples, rows: np.ndarray, cell: np.ndarray) -> CutCells:
    """Moments of the cut cells `rows` of `samples`, which are cells `cell` of the finest level.

    Raises
    ------
    DeviceError
        The device cannot hold them.
    """
    n, place = len(rows), np.uint16 if device.precision == "single" else device.real
    centroid, boundary, normal, aperture = (device.empty((n, width)) for width in (4, 4, 3, 3))
    face_centroid = device.empty((n, 3, 2), place)
    owners = device.array(samples.owners[rows])
    kernel = device.kernel("cutcell", "moments")
    device.run(kernel, n, n, owners, samples.distance, centroid, boundary, normal, aperture, face_centroid)
    places = device.array(cell.astype(np.int32))
    return CutCells(places, centroid, boundary, normal, stow(aperture.get()), face_centroid)
