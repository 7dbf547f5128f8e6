"""What the benchmarks share: the triad that times are measured against, launches to repeat, the machine.

A share is taken between a kernel and a triad that ran moments apart, over and over, and is the median of those
ratios: other work on the machine slows both.
"""

from __future__ import annotations

import gzip
import os
import re
import statistics
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from time import perf_counter, process_time, thread_time
from typing import Any

import numpy as np

from clsss.device import Buffer, Device
from clsss.kernelsource import KERNEL_DIR, kernel_source

CACHES = 6  # size of a triad's arrays together, in the device's last cache
LEAST_BYTES = 96 << 20  # likewise, at least
PATIENCE = 2.0  # s
LEAST_PIECE = 8 << 20  # bytes of a triad that is timed next to a short kernel
_TRIAD = """__kernel void triad(const int first, const int n, const REAL s, __global const REAL4 *restrict b,
                                __global const REAL4 *restrict c, __global REAL4 *restrict a)
            { const int i = first + get_global_id(0); if (i < first + n) a[i] = b[i] + s * c[i]; }"""
_COST = re.compile(r"// cost (\w+): ([\dRCM+]+) B, (\d+) flop")


class Recorder(Device):
    """A device that times what it runs, and keeps the largest launch of every kernel.

    With each it keeps what the kernel was about to overwrite: repeated from there, a launch does the same again.
    On a `busy` machine it counts the processor time of a CPU device's threads, over their number, not the clock's.
    """

    def __init__(self, name: str | None = None, precision: str = "single", busy: bool = False):
        import pyopencl as cl

        super().__init__(name, precision)
        self.busy = busy
        self.queue = cl.CommandQueue(self.context, properties=cl.command_queue_properties.PROFILING_ENABLE)
        self.launches: dict[str, Launch] = {}
        variants: tuple[tuple[str, ...], ...] = ((), ("HETEROGENEOUS",), ("HETEROGENEOUS", "FITTED"))
        self.costs = {defines: declared_costs(self.real.itemsize, defines) for defines in variants}
        self._sources: dict[Any, tuple[str, tuple[str, ...]]] = {}
        self.recording = True

    def kernel(self, file: str, name: str, *defines: str) -> Any:
        """As `Device.kernel`."""
        kernel = super().kernel(file, name, *defines)
        if kernel not in self._sources:
            self._sources[kernel] = (kernel_source(f"{file}.cl"), defines)
        return kernel

    def run(self, kernel: Any, n: int, *arguments: Any, group: int | None = None) -> None:
        """As `Device.run`."""
        if self.recording and n > 0 and kernel in self._sources:
            name = kernel.function_name
            if name not in self.launches or self.launches[name].n < n:
                self.launches[name] = Launch(self, kernel, *self._sources[kernel], n, arguments, group)
        super().run(kernel, n, *arguments, group=group)

    def capture(self, work: Callable[[], Any]) -> Callable[[], Any]:
        """As `Device.capture`; while it records, what is launched each time anew."""
        return work if self.recording else super().capture(work)

    def seconds(self, work: Callable[[], Any], before: Callable[[], Any] = lambda: None) -> float:
        """Time on the device of all that `work` enqueues, `before` done and the queue filled before it starts."""
        import pyopencl as cl

        before()
        if self.busy:
            self.queue.finish()
            start = process_time() - thread_time()
            work()
            self.queue.finish()
            return (process_time() - thread_time() - start) / self.handle.max_compute_units
        gate = cl.UserEvent(self.context)
        cl.enqueue_barrier(self.queue, wait_for=[gate])
        first = cl.enqueue_marker(self.queue)
        work()
        last = cl.enqueue_marker(self.queue)
        gate.set_status(cl.command_execution_status.COMPLETE)
        self.queue.finish()
        return (last.profile.end - first.profile.end) * 1e-9

    def seconds_with_launches(self, work: Callable[[], Any]) -> float:
        """From the host's first call to the device's last work; all threads' processor time where it is `busy`."""
        self.queue.finish()
        clock, share = (process_time, 1 / self.handle.max_compute_units) if self.busy else (perf_counter, 1.0)
        start = clock()
        work()
        self.queue.finish()
        return (clock() - start) * share


@dataclass(eq=False)
class Launch:
    """One launch of a kernel, to repeat."""

    device: Recorder
    kernel: Any
    source: str
    defines: tuple[str, ...]
    n: int
    arguments: tuple[Any, ...]
    group: int | None
    parameters: dict[str, bool] = field(init=False)  # name: whether the kernel may write to it
    before: dict[str, Buffer] = field(init=False)

    def __post_init__(self) -> None:
        self.parameters = parameters(self.source, self.kernel.function_name, self.defines)
        assert len(self.parameters) == len(self.arguments), self.kernel.function_name
        self.before = self.written()

    def named(self) -> dict[str, Any]:
        """Arguments by the names of the kernel's source."""
        return dict(zip(self.parameters, self.arguments, strict=True))

    def written(self) -> dict[str, Buffer]:
        """Copies of what the kernel may write to."""
        copies = {}
        for name, value in self.named().items():
            if self.parameters[name] and isinstance(value, Buffer):
                copies[name] = self.device.empty(value.shape, value.dtype)
                copies[name].copy_from(value)
        return copies

    def restore(self, copies: dict[str, Buffer] | None = None) -> None:
        """Undo what the kernel wrote; or put back what `written` gave."""
        named = self.named()
        for name, contents in (self.before if copies is None else copies).items():
            named[name].copy_from(contents)

    def run(self) -> None:
        """Once more."""
        Device.run(self.device, self.kernel, self.n, *self.arguments, group=self.group)

    def host(self) -> dict[str, Any]:
        """Arguments by name, buffers as arrays."""
        return {name: v.get() if isinstance(v, Buffer) else v for name, v in self.named().items()}

    def cost(self) -> tuple[int, int]:
        """Declared bytes and flop of the whole launch."""
        per_item, flop = self.device.costs[self.defines][self.kernel.function_name]
        return self.n * per_item, self.n * flop


def parameters(source: str, kernel: str, defines: tuple[str, ...]) -> dict[str, bool]:
    """Names of a kernel's parameters in order, and whether each is memory that it may write to."""
    macros: dict[str, str] = {}
    active = [True]
    for line in source.replace("\\\n", " ").splitlines():
        if line.startswith("#if"):
            active.append(line.split()[1] in defines if line.startswith("#ifdef") else True)
        elif line.startswith("#else"):
            active[-1] = not active[-1]
        elif line.startswith("#endif"):
            active.pop()
        elif all(active) and (found := re.match(r"#define (\w+)(?:\(\w+\))? (.+)", line)):
            macros[found[1]] = found[2]
    head = re.search(rf"__kernel\s+void\s+{kernel}\s*\((.*?)\)\s*{{", source, re.S)
    assert head, kernel
    text = head[1]
    several = r"\b(BODY|TREE|MEDIUM|EXTINCTION|COND|TWO_POINT)\b"
    for _ in range(2):  # a body's arguments hold those of its extinction
        text = re.sub(several, lambda m: macros.get(m[0], m[0]), text)
        text = re.sub(r"\b(MATRIX|PLACES)\((\w+)\)", lambda m: re.sub(r"\bm\b(##)?", m[2], macros[m[1]]), text)
    declared = [" ".join(part.split()) for part in text.split(",")]
    return {d.split()[-1].lstrip("*"): d.startswith("__global") and "const" not in d.split() for d in declared}


def declared_costs(size_of_real: int, defines: tuple[str, ...] = ()) -> dict[str, tuple[int, int]]:
    """Bytes and flop per work-item of the ``// cost`` lines: R a real, C a conductance, M a medium's coefficient."""
    varies = "HETEROGENEOUS" in defines
    sizes = {"R": size_of_real, "C": size_of_real * (3 if varies else 1), "M": size_of_real * 3 * varies, "": 1}
    costs = {}
    for path in sorted(KERNEL_DIR.glob("*.cl")):
        for name, terms, flop in _COST.findall(path.read_text()):
            parts = [re.fullmatch(r"(\d*)([RCM]?)", term) for term in terms.split("+")]
            costs[name] = (sum(int(p[1] or 1) * sizes[p[2]] for p in parts if p), int(flop))
    return costs


class Triad:
    """a = b + s c over arrays much larger than the cache; 12 or 24 bytes an element.

    Timed in pieces that go round the arrays, so that none is in the cache when its turn comes: where other work
    shares the machine, what took as long got as much of it.
    """

    def __init__(self, device: Device):
        import pyopencl as cl

        cache = device.handle.global_mem_cache_size
        self.device = device
        self.row = 3 * 4 * device.real.itemsize
        self.n = max(LEAST_BYTES, CACHES * cache) // self.row
        self.a, self.b, self.c = device.zeros((self.n, 4)), device.zeros((self.n, 4)), device.zeros((self.n, 4))
        self.b.fill(1)
        self.c.fill(2)
        define = "#define REAL4 " + ("float4" if device.precision == "single" else "double4") + "\n"
        real = f"-DREAL={'float' if device.precision == 'single' else 'double'}"
        self._kernel = cl.Kernel(cl.Program(device.context, define + _TRIAD).build([real]), "triad")
        self._first = 0

    def unit(self, timer: Callable[[Callable[[], Any]], float], nbytes: float = float("inf")) -> float:
        """u: seconds that it needs to move 1 GB, from a piece of about `nbytes`."""
        n = int(min(max(nbytes, LEAST_PIECE) / self.row, self.n))
        if self._first + n > self.n:
            self._first = 0
        first, self._first = self._first, self._first + n
        work = partial(Device.run, self.device, self._kernel, n, first, n, 3.0, self.b, self.c, self.a)
        return timer(work) / (n * self.row) * 1e9

    def check(self) -> bool:
        """Whether it computed what it should."""
        return bool((self.a.get() == 7).all())


def paired(triad: Callable[[], float], work: Callable[[], float], rounds: int) -> tuple[float, float]:
    """Median seconds of `work`, and the same in u: the median of its ratio to u just before and just after it.

    The first run of `work` is dropped; at least three rounds, no more once they took `PATIENCE`.
    """
    work()
    times: list[float] = []
    ratios: list[float] = []
    before = triad()
    while len(times) < rounds and (len(times) < 3 or sum(times) < PATIENCE):
        times.append(work())
        after = triad()
        ratios.append(times[-1] / ((before + after) / 2))
        before = after
    return statistics.median(times), statistics.median(ratios)


def bandwidth_unit(repeats: int = 5) -> float:
    """The unit u on the best device, the median of `repeats`."""
    recorder = Recorder()
    triad = Triad(recorder)
    return statistics.median([triad.unit(recorder.seconds) for _ in range(repeats + 1)][1:])


def hardware(device: Device) -> dict[str, Any]:
    """What the figures belong to."""
    try:
        found = re.search(r"model name\s*:\s*(.+)", Path("/proc/cpuinfo").read_text())
    except OSError:
        found = None
    return {
        "cpu": found[1].strip() if found else "unknown",
        "cores": os.cpu_count(),
        "load": round(os.getloadavg()[0], 1),
        "device": device.name,
        "compute_units": device.handle.max_compute_units,
        "driver": f"{device.platform} {device.handle.driver_version}",
        "precision": device.precision,
        "numpy": np.__version__,
    }


def peak_rss() -> float:
    """Most memory that this process had resident [B]; getrusage would start from its parent's."""
    try:
        found = re.search(r"VmHWM:\s*(\d+) kB", Path("/proc/self/status").read_text())
    except OSError:
        found = None
    return 1024.0 * int(found[1]) if found else float("nan")


def unpacked_bytes(name: str) -> int:
    """Size of a mesh's file, or of what is packed in it."""
    path = Path(name)
    if not path.exists():
        return 0
    with gzip.open(path) if path.suffix == ".gz" else path.open("rb") as file:
        return file.seek(0, os.SEEK_END)
