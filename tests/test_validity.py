"""Doubts about diffusion come with numbers, and only where there are any."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
import trimesh

from clsss.materials import Material, material
from clsss.media import Mix
from clsss.mesh import load_mesh
from clsss.validity import DiffusionWarning, doubts, thickness_of, warn


def ball(diameter):
    return load_mesh(trimesh.creation.icosphere(4), size=diameter)


def test_mean_chord_of_a_ball_and_of_a_plate():
    assert thickness_of(ball(30)) == pytest.approx(20, rel=0.01)  # 4 r / 3
    plate = load_mesh(trimesh.creation.box([100, 100, 1.0]))
    assert thickness_of(plate) == pytest.approx(2, rel=0.03)


def test_marble_raises_no_doubt():
    assert doubts(ball(20), material("marble")) == ""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warn(ball(20), material("marble"))


def test_low_albedo_is_told_by_channel():
    text = doubts(ball(50), material("skin1"))
    assert "0.84 in green, 0.68 in blue" in text
    assert "in red" not in text


def test_thin_objects_are_told_in_mean_free_paths():
    text = doubts(ball(1.5), Material(0.0, (1.0, 2.0, 4.0)))
    assert "1 mm thick" in text
    assert "mean free paths of 1 mm in red" in text
    assert "albedo" not in text


def test_a_mixture_counts_by_its_mean():
    medium = Mix(Material(0.0, 1.0), Material(1.0, 1.0), lambda points: np.full(len(points), 0.5))
    assert "0.67 in red" in doubts(ball(50), medium)


def test_the_warning_is_a_user_warning():
    with pytest.warns(DiffusionWarning, match="diffusion is only approximate here"):
        warn(ball(50), material("skin1"))
    assert issubclass(DiffusionWarning, UserWarning)
