"""How long do whole bakes take, where does the time go, and what do others need for the same equations?

    python apps/bench_bake.py [MESH ...] [--sizes N ...] [--repeats N] [--quick] [--json FILE] [--out FOLDER]

Bakes each mesh at each resolution in a process of its own, then lights it again from other sides. Meshes: "demo",
"ball", or files; by default the first two, and the scans of the folder CLSSS_SHARED where that is set (their
targets are not judged otherwise). Seconds per stage, cells, cycles, memory, and how set-up and solve grow with the
number of cells. u is the time that a triad needs to move 1 GB, measured just before and after each bake. PyAMG, where
it is installed (pip install clsss[bench]), solves exactly the matrix that the two-point operator is.

Seven minutes on two cores with the scans; --quick under 40 seconds. Exits with 1 where a target is missed; --quick
judges none that needs more than it runs.
"""

from __future__ import annotations

import argparse
import importlib.util
import multiprocessing
import os
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, field
from functools import partial
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
import problems
from measuring import bandwidth_unit, hardware, peak_rss, unpacked_bytes
from outputs import Target, add_outputs, print_targets, write_outputs
from peers import Comparison, compare

from clsss import DirectionalLight, Mesh, Mix, Perlin, load_mesh, material, simulate
from clsss.device import Device

SIZE = 20.0  # mm, of every mesh
USUAL = 128  # resolution from which memory per cell is judged: below, what does not grow with the cells dominates
STAGES = ("load", "device", "cutcells", "octree", "exchange", "source", "solve", "surface")
SET_UP = ("cutcells", "octree", "exchange")
LIGHT, *OTHER_LIGHTS = (DirectionalLight(d) for d in (
    (0.3, -1, -0.4), (-1, -0.3, 0.2), (0.2, 0.4, -1), (0.5, 1, 0.3), (1, -0.2, 0.6), (-0.3, 0.1, 1)))  # fmt: skip
DRAGON, BIG_DRAGON = "dragon_201k_clean.ply", "dragon_871k_full.ply.gz"
SCANS = (DRAGON, "bunny_69k_holes.ply", "lucy_100k.ply")


@dataclass(frozen=True)
class Job:
    """One bake."""

    mesh: str
    resolution: int
    heterogeneous: bool = False
    tolerance: float = 1e-4


@dataclass
class Bake:
    """What one bake took: seconds by stage, bytes, and the machine's u around it."""

    job: Job
    u: float  # s/GB
    seconds: dict[str, float]
    whole: float  # from the file to the vertices' colours [s]
    relight: float
    faces: int
    cells: int
    leaves: int
    cycles: int
    relight_cycles: int
    converged: bool
    device_bytes: float
    peak_rss: float
    file_bytes: int = 0  # of the mesh, unpacked; 0 where it came from none
    process: float = field(default=0.0)  # with the start of Python and the build of kernels [s]

    @property
    def bytes_per_cell(self) -> float:
        """Most device memory held at once, bake and relight, over the cells of all levels."""
        return self.device_bytes / self.cells

    @property
    def set_up(self) -> float:
        """Seconds from triangles to the operator and the exchange."""
        return sum(self.seconds.get(stage, 0.0) for stage in SET_UP)

    def __str__(self) -> str:
        stages = " ".join(f"{self.seconds.get(stage, 0.0):>8.2f}" for stage in STAGES)
        name = self.job.mesh.rsplit("/", 1)[-1][:22] + (" (two)" if self.job.heterogeneous else "")
        return (f"{name:<28} {self.job.resolution:>4} {stages} {self.whole:>7.2f} {self.relight:>7.2f} {self.u:>6.3f} "
                f"{self.cells / 1e3:>7.0f}k {self.cycles:>3}/{self.relight_cycles:<2} {self.bytes_per_cell:>6.0f} "
                f"{self.peak_rss / 1e6:>6.0f}")  # fmt: skip


HEADER = (f"{'mesh':<28} {'res':>4} " + " ".join(f"{stage:>8}" for stage in STAGES)
          + f" {'whole':>7} {'relight':>7} {'u':>6} {'cells':>8} {'cycles':<6} {'B/cell':>6} {'RSS':>6}")  # fmt: skip


def read(name: str) -> Mesh:
    """A mesh by name, longest side `SIZE`."""
    if name == "demo":
        from clsss.demo import demo_mesh

        return load_mesh(demo_mesh(), size=SIZE)
    if name == "ball":
        return load_mesh(problems.ball(SIZE / 2, subdivisions=6), size=SIZE)
    return load_mesh(name, size=SIZE)


def bake(job: Job) -> Bake:
    """Bake, timed from the file on, and relight; a relight is so short that the median of some counts."""
    marble = material("marble")
    medium = Mix(marble, material("skimmilk"), Perlin(scale=SIZE / 4, seed=1)) if job.heterogeneous else marble
    start = perf_counter()
    mesh = read(job.mesh)
    loaded = perf_counter()
    result = simulate(mesh, medium, [LIGHT], resolution=job.resolution, tolerance=job.tolerance)
    report, again, times, cycles = result.report, result, [perf_counter()], []
    for light in OTHER_LIGHTS:
        again = again.relight([light])
        times.append(perf_counter())
        cycles.append(again.report["solve"]["cycles"])
    octree, solve, peak = report["octree"], report["solve"], peak_rss()
    return Bake(job, bandwidth_unit(), {**report["seconds"], "load": loaded - start}, times[0] - start,
                statistics.median(np.diff(times)), report["mesh"]["faces"], octree["cells"], octree["leaves"],
                solve["cycles"], statistics.median(cycles), solve["converged"],
                again.report["memory_mb"]["device"] * 2**20, peak, unpacked_bytes(job.mesh))  # fmt: skip


def in_own_process(work: Callable[..., Any], *arguments: Any) -> Any:
    """Call in a fresh process: its memory is its own, its kernels come from the driver's cache or not at all."""
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as pool:
        return pool.submit(work, *arguments).result()


def repeated(job: Job, repeats: int) -> Bake:
    """The run of median length of several."""
    runs = []
    for _ in range(repeats):
        before, start = bandwidth_unit(), perf_counter()
        run = in_own_process(bake, job)
        run.process, run.u = perf_counter() - start, (before + run.u) / 2
        runs.append(run)
    return sorted(runs, key=lambda run: run.whole / run.u)[(repeats - 1) // 2]


def first_run_costs() -> float:
    """Seconds that a bake in a new process takes longer while the driver's kernel cache is still empty."""
    job = Job("ball", 24)
    before = os.environ.get("POCL_CACHE_DIR")
    with tempfile.TemporaryDirectory() as empty:
        os.environ["POCL_CACHE_DIR"] = empty
        try:
            times = [repeated(job, 1).process for _ in range(2)]
        finally:
            if before is None:
                del os.environ["POCL_CACHE_DIR"]
            else:
                os.environ["POCL_CACHE_DIR"] = before
    return times[0] - times[1]


def view_help_seconds(repeats: int) -> float:
    """Median seconds of ``python -m clsss.view --help``."""
    times = []
    for _ in range(repeats):
        start = perf_counter()
        subprocess.run([sys.executable, "-m", "clsss.view", "--help"], check=True, stdout=subprocess.DEVNULL)
        times.append(perf_counter() - start)
    return statistics.median(times)


def exponents(bakes: list[Bake]) -> dict[str, dict[str, float]]:
    """For each mesh, p in seconds ~ leaves^p of set-up and solve."""
    out = {}
    for name in dict.fromkeys(b.job.mesh for b in bakes if not b.job.heterogeneous):
        runs = [b for b in bakes if b.job.mesh == name and not b.job.heterogeneous]
        if len({b.job.resolution for b in runs}) < 2:
            continue
        size = np.log([b.leaves for b in runs])
        out[name] = {
            "set-up": float(np.polyfit(size, np.log([b.set_up / b.u for b in runs]), 1)[0]),
            "solve": float(np.polyfit(size, np.log([b.seconds["solve"] / b.u for b in runs]), 1)[0]),
        }
    return out


def targets(bakes: list[Bake], growth: dict[str, dict[str, float]], comparison: Comparison | None, first_run: float,
            libraries: float, view_help: float, judged: bool) -> list[Target]:  # fmt: skip
    """The figures that the project promises; those that `judged` forbids have no figure.

    `libraries` is the host memory of a process that baked next to nothing.
    """

    def of(name: str, resolution: int, value: Callable[[Bake], float]) -> float | None:
        found = [value(b) for b in bakes if b.job.mesh.endswith(name) and b.job.resolution == resolution]
        return found[0] if found else None

    def worst(values: list[float]) -> float | None:
        return max(values) if values and judged else None

    def memory(heterogeneous: bool) -> float | None:
        at = [b for b in bakes if b.job.heterogeneous == heterogeneous and b.job.resolution >= USUAL]
        return worst([b.bytes_per_cell for b in at])

    return [
        Target("dragon at 128: solve to 1e-4", of(DRAGON, 128, lambda b: b.seconds["solve"] / b.u), 4, "u"),
        Target("dragon at 128: relight", of(DRAGON, 128, lambda b: b.relight / b.u), 5, "u"),
        Target("dragon at 256: relight", of(DRAGON, 256, lambda b: b.relight / b.u), 25, "u"),
        Target("dragon, 201K faces, at 128: file to colours", of(DRAGON, 128, lambda b: b.whole / b.u), 75, "u"),
        Target("dragon, 871K faces, at 128: file to colours", of(BIG_DRAGON, 128, lambda b: b.whole / b.u), 200, "u"),
        Target("first run ever: kernels to build", first_run, 10, "s"),
        Target("growth of set-up with cells, worst mesh", worst([g["set-up"] for g in growth.values()]), 1.1),
        Target("growth of solve with cells, worst mesh", worst([g["solve"] for g in growth.values()]), 1.1),
        Target("device memory per cell from 128 on, homogeneous", memory(False), 220, "B"),
        Target("device memory per cell from 128 on, heterogeneous", memory(True), 320, "B"),
        Target("host memory over libraries', of 6 times the mesh's file and the device's",
               worst([(b.peak_rss - libraries) / (6 * b.file_bytes + b.device_bytes) for b in bakes if b.file_bytes]),
               1, "x"),
        Target("solve to 1e-6, 3 channels: times faster than PyAMG's best",
               comparison.speedup if comparison and judged else None, 20, "x", True),
        Target("python -m clsss.view --help", view_help, 0.3, "s"),
    ]  # fmt: skip


def jobs(args: argparse.Namespace) -> list[Job]:
    """What to bake."""
    if args.quick and not args.mesh:
        return [Job("ball", 32), Job("ball", 64), Job("ball", 32, True), Job("demo", 48)]
    shared = os.environ.get("CLSSS_SHARED")
    folder = Path(shared or "") / "meshes"
    names = args.mesh or ["demo", "ball", *(str(folder / name) for name in SCANS if shared)]
    sizes = args.sizes or ([32, 64] if args.quick else [64, USUAL, 256, 384])
    out = [Job(name, size) for name in names for size in sizes]
    out += [Job(names[0], size, True) for size in sizes[:2]]
    if shared and not args.mesh:
        out.append(Job(str(folder / BIG_DRAGON), USUAL))
    return out


def draw(bakes: list[Bake], path: Path) -> None:
    """Seconds of set-up and solve against leaves."""
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(7, 5))
    for name in dict.fromkeys(b.job.mesh for b in bakes):
        runs = [b for b in bakes if b.job.mesh == name and not b.job.heterogeneous]
        leaves, label = [b.leaves for b in runs], name.rsplit("/", 1)[-1]
        (line,) = axes.loglog(leaves, [b.set_up for b in runs], "o-", label=f"{label}: set-up")
        axes.loglog(leaves, [b.seconds["solve"] for b in runs], "s--", color=line.get_color(), label=f"{label}: solve")
    axes.set(xlabel="leaves", ylabel="seconds")
    axes.legend(fontsize=7)
    figure.savefig(path, dpi=150)
    plt.close(figure)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("mesh", nargs="*", help='"demo", "ball" or a mesh file')
    parser.add_argument("--sizes", type=int, nargs="+", metavar="N", help="resolutions; by default 64 128 256 384")
    parser.add_argument("--quick", action="store_true", help="32 and 64 cells, under 40 seconds")
    parser.add_argument("--repeats", type=int, metavar="N", help=f"runs of each bake of up to {USUAL} cells, the "
                        "median one of which counts; by default 3, 1 if --quick")
    add_outputs(parser, "how the stages grow")
    args = parser.parse_args()
    args.repeats = args.repeats or (1 if args.quick else 3)
    about = hardware(Device())
    print(", ".join(f"{key} {value}" for key, value in about.items()))
    first_run = first_run_costs()
    for rarer in (Job("ball", 24, True), Job("demo", 48 if args.quick else USUAL, tolerance=1e-6)):
        in_own_process(bake, rarer)  # the driver's cache gets the kernels of mixed materials and of slow cycles
    libraries = in_own_process(bake, Job("ball", 8)).peak_rss
    print(HEADER)
    bakes = []
    for job in jobs(args):
        bakes.append(repeated(job, args.repeats if job.resolution <= USUAL else 1))
        print(bakes[-1], flush=True)
    growth = exponents(bakes)
    for name, p in growth.items():
        print(f"{name.rsplit('/', 1)[-1]}: set-up ~ leaves^{p['set-up']:.2f}, solve ~ leaves^{p['solve']:.2f}")
    peers = importlib.util.find_spec("pyamg")
    comparison = in_own_process(compare, 32 if args.quick else USUAL, 1e-6) if peers else None
    print(comparison or "PyAMG is not installed: pip install clsss[bench]")
    view_help = view_help_seconds(3 if args.quick else 7)
    goals = targets(bakes, growth, comparison, first_run, libraries, view_help, not args.quick)
    missed = print_targets(goals)
    figures = {"hardware": about, "bakes": [asdict(b) for b in bakes], "growth": growth,
               "first_run_seconds": first_run, "peers": comparison and asdict(comparison)}  # fmt: skip
    write_outputs(args, figures, goals, "bakes.png", partial(draw, bakes))
    return 1 if missed and not args.quick else 0


if __name__ == "__main__":
    sys.exit(main())
