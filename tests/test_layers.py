"""A module imports only from lower layers; heavy libraries stay in their one place and load late."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parent.parent / "clsss"
LAYERS = {
    -1: ["errors", "discovery", "capture", "kernelsource", "morton", "srgb", "kept", "fresnel", "heap"],
    0: [
        "device",
        "materials",
        "meshfile",
        "halfedges",
        "demo",
        "analytic",
        "analytic_sphere",
        "images",
        "grammar",
        "camera",
        "subdivision",
        "pointtree",
        "bvh",
    ],
    0.1: [
        "sparsematrix",
        "room",
        "media",
        "lights",
        "rays",
        "options",
        "opengl",
        "overlay",
        "winding",
        "tomlfile",
        "paint",
    ],
    0.15: ["orientation", "exposure", "stowed"],
    0.2: ["repair", "renderer", "doctor", "triangles"],
    0.3: ["mesh"],
    0.4: ["validity", "volumes", "thickness", "problem"],
    1: ["cutcell", "transport", "dipole"],
    1.1: ["paths", "launch"],
    1.2: ["photons"],
    1.3: ["montecarlo"],
    1.4: ["reference", "refinement", "coarsening", "leafmap"],
    1.5: ["level"],
    2: ["octree"],
    2.1: ["around", "fields", "inner", "rows", "jumps"],
    3: ["diffusion"],
    3.05: ["emission", "layer", "residual"],
    3.06: ["sums"],
    3.1: ["beams", "anderson", "fused"],
    3.15: ["source"],
    3.2: ["rounding", "steps"],
    4: ["arguments", "multigrid", "surface"],
    4.1: ["exchange", "single"],
    4.12: ["boundary"],
    4.15: ["interreflection"],
    4.2: ["lighting"],
    4.3: ["report"],
    5: ["simulate"],
    5.1: ["compare"],
    6: ["export", "request"],
    6.1: ["running", "comparison_picture", "scenefile", "listing"],
    6.15: ["baker"],
    6.2: ["window"],
    7: ["view"],
    8: ["cli"],
    9: ["__main__"],
}
LAYER_OF = {module: layer for layer, modules in LAYERS.items() for module in modules}
# A result saves itself: the one call from below.
UPWARD = {("simulate", "export")}
ONLY_IN = {
    "pyopencl": {"capture", "device", "discovery", "doctor"},
    "trimesh": {"mesh", "meshfile", "rays", "repair", "demo", "export", "paint"},
    "embreex": {"mesh", "rays"},
    "moderngl": {"opengl", "renderer", "doctor"},
    "glfw": {"opengl", "window"},
    "tomllib": {"tomlfile"},
    "tomli": {"tomlfile"},
    "tomli_w": {"scenefile"},
    "nrrd": {"volumes"},
    "nibabel": {"volumes"},
    "OpenEXR": {"images"},
}
MODULES = sorted(path.stem for path in PACKAGE.glob("*.py") if path.stem != "__init__")


def imports(module: str) -> list[tuple[str, bool]]:
    """Every module imported, as (dotted name, whether only for type checkers)."""
    tree = ast.parse((PACKAGE / f"{module}.py").read_text(encoding="utf-8"))
    typing_only = {
        id(inner)
        for node in ast.walk(tree)
        if isinstance(node, ast.If) and isinstance(node.test, ast.Name) and node.test.id == "TYPE_CHECKING"
        for child in node.body
        for inner in ast.walk(child)
    }
    found = []
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            parts = [f"clsss.{alias.name}" for alias in node.names]
            names = parts if node.module == "clsss" else [node.module or ""]
        else:
            continue
        found += [(name, id(node) in typing_only) for name in names]
    return found


@pytest.mark.parametrize("module", MODULES)
def test_imports_only_lower_layers(module):
    assert module in LAYER_OF, f"give {module} a layer"
    for name, typing_only in imports(module):
        package, _, other = name.partition(".")
        if package == "clsss" and other in MODULES and not typing_only and (module, other) not in UPWARD:
            assert LAYER_OF[other] < LAYER_OF[module], f"{module} imports {other}"


@pytest.mark.parametrize("module", MODULES)
def test_libraries_stay_in_their_place(module):
    for name, typing_only in imports(module):
        package = name.partition(".")[0]
        if package in ONLY_IN and not typing_only and name != "pyopencl.cltypes":
            assert module in ONLY_IN[package], f"{module} imports {package}"


@pytest.mark.parametrize("module", ["clsss", "clsss.cli", "clsss.view"])
def test_import_is_light(module):
    heavy = ["scipy", "trimesh", "embreex", "pyopencl", "moderngl", "glfw", "PIL", "manifold3d", "meshio"]
    code = f"import sys, {module}; print([m for m in {heavy} if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True,
                          cwd=PACKAGE.parent)  # fmt: skip
    assert done.stdout.strip() == "[]"


@pytest.mark.parametrize(
    ("words", "code"),
    [("view --help", 0), ("cli --help", 0), ("cli bake --help", 0), ("view", 2), ("cli bake --nothing", 2)],
)
def test_help_waits_for_nothing(words, code):
    """Parsing needs no numbers: not even numpy, which takes longer to import than everything else."""
    module, *options = words.split()
    command = [sys.executable, "-X", "importtime", "-c", f"from clsss.{module} import main; main()", *options]
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=PACKAGE.parent)
    assert done.returncode == code
    assert "numpy" not in re.findall(r"\| +([\w.]+)$", done.stderr, flags=re.M)
    assert "clsss.options" in done.stderr


def test_every_public_name_is_there():
    import clsss

    assert set(clsss.__all__) < set(dir(clsss))
    assert all(getattr(clsss, name) is not None for name in clsss.__all__)


def test_modules_do_not_hide_functions_of_their_names():
    """`clsss.simulate` and `clsss.materials` are functions, whatever was imported before."""
    code = (
        "import clsss.materials, clsss.simulate; clsss.Result, clsss.Material\n"
        "assert callable(clsss.simulate) and callable(clsss.materials), (clsss.simulate, clsss.materials)\n"
        "from clsss import simulate; assert simulate is clsss.simulate"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
