"""Which OpenCL devices there are, and which of them work."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    import pyopencl as cl

NO_DEVICE = (
    "no OpenCL device works; on Debian or Ubuntu install PoCL, which runs OpenCL on the CPU: "
    "sudo apt install pocl-opencl-icd (`clsss doctor` shows what was found)"
)
_TRIAL = "__kernel void trial(__global float *x) { size_t i = get_global_id(0); x[i] = 2 * x[i]; }"


@dataclass(frozen=True)
class DeviceInfo:
    """One OpenCL device and whether a trial kernel ran on it."""

    name: str
    platform: str
    works: bool
    why_not: str
    handle: Any = None


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())[:200]


def _try(handle: cl.Device) -> str:
    """Build and run a tiny kernel; the reason for failure, or an empty string."""
    import pyopencl as cl

    try:
        context = cl.Context([handle])
        queue = cl.CommandQueue(context)
        x = np.arange(64, dtype=np.float32)
        buffer = cl.Buffer(context, cl.mem_flags.COPY_HOST_PTR, hostbuf=x)
        program = cl.Program(context, _TRIAL).build()
        cl.Kernel(program, "trial")(queue, x.shape, None, buffer)
        out = np.empty_like(x)
        cl.enqueue_copy(queue, out, buffer)
        return "" if np.array_equal(out, 2 * x) else "the trial kernel gave a wrong result"
    except Exception as error:  # a broken driver may raise anything
        return _one_line(error)


@functools.lru_cache(maxsize=1)
def find_devices() -> tuple[DeviceInfo, ...]:
    """All OpenCL devices, each tried with a tiny kernel, the best working one first.

    A listed device need not work (a driver too old for the CPU lists itself and then cannot compile), so
    every one is tried. GPUs come before CPUs, then more compute units first.
    """
    try:
        import pyopencl as cl

        platforms = cl.get_platforms()
    except Exception:  # no loader, no platform
        return ()
    found = []
    for platform in platforms:
        try:
            handles = platform.get_devices()
        except Exception:
            continue
        for handle in handles:
            why_not = _try(handle)
            is_gpu = bool(handle.type & cl.device_type.GPU)
            rank = (bool(why_not), not is_gpu, -handle.max_compute_units)
            name = " ".join(handle.name.split())
            found.append((rank, DeviceInfo(name, platform.name.strip(), not why_not, why_not, handle)))
    return tuple(info for _, info in sorted(found, key=lambda pair: pair[0]))


def devices() -> list[tuple[str, str, bool, str]]:
    """Every OpenCL device as ``(name, platform, works, why_not)``, the best working one first."""
    return [(d.name, d.platform, d.works, d.why_not) for d in find_devices()]
