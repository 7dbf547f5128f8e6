"""Subsurface light diffusion in objects of any shape, solved with OpenCL and baked to mesh vertices.

>>> import clsss
>>> mesh = clsss.load_mesh("dragon.ply", size=20.0)
>>> result = clsss.simulate(mesh, clsss.material("marble"), [clsss.DirectionalLight((0, -1, 0))])
>>> result.save("dragon.glb")
"""

from __future__ import annotations

import importlib
import sys
from types import ModuleType
from typing import TYPE_CHECKING, Any

from clsss.errors import DeviceError, InputError

if TYPE_CHECKING:
    import clsss.reference as reference
    from clsss.discovery import devices
    from clsss.lights import DirectionalLight, Emission, EnvironmentLight, PointLight
    from clsss.materials import Material, material, materials
    from clsss.media import Grid, Mix, Perlin, Voxels
    from clsss.mesh import Mesh, load_mesh
    from clsss.paint import Inward
    from clsss.simulate import Result, simulate
    from clsss.validity import ConvergenceWarning, DiffusionWarning, ResolutionWarning

__version__ = "0.1.0"

__all__ = [
    "ConvergenceWarning",
    "DeviceError",
    "DiffusionWarning",
    "DirectionalLight",
    "Emission",
    "EnvironmentLight",
    "Grid",
    "InputError",
    "Inward",
    "Material",
    "Mesh",
    "Mix",
    "Perlin",
    "PointLight",
    "ResolutionWarning",
    "Result",
    "Voxels",
    "devices",
    "load_mesh",
    "material",
    "materials",
    "reference",
    "simulate",
]

_HOME = {
    "lights": ("DirectionalLight", "Emission", "EnvironmentLight", "PointLight"),
    "materials": ("Material", "material", "materials"),
    "media": ("Grid", "Mix", "Perlin", "Voxels"),
    "paint": ("Inward",),
    "mesh": ("Mesh", "load_mesh"),
    "simulate": ("Result", "simulate"),
    "discovery": ("devices",),
    "validity": ("ConvergenceWarning", "DiffusionWarning", "ResolutionWarning"),
}
_MODULE_OF = {name: module for module, names in _HOME.items() for name in names}


class _Package(ModuleType):
    """The package: `simulate` and `materials` are its functions, whenever the modules of these names are imported."""

    def __setattr__(self, name: str, value: Any) -> None:
        if not (name in _MODULE_OF and isinstance(value, ModuleType)):
            super().__setattr__(name, value)


sys.modules[__name__].__class__ = _Package


def __getattr__(name: str) -> Any:
    """Import a public name when it is first used: `import clsss` stays fast."""
    if name == "reference":
        return importlib.import_module("clsss.reference")
    if name not in _MODULE_OF:
        raise AttributeError(f"module 'clsss' has no attribute {name!r}")
    value = getattr(importlib.import_module(f"clsss.{_MODULE_OF[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    """The public names, also those not imported yet: for completion."""
    return sorted([*__all__, "__version__"])
