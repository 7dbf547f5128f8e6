"""Doubts about diffusion come with numbers, and only where there are any."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
import trimesh

from clsss import diffusion
from clsss.cutcell import make_grid, sample_surface
from clsss.lights import DirectionalLight
from clsss.materials import Material, material
from clsss.media import Mix
from clsss.mesh import load_mesh
from clsss.simulate import simulate
from clsss.validity import (
    WIDEST_CELL,
    DiffusionWarning,
    ResolutionWarning,
    doubts,
    thickness_of,
    thin_shares,
    too_wide,
    unresolved,
    warn,
)


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
        warn(ball(20), material("marble"), 64)


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
        warn(ball(50), material("skin1"), 64)
    assert issubclass(DiffusionWarning, UserWarning)


def test_cells_much_wider_than_light_diffuses_are_told():
    """A figure of skin as large as life; the limit is where exponentials are no longer fitted."""
    assert WIDEST_CELL**2 == diffusion.WIDEST
    text = too_wide(ball(1800), material("skin1"), 64)
    assert "are 41 diffusion lengths wide in blue" in text
    assert text.endswith("resolution 140 will do")
    assert too_wide(ball(1800), material("skin1"), 140) == ""
    assert too_wide(ball(1e6), material("marble"), 128).endswith("is the object 1e+06 mm large?")
    with pytest.warns(ResolutionWarning, match="comes out too bright"):
        warn(ball(1800), Material(0.1, 5.0), 8)


def comb(*thicknesses, resolution=64):
    """Plates of 10 x 10 mm and so many mm thick, side by side, tilted against the grid."""
    plates = [trimesh.creation.box([10, 10, t]).apply_translation([0, 0, 3 * k]) for k, t in enumerate(thicknesses)]
    turned = trimesh.util.concatenate(plates).apply_transform(trimesh.transformations.euler_matrix(0.4, 0.7, 1.1))
    mesh = load_mesh(turned)
    grid = make_grid(mesh.bounds, resolution)
    return mesh, grid


def test_thickness_is_measured_along_normals(device):
    mesh, grid = comb(0.1, 0.05, 2.0)
    found = sample_surface(device, grid, mesh).thickness * grid.h
    thin, shares = found[np.isfinite(found)], thin_shares(found / grid.h)
    np.testing.assert_allclose(np.minimum(abs(thin - 0.1), abs(thin - 0.05)), 0, atol=1e-4)
    area = [200 + 40 * t for t in (0.1, 0.05, 2.0)]
    assert shares["cell"] == pytest.approx(400 / sum(area), abs=0.05)
    assert unresolved(found / grid.h, grid.h, 64).startswith(f"{100 * shares['cell']:.3g} % of the surface")


@pytest.mark.parametrize("thicknesses", [(2.0,), (2.0, 1.0)])
def test_what_is_thicker_than_cells_is_resolved(device, thicknesses):
    mesh, grid = comb(*thicknesses)
    samples = sample_surface(device, grid, mesh)
    assert unresolved(samples.thickness, grid.h, 64) == ""


def test_the_resolution_advised_resolves(device):
    mesh, grid = comb(0.1, 2.0, resolution=32)
    text = unresolved(sample_surface(device, grid, mesh).thickness, grid.h, 32)
    assert "half of one, nearly black" in text
    advised = int(text.split("resolution ")[1].split()[0])
    grid = make_grid(mesh.bounds, advised)
    assert unresolved(sample_surface(device, grid, mesh).thickness, grid.h, advised) == ""


def test_sheets_without_thickness_get_no_resolution():
    assert unresolved(np.zeros(100), 0.1, 128).endswith("they need to be thicker")


def test_thin_parts_warn_and_are_reported():
    mesh, _ = comb(0.1, 2.0)
    with pytest.warns(ResolutionWarning, match="resolution"):
        result = simulate(mesh, material("marble"), [DirectionalLight((0, 0, -1))], resolution=32)
    assert result.report["octree"]["thinner_than"]["half_a_cell"] > 0.3
