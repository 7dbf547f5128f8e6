"""A complete binary tree of boxes over triangles, for rays on the device (kernels/bvh.h).

Input: triangles (m, 3, 3) [mm]. Output: boxes of the nodes and the triangles in the order of the leaves.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, eq=False)
class BoxTree:
    """Node 1 is the root, 2i and 2i + 1 are the children of i, the leaves hold `leaf_size` triangles each.

    Attributes
    ----------
    boxes : (2 n, 6) float32
        Lower and upper corner of each of the 2 n - 1 nodes, from row 1 on [mm].
    order : (n leaf_size,) int64
        Which triangle each place of the leaves holds; some appear twice so that all leaves are full.
    leaf_size : int
        Triangles per leaf, 2 to 4 (less for very few triangles).
    """

    boxes: np.ndarray
    order: np.ndarray
    leaf_size: int

    @property
    def n_leaves(self) -> int:
        """Number of leaves, a power of two; also the first leaf's node."""
        return len(self.boxes) // 2


def build(triangles: np.ndarray) -> BoxTree:
    """Halve the triangles along their longest extent, all nodes of one depth at a time."""
    m = len(triangles)
    depth = max(0, int(np.log2(max(m, 1) / 2)))
    leaf_size = -(-m // 2**depth)
    order = np.linspace(0, m - 1, leaf_size * 2**depth).round().astype(np.int64)
    centres = triangles.mean(axis=1)
    for level in range(depth):
        order = order.reshape(2**level, -1)
        inside = centres[order]
        axis = np.argmax(np.ptp(inside, axis=1), axis=1)
        along = np.take_along_axis(inside, axis[:, None, None], axis=2)[..., 0]
        order = np.take_along_axis(order, np.argsort(along, axis=1, kind="stable"), axis=1)
    order = order.ravel()
    corners = triangles[order].astype(np.float32).reshape(2**depth, -1, 3)
    boxes = np.zeros((2 ** (depth + 1), 6), np.float32)
    boxes[2**depth :] = np.concatenate([corners.min(axis=1), corners.max(axis=1)], axis=1)
    for level in range(depth - 1, -1, -1):
        pairs = boxes[2 ** (level + 1) : 2 ** (level + 2)].reshape(-1, 2, 6)
        boxes[2**level : 2 ** (level + 1), :3] = pairs[..., :3].min(axis=1)
        boxes[2**level : 2 ** (level + 1), 3:] = pairs[..., 3:].max(axis=1)
    return BoxTree(boxes, order, leaf_size)
