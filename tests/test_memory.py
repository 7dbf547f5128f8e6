"""Host memory of a bake, as numpy allocates it: bytes a cell, so that whole arrays are not copied again unnoticed."""

from __future__ import annotations

import tracemalloc

from shapes import torus

from clsss import DirectionalLight, material, simulate

MOST, MOST_KEPT, MOST_RELIT = 160, 75, 105  # bytes a cell


def test_host_memory_of_a_bake():
    """The highest while it is made, what it keeps, and what it and another under other lights keep."""
    mesh, marble = torus(), material("marble")
    simulate(mesh, marble, [DirectionalLight((0, 0, -1))], resolution=96)  # builds kernels, imports
    tracemalloc.start()
    result = simulate(mesh, marble, [DirectionalLight((0, 0, -1))], resolution=96)
    kept, peak = tracemalloc.get_traced_memory()
    relit = result.relight([DirectionalLight((0, 0, 1))])
    both, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    cells = relit.report["octree"]["cells"]
    assert peak <= MOST * cells
    assert kept <= MOST_KEPT * cells
    assert both <= MOST_RELIT * cells
