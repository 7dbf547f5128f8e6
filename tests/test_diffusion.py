"""The discrete diffusion equation: exact for what it should be exact for, conservative, and of order two."""

from __future__ import annotations

import cases
import numpy as np
import pytest
from scipy import sparse
from shapes import (
    ROTATION,
    box,
    box_triangles,
    build_operator,
    build_tree,
    conductances,
    fields,
    links,
    pulley,
    relative_rms,
    set_field,
    solid,
    solve,
    sphere,
    stack,
    torus,
)

from clsss import diffusion
from clsss.fields import Field
from clsss.fresnel import fresnel_A
from clsss.layer import fitted_layer
from clsss.lights import Emission
from clsss.materials import Material
from clsss.residual import Residual
from clsss.surface import boundary_points

MATERIAL = Material(sigma_a=0.1, sigma_s=0.9, eta=1.3)
CLEAR = Material(sigma_a=0.0, sigma_s=0.5, eta=1.37)


class Wavy:
    """A medium whose coefficients vary smoothly."""

    g, eta, homogeneous = 0.2, 1.3, False

    def coefficients(self, points):
        wave = np.sin(points @ [[0.3], [0.5], [-0.2]])
        return 0.05 * (1.5 + wave) * [1, 2, 3], (1.0 + 0.5 * wave) * [3, 2, 1]


MEDIA = [MATERIAL, Wavy()]
BOTH = pytest.mark.parametrize("medium", MEDIA, ids=["homogeneous", "heterogeneous"])


def scale_of(medium, points):
    """What the operator multiplies the equation by: 1/D in a homogeneous medium."""
    if not medium.homogeneous:
        return np.ones((len(points), 3))
    return np.tile(1 / medium.D, (len(points), 1))


@BOTH
@pytest.mark.parametrize("make", [sphere, torus, pulley])
def test_two_point_part_is_symmetric(device, make, medium):
    """The flux from i to j is minus that from j to i, on every level."""
    tree = build_tree(device, make(), 24)
    op = build_operator(device, tree, medium)
    for k, level in enumerate(tree.levels):
        cell, _, beyond, _ = links(level)
        there, back = (conductances(op, k)[np.lexsort(pair)] for pair in ((cell, beyond), (beyond, cell)))
        np.testing.assert_allclose(there, back, rtol=32 * np.finfo(device.real).eps)
        T = op.T[k].get()
        assert not T[level.nbr.get() == np.arange(level.n)[:, None]].any()
        assert T.min() >= 0


@BOTH
@pytest.mark.parametrize("make", [sphere, stack, pulley])
def test_coarse_faces_have_half_of_their_fine_ones(double, make, medium):
    """Also where several parts of a split block lie behind one face: each gets its own."""
    tree = build_tree(double, make(), 40, refine=None)
    op = build_operator(double, tree, medium)
    for k, (coarse, fine) in enumerate(zip(tree.levels[:-1], tree.levels[1:], strict=True)):
        parent, (cell, _, beyond, _), T = fine.parent.get()[: fine.n], links(fine), conductances(op, k + 1)
        cell, beyond = parent[cell], parent[beyond]
        expected = [sparse.csr_matrix((t, (cell, beyond)), shape=(coarse.n, coarse.n)) for t in T.T]
        cell, _, beyond, _ = links(coarse)
        for t, sums in zip(conductances(op, k).T, expected, strict=True):
            np.testing.assert_allclose(t, 0.5 * np.asarray(sums[cell, beyond]).ravel(), rtol=1e-12)


@BOTH
def test_coefficients_are_positive(device, medium):
    op = build_operator(device, build_tree(device, sphere(), 24), medium)
    assert all((absorb.get() > 0).all() for absorb in op.absorb)


def test_coarse_absorption_is_that_of_a_relaxed_field(double):
    """Two Jacobi relaxations of A x = 0 from one, then what the children take over the mean of what is left of them."""
    tree = build_tree(double, sphere(), 32)
    dense = Material(sigma_a=(0.0, 0.001, 1.0), sigma_s=10.0, eta=1.3)
    op = build_operator(double, tree, dense)
    unlike_sums = 0
    pairs = zip(tree.levels, tree.levels[1:], op.T[1:], op.absorb[1:], op.absorb, strict=False)
    for coarse, fine, T, taken, found in pairs:
        T, taken = T.get().reshape(fine.n, 6, 1), taken.get()
        x, nbr = np.ones((fine.n + fine.n_ghost, 4)), fine.nbr.get()
        for _ in range(2):
            x[: fine.n] = (T * x[nbr]).sum(axis=1) / (T.sum(axis=1) + taken)
        x = x[: fine.n]
        parent = fine.parent.get()[: fine.n]

        def over_children(values, parent=parent, coarse=coarse):
            total = np.zeros((coarse.n, 4))
            np.add.at(total, parent, values)
            return total

        count, plain = over_children(np.ones((fine.n, 4))), over_children(taken)
        least = np.full((coarse.n, 4), np.inf)
        np.minimum.at(least, parent, taken)
        least[coarse.leaf] = 0
        unlike = ~coarse.leaf & (plain > 1.25 * count * least).any(axis=1)
        expected = np.where(coarse.leaf[:, None], found.get(), plain)
        left = over_children(x)[unlike]
        expected[unlike] = (count * over_children(x * taken))[unlike] / left
        np.testing.assert_allclose(found.get(), expected, rtol=1e-12)
        unlike_sums += int((expected < 0.9 * plain)[~coarse.leaf].sum())
    assert unlike_sums > 100


@pytest.mark.parametrize("medium", [*MEDIA, CLEAR], ids=["homogeneous", "heterogeneous", "clear"])
def test_residual_conserves(double, medium):
    """Summed over all leaves only the source, the absorption and the flux through the surface are left.

    The field is random: faces between cells, cut or full, of one level or two, must cancel one by one.
    """
    tree = build_tree(double, sphere(), 40)
    assert sum(level.leaf.any() for level in tree.levels) > 1
    op = build_operator(double, tree, medium)
    residual = Residual(double, op)
    rng = np.random.default_rng(5)
    phi, b, r = fields(double, tree)
    for x in phi:
        x.set(rng.uniform(1, 2, x.shape))
    residual(phi, b, r)
    points, absorbed = diffusion.cell_points(tree), np.zeros(3)
    volumes, layer = [v[:, None] for v in tree.volumes()], fitted_layer(double, tree, op.medium)
    assert (layer is None) == (medium is CLEAR)
    if layer is not None:
        volumes[-1] = layer.volume.get()
    for x, p, volume, level in zip(phi, points, volumes, tree.levels, strict=True):
        sigma_a = medium.coefficients(p)[0] * scale_of(medium, p)
        absorbed += (x.get()[: level.n, :3] * sigma_a * volume * level.leaf[:, None]).sum(axis=0)
    phi_B = residual.boundary_value(phi, double.zeros((tree.cut.n, 3))).get()[:, :3]
    area = tree.cut.boundary.get()[:, 3:] * tree.grid.h**2
    at_cut = points[-1][tree.cut.cell.get()]
    exited = (area * phi_B / (2 * fresnel_A(medium.eta)) * scale_of(medium, at_cut)).sum(axis=0)
    total = sum(x.get()[: level.n, :3].sum(axis=0) for x, level in zip(r, tree.levels, strict=True))
    np.testing.assert_allclose(total, -absorbed - exited, rtol=1e-11)


@pytest.mark.parametrize("resolution", [24, 48])
def test_linear_fields_are_exact_in_full_cells(double, resolution):
    """Between full cells, of one level or of two, the flux of a linear field is constant: nothing is left over."""
    tree = build_tree(double, sphere(), resolution)
    op = build_operator(double, tree, CLEAR)
    phi, b, r = fields(double, tree)
    slope = np.array([1.0, -2.0, 0.5])
    set_field(tree, phi, lambda points: 3 + points @ slope)
    Residual(double, op)(phi, b, r)
    seen = 0
    for level, x in zip(tree.levels, r, strict=True):
        full = level.leaf.copy()
        if level.depth == 0:
            full[op.irregular.get()] = False
        seen += full.sum()
        np.testing.assert_allclose(x.get()[: level.n][full] / level.h**2, 0, atol=1e-11)
    assert seen > 0.3 * tree.n_leaves


def test_linear_fields_are_exact_in_cut_cells(double):
    """At a plane the field phi = 2 A D + depth meets the boundary condition: nothing is left over, phi_B = 2 A D.

    The plane is one side of a turned box, away from the others. Numbers from the scheme's own clamps (centroids
    nearer than a quarter cell) may remain, in few cells.
    """
    tree = build_tree(double, box((20, 20, 12), ROTATION), 48)
    op = build_operator(double, tree, CLEAR)
    residual, n = Residual(double, op), ROTATION[:, 2]
    phi, b, r = fields(double, tree)
    drop = 2 * fresnel_A(CLEAR.eta) * CLEAR.D[0]
    set_field(tree, phi, lambda points: drop + 6 - points @ n)
    residual(phi, b, r)
    points, normals = boundary_points(tree)
    local = points @ ROTATION
    chosen = (np.abs(local[:, :2]) < 10 - 4 * tree.grid.h).all(axis=1) & (normals @ n > 0.99)
    assert chosen.sum() > 300
    left = np.abs(r[-1].get()[tree.cut.cell.get()[chosen], 0]) / tree.grid.h**2
    assert np.median(left) <= 1e-12
    assert left.max() <= 1e-4
    phi_B = residual.boundary_value(phi, double.zeros((tree.cut.n, 3))).get()[chosen, 0]
    np.testing.assert_allclose(phi_B, drop, rtol=1e-9)


def sinhc(x):
    return np.sinh(x) / x if x else 1.0


class Dense:
    """The scheme written down with numpy, cell by cell, for a solid all of whose cells are on the finest level."""

    def __init__(self, tree, medium):
        self.h, self.ijk, self.A = tree.grid.h, tree.positions()[-1], fresnel_A(medium.eta)
        self.index = {tuple(p): i for i, p in enumerate(self.ijk)}
        n, cut = len(self.ijk), tree.cut.cell.get()
        self.centroid, self.kappa = np.full((n, 3), 0.5), np.ones(n)
        moments = tree.cut.centroid.get()
        self.centroid[cut], self.kappa[cut] = moments[:, :3], moments[:, 3]
        self.cut = {int(cell): k for k, cell in enumerate(cut)}
        self.boundary, self.normal = tree.cut.boundary.get(), tree.cut.normal.get()[:, :3]
        self.normal = self.normal / np.linalg.norm(self.normal, axis=1, keepdims=True)
        self.aperture, self.face_centroid = tree.cut.aperture.get(), tree.cut.face_centroid.get()
        self.medium, self.points = medium, diffusion.cell_points(tree)[-1]
        sigma_a, sigma_s = medium.coefficients(self.points)
        self.sigma_a = sigma_a[:, 0]
        self.D = 1 / (3 * (sigma_a + (1 - medium.g) * sigma_s))[:, 0]
        k2 = self.sigma_a * self.h**2 / self.D
        t = np.clip((k2 - 0.05) / 0.025, 0, 1)
        self.k2 = k2 * t * t * (3 - 2 * t)
        self.singular = 0  # fits with a direction left out

    def gradient(self, phi, i):
        """Weighted least squares over the 26 neighbours and the boundary condition, per cell width."""
        if i not in self.cut:
            return np.zeros(3)
        rows, right, k = [], [], self.cut[i]
        for step in np.ndindex(3, 3, 3):
            j = self.index.get(tuple(self.ijk[i] + np.array(step) - 1))
            if j is None or j == i:
                continue
            dx = self.centroid[j] + self.ijk[j] - self.centroid[i] - self.ijk[i]
            weight = np.sqrt(self.kappa[j]) / max(dx @ dx, 0.05)
            rows.append(weight * dx)
            right.append(weight * (phi[j] - phi[i]))
        offset = self.boundary[k, :3] - self.centroid[i]
        D = self.D[i] / self.h
        weight = min(self.boundary[k, 3], 1) / (D + np.linalg.norm(offset) / (2 * self.A))
        rows.append(weight * (D * self.normal[k] + offset / (2 * self.A)))
        right.append(-weight * phi[i] / (2 * self.A))
        rows = np.array(rows)
        self.singular += np.linalg.cond(rows) ** 2 > 1e3
        return np.linalg.pinv(rows.T @ rows, rcond=1e-3, hermitian=True) @ (rows.T @ right)

    def resistivity(self, i, j):
        """Mean of 1/D between the centroids: of both ends, or, where D jumps, of eight places along the link."""
        t = (np.arange(8)[:, None] + 0.5) / 8
        ends, along = (self.transport((1 - t) * self.points[i] + t * self.points[j]) for t in (np.eye(2)[:, :1], t))
        jumps = (ends.max(axis=0) > 1.2 * ends.min(axis=0)).any()
        return 3 * (along if jumps else ends)[:, 0].mean()

    def transport(self, points):
        sigma_a, sigma_s = self.medium.coefficients(points)
        return sigma_a + (1 - self.medium.g) * sigma_s

    def flux(self, phi, g, i, face):
        """What leaves cell i through a face."""
        axis, up = face >> 1, face & 1
        step = np.zeros(3, int)
        step[axis] = 2 * up - 1
        j = self.index.get(tuple(self.ijk[i] + step))
        if j is None:
            return 0.0
        area, c = 1.0, np.full(2, 0.5)
        if i in self.cut and j in self.cut:
            low = self.cut[i if up else j], axis
            area, c = self.aperture[low], self.face_centroid[low]
        x_f = np.insert(c, axis, up)
        tau_i, tau_j = x_f - self.centroid[i], x_f - self.centroid[j] - step
        tau_i[axis] = tau_j[axis] = 0
        delta = max((self.centroid[j] - self.centroid[i] + step)[axis] * step[axis], 0.25)
        T = area * self.h / (delta * self.resistivity(i, j))
        e2 = np.mean([self.normal[self.cut[c], axis] ** 2 for c in (i, j) if c in self.cut] or [0])
        x = delta * np.sqrt(e2 * (self.k2[i] + self.k2[j]) / 2)
        share = self.k2[i] * self.D[i] / (self.sigma_a[i] * self.h**2)
        near = (x_f - self.centroid[i])[axis] * step[axis]
        self.taken[i] += share * area * e2 * (delta / 2 * sinhc(x / 2) / np.cosh(x / 2) - near)
        return T / sinhc(x) * (phi[i] + g[i] @ tau_i - phi[j] - g[j] @ tau_j)

    def residual(self, phi):
        g = [self.gradient(phi, i) for i in range(len(phi))]
        out = np.empty(len(phi))
        self.taken = self.kappa.copy()
        for i in range(len(phi)):
            out[i] = -sum(self.flux(phi, g, i, face) for face in range(6))
            if i in self.cut:
                k = self.cut[i]
                n, x_B = self.normal[k], self.boundary[k, :3]
                d = max((x_B - self.centroid[i]) @ n, 0.05)
                p = phi[i] + g[i] @ (x_B - d * n - self.centroid[i])
                x, D = d * np.sqrt(self.k2[i]), self.D[i]
                resistance = 2 * self.A * np.cosh(x) + d * self.h / D * sinhc(x)
                out[i] -= self.boundary[k, 3] * self.h**2 * p / resistance
                d = max(d, 0.1)
                x = d * np.sqrt(self.k2[i])
                resistance = 2 * self.A * np.cosh(x) + d * self.h / D * sinhc(x)
                depth = d * (2 * self.A * sinhc(x) + d * self.h / D / 2 * sinhc(x / 2) ** 2) / resistance - d
                self.taken[i] += self.k2[i] * D / (self.sigma_a[i] * self.h**2) * self.boundary[k, 3] * depth
            taken = max(self.taken[i], 0.05 * self.kappa[i])
            out[i] -= self.sigma_a[i] * taken * self.h**3 * phi[i]
        return out


@BOTH
def test_residual_is_the_scheme_as_written_down(double, medium):
    tree = build_tree(double, sphere(subdivisions=3), 7, refine=None)
    op = build_operator(double, tree, medium)
    phi, b, r = fields(double, tree)
    values = np.random.default_rng(6).uniform(1, 2, tree.finest.n)
    phi[-1].set(np.repeat(values[:, None], 4, axis=1))
    Residual(double, op)(phi, b, r)
    expected = Dense(tree, medium).residual(values)
    got = r[-1].get()[:, 0] / scale_of(medium, values[:, None])[:, 0]
    np.testing.assert_allclose(got, expected, atol=1e-9 * np.abs(expected).max())


def test_gradients_of_thin_fins_leave_out_what_they_do_not_have(double):
    """Thinner than a cell: numpy's pseudo-inverse, with its cut-off, where the normal equations are near singular."""
    fins = np.concatenate([box_triangles((20, 4, 0.4)), box_triangles((0.4, 4, 20))])
    tree = build_tree(double, solid(fins), 20, refine=None)
    op, scheme, phi = build_operator(double, tree, CLEAR), Dense(tree, CLEAR), Field(double, tree)
    values = np.random.default_rng(8).uniform(1, 2, tree.finest.n)
    phi[-1].set(np.repeat(values[:, None], 4, axis=1))
    residual = Residual(double, op)
    residual.complete(phi)
    expected = np.array([scheme.gradient(values, i) for i in tree.cut.cell.get()])
    found = residual.slope.get()[:, :, 0]
    np.testing.assert_allclose(found, expected, atol=1e-9 * np.abs(expected).max())
    assert scheme.singular > 3


def test_no_first_moment_needs_no_wall(device):
    tree = build_tree(device, sphere(), 24)
    op, found = build_operator(device, tree, MATERIAL), []
    phi, b, r = fields(device, tree)
    set_field(tree, phi, lambda points: np.random.default_rng(9).uniform(1, 2, len(points)))
    for wall in (None, device.zeros((tree.cut.n, 3))):
        residual = Residual(device, op)
        residual.wall = wall
        residual(phi, b, r)
        found.append(r.whole.get())
    np.testing.assert_array_equal(*found)


def errors(device, case, resolution, **options):
    """Relative errors of a solution: phi in all, full and cut cells, and phi_B as the value on the sphere."""
    solved = solve(device, sphere(case.radius, 6), case.medium, case.lights, resolution, 1e-8, **options)
    assert solved.convergence.converged
    points, volumes, values, cut = solved.leaves()
    exact = case.phi(points)
    boundary, _ = boundary_points(solved.tree)
    on_sphere = case.phi(case.radius * boundary / np.linalg.norm(boundary, axis=1, keepdims=True))
    area, phi_B = solved.tree.cut.boundary.get()[:, 3], solved.phi_B[:, 0]
    return {
        "phi": relative_rms(values[:, 0], exact, volumes),
        "phi, full cells": relative_rms(values[~cut, 0], exact[~cut], volumes[~cut]),
        "phi, cut cells": relative_rms(values[cut, 0], exact[cut], volumes[cut]),
        "phi_B": relative_rms(phi_B, on_sphere, area),
        "phi_B, greatest": float(np.abs(phi_B - on_sphere).max() / np.abs(on_sphere).max()),
    }


def uniform_sphere():
    """sigma_tr diameter = 20, sigma_a / sigma_tr = 0.01, a uniform source; A = 1.5 at eta = 1.1263."""
    from scipy.optimize import brentq

    eta = brentq(lambda eta: fresnel_A(eta) - 1.5, 1.01, 1.5)
    return cases.uniform_source(10.0, 0.01, 0.99, eta)


RESOLUTIONS = (16, 32, 64)
ORDERS = pytest.mark.parametrize(
    ("what", "declared"), [("phi", 1.9), ("phi, full cells", 1.7), ("phi, cut cells", 1.7), ("phi_B", 1.7)]
)


def fitted_order(found, what):
    return cases.order([1 / n for n in found], [e[what] for e in found.values()])


@pytest.fixture(scope="module")
def uniform_errors(double):
    return {n: errors(double, uniform_sphere(), n, refine=None) for n in RESOLUTIONS}


@pytest.mark.parametrize(("what", "bar"), [("phi", 2e-4), ("phi_B", 1.2e-3), ("phi_B, greatest", 8e-3)])
def test_uniform_sphere_meets_the_bar_at_64_cells(uniform_errors, what, bar):
    assert uniform_errors[64][what] <= bar


@ORDERS
def test_uniform_sphere_has_order_two(uniform_errors, what, declared):
    assert fitted_order(uniform_errors, what) >= declared


def test_merging_all_that_can_be_merged_costs_little(double):
    """The bars of maximal coarsening: the innermost cells, not the surface, set the error."""
    found = errors(double, uniform_sphere(), 64)
    assert found["phi"] <= 1.3e-3
    assert found["phi_B"] <= 2.1e-3
    assert found["phi_B, greatest"] <= 8e-3


@pytest.fixture(scope="module")
def manufactured_errors(double):
    return {n: errors(double, cases.manufactured(), n, refine=None) for n in RESOLUTIONS}


@ORDERS
def test_manufactured_solution_with_variable_D_has_order_two(manufactured_errors, what, declared):
    assert fitted_order(manufactured_errors, what) >= declared


def test_manufactured_solution_is_accurate(manufactured_errors):
    assert manufactured_errors[64]["phi"] <= 2e-4
    assert manufactured_errors[64]["phi_B"] <= 1.2e-3


@pytest.fixture(scope="module")
def jump_errors(double):
    return {n: errors(double, cases.layered(), n, refine=None) for n in (16, 24, 32, 48)}


@pytest.mark.parametrize("what", ["phi", "phi_B"])
def test_order_is_two_where_D_and_emission_jump(jump_errors, what):
    assert fitted_order(jump_errors, what) >= 1.9
    assert jump_errors[48][what] <= 8e-4


def test_manufactured_solution_on_an_octree(double):
    """D varies across faces between levels too."""
    found = errors(double, cases.manufactured(), 64)
    assert found["phi"] <= 1.3e-3
    assert found["phi_B"] <= 2.1e-3


def test_faces_between_levels_use_the_D_of_both_sides(device, eps):
    """T = A / (d_i / D_i + d_j / D_j), from half a fine cell to half a coarse one."""
    tree, medium = build_tree(device, sphere(), 40), Wavy()
    op, points = build_operator(device, tree, medium), diffusion.cell_points(tree)
    for k, level in enumerate(tree.levels):
        if not level.n_ghost:
            continue
        cell, face = np.divmod(level.ghost_face.get(), 6)
        D = [1 / (3 * (a + (1 - medium.g) * s)) for a, s in map(medium.coefficients, points)]
        coarse = D[k - 1][level.parent.get()[level.n :]]
        expected = level.h**2 / (level.h / 2 / D[k][cell] + level.h / coarse)
        leaf = level.leaf[cell]
        np.testing.assert_allclose(op.T[k].get()[cell, face, :3][leaf], expected[leaf], rtol=1e3 * eps)


def test_single_precision_gives_the_same_solution(single, double):
    medium, lights = Material(0.01, 0.99, eta=1.3), [Emission(1.0)]
    found = [solve(d, sphere(), medium, lights, 24, 1e-4 if d is single else 1e-9) for d in (single, double)]
    difference = relative_rms(found[0].phi_B, found[1].phi_B)
    assert difference <= 1e-4


def test_channels_do_not_couple(double):
    """Three media solved together are the three solved apart."""
    sigma_a, sigma_s = np.array([0.01, 0.1, 1.0]), np.array([2.0, 1.0, 0.5])
    together = solve(double, sphere(), Material(sigma_a, sigma_s), [Emission((1.0, 2.0, 0.0))], 16, 1e-10)
    assert not together.phi_B[:, 2].any()
    for channel, strength in enumerate((1.0, 2.0)):
        medium = Material(sigma_a[channel], sigma_s[channel])
        alone = solve(double, sphere(), medium, [Emission(strength)], 16, 1e-10)
        np.testing.assert_allclose(together.phi_B[:, channel], alone.phi_B[:, 0], rtol=1e-8)
