"""Scene files: every option has its key, the command line comes first, a round trip changes nothing."""

from __future__ import annotations

import argparse
import os
import shlex
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from clsss import grammar, options, request, scenefile, window
from clsss.errors import InputError
from clsss.lights import DirectionalLight, PointLight

EVERY = shlex.split(
    "--size 2cm --material skin1 --sigma-a 0.1,0.2,0.3 --g 0.1 --eta 1.3 --phase p1 --mix ketchup:2mm:7"
    " --scattering split --light directional:0,-1,0.1:2"
    " --light point:0,1.5,-2b --light point:1,2,3:4,5,6 --light env:sky.hdr"
    " --light env:0.5 --blocker wall.ply --blocker a/b.ply --exposure -1.5 --up z --resolution 64 --tolerance 1e-3"
    " --no-adaptive --precision double --device cpu -o out.glb --report r.json --camera -30,15,2,0.1,-0.25"
)


def parser():
    out = argparse.ArgumentParser()
    for add in (options.add_shared, options.add_output, options.add_camera, options.add_window_size):
        add(out)
    return out


def parsed(*words):
    return scenefile.parse(parser(), [str(word) for word in words])


def values(args):
    return {key: value for key, value in vars(args).items() if key not in ("parser", "save_scene", "scene")}


def write(path, text):
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.parametrize(
    "words",
    [
        [],
        EVERY,
        ["--sigma-a", "0.1", "--sigma-s", "1,2,3"],
        ["--vertex-colours", "paint"],
        ["--vertex-colours", "marble:wax.toml"],
        ["--material", "wax.toml", "--mix", "ketchup", "--grid", "weights.nrrd", "--window-size", "640x480"],
    ],
)
def test_round_trip(tmp_path, monkeypatch, words):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "größen").mkdir()
    before = parsed("mesh.ply", *words)
    scenefile.save(before, "größen/szene 1.toml")
    after = parsed("größen/szene 1.toml")
    expected, found = values(before), values(after)
    if expected["lights"] is None:
        expected["lights"] = options.default_lights("y")
    if not words:
        expected["material"] = "marble"
    assert found == expected


def test_every_option_has_its_key():
    described = vars(parsed("m.ply"))
    assert set(described) - set(scenefile._actions()) == {"parser", "quiet", "save_scene", "scene"}


def test_paths_start_at_the_scene_file(tmp_path, monkeypatch):
    (tmp_path / "a").mkdir()
    text = 'mesh = "m.ply"\nmaterial = "wax.toml"\nlights = ["env:sky.hdr", "env:0.5"]\n'
    write(tmp_path / "a" / "s.toml", text + 'output = "../o.ply"\ngrid = "/w.npy"')
    monkeypatch.chdir(tmp_path)
    args = parsed("a/s.toml")
    assert (args.mesh, args.material, args.output, args.grid) == ("a/m.ply", "a/wax.toml", "o.ply", "/w.npy")
    assert [light.file for light in args.lights] == ["a/sky.hdr", ""]
    assert parsed(write(tmp_path / "d.toml", 'mesh = "demo"')).mesh == "demo"


def test_the_command_line_comes_first(tmp_path):
    scene = write(
        tmp_path / "s.toml",
        'mesh = "m.ply"\nsize = 30\nsigma_a = [0.1, 0.2, 0.3]\nsigma_s = 2\neta = 1.5\nadaptive = true\n'
        'lights = ["env:1"]\ncamera = "10,20"\nexposure = 1',
    )
    args = parsed(scene)
    assert (args.size, args.sigma_s, args.exposure, args.camera) == (30, (2,), 1, (10, 20, 1))
    args = parsed(scene, "--size", "1cm", "--light", "env:2", "--no-adaptive", "--exposure", "0")
    assert (args.size, args.adaptive, args.exposure, args.eta) == (10, False, 0, 1.5)
    assert [light.strength for light in args.lights] == [(2,)]
    args = parsed(scene, "--material", "skin1")  # all that the file says of the medium is about another one
    assert (args.material, args.sigma_a, args.sigma_s, args.eta) == ("skin1", None, None, None)


def test_defaults_where_nobody_says(tmp_path):
    args = parsed(write(tmp_path / "s.toml", 'mesh = "m.ply"'))
    assert {key: getattr(args, key) for key in options.DEFAULTS} == options.DEFAULTS


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ('mesh = "m.ply"\nlight = []', "unknown key 'light'; did you mean 'lights'"),
        ('mesh = "m.ply"\nmateriel = "x"', "did you mean 'material'"),
        ('mesh = "m.ply"\nfoo = 3', "unknown key 'foo'; known are mesh, size, "),
        ('material = "marble"', "needs the key 'mesh'"),
        ("mesh = 3", "mesh: needs a text in quotes, got 3"),
        ('mesh = "m.ply"\nsize = "big"', "size: 'big' is no length"),
        ('mesh = "m.ply"\nsigma_a = [1, 2]', "sigma_a: '1,2' is not"),
        ('mesh = "m.ply"\nsigma_a = 1', "go together"),
        ('mesh = "m.ply"\nresolution = 12.5', "resolution: '12.5' is no whole number"),
        ('mesh = "m.ply"\ntolerance = "low"', "tolerance: 'low' is not one number"),
        ('mesh = "m.ply"\nprecision = "half"', "precision: 'half' is none of single, double"),
        ('mesh = "m.ply"\nup = true', "up: needs a text in quotes, got True"),
        ('mesh = "m.ply"\nadaptive = 1', "adaptive: needs true or false"),
        ('mesh = "m.ply"\nlights = "env:1"', "lights: needs a list"),
        ('mesh = "m.ply"\nlights = ["sun"]', "lights: 'sun' is no light"),
        ('mesh = "m.ply"\nvertex_colours = "paint"\ngrid = "x.npy"', "--vertex-colours goes without"),
        ("mesh = ", "is no TOML"),
    ],
)
def test_what_is_wrong_is_said_in_one_sentence(tmp_path, text, says):
    scene = write(tmp_path / "s.toml", text)
    with pytest.raises(InputError) as caught:
        parsed(scene)
    assert says in str(caught.value)
    assert str(scene) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_contradictions_on_the_command_line_are_wrong_usage(capsys):
    for words in (["--vertex-colours", "paint", "--mix", "ketchup"], ["--vertex-colours", "a:b", "--material", "c"]):
        with pytest.raises(SystemExit) as caught:
            parsed("m.ply", *words)
        assert caught.value.code == 2
        assert "--vertex-colours" in capsys.readouterr().err


def test_a_scene_is_written_under_its_own_suffix(tmp_path):
    with pytest.raises(InputError, match=r"ends in \.toml"):
        scenefile.check(str(tmp_path / "scene.json"))
    with pytest.raises(InputError, match="does not exist"):
        scenefile.check(str(tmp_path / "no folder" / "s.toml"))
    assert os.listdir(tmp_path) == []


def test_turned_lights_become_options_that_give_them():
    mesh = SimpleNamespace(bounds=np.array([[-1, 0, 0], [1, 1, 1]]), size=2)
    sun = window.as_option(grammar.light("directional:0,0,1:3"), DirectionalLight((0.6, 0.8, 0), (1, 2, 3)))
    lamp = window.as_option(grammar.light("point:0,1.5,0b"), PointLight((1, 2, 3), 5))
    sky = grammar.light("env:1")
    assert window.as_option(sky, object()) is sky
    made = request.lights_from(SimpleNamespace(lights=[grammar.light(str(o)) for o in (sun, lamp)], up="y"), mesh)
    np.testing.assert_allclose(made[0].direction, (0.6, 0.8, 0))
    np.testing.assert_allclose(made[0].irradiance, (1, 2, 3))
    np.testing.assert_allclose(made[1].position, (1, 2, 3))
    np.testing.assert_allclose(made[1].intensity, 5)


def test_what_the_camera_saw_is_kept():
    """Orbited, zoomed and moved aside in any order: the options give a camera that sees the same picture."""
    mesh = SimpleNamespace(vertices=np.random.default_rng(3).normal(size=(50, 3)), faces=np.arange(48).reshape(16, 3))
    args = argparse.Namespace(camera=(-25.0, 12.0, 1.0), up="z")
    left = window.start_camera(args, mesh, 1.5).panned(0.2, -0.1).orbited(70, -20).zoomed(1.7).panned(-0.05, 0.3)
    args.camera = left.azimuth, left.elevation, 1.0
    args.camera = (*args.camera[:2], *window.moved(left, window.start_camera(args, mesh, 1.5)))
    again = window.start_camera(args, mesh, 1.5)
    clip = [np.hstack([mesh.vertices, np.ones((50, 1))]) @ c.matrix(1.5, 9.0).T for c in (left, again)]
    seen = [c[:, :2] / c[:, 3:] for c in clip]
    np.testing.assert_allclose(*seen, atol=2e-3)
    assert len(window.moved(again.zoomed(2), again)) == 1
    for lost in (again.zoomed(1e-6), again.panned(5, 0).orbited(90, 0).zoomed(30), again.panned(5, 0).orbited(-90, 0)):
        start = replace(again, azimuth=lost.azimuth)
        kept = grammar.camera(grammar.joined((lost.azimuth, 12, *window.moved(lost, start))))
        assert 0 < kept[2] < np.inf  # far away, or past the mesh: options all the same
