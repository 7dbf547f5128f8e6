"""Does the solver converge as docs/numerics.md says? Orders of accuracy and multigrid rates against declared bars.

    python apps/convergence.py [--quick] [--only GROUP] [--out FOLDER]

Prints one line per measured quantity with its bar, draws pictures of them into FOLDER (needs matplotlib: pip
install clsss[docs]) and exits with 1 where a bar is missed. Some five minutes on two cores; --quick under one.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterator

import numpy as np
import problems
from outputs import Target
from rates import Bench, TwoPoint, cycles_needed, errors, norms, rate, solve

from clsss import DirectionalLight, Emission
from clsss.analytic import slab
from clsss.analytic_sphere import sphere_beam
from clsss.device import Device
from clsss.fresnel import fresnel_A, fresnel_transmittance
from clsss.surface import boundary_points, fluence_at

DEPTHS = np.array([0.05, 0.5, 5.0])  # sigma_tr h of the three channels


def closure(bench: Bench) -> Iterator[Target]:
    """Every cell is a closed polyhedron."""
    normals = np.repeat(np.eye(3), 2, axis=0) * np.tile([-1, 1], 3)[:, None]
    for name in ("sphere", "torus", "shell 2h", "plate 1.5h"):
        mesh = problems.shape(name, bench.n)
        tree = bench.multigrid(mesh, problems.layer(DEPTHS, 0.9), problems.cells_along(mesh)).op.octree
        gap = tree.apertures() @ normals + tree.cut.normal.get()[:, :3]
        yield Target(f"{name}: |sum alpha_f n_f + alpha_B n_B|", float(np.abs(gap).max()), 1e-12)


def factors(bench: Bench) -> Iterator[Target]:
    """Reduction per cycle by shape; sigma_tr h .05, .5, 5, without absorption and with little."""
    for name in problems.SHAPES:
        mesh = problems.shape(name, bench.n)
        resolution = problems.cells_along(mesh)
        for absorbed in (1e-3, 0.0):
            medium = problems.layer(DEPTHS * resolution / mesh.size, 1 - absorbed)
            mg = bench.multigrid(mesh, medium, resolution)
            of_two_point, whole = rate(mg, TwoPoint(bench.device, mg.op)), rate(mg, mg.residual)
            label = f"{name}, sigma_a {'0' if absorbed == 0 else '.001 sigma_tr'}"
            round_shape = name in ("sphere", "torus", "shell 2h")
            yield Target(f"{label}: two-point part, V(2,2)", of_two_point.max(), 0.12 if round_shape else None)
            if round_shape:
                single = rate(mg, TwoPoint(bench.device, mg.op), sweeps=1)
                yield Target(f"{label}: two-point part, V(1,1)", single.max(), 0.23)
            bar = 0.40 if name.startswith("balls") else 0.18
            if name == "plate 1.5h" and absorbed == 0:
                bar = 0.22
            yield Target(f"{label}: defect correction", whole.max(), bar)
        plain, accelerated = cycles_needed(mg)
        yield Target(f"{label}: plain cycles to 1e-8", len(plain) - 1)
        yield Target(f"{label}: cycles of solve() to 1e-8", len(accelerated) - 1, 15)
        bench.curves.setdefault("rates", {})[name] = (of_two_point, whole)
        bench.curves.setdefault("histories", {})[name] = (plain, accelerated)


def sizes(bench: Bench) -> Iterator[Target]:
    """The rate does not depend on the grid; the octree costs little of it."""
    rates = {}
    for n in (16, 32, 64) if bench.quick else (32, 64, 128, 192):
        mesh = problems.shape("sphere", n)
        for adaptive in (False, True):
            mg = bench.multigrid(mesh, problems.layer(DEPTHS * 32 / n, 0.999), n, adaptive)
            two_point, whole = rate(mg, TwoPoint(bench.device, mg.op)), rate(mg, mg.residual)
            rates[n, adaptive] = two_point.max()
            label = f"sphere {n}, {'octree' if adaptive else 'uniform'}, sigma_tr h {DEPTHS * 32 / n}"
            yield Target(f"{label}: two-point part", rates[n, adaptive], None if adaptive else 0.12)
            yield Target(f"{label}: defect correction", whole.max(), 0.25 if n >= 128 and 5 * 32 / n > 1 else 0.18)
            if n == 64 and not adaptive:
                work = 8 / 7 * (4 + 1) * np.log(1e-8) / np.log(rates[n, adaptive])
                yield Target("sphere 64: fine-grid sweeps to 1e-8, two-point part", work, 50)
    first, last = (32, 64) if bench.quick else (64, 192)
    change = abs(rates[last, False] - rates[first, False])
    title = f"sphere: change of the two-point rate from {first} to {last} cells"
    yield Target(title, change, None if bench.quick else 0.02)


def media(bench: Bench) -> Iterator[Target]:
    """Reduction per cycle where D varies."""
    n = bench.n
    mesh = problems.shape("sphere", n)
    cases = [
        ("10:1 smooth", problems.smooth_medium(0.5, 10, n / 2), 0.28, None),
        ("10:1 sharp", problems.sharp_medium(0.5, 10, n / 2), 0.45, 18),
        ("100:1 sharp", problems.sharp_medium(0.5, 100, n / 2), None, 55),
    ]
    for label, medium, bar, most in cases:
        mg = bench.multigrid(mesh, medium, n)
        yield Target(f"D {label}: two-point part", rate(mg, TwoPoint(bench.device, mg.op)).max())
        yield Target(f"D {label}: defect correction", rate(mg, mg.residual).max(), bar)
        plain, accelerated = cycles_needed(mg)
        yield Target(f"D {label}: plain cycles to 1e-8", len(plain) - 1)
        yield Target(f"D {label}: cycles of solve() to 1e-8", len(accelerated) - 1, most)
        bench.curves.setdefault("histories", {})[f"D {label}"] = (plain, accelerated)


def orders(bench: Bench) -> Iterator[Target]:
    """Errors and orders on spheres with exact solutions."""
    eta = 1.1263  # A = 1.5
    diameters, absorbed = (20, 200, 200), (0.01, 0.001, 0.01)
    glowing = problems.uniform_source(diameters, absorbed, eta)
    cases = [
        ("uniform source", glowing, ("diameter 20", "diameter 200", "diameter 200, sigma_a .01")),
        ("variable D", problems.manufactured(), ("",)),
        ("D 10:1 sharp", problems.core_and_rind(), ("",)),
    ]
    resolutions = (16, 32, 64) if bench.quick else (16, 32, 64, 128)
    bars = {"phi L2": (2e-4, 1.9), "phi Linf": (None, 1.6), "surface L2": (1.2e-3, 1.7),
            "surface Linf": (8e-3, None), "vertex L2": (None, 1.7)}  # fmt: skip
    at_jumps = {"phi L2": (3e-4, 1.9), "surface L2": (4e-4, 1.8), "vertex L2": (4e-4, 1.8)}
    for name, exact, channels in cases:
        table = {n: errors(bench, exact, n) for n in resolutions}
        bench.curves.setdefault("orders", {})[name] = table
        for channel, label in enumerate(channels):
            easy = name == "variable D" or label == "diameter 20"
            own = bars if easy else at_jumps if name == "D 10:1 sharp" else {}
            for what in bars:
                bar, least = own.get(what, (None, None))
                coarse, fine = (table[n][what][channel] for n in (32, 64))
                title = f"{name} {label}".strip() + f", {what}"
                yield Target(f"{title}: error at 64 cells", fine, bar)
                yield Target(f"{title}: order from 32 to 64", np.log2(coarse / fine), least, at_least=True)
                if not bench.quick:
                    finest = table[128][what][channel]
                    yield Target(f"{title}: order from 64 to 128", np.log2(fine / finest), at_least=True)
    for channel, label in enumerate(cases[0][2]):
        alone = problems.uniform_source((diameters[channel],) * 3, (absorbed[channel],) * 3, eta)
        yield from merged(bench, f"uniform source {label}", alone, channel, resolutions)


def merged(bench: Bench, label: str, exact: problems.Exact, channel: int,
           resolutions: tuple[int, ...]) -> Iterator[Target]:  # fmt: skip
    """The octree of one channel's medium alone (the densest decides for all) against the uniform grid's errors."""
    tables = bench.curves["orders"]
    table = {n: errors(bench, exact, n, True) for n in resolutions}
    tables.setdefault("octree", table)
    for n in resolutions[2:]:
        uniform = tables["uniform source"][n]
        yield Target(f"octree {n}, {label}: leaves over uniform", float(table[n]["leaves"][0] / uniform["leaves"][0]))
        for what, bar in (("surface L2", 1.2), ("vertex L2", None), ("phi L2", None)):
            yield Target(f"octree {n}, {label}, {what} over uniform", table[n][what][0] / uniform[what][channel], bar)


def plates(bench: Bench) -> Iterator[Target]:
    """Both sides of thin plates with a uniform source against the solution in one dimension."""
    width, depths = 60, (0.2, 1, 5)
    place = np.random.default_rng(0).uniform(-10, 10, (2000, 2))
    for thickness, bar in {1.5: 0.04, 2: 0.03, 3: 0.02, 5: 0.012}.items():
        mesh = problems.shape(f"plate {thickness}h", width)
        resolution = problems.cells_along(mesh)
        medium = problems.layer(np.array(depths) * resolution / mesh.size, 0.99, 1.1263)
        mg = bench.multigrid(mesh, medium, resolution)
        phi, found, _ = solve(mg, [Emission(1.0)])
        phi_B, exact = mg.residual.boundary_value(phi, found.moment), problems.plate_fluence(thickness, medium)
        far = np.linalg.norm(boundary_points(mg.op.octree)[0], axis=1) < width / 2 - 14
        values = phi_B.get()[far, :3]
        rms, worst = norms(values, np.tile(exact, (len(values), 1)), mg.op.octree.cut.boundary.get()[far, 3])
        on_plate = np.column_stack([place, np.full(2000, thickness / 2)]) @ problems.TILT[:3, :3].T
        normals = np.tile(problems.TILT[:3, 2], (2000, 1))
        fitted = fluence_at(bench.device, mg.op.octree, phi_B, on_plate, normals) / exact - 1
        for channel, depth in enumerate(depths):
            label = f"plate {thickness}h, sigma_tr h {depth}"
            yield Target(f"{label}: surface L2", rms[channel], bar if depth == 1 else None)
            yield Target(f"{label}: surface Linf, slivers included", worst[channel])
            yield Target(f"{label}: Linf of fitted values", np.abs(fitted[:, channel]).max())


def beams(bench: Bench) -> Iterator[Target]:
    """A tilted plate lit perpendicularly: the lit side against the slab's exact solution, and the power."""
    albedos, eta, thickness, width = np.array([0.9, 0.99, 0.999]), 1.3, 10.0, 96
    A, entering = fresnel_A(eta), float(fresnel_transmittance(np.ones(1), eta)[0])
    inward = -problems.TILT[:3, 2]
    mesh = problems.plate(width, thickness)
    resolution = problems.cells_along(mesh)
    for depth in (0.05, 0.5, 1, 2, 5, 10, 20):
        sigma_tr = depth * resolution / mesh.size
        mg = bench.multigrid(mesh, problems.layer(np.full(3, sigma_tr), albedos, eta), resolution)
        tree = mg.op.octree
        phi, found, _ = solve(mg, [DirectionalLight(inward)])
        values = mg.residual.boundary_value(phi, found.moment).get()
        points, normals = boundary_points(tree)
        lit = (normals @ inward < -0.99) & (np.linalg.norm(np.cross(points, inward), axis=1) < 12)
        area = tree.cut.boundary.get()[lit, 3]
        lost = found.incident * -np.expm1(-sigma_tr * thickness)
        power = np.abs(found.deposited / (albedos * lost) - 1).max()
        yield Target(f"lit plate, sigma_tr h {depth}: power deposited over power lost - 1", power, 0.01)
        if not 0.5 <= depth <= 10:
            continue
        for channel, albedo in enumerate(albedos):
            exact = slab(thickness, sigma_tr * (1 - albedo), sigma_tr * albedo, 0, A)
            error = values[lit, channel] / (entering * exact.phi(0.0)) - 1
            mean, rms = np.average(error, weights=area), np.sqrt(np.average(error**2, weights=area))
            label = f"lit plate, sigma_tr h {depth}, albedo {albedo}"
            bar = 0.02 if depth <= 5 and albedo >= 0.99 else 0.05
            yield Target(f"{label}: |mean error| of the lit side", abs(mean), bar)
            yield Target(f"{label}: rms error of the lit side", rms)
            bench.curves.setdefault("beams", []).append((depth, albedo, mean, rms))


def lit_ball(bench: Bench) -> Iterator[Target]:
    """A ball in a parallel beam against its expansion in Legendre polynomials: surface L2."""
    eta, radius, albedos = 1.3, 10.0, np.array([0.9, 0.99, 0.999])
    A, mesh, at = fresnel_A(eta), problems.round_ball(radius), np.linspace(-1, 1, 1001)
    for diameter in (20, 100):
        found_errors, sigma_tr = {}, diameter / (2 * radius)
        exact = [sphere_beam(radius, sigma_tr * (1 - a), sigma_tr * a, A, lambda c: fresnel_transmittance(c, eta))(
            np.full(len(at), radius), at) for a in albedos]  # fmt: skip
        for n in (32, 64):
            mg = bench.multigrid(mesh, problems.layer(np.full(3, sigma_tr), albedos, eta), n)
            phi, found, _ = solve(mg, [DirectionalLight((0, 0, -1))])
            points, area = boundary_points(mg.op.octree)[0], mg.op.octree.cut.boundary.get()[:, 3]
            mu = points[:, 2] / np.linalg.norm(points, axis=1)
            values = mg.residual.boundary_value(phi, found.moment).get()
            wanted = np.stack([np.interp(mu, at, e) for e in exact], axis=1)
            found_errors[n] = norms(values, wanted, area)[0]
        for channel, albedo in enumerate(albedos):
            label = f"lit ball, sigma_tr diameter {diameter}, albedo {albedo}"
            coarse, fine = found_errors[32][channel], found_errors[64][channel]
            yield Target(f"{label}: surface L2 at 32 cells", coarse)
            yield Target(f"{label}: surface L2 at 64 cells", fine, 0.02 if albedo >= 0.99 else None)
            yield Target(f"{label}: order from 32 to 64", np.log2(coarse / fine), at_least=True)


def rounding(bench: Bench) -> Iterator[Target]:
    """What float32 costs: where the residual stalls, and the solution at the default tolerance."""
    single = Device(precision="single")
    medium = problems.layer(np.array([0.2, 1, 10]), np.array([1, 0.999, 0.99]))
    mesh = problems.round_ball(10.0, 5)
    results = []
    for device, tolerance in ((bench.device, 1e-10), (single, 1e-4), (single, 1e-9)):
        mg = bench.multigrid(mesh, medium, bench.n, True, device)
        phi, found, convergence = solve(mg, [DirectionalLight((0, 0, -1))], tolerance)
        results.append((mg.residual.boundary_value(phi, found.moment).get(), convergence))
    exact, (usual, convergence), (_, stalled) = results[0][0], results[1], results[2]
    yield Target("float32: cycles to the default tolerance 1e-4", convergence.cycles, 6)
    for channel, name in enumerate(("diameter 4, albedo 1", "diameter 20, albedo .999", "diameter 200, albedo .99")):
        gap = np.abs(usual - exact)[:, channel].max() / exact[:, channel].max()
        yield Target(f"float32, {name}: surface against float64, Linf", gap, 2e-4)
        yield Target(f"float32, {name}: where the residual stalls", min(r[channel] for r in stalled.residuals), 3e-5)


GROUPS: dict[str, Callable[[Bench], Iterator[Target]]] = {
    "closure": closure, "factors": factors, "sizes": sizes, "media": media, "orders": orders, "plates": plates,
    "beams": beams, "ball": lit_ball, "rounding": rounding,
}  # fmt: skip


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="coarser grids, under a minute")
    parser.add_argument("--only", choices=GROUPS, help="one group of measurements")
    parser.add_argument("--out", metavar="FOLDER", help="draw pictures into this folder")
    parser.add_argument("--device", help="part of an OpenCL device's name")
    args = parser.parse_args()
    bench = Bench(Device(args.device, "double"), args.quick, {})
    missed = 0
    for name, measure in GROUPS.items():
        if args.only in (None, name):
            print(f"\n{name}: {(measure.__doc__ or '').strip()}")
            for row in measure(bench):
                print(row, flush=True)
                missed += row.verdict == "FAIL"
    if args.out:
        from convergence_plots import draw

        draw(bench.curves, args.out)
    print(f"\n{missed} bars missed")
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
