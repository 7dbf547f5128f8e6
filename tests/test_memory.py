"""Memory of a bake, bytes a cell: of the host, as numpy allocates it, and of the device."""

from __future__ import annotations

import tracemalloc
from functools import partial

import pytest
from shapes import box, flask, torus

from clsss import DirectionalLight, material, simulate, stowed

MOST, MOST_OF_RELIGHT = 120, 45  # bytes a cell
MOST_KEPT, MOST_RELIT = 12, 20  # likewise, the mesh and what its vertices are told among them


def test_host_memory_of_a_bake(monkeypatch):
    """The highest while it is made, what it keeps, and the same of it and another under other lights."""
    monkeypatch.setattr(stowed, "SMALL", 1 << 12)  # as on grids of millions of cells
    mesh, marble = torus(), material("marble")
    simulate(mesh, marble, [DirectionalLight((0, 0, -1))], resolution=96)  # builds kernels, imports
    tracemalloc.start()
    result = simulate(mesh, marble, [DirectionalLight((0, 0, -1))], resolution=96)
    kept, peak = tracemalloc.get_traced_memory()
    tracemalloc.reset_peak()
    relit = result.relight([DirectionalLight((0, 0, 1))])
    both, peak_of_relight = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    cells = relit.report["octree"]["cells"]
    assert peak <= MOST * cells
    assert kept <= MOST_KEPT * cells
    assert peak_of_relight <= MOST_OF_RELIGHT * cells
    assert both <= MOST_RELIT * cells


@pytest.mark.parametrize(("make", "most"), [(torus, 164), (partial(box, (20.0, 20.0, 1.5)), 146), (flask, 232)])
def test_device_memory_of_a_bake_and_a_relight(make, most):
    """Of an object that is full, of a plate, and of one whose walls face each other so that cycles are combined."""
    result = simulate(make(), material("marble"), [DirectionalLight((0, 0, -1))], resolution=96)
    relit = result.relight([DirectionalLight((0, 0, 1))])
    for each in (result, relit):
        assert each.report["memory_mb"]["device"] * 2**20 <= most * each.report["octree"]["cells"]
