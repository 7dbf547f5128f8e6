"""Arrays in temporary files: the same bits come back, whatever becomes of the file."""

from __future__ import annotations

import os
import tempfile
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from shapes import torus

from clsss import DirectionalLight, material, simulate, stowed
from clsss.errors import DeviceError
from clsss.room import Room
from clsss.stowed import PIECE, SMALL, Stowed, stow

VALUES = np.random.default_rng(3).normal(size=(PIECE // 5, 3)).astype(np.float32)  # two pieces and a half


def full_disk(monkeypatch, room):
    """Let temporary files hold no more than so many bytes."""

    class Full:
        def __init__(self, **_):
            self.left = room

        def write(self, data):
            if not self.left:
                raise OSError(28, "No space left on device")
            written = min(len(data), self.left)
            self.left -= written
            return written

    monkeypatch.setattr(tempfile, "TemporaryFile", Full)


@pytest.mark.parametrize("values", [VALUES, VALUES[:, :2], VALUES[:9], VALUES[:0], np.arange(SMALL, dtype=np.uint8)])
def test_the_same_comes_back(values):
    kept = stow(values)
    assert (kept.shape, kept.dtype) == (values.shape, values.dtype)
    np.testing.assert_array_equal(kept.get(), values)
    np.testing.assert_array_equal(kept.rows(3, 5), values[3:8])
    parts = list(kept.parts())
    np.testing.assert_array_equal(np.concatenate([part for _, part in parts] or [values]), values)
    assert [first for first, _ in parts] == np.cumsum([0, *(len(part) for _, part in parts)])[:-1].tolist()


def test_on_a_device_it_is_the_same(single):
    lent = single.zeros(VALUES.shape)
    for where in (single, Room(single), Room(single, (lent, 0, lent.shape[0]))):
        np.testing.assert_array_equal(stow(VALUES).on_device(where).get(), VALUES)


def test_several_arrays_are_stowed_as_one():
    np.testing.assert_array_equal(stow(VALUES[:100_000], VALUES[:0], VALUES[100_000:]).get(), VALUES)


def test_large_ones_are_in_files_that_go_with_them():
    kept = stow(VALUES)
    file = kept._file.fileno()
    assert os.fstat(file).st_size == VALUES.nbytes
    assert os.fstat(file).st_nlink == 0 or os.name == "nt"
    del kept
    with pytest.raises(OSError, match="descriptor"):
        os.fstat(file)


@pytest.mark.parametrize("room", [0, 1000, VALUES.nbytes - 1])
def test_where_no_file_can_be_filled_they_stay_in_memory(monkeypatch, room):
    full_disk(monkeypatch, room)
    kept = stow(VALUES)
    assert kept._file is None
    np.testing.assert_array_equal(kept.get(), VALUES)


def test_there_are_no_more_than_so_many_files(monkeypatch):
    monkeypatch.setattr(stowed, "MOST_FILES", len(stowed._in_files) + 2)
    kept = [stow(VALUES) for _ in range(4)]
    assert [one._file is None for one in kept] == [False, False, True, True]


def test_nothing_stays_open_when_stowing_is_stopped(monkeypatch):
    opened = []

    def note(**options):
        file = make(**options)
        opened.append(file.fileno())
        return file

    def stop(first, n):
        if first:
            raise KeyboardInterrupt
        return VALUES[:n]

    make = tempfile.TemporaryFile
    monkeypatch.setattr(tempfile, "TemporaryFile", note)
    with pytest.raises(KeyboardInterrupt):
        Stowed(VALUES.shape, VALUES.dtype, stop)
    with pytest.raises(OSError, match="descriptor"):
        os.fstat(opened[0])


def test_threads_may_read_at_once():
    kept = stow(VALUES)
    with ThreadPoolExecutor(8) as pool:
        firsts = np.random.default_rng(4).integers(0, len(VALUES) - 999, 400).tolist()
        for first, rows in zip(firsts, pool.map(lambda first: kept.rows(first, 999), firsts), strict=True):
            np.testing.assert_array_equal(rows, VALUES[first : first + 999])


def test_a_file_that_cannot_be_read_is_told():
    kept = stow(VALUES)
    os.truncate(kept._file.fileno(), 1000)
    with pytest.raises(DeviceError, match="temporary file"):
        kept.get()


def test_bakes_are_the_same_with_files_and_without(monkeypatch):
    def baked():
        first = simulate(torus(), material("marble"), [DirectionalLight((0, 0, -1))], resolution=24)
        second, points = first.relight([DirectionalLight((1, 0, 0))]), first.mesh.vertices[:50] * 0.9
        return [part for result in (first, second)
                for part in (result.vertex_radiosity, result.fluence(points), result.radiosity(points))]  # fmt: skip

    found = []
    for small in (0, 1 << 40):
        monkeypatch.setattr(stowed, "SMALL", small)
        found.append(baked())
    for with_files, without in zip(*found, strict=True):
        np.testing.assert_array_equal(with_files, without)
