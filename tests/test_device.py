"""Finding a device that works, building kernels, and arrays that come back as they went."""

from __future__ import annotations

import re
from types import SimpleNamespace

import numpy as np
import pytest

from clsss import device as module
from clsss import discovery, kernelsource
from clsss.device import Device
from clsss.discovery import DeviceInfo, devices, find_devices
from clsss.errors import DeviceError, InputError
from clsss.kernelsource import kernel_source


def test_kernel_source_splices_headers(tmp_path, monkeypatch):
    (tmp_path / "a.cl").write_text('first\n#include "b.h"\nthird\n')
    (tmp_path / "b.h").write_text('#include "c.h"\nheader\n')
    (tmp_path / "c.h").write_text("inner\n")
    monkeypatch.setattr(kernelsource, "KERNEL_DIR", tmp_path)
    lines = kernel_source("a.cl").split("\n")
    assert not any("#include" in line for line in lines)
    assert [line for line in lines if line and not line.startswith("#line")] == [
        "first",
        "inner",
        "header",
        "third",
    ]


def test_line_directives_point_at_the_files(tmp_path, monkeypatch):
    """The number after #line is that of the next text line in its own file."""
    (tmp_path / "a.cl").write_text('first\n#include "b.h"\nthird\n')
    (tmp_path / "b.h").write_text("header\n")
    monkeypatch.setattr(kernelsource, "KERNEL_DIR", tmp_path)
    place, seen = ("", 0), {}
    for line in kernel_source("a.cl").split("\n"):
        directive = re.fullmatch(r'#line (\d+) "(.+)"', line)
        if directive:
            place = (directive[2], int(directive[1]))
        elif line:
            seen[line] = place
            place = (place[0], place[1] + 1)
    assert seen == {"first": ("a.cl", 1), "header": ("b.h", 1), "third": ("a.cl", 3)}


def test_failed_build_names_file_and_device(single, tmp_path, monkeypatch):
    (tmp_path / "broken.cl").write_text("__kernel void broken(__global float *x) { x[0] = nonsense; }\n")
    monkeypatch.setattr(kernelsource, "KERNEL_DIR", tmp_path)
    with pytest.raises(DeviceError, match=r"kernels/broken\.cl does not build on .*") as error:
        single.kernel("broken", "broken")
    assert single.name in str(error.value)
    assert "nonsense" in str(error.value)


@pytest.mark.parametrize("shape", [(7,), (5, 4), (3, 2, 4), (0,), (0, 4)])
def test_buffer_round_trip(device, shape):
    values = np.random.default_rng(1).normal(size=shape).astype(device.real)
    buffer = device.array(values)
    np.testing.assert_array_equal(buffer.get(), values)
    assert buffer.get().dtype == device.real
    buffer.set(2 * values)
    np.testing.assert_array_equal(buffer.get(), 2 * values)
    other = device.zeros(shape)
    np.testing.assert_array_equal(other.get(), 0 * values)
    other.copy_from(buffer)
    np.testing.assert_array_equal(other.get(), 2 * values)


def test_buffers_keep_integers_and_take_other_types(device):
    assert device.array(np.arange(4, dtype=np.int32)).get().dtype == np.int32
    assert device.array(np.ones(3, np.float16)).get().dtype == device.real
    assert device.array(np.ones(3), np.uint8).get().dtype == np.uint8


def test_buffers_copy_strided_arrays(device):
    values = np.arange(24, dtype=device.real).reshape(4, 6)[::2, ::3].T
    np.testing.assert_array_equal(device.array(values).get(), values)


def test_memory_is_counted(device):
    before = device.allocated
    buffer = device.empty((1000, 4))
    assert device.allocated - before == buffer.nbytes == 4000 * device.real.itemsize
    held = device.allocated
    assert device.peak >= held
    del buffer
    assert device.allocated == before
    device.empty(1)
    assert device.peak >= held


def test_too_large_a_buffer_is_a_device_error(single):
    before = single.allocated
    with pytest.raises(DeviceError, match="lower the resolution"):
        single.empty(1 << 50)
    assert single.allocated == before


def test_captured_work_runs_when_replayed(device):
    """Launches, fills and copies, in their order, as often as asked for and not before."""
    combine = device.kernel("reduce", "combine")
    x, y, kept = device.array(np.ones((5, 4))), device.array(np.zeros((5, 4))), device.zeros((5, 4))
    one = device.vector([1.0, 1.0, 1.0, 1.0])

    def work():
        device.run(combine, 5, 5, one, one, x, y)
        kept.copy_from(y)
        x.fill(3)
        device.run(combine, 5, 5, one, one, x, y)

    replay = device.capture(work)
    assert not y.get().any()
    replay()
    np.testing.assert_array_equal(kept.get(), 1)
    np.testing.assert_array_equal(y.get(), 4)
    replay()
    np.testing.assert_array_equal(y.get(), 10)
    device.run(combine, 5, 5, one, one, x, y)
    np.testing.assert_array_equal(y.get(), 13)


def test_vector_fills_up_with_zeros(device):
    assert list(device.vector([1.0, 2.0]).tolist()) == [1.0, 2.0, 0.0, 0.0]


@pytest.mark.parametrize("precision", ["half", "", None, 64])
def test_unknown_precision(precision):
    with pytest.raises(InputError, match="use single or double"):
        Device(precision=precision)


def test_unknown_device_lists_those_there_are(single):
    with pytest.raises(DeviceError, match="no OpenCL device's name contains 'abacus'; there are: ") as error:
        Device("abacus")
    assert single.name in str(error.value)


def test_device_by_part_of_its_name(single):
    assert Device(single.name.upper()[:7]).name == single.name


def test_every_device_was_tried(single):
    found = find_devices()
    assert devices() == [(d.name, d.platform, d.works, d.why_not) for d in found]
    assert all(d.works != bool(d.why_not) for d in found)
    assert [not d.works for d in found] == sorted(not d.works for d in found)


def test_gpus_come_before_cpus_and_more_units_before_fewer(monkeypatch):
    import pyopencl as cl

    def handle(name, kind, units):
        return SimpleNamespace(name=name, type=kind, max_compute_units=units)

    handles = [handle("cpu", cl.device_type.CPU, 64), handle("small gpu", cl.device_type.GPU, 8),
               handle("broken gpu", cl.device_type.GPU, 99), handle("large gpu", cl.device_type.GPU, 32)]  # fmt: skip
    platform = SimpleNamespace(name="vendor", get_devices=lambda: handles)
    monkeypatch.setattr(cl, "get_platforms", lambda: [platform])
    monkeypatch.setattr(discovery, "_try", lambda h: "no compiler" if "broken" in h.name else "")
    names = [found.name for found in find_devices.__wrapped__()]
    assert names == ["large gpu", "small gpu", "cpu", "broken gpu"]


@pytest.mark.parametrize("command", ["run", "fill", "copy", "move", "replay"])
def test_whatever_was_enqueued_is_waited_for(single, monkeypatch, command):
    """OpenCL tells of what failed by a negative status of what was enqueued last; with nothing new it is not asked."""
    import pyopencl as cl

    x, y, whole = single.zeros((16, 4)), single.zeros((16, 4)), single.zeros((64, 4))
    commands = {
        "run": lambda: single.run(single.kernel("reduce", "combine"), 16, 16, *[single.vector([1.0])] * 2, x, y),
        "fill": lambda: x.fill(1),
        "copy": lambda: x.copy_from(y),
        "move": lambda: x.move(whole, 0),
        "replay": single.capture(lambda: x.fill(1)),
    }
    single.finish()
    monkeypatch.setattr(cl, "enqueue_marker", lambda queue: SimpleNamespace(command_execution_status=-5))
    single.finish()
    commands[command]()
    with pytest.raises(DeviceError, match="failed while it computed"):
        single.finish()


class BrokenDevice:
    """A driver that lists a device but cannot use it."""

    def __getattr__(self, name):
        raise RuntimeError("the driver\nis too old")


def test_a_driver_that_raises_does_not_work():
    assert "\n" not in discovery._try(BrokenDevice())
    assert discovery._try(BrokenDevice())


@pytest.mark.parametrize("found", [(), (DeviceInfo("old", "vendor", False, "too old"),)])
def test_no_device_tells_what_to_install(monkeypatch, found):
    monkeypatch.setattr(module, "find_devices", lambda: found)
    with pytest.raises(DeviceError, match="pocl-opencl-icd"):
        Device()


def test_broken_device_asked_for_by_name(monkeypatch):
    found = (
        DeviceInfo("good", "vendor", True, ""),
        DeviceInfo("old", "vendor", False, "the driver is too old"),
    )
    monkeypatch.setattr(module, "find_devices", lambda: found)
    with pytest.raises(DeviceError, match="old does not work: the driver is too old"):
        Device("old")


def test_no_double_precision(monkeypatch):
    class Handle:
        double_fp_config = 0

    monkeypatch.setattr(module, "find_devices", lambda: (DeviceInfo("small", "vendor", True, "", Handle()),))
    with pytest.raises(DeviceError, match="small has no double precision; use single"):
        Device(precision="double")
