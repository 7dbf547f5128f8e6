"""What is installed: every file that the package reads, and every library that it imports."""

from __future__ import annotations

import ast
import re
import sys
from pathlib import Path

import pytest

from clsss import tomlfile

ROOT = Path(__file__).parent.parent
PROJECT = tomlfile.read(ROOT / "pyproject.toml", ("build-system", "project", "tool"))
SETUPTOOLS = PROJECT["tool"]["setuptools"]
DISTRIBUTION_OF = {"PIL": "pillow", "nrrd": "pynrrd", "tomli_w": "tomli-w", "tomllib": "tomli"}


@pytest.mark.parametrize("package", SETUPTOOLS["packages"])
def test_every_file_is_installed(package):
    folder = ROOT / SETUPTOOLS["package-dir"].get(package, package.replace(".", "/"))
    data = {path for pattern in SETUPTOOLS["package-data"][package] for path in folder.glob(pattern)}
    files = {path for path in folder.iterdir() if path.is_file() and path.suffix not in (".py", ".pyc")}
    assert files
    assert files <= data


def test_every_library_is_declared():
    project = PROJECT["project"]
    extras = project["optional-dependencies"]
    declared = {re.match(r"[\w-]+", text)[0] for text in project["dependencies"] + extras["exr"] + extras["volumes"]}
    for path in (ROOT / "clsss").glob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            names += [node.module] if isinstance(node, ast.ImportFrom) and node.module else []
            for name in (name.partition(".")[0] for name in names):
                if name not in sys.stdlib_module_names and name != "clsss":
                    assert DISTRIBUTION_OF.get(name, name) in declared, f"{path.name} imports {name}"
