"""Kernels keep up with the machine's memory: times only as shares of a triad next to them, never in seconds.

The ball fits the caches of many machines, which helps the kernels and not the triad; the bounds are far below what any
machine should show, and catch a kernel that lost a factor.
"""

from __future__ import annotations

import re
import sys
from functools import partial
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent.parent / "apps"))
from bench_kernels import AT_LEAST, MEDIA, besides, check, measure_cycle, pipeline
from measuring import Recorder, Triad, paired

from clsss.kernelsource import KERNEL_DIR

CELLS = 48
LEAST_SHARE = 0.15  # of the triad's bandwidth, by the declared bytes
MOST_UNITS = 2.5  # of the time the triad needs to move 1 GB, for a V(2,2) with residual: launches count, cells hardly
ROUNDS = 5
TRIES = 3  # other work on the machine may spoil a few


@pytest.fixture(scope="module")
def bench(single):
    """What times launches, and the triad; by processor time on a CPU, which other tests may be using."""
    device = Recorder(precision="single", busy=single.is_cpu)
    return device, Triad(device)


@pytest.fixture(scope="module", params=MEDIA)
def solved(bench, request):
    """The launches of a whole bake of a ball; its multigrid and right-hand side."""
    device, _ = bench
    device.launches.clear()
    device.recording = True
    found = pipeline(device, CELLS, MEDIA[request.param], adaptive=False)
    device.recording = False
    return found


@pytest.mark.parametrize("name", AT_LEAST)
def test_kernels_keep_up_with_memory(bench, solved, name):
    device, triad = bench
    launch = device.launches[name]
    nbytes = launch.cost()[0]
    unit, timed = partial(triad.unit, device.seconds, nbytes), partial(device.seconds, launch.run, launch.restore)
    shares = (1e-9 * nbytes / paired(unit, timed, ROUNDS)[1] for _ in range(TRIES))
    assert any(share > LEAST_SHARE for share in shares)
    assert check(launch) == "numpy"


def test_cycles_take_no_longer_than_reading_memory(bench, solved):
    tries = (measure_cycle(*bench, *solved, ROUNDS)[1] for _ in range(TRIES))
    assert any(units < MOST_UNITS for units in tries)


def test_every_kernel_is_measured(bench):
    device, _ = bench
    device.launches.clear()
    device.recording = True
    for name, medium in MEDIA.items():
        pipeline(device, CELLS, medium, adaptive=True)
        besides(device, 32, name)
    device.recording = False
    written = "".join(path.read_text() for path in KERNEL_DIR.glob("*.cl"))
    assert set(re.findall(r"__kernel void (\w+)", written)) == set(device.launches)
