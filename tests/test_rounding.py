"""Single precision: what rounding the solution leaves, and solves that are not kept from their tolerance by it."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from shapes import build_operator, build_tree, hollow_sphere, solid, sphere, sphere_triangles

from clsss import source
from clsss.fields import Field
from clsss.lights import DirectionalLight, Emission
from clsss.materials import Material, material
from clsss.mesh import load_mesh
from clsss.multigrid import Multigrid
from clsss.rounding import rounding_gain
from clsss.simulate import simulate

SUN = DirectionalLight((0.4, -0.6, -0.7))
CLEAR = Material(sigma_a=0.0, sigma_s=0.02, eta=1.3)  # 0.4 mean free paths across: phi far above its differences
THIN = Material(sigma_a=0.0, sigma_s=0.2, eta=1.3)


class TwoToOne:
    """D varies smoothly by two, and nothing absorbs."""

    g, eta, homogeneous = 0.0, 1.3, False

    def coefficients(self, points):
        sigma_s = 0.02 * 2 ** (0.5 * np.sin(0.3 * points @ [[1.0], [0.7], [-0.5]])) * np.ones(3)
        return 0 * sigma_s, sigma_s


def close_balls():
    """Two balls half a cell apart at 48 cells: plain cycles are slow, Anderson acceleration starts."""
    triangles = [sphere_triangles(5.0, 5, (side * (5.0 + 0.1), 0, 0)) for side in (-1, 1)]
    return solid(np.concatenate(triangles))


def problem(device, mesh, medium, lights, resolution, **options):
    """Multigrid, right-hand side, and a field to solve into."""
    mg = Multigrid(device, build_operator(device, build_tree(device, mesh, resolution, **options), medium))
    found = source.make_source(device, mg.op.octree, mg.op.medium, lights, 1.0)
    mg.residual.wall = found.wall
    return mg, found.b, Field(device, mg.op.octree)


def on_leaves(mg, fields):
    levels = mg.op.octree.levels
    return np.concatenate([x.get()[: level.n, :3][level.leaf] for level, x in zip(levels, fields, strict=True)])


@pytest.mark.parametrize("medium", [CLEAR, THIN, TwoToOne()], ids=["clear", "thin", "varying"])
@pytest.mark.parametrize("lights", [[SUN], [Emission(1.0)]], ids=["sun", "glow"])
def test_what_rounding_leaves_is_foretold(double, single, medium, lights):
    """The residual, in double precision, of the exact solution rounded to float32: within a factor of 1.5."""
    mg, b, phi = problem(double, sphere(), medium, lights, 40, refine=None)
    mg.solve(b, phi, 1e-10)
    size = np.sqrt(mg.inner_product(phi, phi))
    for x in phi:
        x.set(x.get().astype(np.float32))
    mg.residual(phi, b, mg.r)
    left = np.sqrt(mg.inner_product(mg.r, mg.r))
    foretold = size * rounding_gain(mg.op) * np.finfo(np.float32).eps / np.finfo(np.float64).eps
    np.testing.assert_allclose(np.log2(foretold / left), 0, atol=np.log2(1.5))
    if medium is CLEAR:
        assert left.max() > 1e-4 * np.sqrt(mg.inner_product(b, b)).min()


@pytest.mark.parametrize("medium", [CLEAR, TwoToOne()], ids=["clear", "varying"])
@pytest.mark.parametrize("make", [sphere, close_balls], ids=["sphere", "close-balls"])
@pytest.mark.parametrize("refine", [{}, {"refine": None}], ids=["octree", "uniform"])
def test_single_precision_reaches_any_tolerance_a_user_asks_for(double, single, medium, make, refine):
    """1e-4 to 1e-6 of |Q|, though the rounded solution's own residual is above; the solution is the right one.

    In every cell where both precisions solve for the same source. Sources differ where a ray runs along the edge
    between two cut cells and takes the transmittance of either, as it may from the centre of a coarse leaf, which is a
    corner of the finest grid: one leaf of the sphere, by .2 %.
    """
    mg, b, phi = problem(single, make(), medium, [SUN], 48, **refine)
    exact_mg, exact_b, exact_phi = problem(double, make(), medium, [SUN], 48, **refine)
    assert exact_mg.solve(exact_b, exact_phi, 1e-10).converged
    of_own_source = on_leaves(exact_mg, exact_phi)
    exact_b.whole.set(b.whole.get())
    assert mg.residual.wall is None
    assert exact_mg.solve(exact_b, exact_phi, 1e-10).converged
    exact = on_leaves(exact_mg, exact_phi)
    for tolerance in (1e-4, 1e-6):
        phi.whole.fill(0)
        done = mg.solve(b, phi, tolerance)
        assert done.converged
        assert done.residuals[-1].max() <= tolerance
    assert np.abs(on_leaves(mg, phi) - exact).max() <= 5e-6 * np.abs(exact).max()
    assert np.linalg.norm(on_leaves(mg, phi) - of_own_source) <= 2e-6 * np.linalg.norm(of_own_source)


def test_it_takes_no_more_cycles_than_double_precision(double, single):
    cycles = []
    for device in (double, single):
        mg, b, phi = problem(device, sphere(), CLEAR, [SUN], 48, refine=None)
        cycles.append(mg.solve(b, phi, 1e-6).cycles)
    assert cycles[0] == cycles[1]


def test_a_held_solution_needs_no_memory_of_the_device(single):
    """What is set aside lies in the host's memory, and comes back as it was."""
    mg, b, phi = problem(single, sphere(), CLEAR, [SUN], 48, refine=None)
    before, given = single.allocated, b.whole.get()
    peaks = []
    for tolerance in (1.0, 1e-4):
        single.peak = single.allocated
        mg.solve(b, phi, tolerance)
        peaks.append(single.peak)
    assert peaks[0] == peaks[1]
    assert single.allocated == before
    np.testing.assert_array_equal(b.whole.get(), given)


@pytest.mark.parametrize("adaptive", [True, False], ids=["octree", "uniform"])
def test_light_exchanged_across_a_cavity_is_held_too(adaptive):
    """Parts of the surface that light each other, in a clear medium: single and double precision agree."""
    mesh = hollow_sphere(10, 5)
    single, double = (
        simulate(mesh, CLEAR, [SUN], resolution=48, adaptive=adaptive, tolerance=1e-6, precision=precision)
        for precision in ("single", "double")
    )
    assert single.report["solve"]["converged"]
    assert single.report["solve"]["cycles"] <= double.report["solve"]["cycles"] + 1
    gap = np.abs(single.vertex_radiosity - double.vertex_radiosity).max()
    assert gap <= 2e-5 * double.vertex_radiosity.max()
    again = single.relight([DirectionalLight((0, 0, 1))])
    assert again.report["solve"]["converged"]


def closed_meshes(shared: Path) -> list[Path]:
    """The scans and solids of the reference data that the manifest says are watertight, up to 250,000 triangles."""
    listed = [m for m in json.loads((shared / "meshes" / "manifest.json").read_text())["meshes"] if m["set"] == "bench"]
    return [shared / "meshes" / m["name"] for m in listed if m["watertight"] and m["tris"] <= 250_000]


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::UserWarning")
@pytest.mark.parametrize(("precision", "tolerance"), [("single", 1e-4), ("double", 1e-10)])
@pytest.mark.parametrize("name", ["thin", "marble"])
@pytest.mark.parametrize("adaptive", [True, False], ids=["octree", "uniform"])
def test_every_scan_reaches_the_tolerance(shared, precision, tolerance, name, adaptive):
    """All closed scans at 128 cells, 4 mean free paths without absorption and marble, with the exchange."""
    medium = THIN if name == "thin" else material(name)
    short = {}
    for path in closed_meshes(shared):
        result = simulate(load_mesh(path, size=20.0), medium, [SUN], resolution=128, adaptive=adaptive,
                                tolerance=tolerance, precision=precision)  # fmt: skip
        solve = result.report["solve"]
        if not solve["converged"]:
            short[path.name] = (solve["cycles"], max(solve["residuals"][-1]))
    assert not short
