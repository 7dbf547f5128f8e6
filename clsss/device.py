"""The OpenCL device: build and launch kernels, hold arrays.

No physics here. Everything else sees a `Device`; nothing else knows a ``cl.Context``.
"""

from __future__ import annotations

import functools
import os
import time
from collections import OrderedDict
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from clsss.capture import Launch, Prepared
from clsss.discovery import NO_DEVICE, find_devices
from clsss.errors import DeviceError, InputError
from clsss.kernelsource import kernel_source, program_of

if TYPE_CHECKING:
    import pyopencl as cl

os.environ.setdefault("PYOPENCL_NO_CACHE", "1")  # PoCL and GPU drivers cache builds themselves
PREPARED = 1024  # kernels with their numbers that are kept; each takes the host a millisecond to make
BEYOND = 16  # bytes after the last that kernels may read (real.h)


@functools.lru_cache(maxsize=8)
def open_device(name: str | None, precision: str) -> Device:
    """A device as `Device` gives it, the same one every time: kernels are built once a process."""
    return Device(name, precision)


class Buffer:
    """A typed array on the device: shape and dtype of its host image, and the memory that holds it."""

    def __init__(self, device: Device, shape: tuple[int, ...], dtype: np.dtype, data: cl.Buffer | None = None):
        self.device, self.shape, self.dtype = device, tuple(int(s) for s in shape), np.dtype(dtype)
        self.nbytes = int(np.prod(self.shape, dtype=np.int64)) * self.dtype.itemsize
        self.data = device._allocate(self.nbytes) if data is None else data
        self._owned = 0 if data is not None else self.nbytes

    def get(self, first: int = 0, n: int | None = None) -> np.ndarray:
        """A copy on the host (waits for the queue), of all rows or of the `n` from `first` on."""
        out = np.empty(self.shape if n is None else (n, *self.shape[1:]), self.dtype)
        if out.size:
            self.device.finish()
            start = first * self.nbytes // self.shape[0]
            self.device._cl.enqueue_copy(self.device.queue, out, self.data, src_offset=start)
        return out

    def set(self, values: np.ndarray, first: int | None = None) -> None:
        """Overwrite with host values of the same shape, or rows from `first` on."""
        host = np.ascontiguousarray(values, self.dtype)
        assert host.shape == self.shape or first is not None, (host.shape, self.shape)
        if host.size:
            start = (first or 0) * self.nbytes // max(1, self.shape[0] if self.shape else 1)
            self.device._cl.enqueue_copy(self.device.queue, self.data, host, dst_offset=start)

    def fill(self, value: float, first: int = 0, end: int | None = None) -> None:
        """Set every element from row `first` on, to before row `end`."""
        row, end = self.nbytes // max(1, self.shape[0]), self.shape[0] if end is None else end
        start, stop = first * row, end * row
        if stop > start:
            size = stop - start
            pattern = np.full(np.gcd.reduce((start, size, 64)) // self.dtype.itemsize, value, self.dtype)  # faster
            fill = self.device._cl.enqueue_fill_buffer
            self.device.enqueue(lambda queue: fill(queue, self.data, pattern, start, size))

    def copy_from(self, other: Buffer) -> None:
        """Copy the contents of another buffer of the same size, on the device."""
        if self.nbytes:
            copy = self.device._cl.enqueue_copy
            self.device.enqueue(lambda queue: copy(queue, self.data, other.data, byte_count=self.nbytes))

    def move(self, whole: Buffer, first: int) -> None:
        """Become a view of another buffer from byte `first` on, the contents with it."""
        data, own = whole.data.get_sub_region(first, self.nbytes + BEYOND), self.data
        copy = self.device._cl.enqueue_copy
        self.device.enqueue(lambda queue: copy(queue, data, own, byte_count=self.nbytes))
        self.device.allocated -= self._owned
        self.data, self._owned = data, 0

    def rows(self, first: int, n: int) -> Buffer:
        """The `n` rows from `first` on, a view of the same memory; `first` in multiples of `Device.row_alignment`."""
        row = self.nbytes // self.shape[0]
        data = self.data.get_sub_region(first * row, n * row + BEYOND)
        return Buffer(self.device, (n, *self.shape[1:]), self.dtype, data)

    def __del__(self) -> None:
        self.device.allocated -= getattr(self, "_owned", 0)


class Device:
    """An OpenCL device with one in-order queue and a precision, for one thread at a time.

    Kernels keep the arguments of one launch, and `capture` takes what is enqueued meanwhile, by whomever.

    Parameters
    ----------
    name : str, optional
        Substring of the device's or its platform's name; by default the best that works.
    precision : {"single", "double"}
        `real` is float32 or float64; kernels see it as ``REAL``.

    Attributes
    ----------
    real : numpy.dtype
    lanes : int
        Numbers of type `real` that the device computes at once; 1 where it does so across work-items.
    row_alignment : int
        Views of a buffer start at multiples of so many rows, if rows are of whole 4-byte words.
    allocated, peak : int
        What buffers hold now, and the most they ever held together [B].

    Raises
    ------
    DeviceError
        No device works, none matches `name`, or it lacks double precision.
    InputError
        `precision` is neither of the two.
    """

    def __init__(self, name: str | None = None, precision: str = "single"):
        import pyopencl as cl

        if precision not in ("single", "double"):
            raise InputError(f"precision: unknown value {precision!r}; use single or double")
        if not isinstance(name, (str, type(None))):
            raise InputError(f"device: needs part of a device's name, got {name!r}")
        found = find_devices()
        if not any(d.works for d in found):
            raise DeviceError(NO_DEVICE)
        matching = [d for d in found if name is None or name.lower() in f"{d.name} {d.platform}".lower()]
        if not matching:
            names = ", ".join(d.name for d in found)
            raise DeviceError(f"no OpenCL device's name contains {name!r}; there are: {names}")
        if not matching[0].works:
            raise DeviceError(f"OpenCL device {matching[0].name} does not work: {matching[0].why_not}")
        handle = matching[0].handle
        if precision == "double" and not handle.double_fp_config:
            raise DeviceError(f"OpenCL device {matching[0].name} has no double precision; use single")
        self.name, self.platform = matching[0].name, matching[0].platform
        self.precision = precision
        self.real = np.dtype(np.float32 if precision == "single" else np.float64)
        self.handle = handle
        self.context = cl.Context([handle])
        self._cl, self.queue = cl, cl.CommandQueue(self.context)
        self._idle = True  # whether nothing was enqueued since it was last waited for
        width = handle.native_vector_width_float if precision == "single" else handle.native_vector_width_double
        self.lanes = max(1, int(width))
        self.row_alignment = max(1, int(handle.mem_base_addr_align) // 32)  # that is told in bits
        self.is_cpu = bool(handle.type & cl.device_type.CPU)
        self.allocated = self.peak = 0
        self._programs: dict[tuple[str, tuple[str, ...]], Any] = {}
        self._kernels: dict[tuple[str, str, tuple[str, ...]], Any] = {}
        self._captured: list[Callable[[Any], Any]] | None = None
        self._prepared: OrderedDict[Any, Prepared] = OrderedDict()  # the last ones, for when a scene is lit anew

    def _allocate(self, nbytes: int) -> cl.Buffer:
        cl = self._cl
        try:
            data = cl.Buffer(self.context, cl.mem_flags.READ_WRITE, nbytes + BEYOND)
        except cl.Error as error:
            raise DeviceError(
                f"OpenCL device {self.name} cannot hold {nbytes / 2**20:.0f} MB more; lower the resolution"
            ) from error
        self.allocated += nbytes
        self.peak = max(self.peak, self.allocated)
        return data

    def empty(self, shape: int | tuple[int, ...], dtype: Any = None) -> Buffer:
        """A buffer of unspecified contents; `dtype` defaults to `real`."""
        shape = (shape,) if isinstance(shape, (int, np.integer)) else shape
        return Buffer(self, shape, np.dtype(dtype or self.real))

    def zeros(self, shape: int | tuple[int, ...], dtype: Any = None) -> Buffer:
        """A buffer of zeros."""
        out = self.empty(shape, dtype)
        out.fill(0)
        return out

    def array(self, values: Any, dtype: Any = None) -> Buffer:
        """A buffer with a copy of host values; floating values become `real` unless `dtype` is given."""
        host = np.asarray(values)
        if dtype is None:
            dtype = self.real if host.dtype.kind == "f" else host.dtype
        out = self.empty(host.shape, dtype)
        out.set(host)
        return out

    def kernel(self, file: str, name: str, *defines: str) -> Any:
        """The kernel `name` of ``kernels/<file>.cl``, built with `defines` such as ``"HETEROGENEOUS"``."""
        cl, key = self._cl, (file, name, defines)
        if key not in self._kernels:
            files = program_of(file)
            if (files[0], defines) not in self._programs:
                options = ["-DREAL=double", "-DDOUBLE"]
                if self.precision == "single":
                    options = ["-DREAL=float", "-cl-single-precision-constant"]
                options += [f"-DLANES={self.lanes}", *(f"-D{d}" for d in defines)]
                try:
                    source = kernel_source(*(f"{name}.cl" for name in files))
                    program = cl.Program(self.context, source).build(options)
                except cl.Error as error:
                    raise DeviceError(f"kernels/{file}.cl does not build on {self.name}: {error}") from error
                self._programs[files[0], defines] = program
            self._kernels[key] = cl.Kernel(self._programs[files[0], defines], name)
        return self._kernels[key]

    def run(self, kernel: Any, n: int, *arguments: Any, group: int | None = None) -> None:
        """Enqueue `kernel` over `n` work-items; ints become int32, tuples of ints int4, floats `real`.

        Global size is rounded up to whole work-groups; kernels guard with ``if (i < n)``.
        """
        if n <= 0:
            return
        group = group or min(64, 1 << max(0, (n - 1).bit_length()))
        size, converted = -(-n // group) * group, [self._argument(a) for a in arguments]
        if self._captured is None:
            self._idle = False
            kernel(self.queue, (size,), (group,), *converted)
            return
        numbers = [(i, a) for i, a in enumerate(converted) if isinstance(a, (np.generic, np.ndarray))]
        key = (kernel, *((i, a.tobytes()) for i, a in numbers))
        prepared = self._prepared.pop(key, None) or Prepared(kernel, numbers)
        self._prepared[key] = prepared
        if len(self._prepared) > PREPARED:
            self._prepared.popitem(last=False)
        buffers = [(i, a) for i, a in enumerate(converted) if not isinstance(a, (np.generic, np.ndarray))]
        self._captured.append(Launch(prepared, size, group, buffers))

    def enqueue(self, command: Callable[[Any], Any]) -> None:
        """Call `command` with the queue, or note it where commands are captured."""
        if self._captured is None:
            self._idle = False
            command(self.queue)
        else:
            self._captured.append(command)

    def capture(self, work: Callable[[], Any]) -> Callable[[], None]:
        """What `work` enqueues, to be enqueued again and again; nothing runs yet.

        Arguments are converted once, which is most of what a launch costs the host. `work` must not read back.
        """
        commands: list[Callable[[Any], Any]] = []
        self._captured = commands
        try:
            work()
        finally:
            self._captured = None

        def replay() -> None:
            self._idle = False
            for command in commands:
                command(self.queue)

        return replay

    def _argument(self, value: Any) -> Any:
        if isinstance(value, Buffer):
            return value.data
        if isinstance(value, (int, np.integer)):
            return np.int32(value)
        if isinstance(value, tuple):
            from pyopencl import cltypes

            return cltypes.make_int4(*value, *[0] * (4 - len(value)))
        if isinstance(value, (float, np.floating)):
            return self.real.type(value)
        return value

    def vector(self, values: Any) -> np.ndarray:
        """Up to four numbers as one ``REAL4`` kernel argument."""
        from pyopencl import cltypes

        out = np.zeros(4)
        out[: len(values)] = values
        make = cltypes.make_float4 if self.precision == "single" else cltypes.make_double4
        return make(*out)

    def finish(self) -> None:
        """Wait until everything enqueued is done, awake to Ctrl-C: OpenCL's own waits are not."""
        if self._idle:
            return
        last = self._cl.enqueue_marker(self.queue)
        self.queue.flush()
        pause = 0.0
        while (status := last.command_execution_status) > self._cl.command_execution_status.COMPLETE:
            time.sleep(pause)
            pause = min(pause + 2e-5, 3e-4)
        if status < 0:
            raise DeviceError(f"OpenCL device {self.name} failed while it computed (error {status})")
        self._idle = True
