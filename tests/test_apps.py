"""apps/convergence.py: what it measures meets its bars.

apps/figure5_dipole.py: clsss is closer to Monte Carlo than the dipole.
"""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

from clsss.errors import DeviceError

ROOT = Path(__file__).parent.parent


@pytest.fixture(autouse=True)
def _needs_a_device():
    from clsss.device import Device

    try:
        Device(precision="double")
    except DeviceError as error:
        pytest.skip(str(error))


def convergence(*options: str) -> tuple[int, dict[str, tuple[float, str]]]:
    """Exit code, and value and verdict of every quantity."""
    command = [sys.executable, str(ROOT / "apps" / "convergence.py"), "--quick", *options]
    done = subprocess.run(command, capture_output=True, text=True, cwd=ROOT, check=False)
    assert not done.stderr, done.stderr
    rows = re.findall(r"^(.+?) {2,}([-\d.e+]+) +(?:[<>]= \S+ +)?(pass|FAIL|) *$", done.stdout, flags=re.M)
    return done.returncode, {name: (float(value), verdict) for name, value, verdict in rows}


def test_thin_plates_are_as_accurate_as_declared():
    """The error of a plate two cells thick, to a tenth of its value: geometry, gradients, boundary values at once."""
    code, rows = convergence("--only", "plates")
    assert code == 0
    assert rows["plate 2h, sigma_tr h 1: surface L2"][0] == pytest.approx(0.0167, rel=0.1)


def test_a_hollow_ball_is_closer_to_monte_carlo_than_the_dipole(tmp_path):
    from clsss.opengl import standalone_context

    try:
        standalone_context().release()
    except DeviceError as error:
        pytest.skip(str(error))
    command = [sys.executable, str(ROOT / "apps" / "figure5_dipole.py"), "--quick", "--only", "cavity"]
    done = subprocess.run([*command, "--out", str(tmp_path)], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["compare-cavity.png"]
    assert done.stdout.count("| cavity |") == 3


@pytest.mark.slow
def test_every_bar_is_met():
    code, rows = convergence()
    assert len(rows) > 100
    assert [name for name, (_, verdict) in rows.items() if verdict == "FAIL"] == []
    assert code == 0
