"""The `clsss` command: bake, materials, info, doctor, demo.

Results go to stdout, everything said on the way to stderr.
"""

from __future__ import annotations

import argparse
import json
import sys
from typing import TYPE_CHECKING

from clsss import __version__
from clsss.options import LIGHT_HELP, add_mesh, add_shared, parse
from clsss.running import bake_with_bar, interruptible, leave, load, run

if TYPE_CHECKING:
    from clsss.materials import Material


def main(argv: list[str] | None = None) -> None:
    """Run the command line and exit."""
    code = 0

    def command() -> None:
        args = parse(_parser(), argv)
        args.command(args)

    try:
        code = run(command)
    except SystemExit as stop:  # argparse: help or wrong usage
        code = stop.code if isinstance(stop.code, int) else 2
    leave(code)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="clsss",
        description="Subsurface light diffusion in meshes: bakes how light scatters inside to colours.",
        epilog="`python -m clsss.view MESH` shows the result in a window.",
    )
    parser.add_argument("--version", action="version", version=f"clsss {__version__}")
    commands = parser.add_subparsers(metavar="COMMAND", required=True)

    def add(name: str, command: object, text: str, epilog: str | None = None) -> argparse.ArgumentParser:
        sub = commands.add_parser(
            name,
            help=text,
            description=text,
            epilog=epilog,
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
        sub.set_defaults(command=command)
        return sub

    sub = add("bake", bake, "simulate a mesh and save its vertex colours", LIGHT_HELP)
    add_shared(sub)
    sub.add_argument(
        "-o", "--output", required=True, metavar="OUT", help="file to write: .glb .ply .obj .npz .vtu"
    )
    sub.add_argument(
        "--report", metavar="R.json", help="also write the report: sizes, convergence, energy, seconds"
    )
    sub = add("materials", list_materials, "list the measured materials, or show one")
    sub.add_argument("name", nargs="?", metavar="NAME")
    sub = add("info", info, "tell what a mesh is and what would be repaired")
    add_mesh(sub)
    sub.set_defaults(quiet=True)
    add("doctor", doctor, "check this machine: OpenCL devices, OpenGL back ends, versions")
    sub = add("demo", demo, "write the demonstration mesh")
    sub.add_argument(
        "-o", "--output", required=True, metavar="OUT", help="mesh file to write, such as demo.ply"
    )
    return parser


def bake(args: argparse.Namespace) -> None:
    """``clsss bake``: refuse bad outputs first, then simulate, then write."""
    from clsss.export import check_output, check_writable, save, write_atomically

    check_output(args.output)
    if args.report:
        check_writable(args.report)
    result = bake_with_bar(args)
    save(result, args.output, args.exposure)
    if args.report:
        write_atomically(args.report, (json.dumps(result.report, indent=1) + "\n").encode())
    if not args.quiet:
        print(_summary(result.report), f"saved {args.output}", sep="\n", file=sys.stderr)


def _summary(report: dict) -> str:
    octree, solve, energy = report["octree"], report["solve"], report["energy"]
    incident = max(sum(energy["incident_W"]), 1e-300)
    return (
        f"baked {report['mesh']['vertices']} vertices on {report['device']} "
        f"in {report['seconds']['total']:.1f} s: {octree['leaves']} cells of {octree['h_mm']:.3g} mm and up, "
        f"{solve['cycles']} cycles"
        f"{'' if solve['converged'] else ' (not converged)'}, "
        f"{100 * sum(energy['exited_W']) / incident:.0f} % of the light comes out again"
    )


def list_materials(args: argparse.Namespace) -> None:
    """``clsss materials [NAME]``."""
    from clsss.materials import material, materials

    if args.name:
        print(_describe(material(args.name)))
        return
    print(" " * 30 + f"{'sigma_a [1/mm]':^25}" + " sigma_s' [1/mm]           eta    path  spread  colour")
    for name in materials():
        entry = material(name)
        print(
            f"{name:<30}{_three(entry.sigma_a, 8)} {_three(entry.sigma_s_prime, 7)} {entry.eta:5.2f} "
            f"{1 / entry.sigma_tr.mean():7.3f} {_spread(entry):>7}  {_swatch(entry)}"
        )
    print("path: mean free path 1/sigma_tr [mm]; spread: how far light diffuses, 1/sigma_eff [mm], in the")
    print("channel it goes farthest in; colour: diffuse reflectance in white light (sRGB)")


def _three(values: object, width: int) -> str:
    return "".join(f"{value:{width}.4g}" for value in values)  # type: ignore[attr-defined]


def _spread(entry: Material) -> str:
    smallest = float(entry.sigma_eff.min())
    return f"{1 / smallest:.2f}" if smallest > 0 else "inf"


def _swatch(entry: Material) -> str:
    import numpy as np

    from clsss.export import srgb_encode

    red, green, blue = np.rint(255 * srgb_encode(entry.diffuse_reflectance)).astype(int)
    text = f"#{red:02x}{green:02x}{blue:02x}"
    return f"\x1b[48;2;{red};{green};{blue}m    \x1b[0m {text}" if sys.stdout.isatty() else text


def _describe(entry: Material) -> str:
    rows = [
        ("absorption sigma_a", entry.sigma_a, "1/mm"),
        ("reduced scattering sigma_s'", entry.sigma_s_prime, "1/mm"),
        ("mean free path 1/sigma_tr", 1 / entry.sigma_tr, "mm"),
        ("attenuation sigma_eff", entry.sigma_eff, "1/mm"),
        ("reduced albedo", entry.albedo, ""),
        ("diffuse reflectance", entry.diffuse_reflectance, _swatch(entry)),
    ]
    lines = [entry.name, *(f"  {name:<28}{_three(values, 10)}  {unit}" for name, values, unit in rows)]
    lines += [f"  g {entry.g:g}, eta {entry.eta:g}", f"  source: {entry.source}"]
    return "\n".join(lines)


def info(args: argparse.Namespace) -> None:
    """``clsss info MESH``."""
    from clsss.request import size_note

    mesh = interruptible(lambda: load(args))
    low, high = mesh.bounds
    report = mesh.report
    print(f"{mesh.name}: {report['vertices']} vertices, {report['faces']} faces")
    print(size_note(args, mesh))
    print("box:", " x ".join(f"{side:.4g}" for side in high - low), "mm")
    print("surface:", "closed" if report["closed"] else "not closed")
    for repair in report["repairs"]:
        print("repaired:", repair)
    if not report["repairs"]:
        print("repaired: nothing")
    if not mesh.closed:
        print("inside: where the surface winds around more than half (it cannot be closed)")


def doctor(args: argparse.Namespace) -> None:
    """``clsss doctor``."""
    from clsss.doctor import examine

    examine()


def demo(args: argparse.Namespace) -> None:
    """``clsss demo``: the generated mesh as a file of any format that trimesh writes."""
    from pathlib import Path

    from clsss.demo import demo_mesh
    from clsss.errors import InputError
    from clsss.export import check_writable, write_atomically

    path = check_writable(Path(args.output))
    mesh = interruptible(demo_mesh)
    try:
        content = mesh.export(file_type=path.suffix.lstrip(".").lower() or "ply")
    except (ValueError, KeyError) as error:
        raise InputError(
            f"{path}: cannot write a mesh as {path.suffix!r}; use .ply, .obj, .stl or .glb"
        ) from error
    write_atomically(path, content if isinstance(content, bytes) else str(content).encode())
