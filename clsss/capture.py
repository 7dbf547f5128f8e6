"""Launches of kernels that are enqueued again and again.

Setting a kernel's numbers costs the host far more than setting its buffers and enqueueing it: launches that differ in
buffers alone share a kernel that has its numbers.
"""

from __future__ import annotations

from typing import Any


class Prepared:
    """A kernel object of its own, with its numbers set.

    Parameters
    ----------
    kernel : cl.Kernel
    numbers : list of (int, scalar)
        Arguments of int, real or vector type, by their places.
    """

    def __init__(self, kernel: Any, numbers: list[tuple[int, Any]]):
        import pyopencl as cl

        self.kernel = cl.Kernel(kernel.program, kernel.function_name)
        for index, value in numbers:
            self.kernel.set_arg(index, value)


class Launch:
    """A launch to be repeated.

    Parameters
    ----------
    prepared : Prepared
    size, group : int
        Work-items, and how many of them to a group.
    buffers : list of (int, cl.Buffer or None)
        The other arguments, by their places.
    """

    def __init__(self, prepared: Prepared, size: int, group: int, buffers: list[tuple[int, Any]]):
        import pyopencl as cl

        self.prepared, self.kernel, self.buffers = prepared, prepared.kernel, buffers
        self.size, self.group, self.enqueue = (size,), (group,), cl.enqueue_nd_range_kernel

    def __call__(self, queue: Any) -> None:
        """Enqueue it."""
        for index, data in self.buffers:
            self.kernel.set_arg(index, data)
        self.enqueue(queue, self.kernel, self.size, self.group)
