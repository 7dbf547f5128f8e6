"""How much of a cycle's correction counts, and which cycle is the last."""

from __future__ import annotations

import pytest
from shapes import solve, sphere

from clsss import steps
from clsss.lights import DirectionalLight
from clsss.materials import Material
from clsss.steps import share, without_coupling


@pytest.mark.parametrize(
    ("history", "expected"),
    [
        ([1.0], 1.0),
        ([1.0, 0.5], 0.9),
        ([1.0, 0.5, 0.05], 1.1),
        ([1.0, 0.5, 0.05, 5e-3], 1.0),
        ([1.0, 0.2], 1.0),  # cut cells do not prevail
        ([1.0, 0.2, 0.05], 1.0),
        ([0.1, 0.05], 1.0),  # near already
    ],
)
def test_the_second_step_and_the_third_are_off_one(history, expected):
    assert share(history, 1e-4) == pytest.approx(expected)


@pytest.mark.parametrize(
    ("history", "expected"),
    [
        ([1.0, 0.1, 2e-4], True),
        ([1.0, 0.1, 3e-4], False),
        ([1.0, 3e-4, 2e-4], False),  # smooth errors are left
        ([1.0, 0.1, 0.9e-4], False),  # there, but what follows still moves
        ([2e-4], False),
    ],
)
def test_the_last_cycle_leaves_out_what_follows(history, expected):
    assert without_coupling(history, 1e-4) is expected


@pytest.mark.parametrize("sigma_s", [0.5, 1.0])
def test_steps_off_one_leave_less(double, monkeypatch, sigma_s):
    """After four cycles, a lit ball: two thirds of what steps of one leave, or less."""
    medium = Material(sigma_a=0.002 * sigma_s, sigma_s=sigma_s, eta=1.4)
    left = []
    for off in (steps.OFF, 0.0):
        monkeypatch.setattr(steps, "OFF", off)
        residuals = solve(double, sphere(), medium, [DirectionalLight((0.3, -1, 0.2))], 48, 1e-8).convergence.residuals
        left.append(residuals[4].max())
    assert left[0] <= 0.67 * left[1]
