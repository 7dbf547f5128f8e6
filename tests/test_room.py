"""Memory that is lent, and that a solve is the same without."""

from __future__ import annotations

import numpy as np
import pytest
from shapes import flask

from clsss.lights import DirectionalLight
from clsss.materials import Material
from clsss.room import Room
from clsss.simulate import simulate

MILK = Material.from_reduced(sigma_a=(0.002, 0.004, 0.007), sigma_s_prime=3.0, eta=1.4)


def test_pieces_lie_apart_within_the_rows_lent(device):
    n, step = device.row_alignment, 3 * device.row_alignment
    whole = device.array(np.zeros((4 * step, 3)))
    before = device.allocated
    room = Room(device, (whole, step, 3 * step))
    pieces = [room.empty((n + 1, 3)) for _ in range(3)]
    assert device.allocated == before
    for value, piece in enumerate(pieces, 1):
        piece.fill(value)
    for value, piece in enumerate(pieces, 1):
        assert (piece.get() == value).all()
    found = whole.get()
    assert not found[:step].any()
    assert not found[3 * step :].any()
    assert sorted(np.unique(found, return_counts=True)[1])[:3] == 3 * [3 * (n + 1)]


def test_what_does_not_fit_has_memory_of_its_own(device):
    whole = device.array(np.zeros((2 * device.row_alignment, 3)))
    before = device.allocated
    piece = Room(device, (whole, 0, device.row_alignment)).empty((device.row_alignment + 1, 3))
    assert device.allocated - before == piece.nbytes
    piece.fill(1)
    assert not whole.get().any()


@pytest.mark.parametrize("resolution", [48, 140])
def test_solves_with_lent_memory_are_the_same(monkeypatch, resolution):
    """With one level finer than patches, and with two."""
    arguments = (flask(), MILK, [DirectionalLight((0.3, -1, 0.2))])
    lent = simulate(*arguments, resolution=resolution)
    monkeypatch.setattr(Room, "empty", lambda self, shape, dtype=None: self.device.empty(shape, dtype))
    own = simulate(*arguments, resolution=resolution)
    assert np.array_equal(lent.vertex_radiosity, own.vertex_radiosity)
    assert lent.report["memory_mb"]["device"] < own.report["memory_mb"]["device"]
