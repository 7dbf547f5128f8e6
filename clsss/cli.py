"""The `clsss` command: bake, compare, materials, info, doctor, demo.

Results go to stdout, everything said on the way to stderr. What is imported is imported inside `main`, where Ctrl-C
ends the program without a traceback.
"""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

from clsss.errors import InputError
from clsss.running import bake_with_bar, interruptible, load, progress_bar, run_and_leave

if TYPE_CHECKING:
    import argparse

    from clsss.compare import Comparison
    from clsss.renderer import Renderer


def main(argv: list[str] | None = None) -> None:
    """Run the command line and exit."""

    def command() -> None:
        from clsss import scenefile

        args = scenefile.parse(_parser(), argv)
        args.command(args)

    run_and_leave(command)


def _parser() -> argparse.ArgumentParser:
    import argparse

    from clsss import __version__
    from clsss.options import LIGHT_HELP, Parser, add_camera, add_mesh, add_output, add_shared

    parser = Parser(
        prog="clsss",
        description="Subsurface light diffusion in meshes: bakes how light scatters inside to colours.",
        epilog="`python -m clsss.view MESH` shows the result in a window.",
    )
    parser.add_argument("--version", action="version", version=f"clsss {__version__}")
    commands = parser.add_subparsers(metavar="COMMAND", required=True)

    def add(name: str, command: object, text: str, epilog: str | None = None) -> argparse.ArgumentParser:
        layout = argparse.RawDescriptionHelpFormatter
        sub = commands.add_parser(name, help=text, description=text, epilog=epilog, formatter_class=layout)
        sub.set_defaults(command=command)
        return sub

    sub = add("bake", bake, "simulate a mesh and save its vertex colours", LIGHT_HELP)
    add_shared(sub)
    add_camera(sub)
    add_output(sub)
    sub = add("compare", compare, "compare a bake with the dipole and with Monte Carlo", LIGHT_HELP)
    add_shared(sub)
    add_camera(sub)
    _add_comparison(sub)
    sub = add("materials", show_materials, "list the measured materials, or show one")
    sub.add_argument("name", nargs="?", metavar="NAME")
    sub = add("info", info, "tell what a mesh is and what would be repaired")
    add_mesh(sub)
    sub.set_defaults(quiet=True)
    add("doctor", doctor, "check this machine: OpenCL devices, OpenGL back ends, versions")
    sub = add("demo", demo, "write the demonstration mesh")
    sub.add_argument("-o", "--output", required=True, metavar="OUT", help="mesh file to write, such as demo.ply")
    return parser


def _add_comparison(parser: argparse.ArgumentParser) -> None:
    from clsss.grammar import count

    group = parser.add_argument_group("comparison")
    group.add_argument("--picture", metavar="OUT.png", help="draw all three, and how far they are from the truth")
    group.add_argument("--json", metavar="OUT.json", help="write the table as data")
    group.add_argument("--points", type=count, default=1000, metavar="N", help="of Monte Carlo (1000)")
    group.add_argument("--paths", type=count, default=1000, metavar="N", help="from each point and channel (1000)")
    group.add_argument("--seed", type=int, default=0, metavar="N", help="of the points and paths (0)")


def show_materials(args: argparse.Namespace) -> None:
    """``clsss materials [NAME]``."""
    from clsss import listing

    print(listing.one(args.name) if args.name else listing.table())


def bake(args: argparse.Namespace) -> None:
    """``clsss bake``: refuse bad outputs first, then simulate, then write."""
    import json

    from clsss import scenefile
    from clsss.export import check_output, check_writable, save, write_atomically
    from clsss.request import eye_from

    if not args.output:
        args.parser.error("say where the result goes: -o OUT.glb, or 'output' in the scene file")
    check_output(args.output)
    if args.report:
        check_writable(args.report)
    if args.save_scene:
        scenefile.check(args.save_scene)
    result = bake_with_bar(args)
    save(result, args.output, args.exposure, eye_from(args))
    if args.report:
        write_atomically(args.report, (json.dumps(result.report, indent=1) + "\n").encode())
    if not args.quiet:
        print(_summary(result.report, getattr(result.medium, "name", "")), file=sys.stderr)
    _finish(args, [args.output, args.report])


def _finish(args: argparse.Namespace, written: list[str | None]) -> None:
    """Write the scene if that was asked for; say which files there are now."""
    from clsss import scenefile

    if args.save_scene:
        scenefile.save(args, args.save_scene)
    if not args.quiet:
        for path in filter(None, [*written, args.save_scene]):
            print(f"saved {path}", file=sys.stderr)


def _summary(report: dict, material: str) -> str:
    octree, solve, energy = report["octree"], report["solve"], report["energy"]
    incident = max(sum(energy["incident_W"]), 1e-300)
    return (
        f"baked {report['mesh']['vertices']} vertices{material and f' of {material}'} on {report['device']} "
        f"in {report['seconds']['total']:.1f} s: {octree['leaves']} cells of {octree['h_mm']:.3g} mm and up, "
        f"{solve['cycles']} cycles"
        f"{'' if solve['converged'] else ' (not converged)'}, "
        f"{100 * sum(energy['exited_W']) / incident:.0f} % of the light comes out again"
    )


def compare(args: argparse.Namespace) -> None:
    """``clsss compare``: bake, run both references, then print and write how they differ."""
    import json

    from clsss import scenefile
    from clsss.compare import compare as compare_with
    from clsss.export import check_writable, write_atomically

    for path, suffix in ((args.picture, ".png"), (args.json, ".json")):
        if path and check_writable(path).suffix.lower() != suffix:
            raise InputError(f"{path}: its name must end in {suffix}")
    if args.save_scene:
        scenefile.check(args.save_scene)
    renderer = _renderer() if args.picture else None
    result = bake_with_bar(args)
    with progress_bar(args) as show:
        found = interruptible(lambda: compare_with(result, args.points, args.paths, args.seed, show))
    print(found.table())
    if renderer is not None:
        _draw(args, found, renderer)
    if args.json:
        write_atomically(args.json, (json.dumps(_comparison(found), indent=1) + "\n").encode())
    _finish(args, [args.picture, args.json])


def _renderer() -> Renderer:
    from clsss.opengl import standalone_context
    from clsss.renderer import Renderer

    return Renderer(standalone_context())


def _draw(args: argparse.Namespace, found: Comparison, renderer: Renderer) -> None:
    from pathlib import Path

    from clsss.comparison_picture import picture
    from clsss.window import save_png, start_camera

    camera = start_camera(args, found.mesh, 1.0)
    save_png(picture(found, renderer, camera, exposure=args.exposure), Path(args.picture))


def _comparison(found: Comparison) -> dict[str, object]:
    """The table as data."""
    from dataclasses import asdict

    return {
        "methods": [
            asdict(score) | {"beyond_noise": beyond, "hidden_by_noise": not told}
            for score in found.scores
            for beyond, told in [found.beyond(score)]
        ],
        "monte_carlo": {
            "points": len(found.points),
            "noise": found.noise,
            "bias_noise": found.bias_noise,
            "seconds": found.seconds,
        },
        "left_out": found.left_out,
    }


def info(args: argparse.Namespace) -> None:
    """``clsss info MESH``."""
    from clsss.request import size_note
    from clsss.validity import thickness_of

    mesh = interruptible(lambda: load(args))
    low, high = mesh.bounds
    report = mesh.report
    print(f"{mesh.name}: {report['vertices']} vertices, {report['faces']} faces")
    print(size_note(args, mesh))
    print("box:", " x ".join(f"{side:.4g}" for side in high - low), "mm")
    print(f"thickness: {thickness_of(mesh):.4g} mm on average")
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
    from clsss.export import check_writable, write_atomically

    path = check_writable(Path(args.output))
    mesh = interruptible(demo_mesh)
    try:
        content = mesh.export(file_type=path.suffix.lstrip(".").lower() or "ply")
    except (ValueError, KeyError) as error:
        raise InputError(f"{path}: cannot write a mesh as {path.suffix!r}; use .ply, .obj, .stl or .glb") from error
    write_atomically(path, content if isinstance(content, bytes) else str(content).encode())
