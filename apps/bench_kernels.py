"""How fast is each kernel, measured against what the memory of this machine gives?

    python apps/bench_kernels.py [--quick] [--busy] [--precision double] [--json FILE] [--out FOLDER]

Runs the whole pipeline on a ball, uniform and as an octree, of one material and of two mixed, and what a ball has
no use for on plates that light one another, with light scattered once apart, absorption and jumps, and on the
references; then repeats the largest launch of every kernel alone, each next to a triad (a = b + s c over arrays much
larger than the cache).
GB/s count the bytes that the kernel's ``// cost`` line declares, without cache reuse, so that a share of the triad
may exceed 100 %; "once" is the time that a triad needs for every array the launch takes, each once, over the
kernel's own: what is left to 100 % is what perfect reuse could still gain. Results are checked after timing:
against numpy where a model exists (kernel_models.py), and by repeating from the same start to the same bits.

Three to five minutes on two cores; --quick under 20 seconds. Exits with 1 where a target is missed or a result is
wrong; --quick judges results alone.
"""

from __future__ import annotations

import argparse
import sys
from collections import defaultdict
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import problems
from kernel_models import verify
from measuring import Launch, Recorder, Triad, hardware, paired
from outputs import Target, add_outputs, print_targets, write_outputs

from clsss import DirectionalLight, Material, Mix, Perlin, cutcell, diffusion, octree, source
from clsss.anderson import Anderson
from clsss.device import Buffer
from clsss.dipole import dipole
from clsss.exchange import trace_exchange
from clsss.fields import Field
from clsss.fresnel import fresnel_A
from clsss.interreflection import PatchMatrices, coupled
from clsss.layer import fitted_layer
from clsss.lighting import Setup, light
from clsss.montecarlo import estimate
from clsss.multigrid import Multigrid
from clsss.refinement import varies
from clsss.surface import fluence_at, shares_at
from clsss.winding import winding_number

RADIUS = 10.0  # mm
WHOLE_CYCLE = "V(2,2) and residual"
AT_LEAST = {
    "smooth": "smoother",
    "residual": "residual",
    "leave_residual": "restriction",
    "restrict_residual": "restriction",
    "prolong": "prolongation",
}
OF_LEAVES = ("residual_of_leaves", "deposit_coarse")  # have no work where no coarser cell is a leaf
SHARE, UNITS = 50.0, 1.5  # % of the triad for each of these; and u for a whole cycle
BIGGEST = 128
IN_BOX = 115  # cells across a ball of radius 0.45 in a box of 128: 0.83 million, on which a whole cycle is judged


@dataclass(frozen=True)
class Row:
    """One kernel, or a whole cycle, on one ball."""

    kernel: str
    cells: int
    medium: str
    n: int
    milliseconds: float
    gb_per_s: float
    share: float  # of the triad, by the declared bytes [%]
    once: float  # of the triad, by every array once [%]
    flop_per_byte: float
    check: str

    def __str__(self) -> str:
        return (f"{self.kernel:<22} {self.cells:>4} {self.medium:<13} {self.n:>9} {self.milliseconds:>9.3f} "
                f"{self.gb_per_s:>7.1f} {self.share:>6.0f} {self.once:>6.0f}  {self.check}")  # fmt: skip


HEADER = (f"{'kernel':<22} {'ball':>4} {'medium':<13} {'items':>9} {'ms':>9} {'GB/s':>7} {'% tri':>6} {'% once':>6}  "
          "check")  # fmt: skip
MEDIA: dict[str, Any] = {
    "homogeneous": Material(sigma_a=(0.002, 0.004, 0.007), sigma_s=(2.2, 2.6, 3.0), eta=1.5),
    "heterogeneous": Mix(
        Material(sigma_a=(0.002, 0.004, 0.007), sigma_s=(2.2, 2.6, 3.0), eta=1.5),
        Material(sigma_a=(0.03, 0.02, 0.01), sigma_s=(1.0, 1.2, 1.4), eta=1.5),
        Perlin(scale=RADIUS / 2, seed=1),
    ),
}


def pipeline(device: Recorder, cells: int, medium: Any, adaptive: bool) -> tuple[Multigrid, Field]:
    """Everything that a bake runs on the device; the multigrid and a right-hand side."""
    mesh = problems.round_ball(RADIUS, 6)
    grid = cutcell.make_grid(mesh.bounds, cells)
    refine = varies(medium) if adaptive else None
    tree = octree.build(device, grid, cutcell.sample_surface(device, grid, mesh), refine)
    sampled = diffusion.sample_medium(device, tree, medium, fresnel_A(medium.eta))
    mg = Multigrid(device, diffusion.make_operator(device, tree, sampled))
    found = source.make_source(device, tree, sampled, [DirectionalLight((0.3, -1, 0.2))], 1.0)
    phi = Field(device, tree)
    mg.solve(found.b, phi, 1e-4, max_cycles=2)
    phi_B = mg.residual.boundary_value(phi, found.moment)
    fluence_at(device, tree, phi_B, mesh.vertices, mesh.normals)
    device.finish()
    return mg, found.b


def besides(device: Recorder, cells: int, name: str) -> None:
    """Everything that a bake of a ball does not run: plates with gaps, a medium that absorbs and jumps, references."""
    plain, mesh = MEDIA["homogeneous"], problems.shape("stack 2.2h", cells)
    dark = Material(sigma_a=0.2, sigma_s=0.5, eta=1.3)
    medium: Any = dark if name == "homogeneous" else Mix(dark, Material(0.05, 3.0, eta=1.3), lambda x: x[:, 0] > 0)
    grid = cutcell.make_grid(mesh.bounds, problems.cells_along(mesh))
    tree = octree.build(device, grid, cutcell.sample_surface(device, grid, mesh), varies(medium))
    sampled = diffusion.sample_medium(device, tree, medium, fresnel_A(medium.eta))
    layer, exchange = fitted_layer(device, tree, sampled), trace_exchange(tree, medium.eta)
    assert exchange
    mg, coupling = coupled(device, diffusion.make_operator(device, tree, sampled), PatchMatrices(device, exchange))
    at_vertices = shares_at(device, tree, mesh.vertices, mesh.normals)
    setup = Setup(device, mesh, tree, sampled, mg, layer, coupling, at_vertices, (), None, True, 1e-4, 0)
    sun = DirectionalLight((0.3, -1, 0.2))
    light(setup, (sun,), None, defaultdict(float), lambda stage, share: None)
    for k in range(1, len(mg.e)):  # one by one, as cycles take only levels of many cells
        mg.smooth(k)
        mg.restrict(k)
    anderson = Anderson(device, Field(device, tree), mg.r, None)
    for _ in range(2):
        anderson.measure()
        anderson.combine()
        anderson.add_correction(mg.e)
    winding_number(device, mesh.triangles, mesh.vertices)
    if name == "homogeneous":
        ball = problems.round_ball(RADIUS, 3)
        for hierarchical in (True, False):
            dipole(ball, plain, [sun], hierarchical=hierarchical, device=device)
        for forward in (True, False):
            matched = replace(plain, eta=1.0)
            estimate(ball, matched, [sun], cells, ball.vertices[:cells], forward=forward, device=device)
    device.finish()


def touched(launch: Launch) -> int:
    """Bytes of all arrays of a launch, each once; half of them where it takes one colour."""
    arrays = {id(v.data): v.nbytes for v in launch.named().values() if isinstance(v, Buffer)}
    return sum(arrays.values()) // (2 if "first" in launch.parameters else 1)


def check(launch: Launch) -> str:
    """Repeat the launch from the same start: the same bits, and what numpy says."""
    launch.restore()
    before = launch.host()
    results = []
    for _ in range(2):
        launch.restore()
        launch.run()
        results.append(launch.host())
    name = launch.kernel.function_name
    for key in () if name.startswith("list_") else launch.before:  # lists fill in any order
        if not np.array_equal(results[0][key], results[1][key], equal_nan=True):
            return f"WRONG: {key} differs between two runs"
    found = verify(name, before, results[0], float(np.finfo(launch.device.real).eps))
    return f"WRONG: {found}" if "off" in found else found or "same bits"


def measure(device: Recorder, triad: Triad, launch: Launch, cells: int, medium: str, rounds: int) -> Row:
    """Time a launch next to the triad, then check it."""
    nbytes, flop = launch.cost()
    left = launch.written()  # other kernels may need it as it was left
    once = partial(triad.unit, device.seconds, touched(launch))
    seconds, units = paired(once, partial(device.seconds, launch.run, launch.restore), rounds)
    verdict = check(launch)
    launch.restore(left)
    return Row(launch.kernel.function_name, cells, medium, launch.n, 1e3 * seconds, nbytes / seconds * 1e-9,
               1e-7 * nbytes / units, 1e-7 * touched(launch) / units, flop / nbytes, verdict)  # fmt: skip


def measure_cycle(device: Recorder, triad: Triad, mg: Multigrid, b: Field, rounds: int) -> tuple[float, float]:
    """Seconds of one residual with its V(2,2), launches included, and the same in u."""
    phi = Field(device, mg.op.octree)

    def work() -> None:
        mg.residual(phi, b, mg.r)
        mg.v_cycle(len(mg.e) - 1)
        mg.combine(1, mg.e, 1, phi)

    cycle, timer = device.capture(work), device.seconds_with_launches
    return paired(partial(triad.unit, timer), partial(timer, cycle), rounds)


def tell_cycle(device: Recorder, triad: Triad, mg: Multigrid, b: Field, medium: str, rounds: int) -> float:
    """Print what a whole cycle takes, and give it in u."""
    seconds, units = measure_cycle(device, triad, mg, b, rounds)
    ball = f"uniform ball, {mg.op.octree.finest.n * 1e-6:.2f} M cells, {medium}"
    print(f"{WHOLE_CYCLE}, {ball}: {1e3 * seconds:.2f} ms, {units:.2f} u", flush=True)
    return units


def bench(device: Recorder, triad: Triad, cells: int, name: str, rounds: int) -> tuple[list[Row], float]:
    """All kernels on one ball, the slowest first; and what a whole cycle takes, in u."""
    device.launches.clear()
    device.recording = True
    mg, b = pipeline(device, cells, MEDIA[name], adaptive=False)
    for kernel in OF_LEAVES:
        device.launches.pop(kernel, None)
    pipeline(device, cells, MEDIA[name], adaptive=True)
    of_ball, device.launches = device.launches, {}
    besides(device, cells, name)
    device.launches = {**device.launches, **of_ball}
    device.recording = False
    rows = [measure(device, triad, launch, cells, name, rounds) for launch in device.launches.values()]
    rows.sort(key=lambda row: -row.milliseconds)
    units = tell_cycle(device, triad, mg, b, name, rounds)
    for row in rows:
        print(row, flush=True)
    return rows, units


def targets(rows: list[Row], cycles: dict[tuple[int, str], float]) -> list[Target]:
    """The figures that the project promises: kernels on the biggest ball, whole cycles on that in a box."""
    out = []
    for label in dict.fromkeys(AT_LEAST.values()):
        for medium in MEDIA:
            kernels = [r for r in rows if AT_LEAST.get(r.kernel) == label and (r.medium, r.cells) == (medium, BIGGEST)]
            time = sum(row.milliseconds for row in kernels)
            share = sum(row.share * row.milliseconds for row in kernels) / time if kernels else None
            name = f"{label}, {medium}, ball {BIGGEST}: share of the triad"
            out.append(Target(name, share, SHARE, "%", at_least=True))
    out.append(Target(f"{WHOLE_CYCLE}, uniform ball, 0.83 M cells", cycles.get((IN_BOX, "homogeneous")), UNITS, "u"))
    return out


def draw(rows: list[Row], bandwidth: float, path: Path) -> None:
    """A roofline: GB/s times flop per byte against flop per byte, below the triad's slope."""
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(9, 6))
    biggest = max(row.cells for row in rows)
    for medium, marker in zip(MEDIA, "os", strict=True):
        here = [row for row in rows if row.medium == medium and row.cells == biggest]
        x = np.array([row.flop_per_byte for row in here])
        y = np.array([row.gb_per_s for row in here]) * x
        axes.plot(x, y, marker, label=medium, alpha=0.6)
        if medium == "homogeneous":
            for row, at, height in zip(here, x, y, strict=True):
                axes.annotate(row.kernel, (at, height), fontsize=6, xytext=(3, 2), textcoords="offset points")
    span = np.array([max(min(row.flop_per_byte for row in rows), 0.02), max(row.flop_per_byte for row in rows)])
    axes.loglog(span, bandwidth * span, "k-", label=f"triad, {bandwidth:.1f} GB/s")
    axes.set(xlabel="declared flop per byte", ylabel="Gflop/s", title=f"Kernels on a ball of {biggest} cells")
    axes.legend()
    figure.savefig(path, dpi=150)
    plt.close(figure)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="small balls, few repeats, under 20 seconds")
    parser.add_argument("--sizes", type=int, nargs="+", metavar="N", help="balls to run, in cells across")
    parser.add_argument("--rounds", type=int, help="repeats of each kernel")
    parser.add_argument("--precision", choices=("single", "double"), default="single")
    parser.add_argument("--device", help="part of an OpenCL device's name")
    parser.add_argument("--busy", action="store_true", help="count processor time: other work runs on this CPU")
    add_outputs(parser, "a roofline")
    args = parser.parse_args()
    sizes = args.sizes or ([32] if args.quick else [32, 64, BIGGEST])
    rounds = args.rounds or (3 if args.quick else 11)
    device = Recorder(args.device, args.precision, args.busy)
    if args.busy and not device.is_cpu:
        parser.error("--busy: processor time tells nothing of a GPU")
    triad = Triad(device)
    about = hardware(device)
    print(", ".join(f"{key} {value}" for key, value in about.items()))
    bandwidth = 1 / float(np.median([triad.unit(device.seconds) for _ in range(rounds)]))
    print(f"triad {bandwidth:.1f} GB/s over {triad.n * triad.row / 1e6:.0f} MB\n\n{HEADER}")
    rows: list[Row] = []
    cycles: dict[tuple[int, str], float] = {}
    for cells in sizes:
        for name in MEDIA:
            found, cycles[cells, name] = bench(device, triad, cells, name, rounds)
            rows += found
    if BIGGEST in sizes:
        in_box = pipeline(device, IN_BOX, MEDIA["homogeneous"], adaptive=False)
        cycles[IN_BOX, "homogeneous"] = tell_cycle(device, triad, *in_box, "homogeneous", rounds)
    wrong = sum(row.check.startswith("WRONG") for row in rows) + (not triad.check())
    goals = targets(rows, cycles)
    missed = print_targets(goals)
    print(f"\n{wrong} wrong results, {missed} targets missed")
    figures = {"hardware": about, "triad_gb_per_s": bandwidth, "kernels": [asdict(row) for row in rows],
               "cycles": [{"cells": c, "medium": m, "u": u} for (c, m), u in cycles.items()]}  # fmt: skip
    write_outputs(args, figures, goals, "roofline.png", partial(draw, rows, bandwidth))
    return 1 if wrong or (missed and not args.quick) else 0


if __name__ == "__main__":
    sys.exit(main())
