"""What the user may say on a command line, shared by `clsss.view` and `clsss.cli`.

An option that was not given is None, so that a scene file can say it instead (scenefile.py); DEFAULTS fill in
what neither says. Parsing imports nothing heavy, so help and wrong usage are told at once; request.py makes the
mesh, the medium and the lights from what was parsed.
"""

from __future__ import annotations

import argparse
import re
import sys
from typing import Any, NoReturn

from clsss.grammar import (
    PAINT,
    LightOption,
    camera,
    channels,
    length,
    light,
    mixture,
    number,
    stops,
    vertex_colours,
    whole,
    window_size,
)

DEMO = "demo"
DEFAULT_MATERIAL = "marble"
DEFAULTS: dict[str, Any] = {
    "phase": "similarity",
    "scattering": "all",
    "resolution": 128,
    "tolerance": 1e-4,
    "adaptive": True,
    "precision": "single",
    "exposure": 0.0,
    "up": "y",
    "camera": (-25.0, 12.0, 1.0),
    "window_size": (1280, 720),
}

WINDOW_HELP = (
    "left drag\torbit",
    "wheel\tzoom",
    "right drag\tpan",
    "+ -\texposure",
    "L\tleft drag turns the light, or again the camera",
    "S\tsave a picture",
    "R\treset camera and exposure",
    "H\tthis help",
    "Esc\tquit",
)
LIGHT_HELP = """lights (--light, repeatable; several add up):
  directional:DX,DY,DZ[:E]   parallel light that travels along DX,DY,DZ; E in W/mm^2, one number or R,G,B (1)
  point:X,Y,Z[:I]            lamp at X,Y,Z mm of the mesh's frame; I in W/sr, one number or R,G,B
  point:X,Y,Zb[:I]           the same in half-sides of the bounding box from its centre: 0,1.5,0b is above it;
                             without I, a lamp gives 1 W/mm^2 at the centre of the box, and where it is nearer to
                             that than any side, at the distance of the nearest
  env:FILE.hdr               light from all around, an equirectangular picture (.hdr .exr .png .jpg), W/mm^2/sr
  env:L or env:R,G,B         the same light from everywhere
without --light: a light from behind and a weak one from the front

material file (--material FILE.toml), coefficients in 1/mm, one number or [R, G, B]:
  name = "wax"   sigma_a = [0.001, 0.002, 0.01]   sigma_s_prime = 1.5   (or sigma_s and g)   eta = 1.4

scene file (SCENE.toml in place of MESH): every option above by its name, - written _, lights and blockers as
lists; paths start at the scene file; options on the command line come first. --save-scene writes one:
  mesh = "dragon.ply"   size = "5cm"   material = "marble"   lights = ["env:sky.hdr"]   output = "dragon.glb"
"""


class Parser(argparse.ArgumentParser):
    """Tells wrong usage in one line, as all other errors are told."""

    def error(self, message: str) -> NoReturn:
        """Say what is wrong and leave with exit code 2."""
        self.exit(2, f"clsss: error: {message} (see {self.prog} --help)\n")


def default_lights(up: str) -> list[LightOption]:
    """What lights a mesh unless told otherwise: a light from behind and above, a weak one from the front."""
    vectors = ((-0.25, -0.45, 0.85), 1.0), ((0.7, -0.6, -0.5), 0.15)
    return [
        LightOption("directional", (x, y, z) if up == "y" else (x, -z, y), (strength,))
        for (x, y, z), strength in vectors
    ]


def add_mesh(parser: argparse.ArgumentParser) -> None:
    """The mesh and its size."""
    parser.add_argument("mesh", metavar="MESH", help=f"mesh file, or SCENE.toml; '{DEMO}' is a built-in mesh of 20 mm")
    parser.add_argument(
        "--size",
        type=length,
        metavar="MM",
        help="longest side of the bounding box: 20, 20mm, 2cm, 0.1m, 1in (the file's units as mm)",
    )
    parser.set_defaults(parser=parser)


def add_shared(parser: argparse.ArgumentParser) -> None:
    """The options that view, bake and compare share."""
    add_mesh(parser)
    _add_material(parser.add_argument_group("material"))
    group = parser.add_argument_group("light and picture")
    group.add_argument(
        "--light", dest="lights", type=light, action="append", metavar="LIGHT", help="see below; repeatable"
    )
    group.add_argument(
        "--blocker",
        dest="blockers",
        action="append",
        metavar="MESH",
        help="another mesh, closed or open, in the units and frame of the first, that keeps light from it; repeatable",
    )
    group.add_argument("--exposure", type=stops, metavar="EV", help="stops brighter than the automatic exposure (0)")
    group.add_argument("--up", choices=("y", "z"), help="axis that points up (y)")
    group = parser.add_argument_group("solver")
    group.add_argument("--resolution", type=whole, metavar="N", help="finest cells along the longest side (128)")
    group.add_argument("--tolerance", type=number, metavar="T", help="relative residual (1e-4)")
    group.add_argument(
        "--no-adaptive", dest="adaptive", action="store_const", const=False, help="the finest cells everywhere"
    )
    group.add_argument("--precision", choices=("single", "double"), help="of the device's arithmetic (single)")
    group.add_argument("--device", metavar="NAME", help="part of an OpenCL device's name (the best that works)")
    parser.add_argument(
        "--save-scene", metavar="FILE.toml", help="also write these options to a file that can stand for MESH"
    )
    parser.add_argument("--quiet", action="store_true", help="say nothing but errors")


def _add_material(group: argparse._ArgumentGroup) -> None:
    group.add_argument("--material", metavar="NAME|FILE.toml", help=f"see `clsss materials` ({DEFAULT_MATERIAL})")
    group.add_argument("--sigma-a", type=channels, metavar="R[,G,B]", help="absorption [1/mm]")
    group.add_argument("--sigma-s", type=channels, metavar="R[,G,B]", help="scattering [1/mm]")
    group.add_argument("--g", type=number, metavar="G", help="mean cosine of scattering (0)")
    group.add_argument("--eta", type=number, metavar="ETA", help="relative index of refraction (1)")
    group.add_argument(
        "--phase",
        choices=("similarity", "delta-eddington", "p1"),
        help="how light that has not been scattered yet is counted where g is not 0 (similarity)",
    )
    group.add_argument(
        "--scattering",
        choices=("all", "split"),
        help="split traces light scattered once on its own, as the camera sees it; slower (all)",
    )
    group.add_argument(
        "--mix",
        type=mixture,
        metavar="NAME[:SCALE[:SEED]]",
        help="blend with another material in noise of this feature size (a quarter of the mesh)",
    )
    group.add_argument(
        "--vertex-colours",
        type=vertex_colours,
        metavar=f"{PAINT}|NAME:NAME",
        help=f"what the mesh is painted with goes all the way in: {PAINT} gives the material the colours, "
        "NAME:NAME blends from the first where it is black to the second where it is white",
    )
    group.add_argument(
        "--grid",
        metavar="FILE",
        help="voxels (.npz .npy .nrrd .nii): coefficients, or where --mix is instead of in noise",
    )


def add_camera(parser: argparse.ArgumentParser) -> None:
    """Where a picture is taken from."""
    parser.add_argument(
        "--camera",
        type=camera,
        metavar="AZIMUTH,ELEVATION[,ZOOM[,RIGHT,UP]]",
        help="degrees around the up axis from the front, degrees above it, zoom, and how far the camera is moved aside "
        "in heights of the picture (-25,12,1,0,0)",
    )


def add_window_size(parser: argparse.ArgumentParser) -> None:
    """How large a window or a picture of it is."""
    parser.add_argument(
        "--window-size", type=window_size, metavar="WxH", help="of window or picture, in pixels (1280x720)"
    )


def add_output(parser: argparse.ArgumentParser) -> None:
    """Where a bake goes."""
    parser.add_argument("-o", "--output", metavar="OUT", help="file to write: .glb .ply .obj .npz .vtu")
    parser.add_argument("--report", metavar="R.json", help="also write the report: sizes, convergence, energy, seconds")


def parse(parser: argparse.ArgumentParser, argv: list[str] | None) -> argparse.Namespace:
    """Parse, taking values such as ``-30,15`` and ``-5mm`` for what they are; argparse takes them for options."""
    words: list[str] = []
    for word in sys.argv[1:] if argv is None else argv:
        if words and re.fullmatch(r"--[a-z-]+", words[-1]) and re.match(r"-[0-9.]", word):
            words[-1] += f"={word}"
        else:
            words.append(word)
    return parser.parse_args(words)


def conflict(args: argparse.Namespace) -> str:
    """What contradicts itself in the options, or nothing."""
    own = args.sigma_a is not None or args.sigma_s is not None
    if args.vertex_colours is not None and (args.mix or args.grid):
        return "--vertex-colours goes without --mix and --grid"
    if args.vertex_colours and (args.material or own):
        return "--vertex-colours NAME:NAME gives both materials; leave --material, --sigma-a and --sigma-s out"
    if not args.material and (args.sigma_a is None) != (args.sigma_s is None):
        return "--sigma-a and --sigma-s go together, unless --material gives the other"
    return ""
