"""Light between parts of the surface within a solve: it costs few cycles and does not change what is solved."""

from __future__ import annotations

import numpy as np
import pytest
from shapes import box_triangles, build_operator, build_tree, flask, hollow_sphere, solid

from clsss.boundary import Boundary
from clsss.exchange import trace_exchange
from clsss.fields import Field
from clsss.interreflection import PatchCoupling, PatchMatrices
from clsss.lights import DirectionalLight
from clsss.materials import Material, material
from clsss.mesh import Mesh, load_mesh
from clsss.room import Room
from clsss.simulate import simulate

MARBLE = Material.from_reduced(sigma_a=(0.0021, 0.0041, 0.0071), sigma_s_prime=(2.19, 2.62, 3.0), eta=1.5)
DENSE = Material.from_reduced(sigma_a=(0.002, 0.004, 0.007), sigma_s_prime=20.0, eta=1.4)
LOSSLESS = Material(sigma_a=0.0, sigma_s=(1.0, 2.0, 3.0), eta=1.3)


def comb(fins: int = 10) -> Mesh:
    """Fins 1 thick and 1 apart on a plate, 8 high."""
    parts = [box_triangles((2 * fins - 1, 8, 1.5))]
    parts += [box_triangles((1, 8, 8), (2 * k - fins + 1, 0, 4)) for k in range(fins)]
    return solid(np.concatenate(parts))


@pytest.fixture(scope="module")
def hollow(double):
    """Operator, exchange and the cut cells' boundary of a hollow sphere."""
    tree = build_tree(double, hollow_sphere(10, 6), 40)
    op = build_operator(double, tree, LOSSLESS)
    return op, trace_exchange(tree, LOSSLESS.eta), Boundary(op)


@pytest.mark.parametrize("depth", [1, 2])
def test_levels_above_let_out_and_take_in_what_they_hold(hollow, depth):
    """Without absorption all that coarse cells hold leaves: their J.n is the diagonal's part, D times as scaled."""
    op, exchange, boundary = hollow
    seen, k = list(boundary.above(exchange.share, depth))[-1], len(op.absorb) - 1 - depth
    areas = seen.share.T @ ((exchange.share > 0) @ boundary.area)  # of each cell, by patches
    D = np.array(op.medium.D[-1].tolist())[:3]
    np.testing.assert_allclose(areas * seen.leaving, D * op.absorb[k].get()[seen.cell, :3], rtol=1e-9)
    taken = (boundary.area * boundary.per_area).sum(axis=0) / D
    np.testing.assert_allclose(seen.entering.sum(axis=0), taken, rtol=1e-9)


def test_means_of_levels_above_are_means(hollow):
    """Constant light stays what it is, from patches to cells and back."""
    _, exchange, boundary = hollow
    lit = np.asarray((exchange.share > 0) @ boundary.area)[:, 0] > 0
    for seen in boundary.above(exchange.share, 2):
        np.testing.assert_allclose(seen.blend @ np.ones(seen.blend.shape[1]), 1, rtol=1e-9)
        np.testing.assert_allclose((seen.share @ np.ones(seen.share.shape[1]))[lit], 1, rtol=1e-9)


def test_what_light_on_its_way_needs_is_lent_but_for_its_state(hollow):
    """Beside matrices: B and its change in full; conductances in 16 bits; nothing of the size of the cut cells."""
    op, exchange, boundary = hollow
    device = op.irregular.device
    e = Field(device, op.octree)
    room = Room(device, e.lent())
    before = device.allocated
    coupling = PatchCoupling(device, op, PatchMatrices(device, exchange))
    coupling.borrow(e, room)
    held, p = device.allocated - before, exchange.share.shape[0]
    above = list(boundary.above(exchange.share, 1))
    matrices = sum(4 * m.nnz + (4 + 8) * m.shape[0] + 8 for m in (exchange.blend, exchange.arriving, exchange.share))
    matrices += 2 * exchange.entering.nnz + 8 * p + sum(4 * m.nnz + 12 * m.shape[0] + 8 for m in (*above[0][3:],))
    state = 2 * 3 * 8 * p + 64
    conductances = 6 * p + (4 + 12) * len(above[0].cell)
    assert coupling.level == len(op.octree.levels) - 2
    assert held <= matrices + state + conductances


def lagging(self, solve, r, e):
    """A coupling that lets the light pass between cycles alone."""
    self._entered.fill(0)
    solve(None)


@pytest.mark.parametrize("resolution", [48, 96])
def test_light_that_passes_within_a_cycle_saves_cycles_and_changes_nothing(monkeypatch, resolution):
    """In a dense material nearly all that enters comes out again, many times over."""
    arguments = (flask(), DENSE, [DirectionalLight((0.3, -1, 0.2))])
    options = {"resolution": resolution, "precision": "double", "tolerance": 1e-8}
    result = simulate(*arguments, **options)
    monkeypatch.setattr(PatchCoupling, "respond", lagging)
    slow = simulate(*arguments, **options)
    np.testing.assert_allclose(result.vertex_radiosity, slow.vertex_radiosity, rtol=2e-6)
    assert result.report["solve"]["factor"] <= 0.16
    assert result.report["solve"]["cycles"] + 3 <= slow.report["solve"]["cycles"]


def test_thin_fins_that_face_each_other_take_few_cycles():
    result = simulate(comb(), MARBLE, [DirectionalLight((0.4, -0.6, -0.7))], resolution=64)
    assert result.report["solve"]["converged"]
    assert result.report["solve"]["factor"] <= 0.25


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::UserWarning")
@pytest.mark.parametrize(("resolution", "bar"), [(128, 0.25), (256, 0.35)])
@pytest.mark.parametrize(
    "name",
    ["spot_6k", "bunny_69k_holes", "dragon_201k_clean", "lucy_100k", "armadillo_86k", "comb_thin_fins"],
)
def test_scans_of_marble_converge_within_the_bar(shared, name, resolution, bar):
    """Mean reduction of a cycle to the default tolerance."""
    mesh = load_mesh(shared / "meshes" / f"{name}.ply", size=20.0)
    result = simulate(mesh, material("marble"), [DirectionalLight((0.4, -0.6, -0.7))], resolution=resolution)
    assert result.report["solve"]["converged"]
    assert result.report["solve"]["factor"] <= bar
