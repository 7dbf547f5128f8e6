"""The kernels' OpenCL C: where it lies, which files are built together, and their text without includes."""

from __future__ import annotations

import re
from pathlib import Path

KERNEL_DIR = Path(__file__).parent / "kernels"
if not KERNEL_DIR.is_dir():
    KERNEL_DIR = Path(__file__).parent.parent / "kernels"

# A driver takes longer to load a program than to hold some kernels more.
_TOGETHER = (
    ("bin", "crossing", "distance", "cutcell", "octree", "clearance", "planes", "prolong", "reduce", "anderson",
     "exchange", "passage", "surface"),
    ("coefficients", "interpolation", "around", "gradient", "correct", "boundary", "smooth", "residual", "restrict",
     "junction", "fused", "source", "moment", "layer", "attenuate", "entering"),
)  # fmt: skip


def program_of(file: str) -> tuple[str, ...]:
    """The files ``kernels/<file>.cl`` that are built as one program with `file`, itself among them."""
    return next((files for files in _TOGETHER if file in files), (file,))


def kernel_source(*names: str) -> str:
    """Source of ``kernels/<name>`` of all `names`, with ``#include "x.h"`` lines spliced in once each.

    One self-contained text per program: driver caches cannot miss an edited header, and no ``-I`` path
    with spaces can break the build. ``#line`` keeps error messages pointing at the files.
    """
    seen: set[Path] = set()

    def splice(path: Path) -> str:
        if path in seen:
            return ""
        seen.add(path)
        out = [f'#line 1 "{path.name}"']
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1):
            include = re.match(r'\s*#include\s+"([^"]+)"', line)
            if include:
                out += [splice(path.parent / include.group(1)), f'#line {number + 1} "{path.name}"']
            else:
                out.append(line)
        return "\n".join(out) + "\n"

    return "".join(splice(KERNEL_DIR / name) for name in names)
