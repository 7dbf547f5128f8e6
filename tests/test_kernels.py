"""House rules of the kernels, and that each builds in every variant."""

from __future__ import annotations

import itertools
import re

import numpy as np
import pytest

from clsss.device import Device
from clsss.kernelsource import KERNEL_DIR, kernel_source
from clsss.sums import total

FILES = sorted(path.stem for path in KERNEL_DIR.glob("*.cl"))
ALL_FILES = sorted(path.name for path in KERNEL_DIR.iterdir() if path.suffix in (".cl", ".h"))
KERNEL = re.compile(r"__kernel\s+void\s+(\w+)")
COST = re.compile(r"// cost (\w+): [\dRCM+]+ B, \d+ flop")


def code_of(name):
    """The text of a file without its comments."""
    text = (KERNEL_DIR / name).read_text()
    return re.sub(r"//[^\n]*", "", re.sub(r"/\*.*?\*/", "", text, flags=re.S))


@pytest.mark.parametrize("file", FILES)
def test_every_kernel_states_its_cost(file):
    text = (KERNEL_DIR / f"{file}.cl").read_text()
    stated = [match[1] for match in COST.finditer(text)]
    assert stated == KERNEL.findall(code_of(f"{file}.cl"))
    assert len(stated) == text.count("// cost")


@pytest.mark.parametrize("name", ALL_FILES)
def test_precision_comes_from_the_build(name):
    code = code_of(name)
    assert not re.search(r"\d\.?\d*f\b", code)
    assert not re.search(r"\bdouble\d*\b", code)
    if name != "real.h":
        assert not re.search(r"\bfloat\d*\b|convert_float", code)


@pytest.mark.parametrize("name", ALL_FILES)
def test_every_file_says_what_it_is(name):
    assert (KERNEL_DIR / name).read_text().startswith(f"/* {name} -- ")


@pytest.mark.parametrize("name", ALL_FILES)
def test_lines_fit(name):
    assert [line for line in (KERNEL_DIR / name).read_text().splitlines() if len(line) > 120] == []


@pytest.mark.parametrize("file", FILES)
def test_every_kernel_builds(device, file):
    source = kernel_source(f"{file}.cl")
    switches = [name for name in ("HETEROGENEOUS", "BLOCKED", "FITTED") if name in source]
    for defines in itertools.chain.from_iterable(itertools.combinations(switches, k) for k in range(3)):
        for name in KERNEL.findall(code_of(f"{file}.cl")):
            assert device.kernel(file, name, *defines).function_name == name


@pytest.mark.parametrize("precision", ["single", "double"])
def test_rays_build_one_by_one(precision):
    """As GPUs take them, whose work-items are the lanes."""
    device = Device(None, precision)
    device.lanes = 1
    for file, name in (("attenuate", "beam_in_cells"), ("seen", "first_met"), ("single", "scattered_once")):
        assert device.kernel(file, name).function_name == name


@pytest.mark.parametrize("precision", ["single", "double"])
@pytest.mark.parametrize("lanes", [1, None], ids=["three loads", "one load"])
@pytest.mark.parametrize("width", [3, 4])
def test_rows_take_nothing_of_the_next(precision, width, lanes):
    """One load of four takes in the next row's first number, here none, and lets go of it."""
    device = Device(None, precision)
    device.lanes = lanes or device.lanes
    n = device.row_alignment
    values = np.full((2 * n, width), np.nan)
    values[:n] = np.arange(n * width).reshape(n, width)
    np.testing.assert_array_equal(total(device, device.array(values).rows(0, n)), values[:n, :3].sum(axis=0))
