"""`clsss doctor`: what this machine has, what works, and why the rest does not."""

from __future__ import annotations

import importlib.metadata
import platform
import subprocess
import sys

from clsss.discovery import NO_DEVICE, devices
from clsss.errors import DeviceError

_PACKAGES = (
    "clsss",
    "numpy",
    "scipy",
    "pyopencl",
    "trimesh",
    "embreex",
    "manifold3d",
    "moderngl",
    "glfw",
    "pillow",
    "meshio",
    "OpenEXR",
    "nibabel",
    "pynrrd",
)
_OPENGL = {
    "without a window (EGL)": "moderngl.create_context(standalone=True, require=330, **EGL)",
    "window": "open_window((64, 64), visible=False)[1]",
}


def examine() -> None:
    """Print everything, in the order in which a bake needs it.

    Raises
    ------
    DeviceError
        No OpenCL device works, so nothing can be baked.
    """
    print(f"Python {platform.python_version()} on {platform.platform()}")
    print(", ".join(f"{name} {_version(name)}" for name in _PACKAGES))
    found = devices()
    print("OpenCL:")
    for name, where, works, why_not in found:
        print(f"  {'works' if works else 'FAILS'}  {name} ({where}){': ' + why_not if why_not else ''}")
    if not found:
        print("  no device")
    print("OpenGL:")
    for name, attempt in _OPENGL.items():
        print(f"  {_try_opengl(name, attempt)}")
    if not any(works for _, _, works, _ in found):
        raise DeviceError(NO_DEVICE)


def _version(name: str) -> str:
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return "not installed"


def _try_opengl(name: str, attempt: str) -> str:
    """Try in a process of its own: a broken driver may abort."""
    code = f"import moderngl; from clsss.opengl import EGL, open_window; i = ({attempt}).info; "
    code += "print(i['GL_RENDERER'], '| OpenGL', i['GL_VERSION'].split()[0])"
    try:
        done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    except subprocess.TimeoutExpired:
        return f"FAILS  {name}: no answer within a minute"
    if done.returncode == 0:
        return f"works  {name}: {done.stdout.strip()}"
    last = (done.stderr.strip().splitlines() or [f"ended with code {done.returncode}"])[-1]
    return f"FAILS  {name}: {last.removeprefix('clsss.errors.DeviceError: ')[:200]}"
