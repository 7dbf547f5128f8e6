"""The command line: grammar, exit codes, one line for an error, nothing written on failure."""

from __future__ import annotations

import argparse
import importlib
import json
import os
import re
import shlex
import signal
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import trimesh

from clsss import cli, export, grammar, images, listing, options, request, running, scenefile, view
from clsss.errors import DeviceError, InputError

ROOT = Path(__file__).parent.parent


def parsed(*words):
    parser = argparse.ArgumentParser()
    options.add_shared(parser)
    options.add_camera(parser)
    return scenefile.parse(parser, ["mesh.ply", *words])


def box(size=20.0):
    bounds = np.array([[-1, 0, 0], [1, 1, 1]]) * size / 2 + 3
    return SimpleNamespace(bounds=bounds, size=size)


def clsss(*words, **options):
    """Run the command in a process of its own."""
    return subprocess.run(
        [sys.executable, "-m", "clsss", *map(str, words)], capture_output=True, text=True, cwd=ROOT, **options
    )


@pytest.mark.parametrize(
    ("text", "mm"), [("20", 20), ("20mm", 20), ("2cm", 20), ("0.1m", 100), ("1in", 25.4), ("1e1 mm", 10)]
)
def test_length(text, mm):
    assert grammar.length(text) == pytest.approx(mm)


@pytest.mark.parametrize("text", ["", "0", "-1", "3ly", "nan", "inf", "mm", "1,5"])
def test_bad_length(text):
    with pytest.raises(argparse.ArgumentTypeError, match="write 20, 20mm"):
        grammar.length(text)


@pytest.mark.parametrize(
    "text",
    ["sun", "directional:", "directional:1,2", "directional:0,0,0", "point:1,2,x", "point:1,2,3:1,2", "env:"],
)
def test_bad_light(text):
    with pytest.raises(argparse.ArgumentTypeError):
        grammar.light(text)


def test_directional_light():
    (sun,) = request.lights_from(parsed("--light", "directional:0,0,-2:1,2,3"), box())
    np.testing.assert_allclose(sun.direction, (0, 0, -1))
    np.testing.assert_allclose(sun.irradiance, (1, 2, 3))


def test_point_light_in_mm_and_in_half_sides_of_the_box():
    mesh = box()
    args = parsed("--light", "point:1,2,3:5", "--light", "point:0,1.5,0b")
    lamp, above = request.lights_from(args, mesh)
    np.testing.assert_allclose(lamp.position, (1, 2, 3))
    np.testing.assert_allclose(lamp.intensity, 5)
    centre, half = mesh.bounds.mean(axis=0), np.ptp(mesh.bounds, axis=0) / 2
    np.testing.assert_allclose(above.position - centre, (0, 1.5 * half[1], 0), atol=1e-12)
    np.testing.assert_allclose(above.intensity, (1.5 * half[1]) ** 2)  # 1 W/mm^2 at the centre


def test_a_lamp_at_the_centre_shines():
    mesh = box()
    (lamp,) = request.lights_from(parsed("--light", "point:0,0,0b"), mesh)
    np.testing.assert_allclose(lamp.intensity, (np.ptp(mesh.bounds, axis=0).min() / 2) ** 2)


def test_default_lights_follow_the_up_axis():
    for y, z in zip(request.lights_from(parsed(), box()), request.lights_from(parsed("--up", "z"), box()), strict=True):
        np.testing.assert_allclose(z.direction, y.direction[[0, 2, 1]] * (1, -1, 1))
        assert y.direction[1] < 0  # from above


def test_environment(tmp_path, monkeypatch):
    pixels = np.array([[[128, 64, 32, 129], [0, 0, 0, 0]]], np.uint8)
    path = tmp_path / "himmel über.hdr"
    path.write_bytes(b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 1 +X 2\n" + pixels.tobytes())
    (sky,) = request.lights_from(parsed("--light", f"env:{path}", "--up", "z"), box())
    np.testing.assert_allclose(sky.radiance, [[[1, 0.5, 0.25], [0, 0, 0]]])
    assert sky.up == "z"
    path.write_bytes(b"junk")
    with pytest.raises(InputError, match="himmel über"):
        request.lights_from(parsed("--light", f"env:{path}"), box())
    monkeypatch.setattr(images, "read_radiance", lambda path: np.full((1, 2, 3), np.nan))
    with pytest.raises(InputError, match=r"himmel über\.hdr: radiance: .* not finite"):
        request.lights_from(parsed("--light", f"env:{path}"), box())
    (grey,) = request.lights_from(parsed("--light", "env:0.5"), box())
    np.testing.assert_allclose(grey.radiance, 0.5)


def test_run_length_encoded_hdr(tmp_path):
    width = 16
    run, literal = bytes((128 + width, 128)), bytes((width, *range(100, 100 + width)))
    row = bytes((2, 2, 0, width)) + run + literal + run + bytes((128 + width, 128))
    header = b"#?RADIANCE\n\n-Y 2 +X 16\n"
    (tmp_path / "a.hdr").write_bytes(header + 2 * row)
    expected = np.full((2, width, 3), 0.5)
    expected[..., 1] = np.arange(100, 100 + width) / 256
    np.testing.assert_allclose(images.read_radiance(tmp_path / "a.hdr"), expected)
    (tmp_path / "short.hdr").write_bytes(header + row + row[:9])
    with pytest.raises(InputError, match="no complete Radiance picture"):
        images.read_radiance(tmp_path / "short.hdr")


def test_png_is_decoded_from_srgb(tmp_path):
    image = pytest.importorskip("PIL.Image")
    image.new("RGB", (2, 1), (188, 255, 0)).save(tmp_path / "a.png")
    np.testing.assert_allclose(images.read_radiance(tmp_path / "a.png")[0, 0], (0.503, 1, 0), atol=1e-3)
    (tmp_path / "b.png").write_text("no picture")
    with pytest.raises(InputError, match="no picture"):
        images.read_radiance(tmp_path / "b.png")


def test_materials_by_name_by_numbers_and_overridden():
    mesh = box()
    assert request.medium_from(parsed(), mesh).name == "marble"
    own = request.medium_from(parsed("--sigma-a", "0.1", "--sigma-s", "1,2,3", "--g", "0.5"), mesh)
    np.testing.assert_allclose(own.sigma_a, 0.1)
    np.testing.assert_allclose(own.sigma_s, (1, 2, 3))
    assert (own.g, own.eta) == (0.5, 1.0)
    marble = request.medium_from(parsed("--material", "marble"), mesh)
    glassy = request.medium_from(parsed("--material", "marble", "--eta", "1.2", "--g", "0.5"), mesh)
    np.testing.assert_allclose(glassy.sigma_s_prime, marble.sigma_s_prime)
    assert (glassy.eta, glassy.g) == (1.2, 0.5)


def test_mix():
    mix = request.medium_from(parsed("--mix", "ketchup:2mm:7"), box())
    assert (mix.a.name, mix.b.name, mix.weight.scale, mix.weight.seed) == ("marble", "ketchup", 2.0, 7)
    assert request.medium_from(parsed("--mix", "ketchup"), box(20)).weight.scale == 5


def test_material_file(tmp_path):
    path = tmp_path / "grünes wachs.toml"
    path.write_text('name = "wax"\nsigma_a = [0.1, 0.2, 0.3]\nsigma_s_prime = 2\neta = 1.4\n', encoding="utf-8")
    wax = request.medium_from(parsed("--material", str(path)), box())
    np.testing.assert_allclose(wax.sigma_a, (0.1, 0.2, 0.3))
    np.testing.assert_allclose(wax.sigma_s_prime, 2)
    assert (wax.name, wax.eta) == ("wax", 1.4)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("sigma_a = 1\nsigma_t = 2", "did you mean 'sigma_"),
        ("sigma_a = 1", "needs sigma_a and one of"),
        ("sigma_a = 1\nsigma_s = 1\nsigma_s_prime = 1", "needs sigma_a and one of"),
        ("sigma_a = -1\nsigma_s = 1", "sigma_a"),
        ("sigma_a = 'x'\nsigma_s = 1", "sigma_a"),
        ("sigma_a = ", "no TOML"),
    ],
)
def test_bad_material_file(tmp_path, text, says):
    path = tmp_path / "m.toml"
    path.write_text(text)
    with pytest.raises(InputError, match=says) as caught:
        request.material_file(str(path))
    assert str(path) in str(caught.value)


def test_values_may_begin_with_a_minus_sign():
    assert parsed("--camera", "-30,15").camera == (-30, 15, 1)
    assert parsed("--exposure", "-1").exposure == -1


def test_a_length_below_zero_is_told_as_one(capsys):
    with pytest.raises(SystemExit):
        parsed("--size", "-5mm")
    assert "'-5mm' is no length above 0" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("error", "code", "says"),
    [
        (InputError("mesh: bad\nthing"), 1, "clsss: error: mesh: bad thing\n"),
        (DeviceError("no device"), 1, "clsss: error: no device\n"),
        (MemoryError(), 1, "clsss: error: not enough memory; lower --resolution\n"),
        (OSError(28, "No space left on device", "x"), 1, "clsss: error: x: No space left on device\n"),
        (OSError(28, "No space left on device"), 1, "clsss: error: No space left on device\n"),
        (KeyboardInterrupt(), 130, ""),
    ],
)
def test_every_end_has_a_code_and_at_most_one_line(capsys, error, code, says):
    def command():
        raise error

    assert running.run(command) == code
    assert capsys.readouterr().err == says


def test_a_bug_is_one_line_too(capsys):
    assert running.run(lambda: [][0]) == 1
    assert capsys.readouterr().err.count("\n") == 1


def test_progress_covers_the_whole_bake():
    shares = [running.overall(stage, f) for stage in running._STAGES for f in (0, 1)]
    assert np.diff(shares).min() > -1e-12
    assert (shares[0], shares[-1]) == (0, pytest.approx(1))


def test_wrong_usage_is_2():
    for words in (
        [],
        ["bake"],
        ["bake", "x", "-o", "y.glb", "--size", "big"],
        ["bake", "x", "-o", "y.glb", "--sigma-a", "1"],
    ):
        done = clsss(*words)
        assert (done.returncode, done.stdout) == (2, "")
        assert "Traceback" not in done.stderr


@pytest.mark.parametrize("output", ["out.stl", "missing folder/out.glb"])
def test_bad_output_is_told_before_anything_is_read(tmp_path, output):
    done = clsss("bake", tmp_path / "no such mesh.ply", "-o", tmp_path / output)
    assert done.returncode == 1
    assert done.stderr.startswith("clsss: error: ")
    assert output in done.stderr
    assert done.stderr.count("\n") == 1


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["--material", "marbel"], "marble"),
        (["--mix", "none.toml"], "none.toml"),
        (["--vertex-colours", "marble:nothing"], "unknown name 'nothing'"),
        (["--light", "env:none.hdr"], "none.hdr"),
        (["--light", "point:0,2,0b:-1"], "intensity"),
        (["--blocker", "none.ply"], "none.ply"),
        (["--grid", "none.npz"], "none.npz"),
        (["--material", "marble", "--sigma-a=-1"], "sigma_a"),
        (["--eta", "0"], "eta"),
        (["--resolution", "2"], "resolution"),
        (["--tolerance", "2"], "tolerance"),
        (["--device", "no such device"], "no such device"),
    ],
)
def test_what_is_wrong_whatever_the_mesh_is_told_before_it_is_read(tmp_path, words, says):
    path = tmp_path / "mesh.ply"
    path.write_text("no mesh")
    parser = argparse.ArgumentParser()
    options.add_shared(parser)
    with pytest.raises((InputError, DeviceError), match=says):
        running.bake_with_bar(scenefile.parse(parser, [str(path), *words]))


@pytest.mark.parametrize(
    "words", [["a.ply", "-o", "a.ply"], ["a.ply", "-o", "./a.ply"], ["a.ply", "-o", "b.glb", "--report", "b.glb"],
              ["a.ply", "-o", "b.glb", "--material", "w.toml", "--save-scene", "w.toml"],
              ["a.ply", "-o", "link.ply"], ["s.toml", "-o", "b.glb", "--report", "./s.toml"]]
)  # fmt: skip
def test_nothing_is_written_over_what_is_read(tmp_path, monkeypatch, capsys, words):
    before = {"a.ply": "no mesh", "w.toml": "sigma_a = 1\nsigma_s = 1", "s.toml": 'mesh = "a.ply"'}
    for name, text in before.items():
        (tmp_path / name).write_text(text)
    (tmp_path / "link.ply").symlink_to("a.ply")
    monkeypatch.chdir(tmp_path)
    args = scenefile.parse(cli._parser(), ["bake", *words])
    assert running.run(lambda: args.command(args)) == 1
    assert re.fullmatch("clsss: error: .* written over.*\n", capsys.readouterr().err)
    assert {name: (tmp_path / name).read_text() for name in before} == before


def test_what_is_protected_is_left_alone(tmp_path, monkeypatch):
    (tmp_path / "a.ply").write_text("no mesh")
    monkeypatch.setattr(os, "access", lambda path, mode: Path(path).is_dir())
    args = parsed()
    args.mesh = str(tmp_path / "a.ply")
    with pytest.raises(InputError, match=r"a\.ply: no permission to read it"):
        request.check(args)
    with pytest.raises(InputError, match=r"a\.ply: .* write-protected"):
        export.check_writable(tmp_path / "a.ply")
    assert export.check_writable(tmp_path / "b.ply") == tmp_path / "b.ply"


@pytest.mark.parametrize("closed", [">&-", "2>&-", ">&- 2>&-"])
def test_closed_streams_are_no_trouble(tmp_path, closed):
    words = [sys.executable, "-m", "clsss", "bake", "demo", "-o", tmp_path / "a.ply", "--resolution", "8"]
    done = subprocess.run(["bash", "-c", shlex.join(map(str, words)) + " " + closed], capture_output=True, text=True,
                          cwd=ROOT)  # fmt: skip
    assert (done.returncode, "Traceback" in done.stderr) == (0, False)
    assert os.listdir(tmp_path) == ["a.ply"]


def test_the_window_waits_for_nothing_that_is_wrong_already(monkeypatch, capsys):
    monkeypatch.setattr(running, "leave", lambda code: None)
    monkeypatch.setattr("clsss.window.Window", lambda args: pytest.fail("opened a window"))
    view.main(["demo", "--material", "marbel"])
    assert capsys.readouterr().err.startswith("clsss: error: material: unknown name 'marbel'")


def test_missing_mesh(tmp_path):
    pytest.importorskip("clsss.mesh")
    done = clsss("bake", tmp_path / "größe x.ply", "-o", tmp_path / "a.glb")
    assert done.returncode == 1
    assert done.stderr.startswith("clsss: error: ")
    assert "größe x.ply" in done.stderr
    assert list(tmp_path.iterdir()) == []


def test_materials_lists_all_and_shows_one(capsys):
    cli.show_materials(SimpleNamespace(name=None))
    assert "marble " in capsys.readouterr().out
    cli.show_materials(SimpleNamespace(name="marble"))
    assert "2.19" in capsys.readouterr().out


def test_unknown_material_is_one_line():
    done = clsss("materials", "marbel")
    assert done.returncode == 1
    assert done.stderr.startswith("clsss: error: ")
    assert "marble" in done.stderr


def test_reader_that_leaves_early():
    code = f"{shlex.quote(sys.executable)} -m clsss materials | head -c 1; exit ${{PIPESTATUS[0]}}"
    done = subprocess.run(["bash", "-c", code], capture_output=True, text=True, cwd=ROOT)
    assert done.returncode in (0, 130)  # 0 if all was written before the reader left
    assert done.stderr == ""


STUCK = """
import sys, time, types
from clsss import cli, running
running.load = lambda args: None
running.bake = lambda args, mesh, progress: (print("baking", flush=True), time.sleep(3600))
cli.main()
"""


def test_interrupt_ends_a_bake_at_once(tmp_path):
    words = [sys.executable, "-c", STUCK, "bake", "demo", "-o", str(tmp_path / "x.glb")]
    process = subprocess.Popen(words, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert process.stdout.readline() == "baking\n"
    process.send_signal(signal.SIGINT)
    try:
        _, errors = process.communicate(timeout=60)  # the bake would take an hour
    finally:
        process.kill()
    assert (process.returncode, errors) == (130, "")
    assert os.listdir(tmp_path) == []


IMPORTING = """
import sys
class Interrupt:
    def find_spec(self, name, *_):
        if name == {name!r}:
            raise KeyboardInterrupt
sys.meta_path.insert(0, Interrupt())
from clsss.{module} import main
main(["bake", "demo", "-o", "/nowhere/a.glb"] if main.__module__ == "clsss.cli" else ["demo"])
"""


@pytest.mark.parametrize("module", ["cli", "view"])
@pytest.mark.parametrize("name", ["argparse", "clsss.scenefile", "clsss.options", "numpy"])
def test_interrupt_while_python_imports(module, name):
    code = IMPORTING.format(module=module, name=name)
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT)
    assert (done.returncode, done.stderr) == (130, "")


def test_bake_writes_mesh_and_report(tmp_path):
    pytest.importorskip("clsss.simulate")
    pytest.importorskip("clsss.demo")
    done = clsss("bake", "demo", "-o", tmp_path / "a.ply", "--report", tmp_path / "r.json", "--resolution", "16")
    assert done.returncode == 0, done.stderr
    assert "size: 20 mm (the demonstration mesh)" in done.stderr
    assert json.loads((tmp_path / "r.json").read_text())["solve"]["converged"]
    assert sorted(os.listdir(tmp_path)) == ["a.ply", "r.json"]
    quiet = clsss("bake", tmp_path / "a.ply", "-o", tmp_path / "b.glb", "--resolution", "16", "--quiet")
    assert (quiet.returncode, quiet.stderr) == (0, "")


def test_wrong_usage_is_one_line():
    done = clsss("bake", "demo", "-o", "x.ply", "--resolution", "1.5")
    assert done.returncode == 2
    assert done.stderr == "clsss: error: argument --resolution: '1.5' is no whole number (see clsss bake --help)\n"
    assert clsss("bake", "demo").stderr.count("\n") == 1


@pytest.fixture(scope="module")
def ball(tmp_path_factory):
    path = tmp_path_factory.mktemp("mesh") / "ball.ply"
    trimesh.creation.icosphere(2, 10.0).export(path)
    return path


def test_bake_keeps_and_repeats_a_scene(tmp_path, ball):
    shared = ["--resolution", "12", "--material", "skin2"]
    first = clsss("bake", ball, "-o", tmp_path / "a.npz", "--save-scene", tmp_path / "s.toml", *shared)
    assert first.returncode == 0, first.stderr
    assert sorted(os.listdir(tmp_path)) == ["a.npz", "s.toml"]
    again = clsss("bake", tmp_path / "s.toml", "-o", tmp_path / "b.npz", "--quiet")
    assert (again.returncode, again.stderr) == (0, "")
    scene = str(tmp_path / "s.toml")
    args = scenefile.parse(cli._parser(), ["bake", scene, "--camera", "40,0", "--save-scene", scene])
    request.check(args)  # a scene may be written over by what it becomes
    assert args.camera == (40, 0, 1)
    one, two = (np.load(tmp_path / name)["radiosity"] for name in ("a.npz", "b.npz"))
    np.testing.assert_allclose(two, one, rtol=1e-4, atol=1e-6 * one.max())


def test_nothing_is_written_when_a_bake_fails(tmp_path):
    (tmp_path / "s.toml").write_text('mesh = "none.ply"\noutput = "o.ply"\nreport = "r.json"')
    done = clsss("bake", tmp_path / "s.toml", "--save-scene", tmp_path / "t.toml")
    assert done.returncode == 1
    assert done.stderr.startswith("clsss: error: ")
    assert done.stderr.count("\n") == 1
    assert os.listdir(tmp_path) == ["s.toml"]


def test_compare_prints_and_writes(tmp_path, ball):
    words = ["--resolution", "12", "--points", "20", "--paths", "20", "--json", tmp_path / "c.json"]
    done = clsss("compare", ball, *words)
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[0].startswith("method")
    found = json.loads((tmp_path / "c.json").read_text())
    assert [method["name"] for method in found["methods"]] == ["clsss", "dipole"]
    assert found["monte_carlo"]["points"] <= 20
    assert clsss("compare", "demo", "--points", "0").returncode == 2
    refused = clsss("compare", "demo", "--picture", tmp_path / "c.jpg")
    assert (refused.returncode, refused.stderr.count("\n")) == (1, 1)


def test_what_libraries_log_is_not_shown(tmp_path, ball):
    """Some exporters write normals to STL that are no numbers; trimesh does without them and logs a traceback."""
    text = trimesh.load_mesh(ball).export(file_type="stl_ascii")
    (tmp_path / "a.stl").write_text(re.sub("normal .*", "normal x y z", text, count=1))
    done = clsss("info", tmp_path / "a.stl")
    assert (done.returncode, done.stderr) == (0, "")
    assert "surface: closed" in done.stdout


def test_a_flat_card_is_a_blocker(tmp_path):
    (tmp_path / "card.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    scene = tmp_path / "s.toml"
    scene.write_text('mesh = "m.ply"\nblockers = ["card.obj"]\n')
    args = scenefile.parse(cli._parser(), ["bake", str(scene)])
    (card,) = request.blockers_from(args, SimpleNamespace(report={"scale": 2.0}))
    np.testing.assert_allclose(np.ptp(card.vertices[card.faces], axis=(0, 1)), (2, 2, 0))


def test_blockers_scale_with_the_mesh(tmp_path):
    trimesh.creation.box([4, 4, 1]).apply_translation([0, 0, 5]).export(tmp_path / "wall.ply")
    args = parsed("--blocker", str(tmp_path / "wall.ply"))
    (wall,) = request.blockers_from(args, SimpleNamespace(report={"scale": 10.0}))
    np.testing.assert_allclose(wall.bounds, [[-20, -20, 45], [20, 20, 55]])
    np.testing.assert_allclose(wall.vertices.max(axis=0), (20, 20, 55))


def test_no_light_is_said(monkeypatch):
    report = {"energy": {"deposited_W": [0.0, 0.0, 0.0]}}
    module = importlib.import_module("clsss.simulate")  # by its path it may be the function of that name
    monkeypatch.setattr(module, "simulate", lambda *args, **options: SimpleNamespace(report=report))
    mesh = SimpleNamespace(**vars(box()), report={"scale": 1.0})
    with pytest.warns(UserWarning, match="no light enters"):
        running.bake(parsed("--light", "directional:0,0,1:0"), mesh, None)


def test_swatches_only_where_they_show(monkeypatch):
    monkeypatch.setenv("COLORTERM", "truecolor")
    monkeypatch.delenv("NO_COLOR", raising=False)
    monkeypatch.setattr("sys.stdout.isatty", lambda: True, raising=False)
    assert "\x1b[48;2;" in listing.table()
    monkeypatch.setenv("NO_COLOR", "1")
    assert "\x1b" not in listing.table()
    monkeypatch.delenv("NO_COLOR")
    monkeypatch.setenv("COLORTERM", "")
    assert "\x1b" not in listing.one("marble")


def test_doubtful_materials_are_marked():
    lines = {line.split()[0]: line for line in listing.table().splitlines()}
    assert "!" in lines["ketchup"]
    assert "!" not in lines["marble"]
    assert "diffusion is only approximate" in listing.one("ketchup")
    assert "0.4562" in listing.one("marble")  # mean free path, red
