"""An octree over points, each node a range of the points in Morton order.

Input: places (s, 3). Output: nodes depth first, so that a kernel walks them without a stack.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clsss.morton import BITS, morton

LEAF = 8  # points
DEEPEST = BITS  # levels below the root


@dataclass(frozen=True, eq=False)
class PointTree:
    """Samples in Morton order and the octree over them, depth first.

    Attributes
    ----------
    order : (s,) int64
        The samples' order.
    start, end : (n,) int64
        Samples under each node.
    skip : (n,) int32
        The node that follows the subtree.
    leaf : (n,) bool
        Whether the node has no children.
    half_diagonal : (n,) float64
        Of the node's cube.
    """

    order: np.ndarray
    start: np.ndarray
    end: np.ndarray
    skip: np.ndarray
    leaf: np.ndarray
    half_diagonal: np.ndarray

    def sums(self, values: np.ndarray) -> np.ndarray:
        """Sum of the samples' values (s, ...) under each node, (n, ...)."""
        ends = np.stack([self.start, self.end], axis=1).ravel()
        padded = np.concatenate([values, np.zeros((1, *values.shape[1:]))])
        return np.add.reduceat(padded, ends, axis=0)[::2]


def build(places: np.ndarray) -> PointTree:
    """Octree over places (s, 3) with at most `LEAF` samples in a leaf, or as deep as `DEEPEST`."""
    low, width = places.min(axis=0), np.ptp(places, axis=0).max() * (1 + 1e-9) or 1.0
    cells = ((places - low) / width * 2**DEEPEST).astype(np.int64)
    code = morton(cells)
    order = np.argsort(code, kind="stable")
    code = code[order]
    starts, ends, depths = [np.array([0])], [np.array([len(code)])], [np.array([0])]
    for depth in range(1, DEEPEST + 1):
        begin = np.flatnonzero(np.diff(code >> 3 * (DEEPEST - depth), prepend=-1))
        stop = np.append(begin[1:], len(code))
        parent = np.searchsorted(starts[-1], begin, side="right") - 1
        inside = (parent >= 0) & (begin < ends[-1][parent]) & ((ends[-1] - starts[-1])[parent] > LEAF)
        if not inside.any():
            break
        starts.append(begin[inside])
        ends.append(stop[inside])
        depths.append(np.full(inside.sum(), depth))
    start, end, depth_of = (np.concatenate(v) for v in (starts, ends, depths))
    first = np.lexsort((depth_of, start))
    start, end, depth_of = start[first], end[first], depth_of[first]
    skip = np.searchsorted(start, end)
    leaf = skip == np.arange(len(start)) + 1
    return PointTree(order, start, end, skip.astype(np.int32), leaf, 3**0.5 / 2 * width / 2.0**depth_of)
