"""Pictures of light: what a file holds is what is read."""

from __future__ import annotations

import numpy as np
import pytest
from PIL import Image

from clsss.errors import InputError
from clsss.images import read_radiance
from clsss.srgb import srgb_decode

RADIANCE = np.random.default_rng(4).random((4, 8, 3)).astype("f4") * 1000


@pytest.fixture
def exr():
    return pytest.importorskip("OpenEXR", reason="reading .exr needs clsss[exr]")


def write(exr, path, channels):
    exr.File({"compression": exr.ZIP_COMPRESSION, "type": exr.scanlineimage}, channels).write(str(path))
    return path


def test_exr_keeps_its_values(exr, tmp_path):
    np.testing.assert_array_equal(read_radiance(write(exr, tmp_path / "sky.exr", {"RGB": RADIANCE})), RADIANCE)
    half = RADIANCE.astype("f2")
    found = read_radiance(write(exr, tmp_path / "half.exr", {"RGBA": np.dstack([half, half[..., :1]])}))
    np.testing.assert_array_equal(found, half)


def test_grey_exr_lights_alike_in_every_channel(exr, tmp_path):
    grey = RADIANCE[..., 0].copy()
    found = read_radiance(write(exr, tmp_path / "grey.exr", {"Y": grey}))
    np.testing.assert_array_equal(found, np.repeat(grey[..., None], 3, axis=2))


def test_bad_exr_is_one_sentence(exr, tmp_path):
    whole = write(exr, tmp_path / "sky.exr", {"RGB": RADIANCE}).read_bytes()
    (tmp_path / "short.exr").write_bytes(whole[:60])
    with pytest.raises(InputError, match="is no complete OpenEXR picture"):
        read_radiance(tmp_path / "short.exr")
    with pytest.raises(InputError, match="needs the channels R, G and B, or Y, has Z"):
        read_radiance(write(exr, tmp_path / "depth.exr", {"Z": RADIANCE[..., 0].copy()}))


def test_a_missing_package_is_said(tmp_path, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "OpenEXR", None)
    (tmp_path / "sky.exr").write_bytes(b"v/1\x01")
    with pytest.raises(InputError, match=r"pip install 'clsss\[exr\]'"):
        read_radiance(tmp_path / "sky.exr")


def test_greys_of_16_bits_are_not_clipped_to_bytes(tmp_path):
    grey = np.linspace(0, 65535, 32).astype(np.uint16).reshape(4, 8)
    Image.fromarray(grey).save(tmp_path / "deep.png")
    expected = np.repeat(srgb_decode(grey / 65535)[..., None], 3, axis=2)
    np.testing.assert_allclose(read_radiance(tmp_path / "deep.png"), expected)


@pytest.mark.parametrize(
    ("name", "write_picture", "says"),
    [
        ("float.tif", lambda path: Image.fromarray(RADIANCE[..., 0]).save(path), "numbers of 32 bits; save it as .hdr"),
        ("vast.png", lambda path: Image.new("1", (60, 60)).save(path), "far larger than light from all around"),
        ("vast.hdr", lambda path: path.write_bytes(b"#?RADIANCE\n\n-Y 99999999 +X 99999999\n"), "more than it holds"),
        ("text.png", lambda path: path.write_text("sky"), "is no picture"),
    ],
)
def test_what_is_no_picture_of_light_is_said(tmp_path, monkeypatch, name, write_picture, says):
    monkeypatch.setattr(Image, "MAX_IMAGE_PIXELS", 1000)
    write_picture(tmp_path / name)
    with pytest.raises(InputError, match=says):
        read_radiance(tmp_path / name)
