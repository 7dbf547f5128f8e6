"""Emission as the leaves take it: integrals over their parts inside the object, with the first moment.

    Q_i = V_i mean(q0);     where q0 changes within full cells,     Q_i = int q0(x) w_i(x) dx

w_i are weights that sum to one and have x as their mean, so that light starts where it does and not at centroids.
Input: an octree and a density of emission; output: what the cells of every level emit per volume.

References
----------
docs/numerics.md, "Emission".
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from clsss.diffusion import cell_points
from clsss.level import Level
from clsss.octree import Octree

WIDTH = 0.1  # variance of the weights [widths squared], with which two-point fluxes give what emits its right fluence
BEND = 0.08  # of the greatest of three values in a row, from which on they lie on no straight line
FAINT = 1e-3  # emission under this part of the level's strongest may bend as it likes
FEWEST, MOST = 3, 16  # parts of a cell along each axis
PER_LEAF = 4  # parts looked at in all, over the leaves of the octree, unless that were too few or too many
AT_ONCE = 2**17  # places that the density is asked for in one call

Density = Callable[[np.ndarray], np.ndarray]


def cell_emission(octree: Octree, density: Density) -> list[np.ndarray]:
    """Power per volume that each leaf receives, for each level; 0 on covered cells.

    Parameters
    ----------
    octree : Octree
    density : callable
        Power per volume (n, 3) [W/mm^3] at points (n, 3) [mm]; it is asked for nothing outside the object.

    Returns
    -------
    list of (n, 3) float64
        Times the cells' volumes, what they receive [W/mm^3].
    """
    emitted = []
    for level, ijk, points in zip(octree.levels, octree.positions(), cell_points(octree), strict=True):
        leaf, values = np.flatnonzero(level.leaf), np.zeros((level.n, 3))
        values[leaf] = density(points[leaf])
        jumps = _jumps(level, points, values, density)
        if len(jumps):
            _integrate(octree, level, ijk, _with_neighbours(level, jumps), values, density)
        emitted.append(values)
    return emitted


def _jumps(level: Level, points: np.ndarray, values: np.ndarray, density: Density) -> np.ndarray:
    """Leaves (m,) between which emission is no straight line, nor half way, and those about them in which it bends."""
    nbr, leaf, links, peak = level.nbr.get(), level.leaf, [], 0.0
    for axis in range(3):
        low, high = np.arange(level.n), nbr[:, 2 * axis + 1]
        there = (high < level.n) & (high != low) & leaf
        low, high = low[there], high[there]
        low, high = low[leaf[high]], high[leaf[high]]
        middle = density((points[low] + points[high]) / 2)
        most = np.maximum(np.maximum(values[low], values[high]), middle)
        bent = (_bend(values[low], middle, values[high]) > BEND * most).any(axis=1)
        peak = max(peak, most.max(initial=0))
        links.append((low[bent], high[bent], middle[bent], most[bent].max(axis=1)))
    low, high, middle, most = (np.concatenate(parts) for parts in zip(*links, strict=True))
    bright = most > FAINT * peak
    low, high, middle = low[bright], high[bright], middle[bright]
    whole, halves = _bend(values[low], middle, values[high]), np.zeros_like(middle)
    for cells in (low, high):
        other = low + high - cells
        quarter = density((3 * points[cells] + points[other]) / 4)
        halves = np.maximum(halves, _bend(values[cells], quarter, middle))
    sharp = (halves > 0.4 * whole).any(axis=1)  # a quarter where the emission is smooth, at least half at a jump
    found, more = np.unique(np.concatenate([low[sharp], high[sharp]])), 1
    bends = np.unique(np.concatenate([low, high]))
    while more:  # all of what bends about them: sums of means and of values at centroids do not go together
        grown = np.union1d(found, np.intersect1d(_with_neighbours(level, found), bends))
        found, more = grown, len(grown) - len(found)
    return found


def _bend(first: np.ndarray, middle: np.ndarray, last: np.ndarray) -> np.ndarray:
    return abs((first + last) / 2 - middle)


def _with_neighbours(level: Level, cells: np.ndarray) -> np.ndarray:
    """Leaves (m,) and those around them, diagonals included, ascending."""
    nbr, leaf = level.nbr.get(), level.leaf
    for axis in range(3):
        beyond = nbr[cells, 2 * axis : 2 * axis + 2].ravel()
        beyond = beyond[beyond < level.n]
        cells = np.unique(np.concatenate([cells, beyond[leaf[beyond]]]))
    return cells


def _integrate(octree: Octree, level: Level, ijk: np.ndarray, near: np.ndarray, values: np.ndarray,
               density: Density) -> None:  # fmt: skip
    """Replace `values` of the cells `near` a change of the emission, and of those around, by integrals."""
    n = int(np.clip(np.cbrt(PER_LEAF * octree.n_leaves / len(near)), FEWEST, MOST))
    at = (np.arange(n) + 0.5) / n - 0.5
    weight = np.stack([(WIDTH + at**2 - at) / 2, 1 - WIDTH - at**2, (WIDTH + at**2 + at) / 2]) / n
    parts = np.stack(np.meshgrid(at, at, at, indexing="ij"), axis=-1) + 0.5
    cut_index = octree.cut_index.get() if level is octree.finest else np.full(level.n, -1)
    around = _with_neighbours(level, near)
    full, around = near[cut_index[near] < 0], around[cut_index[around] < 0]
    even = weight.sum(axis=1)
    given = values[around, None, None, None] * np.einsum("i,j,k->ijk", even, even, even)[..., None]
    row, per_call = np.searchsorted(around, full), max(1, AT_ONCE // n**3)
    for start in range(0, len(full), per_call):
        some = slice(start, start + per_call)
        points = octree.grid.to_mm((ijk[full[some], None, None, None] + parts) * 2**level.depth)
        found = density(points.reshape(-1, 3)).reshape(points.shape)
        for _ in range(3):  # the axis that is done goes to the end
            found = np.einsum("mxyzc,sx->myzsc", found, weight)
        given[row[some]] = found
    _average(octree, ijk, near[cut_index[near] >= 0], cut_index, parts.reshape(-1, 3), values, density)
    if len(around):
        values[around] = _gathered(ijk[around], given)


def _gathered(ijk: np.ndarray, given: np.ndarray) -> np.ndarray:
    """What cells at (m, 3) get from one another (m, 3) of what each gives to the 27 places around it (m, 3, 3, 3, 3).

    It keeps what would go to none of them: then nothing comes from there either, and what is even stays so.
    """
    size = ijk.max(axis=0) + 3
    own = np.arange(len(ijk))
    code = np.ravel_multi_index((ijk + 1).T, size)
    order = np.argsort(code)
    out = np.zeros((len(ijk), 3))
    for place in np.ndindex(3, 3, 3):
        there = np.ravel_multi_index((ijk + place).T, size)
        found = order[np.minimum(np.searchsorted(code, there, sorter=order), len(order) - 1)]
        np.add.at(out, np.where(code[found] == there, found, own), given[:, place[0], place[1], place[2]])
    return out


def _average(octree: Octree, ijk: np.ndarray, cells: np.ndarray, cut_index: np.ndarray, parts: np.ndarray,
             values: np.ndarray, density: Density) -> None:  # fmt: skip
    """Replace `values` of cut cells by means over the parts on the inner side of their boundary, if there are any."""
    x_B, normal = (part.get()[:, :3].astype(float) for part in (octree.cut.boundary, octree.cut.normal))
    per_call = max(1, AT_ONCE // len(parts))
    for start in range(0, len(cells), per_call):
        some = cells[start : start + per_call]
        m = cut_index[some]
        cell, part = np.nonzero(np.einsum("mpa,ma->mp", parts - x_B[m, None], normal[m]) < 0)
        found = density(octree.grid.to_mm(ijk[some[cell]] + parts[part]))
        sums = np.stack([np.bincount(cell, channel, len(some)) for channel in found.T], axis=1)
        count = np.bincount(cell, minlength=len(some))[:, None]
        values[some] = np.where(count, sums / np.maximum(count, 1), values[some])
