"""Multigrid: transfers, smoother, rates that do not depend on h, and what a solve tells of itself."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest
from scipy import sparse
from shapes import (
    box,
    build_operator,
    build_tree,
    conductances,
    is_split,
    links,
    pulley,
    solve,
    sphere,
    stack,
    torus,
    two_spheres,
)

from clsss import source
from clsss.device import Device
from clsss.fields import Field, Load
from clsss.fused import FusedLevels
from clsss.lights import DirectionalLight, Emission
from clsss.materials import Material
from clsss.multigrid import COARSE_SWEEPS, OVER, Multigrid
from clsss.residual import Residual

MATERIAL = Material(sigma_a=(0.001, 0.01, 0.1), sigma_s=1.0, eta=1.3)
LOSSLESS = Material(sigma_a=0.0, sigma_s=0.1)
SHAPES = {"sphere": sphere, "torus": torus}


def multigrid_for(device, mesh, medium, resolution, **options):
    return Multigrid(device, build_operator(device, build_tree(device, mesh, resolution, **options), medium))


def random_field(mg, rng, kind=Field):
    """A random field on the leaves, zero on covered cells and ghosts."""
    out = kind(mg.device, mg.op.octree)
    for level, x in zip(mg.op.octree.levels, out, strict=True):
        values = np.zeros(x.shape)
        values[: level.n][level.leaf] = rng.normal(size=(int(level.leaf.sum()), x.shape[1]))
        x.set(values)
    return out


@pytest.fixture(scope="module")
def small(double):
    """A sphere on three levels with leaves on two of them or more."""
    return multigrid_for(double, sphere(), MATERIAL, 40)


def two_point_rows(mg, k):
    """Transmissibilities between the cells of level `k` and its cells and ghosts, one channel."""
    level = mg.op.octree.levels[k]
    n, nbr, T = level.n, level.nbr.get(), mg.op.T[k].get().reshape(level.n, 6)
    cell, _, beyond, _ = links(level)
    i, face = np.nonzero((nbr >= n) & (nbr < n + level.n_ghost))
    values = np.append(conductances(mg.op, k)[:, 0], T[i, face])
    where = np.append(cell, i), np.append(beyond, nbr[i, face])
    return sparse.csr_matrix((values, where), shape=(n, n + level.n_ghost))


@pytest.mark.parametrize("make", [sphere, pulley, stack])
def test_restriction_keeps_totals(double, make):
    """What the fine cells have left after a sweep is what the coarse ones get, to the last watt."""
    mg = multigrid_for(double, make(), MATERIAL, 40)
    rng, levels = np.random.default_rng(1), mg.op.octree.levels
    for k in range(len(levels) - 1, 0, -1):
        fine, coarse, T = levels[k], levels[k - 1], two_point_rows(mg, k)
        b = rng.normal(size=mg.r[k].shape)
        mg.r[k].set(b)
        mg.e[k].fill(0)
        mg.r[k - 1].fill(0)
        mg.smooth(k, from_zero=True)
        x, absorb = mg.e[k].get()[:, :3], mg.op.absorb[k].get()[:, :3]
        mg.restrict(k)
        left = b - (absorb + np.asarray(T.sum(axis=1))) * x[: fine.n] + T @ x[: T.shape[1]]
        expected = np.zeros((coarse.n, 3))
        np.add.at(expected, fine.parent.get()[: fine.n], left)
        np.testing.assert_allclose(mg.r[k - 1].get(), expected, atol=1e-13)


def test_gradients_lie_where_the_correction_will(device):
    """Not on the coarsest level, and they leave nothing in rows that no cell has."""
    mg = multigrid_for(device, sphere(), MATERIAL, 24)
    rng = np.random.default_rng(7)
    phi, b, r = random_field(mg, rng), random_field(mg, rng, Load), Load(device, mg.op.octree)
    apart = Residual(device, mg.op)
    apart(phi, b, r)
    expected = r.whole.get()
    mg.residual(phi, b, mg.r)
    np.testing.assert_array_equal(mg.r.whole.get(), expected)
    np.testing.assert_array_equal(mg.residual.slope.get(), apart.slope.get())
    mg.v_cycle(len(mg.e) - 1)
    found, n = mg.e.whole.get(), [level.n_rows for level in mg.op.octree.levels]
    mg.residual.slope.fill(1e9)
    mg.r.whole.set(expected)
    assert mg.e[0].get().max() < 1e9
    mg.v_cycle(len(mg.e) - 1)
    np.testing.assert_array_equal(mg.e.whole.get(), found)
    for first, last in zip(np.add(mg.e.start[:-1], n), mg.e.start[1:], strict=True):
        assert not found[first:last].any()
    assert apart.slope.data is not mg.e[0].data
    corrections = []
    for stale in (0.0, 1e6):
        mg.e[-1].fill(stale)
        mg.r.whole.set(expected)
        mg.v_cycle(len(mg.e) - 1)
        corrections.append(mg.e.whole.get())
    np.testing.assert_array_equal(*corrections)


def prolonged(mg, k, values):
    """A coarse field (n, 4) on level k - 1, carried to the black cells of level k."""
    fine = mg.op.octree.levels[k]
    _, black, end = fine.colour_start
    coarse = np.zeros(mg.e[k - 1].shape)
    coarse[: len(values)] = values
    mg.e[k - 1].set(coarse)
    mg.e[k].fill(0)
    mg.device.run(mg._prolong, end - black, black, end - black, fine.nbr, fine.parent, mg.op.weight[k], mg.e[k - 1],
                  mg.e[k])  # fmt: skip
    return mg.e[k].get()[black:end]


@pytest.mark.parametrize("make", [sphere, pulley])
def test_prolongation_weights_are_of_resistances(double, make):
    """w = r / (r + R): r halfway to the sibling, R to the middle of the coarse cell beyond, as if where faces miss."""
    mg = multigrid_for(double, make(), Lumps(), 24)
    positions = mg.op.octree.positions()
    for k, level in enumerate(mg.op.octree.levels[1:], 1):
        n, nbr, up = level.n, level.nbr.get(), positions[k] & 1
        T = mg.op.T[k].get().reshape(n, 6, -1)[..., :3].mean(axis=2)
        expected = np.zeros((n, 3))
        for d in range(3):
            face = 2 * d + up[:, d]
            cell = np.flatnonzero(T[np.arange(n), face] > 0)
            face = face[cell]
            out, sibling, beyond = T[cell, face], T[cell, face ^ 1], nbr[cell, face]
            here = beyond < n
            further = np.where(here, T[np.where(here, beyond, 0), face], 0)
            inner = 1 / (2 * np.where(sibling > 0, sibling, out))
            outer = 1 / out + here / (2 * np.where(further > 0, further, out))
            expected[cell, d] = inner / (inner + outer)
        expected /= np.maximum(1, expected.sum(axis=1, keepdims=True))
        weight, black = mg.op.weight[k].get(), level.colour_start[1]
        np.testing.assert_allclose(weight[:, :3], 252 * expected[black:], atol=1)  # rounded
        assert (weight[:, :3].sum(axis=1, dtype=int) <= 252).all()
        np.testing.assert_array_equal(weight[:, 3], up[black:] @ [1, 2, 4])


def test_prolongation_keeps_constants(small):
    for k in range(1, len(small.e)):
        np.testing.assert_allclose(prolonged(small, k, np.ones((small.op.octree.levels[k - 1].n, 4))), 1, rtol=1e-13)


def test_prolongation_keeps_linear_fields_inside(double):
    """Where a cell's neighbours and theirs are full, the weights are those of linear interpolation."""
    small = multigrid_for(double, sphere(), MATERIAL, 40, refine=None)
    tree = small.op.octree
    (coarse, fine), level = tree.positions()[-2:], tree.finest
    slope = np.array([1.0, -2.0, 0.5])
    values = np.repeat(((coarse + 0.5) * 2 @ slope)[:, None], 4, axis=1)
    black = level.colour_start[1]
    error = prolonged(small, len(tree.levels) - 1, values)[:, 0] - (fine[black:] + 0.5) @ slope
    nbr, near = level.nbr.get(), np.zeros(level.n + level.n_ghost, bool)
    near[level.n :] = near[tree.cut.cell.get()] = True
    for _ in range(4):
        near[: level.n] |= near[nbr].any(axis=1)
    assert (~near[black : level.n]).sum() > 20
    np.testing.assert_allclose(error[~near[black : level.n]], 0, atol=1e-12)


@pytest.mark.parametrize(("make", "depth"), [(partial(sphere, subdivisions=3), 0), (pulley, 1), (pulley, 2)])
def test_smoother_is_red_black_gauss_seidel(device, eps, make, depth):
    """Cell after cell in numpy, red then black, the black ones over-relaxed: the same numbers."""
    mg = multigrid_for(device, make(), MATERIAL, 14 if depth == 0 else 48)
    k = len(mg.e) - 1 - depth
    level, rng = mg.op.octree.levels[k], np.random.default_rng(2)
    x, b = (rng.normal(size=field[k].shape).astype(device.real) for field in (mg.e, mg.r))
    mg.e[k].set(x)
    mg.r[k].set(b)
    mg.smooth(k, 2)
    T = two_point_rows(mg, k)
    x, b = x[: T.shape[1], 0].astype(float), b[:, 0].astype(float)
    diagonal = mg.op.absorb[k].get()[:, 0] + np.asarray(T.sum(axis=1)).ravel()
    for _ in range(2):
        for i in range(level.n):
            row = T.getrow(i)
            omega = OVER if i >= level.colour_start[1] else 1
            x[i] += omega * ((b[i] + row.data @ x[row.indices]) / diagonal[i] - x[i])
    np.testing.assert_allclose(mg.e[k].get()[: len(x), 0], x, atol=50 * eps * np.abs(x).max())


def two_point_matrix(mg):
    """The two-point part on all leaves: faces between levels belong to their fine side."""
    levels = mg.op.octree.levels
    first = np.cumsum([0] + [int(level.leaf.sum()) for level in levels])
    number = [np.where(level.leaf, first[k] + np.cumsum(level.leaf) - 1, -1) for k, level in enumerate(levels)]
    A = sparse.coo_matrix((first[-1], first[-1]))
    for k, level in enumerate(levels):
        nbr, T = level.nbr.get(), mg.op.T[k].get().reshape(level.n, 6)
        beyond = number[k]
        if level.parent is not None:
            beyond = np.concatenate([beyond, number[k - 1][level.parent.get()[level.n :]]])
        else:
            beyond = np.concatenate([beyond, np.full(level.junction_face.shape[0], -1)])
        own, other = np.repeat(number[k], 6), beyond[nbr].ravel()
        keep = (own >= 0) & (other >= 0) & (own != other)
        i, j, t = own[keep], other[keep], T.ravel()[keep]
        ghost = (nbr.ravel() >= level.n)[keep]
        i, j, t = np.append(i, j[ghost]), np.append(j, i[ghost]), np.append(t, t[ghost])
        A = A + sparse.coo_matrix((np.concatenate([-t, t]), (np.tile(i, 2), np.append(j, i))), shape=A.shape)
        leaves = number[k][level.leaf]
        absorb = mg.op.absorb[k].get()[level.leaf, 0]
        A = A + sparse.coo_matrix((absorb, (leaves, leaves)), shape=A.shape)
    return A.tocsr()


def on_leaves(mg, fields):
    levels = mg.op.octree.levels
    return np.concatenate([x.get()[: level.n, :3][level.leaf] for level, x in zip(levels, fields, strict=True)])


def set_leaves(mg, fields, values):
    end = np.cumsum([int(level.leaf.sum()) for level in mg.op.octree.levels])
    for level, x, part in zip(mg.op.octree.levels, fields, np.split(values, end[:-1]), strict=True):
        full = np.zeros(x.shape)
        full[: level.n][level.leaf] = part
        x.set(full)


def test_two_point_matrix_is_symmetric(small):
    A = two_point_matrix(small)
    assert abs(A - A.T).max() <= 1e-13 * abs(A).max()


def asymptotic(norms):
    """Mean reduction over the last five cycles."""
    return (norms[-1] / norms[-6]) ** (1 / 5)


def two_point_factor(mg, cycles=12):
    """Reduction of the residual by V(2,2) of the two-point part alone, from a random start."""
    A = two_point_matrix(mg)
    error = np.repeat(np.random.default_rng(3).normal(size=A.shape[0])[:, None], 3, axis=1)
    norms = []
    for _ in range(cycles):
        residual = -(A @ error)
        norms.append(np.linalg.norm(residual[:, 0]))
        set_leaves(mg, mg.r, residual)
        mg.v_cycle(len(mg.e) - 1)
        error += on_leaves(mg, mg.e)
    return asymptotic(norms)


def defect_factor(mg, cycles=12):
    """Reduction by defect correction: residuals of the second-order operator, V(2,2) of its two-point part."""
    phi, zero = random_field(mg, np.random.default_rng(4)), Load(mg.device, mg.op.octree)
    norms = []
    for _ in range(cycles):
        mg.residual(phi, zero, mg.r)
        norms.append(np.sqrt(mg.inner_product(mg.r, mg.r)))
        mg.v_cycle(len(mg.e) - 1)
        mg.combine(1, mg.e, 1, phi)
    return asymptotic(np.array(norms)).max()


RESOLUTIONS = [32, 64, pytest.param(128, marks=pytest.mark.slow)]
# sigma_tr h at 64 cells along 20 mm: 0.31 sigma_tr
ABSORBING = Material(sigma_a=0.0016, sigma_s=1.6, eta=1.1263)
CASES = pytest.mark.parametrize("medium", [ABSORBING, LOSSLESS], ids=["absorbing", "lossless"])
EVERY_SHAPE = pytest.mark.parametrize("shape", SHAPES)


@pytest.fixture(scope="module")
def factors(double):
    """Reduction factors, computed once for each case."""
    known = {}

    def find(which, shape, resolution, medium, **options):
        key = (which, shape, resolution, medium, *options.items())
        if key not in known:
            known[key] = which(multigrid_for(double, SHAPES[shape](), medium, resolution, **options))
        return known[key]

    return find


@pytest.mark.parametrize("resolution", RESOLUTIONS)
@CASES
@EVERY_SHAPE
def test_v_cycle_factor_on_a_uniform_grid(factors, shape, resolution, medium):
    assert factors(two_point_factor, shape, resolution, medium, refine=None) <= 0.12


@pytest.mark.parametrize("resolution", RESOLUTIONS)
@CASES
@EVERY_SHAPE
def test_v_cycle_factor_on_an_octree(factors, shape, resolution, medium):
    """Coarser leaves hold still while finer levels are smoothed, which costs a little."""
    assert factors(two_point_factor, shape, resolution, medium) <= 0.15


@pytest.mark.parametrize("resolution", RESOLUTIONS)
@CASES
@EVERY_SHAPE
def test_defect_correction_factor(factors, shape, resolution, medium):
    assert factors(defect_factor, shape, resolution, medium) <= 0.18


@pytest.mark.parametrize("depth", [1.0, 5.0])
@pytest.mark.parametrize("options", [{"refine": None}, {}], ids=["uniform", "octree"])
@pytest.mark.parametrize("resolution", RESOLUTIONS)
@EVERY_SHAPE
def test_factor_where_fluence_vanishes_at_the_boundary(factors, shape, resolution, options, depth):
    """sigma_tr h = `depth`: coarse levels must not move the boundary, or the smoothest correction is the slowest."""
    medium = Material(sigma_a=0.0, sigma_s=depth * resolution / 20)
    assert factors(two_point_factor, shape, resolution, medium, **options) <= 0.12
    assert factors(defect_factor, shape, resolution, medium, **options) <= (0.18 if resolution < 128 else 0.25)


class TenToOne:
    """D varies smoothly by ten."""

    g, eta, homogeneous = 0.0, 1.3, False

    def coefficients(self, points):
        sigma_s = 10 ** (0.5 * np.sin(0.3 * points @ [[1.0], [0.7], [-0.5]])) * np.ones(3)
        return 0.001 * sigma_s, sigma_s


@pytest.mark.parametrize("resolution", [32, 64])
@EVERY_SHAPE
def test_defect_correction_factor_where_D_varies_by_ten(double, shape, resolution):
    mg = multigrid_for(double, SHAPES[shape](), TenToOne(), resolution, refine=None)
    assert defect_factor(mg) <= 0.28


def test_bodies_that_nearly_touch_do_not_share_coarse_cells(double):
    """Where they do, the plates take .75 and the spheres .5 a cycle."""
    plates = multigrid_for(double, stack(), LOSSLESS, 64)
    assert two_point_factor(plates) <= 0.12
    assert defect_factor(plates) <= 0.2
    assert defect_factor(multigrid_for(double, two_spheres(gap=0.3), LOSSLESS, 64)) <= 0.4


@pytest.mark.parametrize("medium", [LOSSLESS, TenToOne()])
def test_parts_of_one_body_that_nearly_touch_converge(double, medium):
    assert defect_factor(multigrid_for(double, pulley(), medium, 64)) <= 0.28


def test_coarsest_level_is_solved_exactly(double):
    """Also where its blocks are split."""
    mg = multigrid_for(double, pulley(gap=2.0), MATERIAL, 12)
    T = two_point_rows(mg, 0)
    assert is_split(mg.op.octree.coarsest)
    b = np.random.default_rng(5).normal(size=mg.r[0].shape)
    mg.r[0].set(b)
    mg.v_cycle(0)
    x, absorb = mg.e[0].get()[: len(b), :3], mg.op.absorb[0].get()[:, :3]
    np.testing.assert_allclose((absorb + np.asarray(T.sum(axis=1))) * x - T @ x, b, atol=1e-11)


@pytest.mark.parametrize("shape", SHAPES)
def test_factor_does_not_depend_on_h(factors, shape):
    found = [factors(two_point_factor, shape, n, ABSORBING, refine=None) for n in (32, 64)]
    assert found[1] - found[0] < 0.02


def prepared(device, medium=MATERIAL, resolution=32):
    """A problem, its right-hand side and a field to solve into."""
    mg = multigrid_for(device, sphere(), medium, resolution)
    lights = [DirectionalLight((0.2, -1, 0.3)), Emission((1e-3, 0.0, 1e-3))]
    b = source.make_source(device, mg.op.octree, mg.op.medium, lights, 1.0).b
    return mg, b, Field(device, mg.op.octree)


def test_solve_reaches_its_tolerance(device, eps):
    """1e-10 in double, 1e-4 in single; the residual told is the residual left."""
    tolerance = 1e-10 if eps < 1e-10 else 1e-4
    mg, b, phi = prepared(device)
    done = mg.solve(b, phi, tolerance)
    assert done.converged
    assert done.tolerance == tolerance
    np.testing.assert_allclose(done.residuals[0], 1, rtol=1e-5)
    assert done.cycles == len(done.residuals) - 1
    assert done.residuals[-1].max() <= tolerance < done.residuals[-2].max()
    r = Load(device, mg.op.octree)
    mg.residual(phi, b, r)
    left = np.sqrt(mg.inner_product(r, r) / mg.inner_product(b, b))
    np.testing.assert_allclose(left, done.residuals[-1], rtol=1e-3)
    assert done.factor <= 0.2


def test_solve_says_when_it_does_not_converge(double):
    mg, b, phi = prepared(double)
    done = mg.solve(b, phi, 1e-10, max_cycles=2)
    assert not done.converged
    assert done.cycles == 2
    assert 1e-10 < done.residuals[-1].max() < 1


def test_impossible_tolerance_ends(single):
    """Single precision cannot reach 1e-12: told, not raised, and without the full number of cycles wasted."""
    mg, b, phi = prepared(single)
    done = mg.solve(b, phi, 1e-12)
    assert not done.converged
    assert done.residuals[-1].max() <= 1e-5


def test_no_source_is_solved_by_nothing(device):
    mg, b, phi = prepared(device)
    b.whole.fill(0)
    done = mg.solve(b, phi, 1e-6)
    assert (done.converged, done.cycles, done.factor) == (True, 0, 0.0)
    assert not phi.whole.get().any()


def test_dark_channel_does_not_hold_up_the_others(double):
    found = solve(double, sphere(), MATERIAL, [Emission((1.0, 0.0, 0.0))], 24, 1e-8)
    assert found.convergence.converged
    assert not found.phi_B[:, 1:].any()


def test_same_bits_twice(device):
    found = []
    for _ in range(2):
        mg, b, phi = prepared(device, resolution=24)
        mg.solve(b, phi, 1e-4)
        found.append(np.concatenate([x.get().ravel() for x in phi]))
    np.testing.assert_array_equal(*found)


def test_a_solve_from_zero_need_not_look_at_it(device):
    found = []
    for from_zero in (False, True):
        mg, b, phi = prepared(device, resolution=24)
        mg.e.whole.fill(7)  # gradients lie there
        done = mg.solve(b, phi, 1e-4, from_zero=from_zero)
        found.append(np.concatenate([*(x.get().ravel() for x in phi), *done.residuals]))
    np.testing.assert_array_equal(*found)


def test_same_bits_as_gpus_load_them(single):
    """Three loads or one of four for three numbers; nothing of the next cell's gets into the spare channel."""
    gpu = Device(precision="single")
    gpu.lanes = 1
    mg, b, phi = prepared(single, resolution=24)
    other, right, found = prepared(gpu, resolution=24)
    right.whole.set(b.whole.get())
    mg.solve(b, phi, 1e-4)
    other.solve(right, found, 1e-4)
    values = phi.whole.get()
    np.testing.assert_array_equal(found.whole.get(), values)
    np.testing.assert_array_equal(values[:, 3], values[:, 2])


def test_progress_grows_to_one(device):
    mg, b, phi = prepared(device, resolution=24)
    told = []
    mg.solve(b, phi, 1e-4, progress=told.append)
    assert told == sorted(told)
    assert f"{told[0]:.0f}" == "0"
    assert told[-1] <= 1


def test_starting_from_the_solution_takes_no_cycle(double):
    mg, b, phi = prepared(double)
    mg.solve(b, phi, 1e-8)
    assert mg.solve(b, phi, 1e-7).cycles == 0


@pytest.mark.parametrize("thickness", [1.5, 3.0])
def test_thin_plates_converge(double, thickness):
    """A plate of a few cells has no interior to speak of on coarser levels."""
    h = 20 / 48
    found = solve(double, box((20, 20, thickness * h)), ABSORBING, [Emission(1.0)], 48, 1e-8)
    assert found.convergence.converged
    assert found.convergence.factor <= 0.25


class Lumps:
    """One half is a hundred times as dense as the other."""

    g, eta, homogeneous = 0.0, 1.0, False

    def coefficients(self, points):
        times = np.where(points[:, :1] > 0.3, 100.0, 1.0) * np.ones(3)
        return 0.001 * times, times


@pytest.mark.parametrize(("make", "resolution"), [(pulley, 48), (partial(box, (20, 20, 20)), 64)])
@pytest.mark.parametrize("medium", [MATERIAL, Lumps()], ids=["homogeneous", "heterogeneous"])
def test_levels_of_few_cells_in_one_launch(device, make, resolution, medium):
    """With junctions, and with leaves on several levels: the same bits as level by level, whatever sweeps there are."""
    mg = multigrid_for(device, make(), medium, resolution)
    levels, top = mg.op.octree.levels, len(mg.e) - 2
    assert top >= 3
    assert levels[top].n_ghost or all(level.junction_cell.shape[0] for level in levels[1:-1])
    inverse, rng = mg._invert_coarsest(), np.random.default_rng(8)
    b, stale = rng.normal(size=mg.r.whole.shape), rng.normal(size=mg.e.whole.shape)
    found = {}
    for few in (0, levels[top - 1].n, levels[top].n):
        mg._fused = FusedLevels(mg.op, mg.e, mg.r, inverse, OVER, COARSE_SWEEPS, few)
        for sweeps in (1, None):
            mg.r.whole.set(b)
            mg.e.whole.set(stale)
            mg.v_cycle(top, sweeps=sweeps)
            found[mg._fused.n, sweeps] = mg.e.whole.get(), mg.r.whole.get()
    assert {n for n, _ in found} == {1, top, top + 1}
    for (n, sweeps), fields in found.items():
        for values, expected in zip(fields, found[1, sweeps], strict=True):
            np.testing.assert_array_equal(values, expected, err_msg=f"{n} levels, {sweeps} sweeps")


def test_levels_of_few_cells_by_many_lanes(single):
    """As on devices that compute across work-items."""
    mg = multigrid_for(single, pulley(), MATERIAL, 48)
    mg._fused = FusedLevels(mg.op, mg.e, mg.r, mg._invert_coarsest(), OVER, COARSE_SWEEPS, mg.e[-2].shape[0])
    assert mg._fused.n == len(mg.e) - 1
    b, found = np.random.default_rng(9).normal(size=mg.r.whole.shape), []
    for group in (1, 32):
        mg._fused._group = group
        mg.r.whole.set(b)
        mg.v_cycle(len(mg.e) - 1)
        found.append(mg.e.whole.get())
    np.testing.assert_array_equal(*found)


def test_slow_cycles_are_accelerated(double):
    """Where D jumps a hundredfold a plain cycle takes half of the residual, 18 of them for eight digits."""
    found = solve(double, sphere(), Lumps(), [Emission(1.0)], 24, 1e-8)
    assert found.convergence.converged
    assert found.convergence.cycles <= 13


@pytest.mark.parametrize("order", [[0, 1, 2], [2, 0, 1], [1, 2, 0]])
def test_every_channel_reaches_the_tolerance(double, order):
    """Also the slowest, whichever it is: dark media take fewer cycles than clear ones."""
    medium = Material(np.array([20.0, 0.01, 0.0])[order], np.array([20.0, 1.0, 0.1])[order], eta=1.3)
    residuals = solve(double, sphere(subdivisions=3), medium, [Emission(1.0)], 16, 1e-6).convergence.residuals
    assert (residuals[-1] <= 1e-6).all()
    assert (residuals[-2] > 1e-6).any()
