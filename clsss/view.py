"""`python -m clsss.view MESH`: bake a mesh and look at it, in a window or as a picture.

The window opens at once and shows the mesh in grey; a thread bakes and the window shows how far it is.
"""

from __future__ import annotations

import argparse
import re
import sys

from clsss.options import LIGHT_HELP, WINDOW_HELP, add_shared, numbers, parse
from clsss.running import bake_with_bar, leave, run


def main(argv: list[str] | None = None) -> None:
    """Run the command line and exit."""

    def command() -> None:
        from clsss.window import Window

        args = parse(_parser(), argv)
        if args.screenshot:
            screenshot(args)
        else:
            Window(args).run()

    try:
        code = run(command)
    except SystemExit as stop:  # argparse: help or wrong usage
        code = stop.code if isinstance(stop.code, int) else 2
    leave(code)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m clsss.view",
        description="Bake how light scatters inside a mesh, and look at it.",
        epilog="window: " + ", ".join(line.replace("\t", " ") for line in WINDOW_HELP) + "\n\n" + LIGHT_HELP,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add_shared(parser)
    parser.add_argument("--screenshot", metavar="OUT.png", help="write this picture and open no window")
    parser.add_argument(
        "--window-size", type=_window_size, default=(1280, 720), metavar="WxH", help="of window or picture, in pixels (1280x720)"
    )
    parser.add_argument(
        "--camera",
        type=_camera,
        default=(-25.0, 12.0, 1.0),
        metavar="AZIMUTH,ELEVATION[,ZOOM]",
        help="degrees around the up axis from the front, degrees above it, zoom (-25,12,1)",
    )
    return parser


def _window_size(text: str) -> tuple[int, int]:
    match = re.fullmatch(r"(\d+)x(\d+)", text)
    size = (int(match[1]), int(match[2])) if match else (0, 0)
    if not (min(size) >= 16 and max(size) <= 16384):
        raise argparse.ArgumentTypeError(f"{text!r} is no size; write 1280x720 (16 to 16384 each)")
    return size


def _camera(text: str) -> tuple[float, float, float]:
    values = (*numbers(text, 2, 3), 1.0)[:3]
    if not (-89 <= values[1] <= 89 and values[2] > 0):
        raise argparse.ArgumentTypeError(f"{text!r}: the elevation lies within -89 and 89, the zoom above 0")
    return values[0], values[1], values[2]


def screenshot(args: argparse.Namespace) -> None:
    """``--screenshot``: bake, then draw the window's picture into a file."""
    from clsss.errors import InputError
    from clsss.export import check_writable, display_scale
    from clsss.opengl import standalone_context
    from clsss.scene import Scene
    from clsss.window import save_png, start_camera

    path = check_writable(args.screenshot)
    if path.suffix.lower() != ".png":
        raise InputError(f"{path}: pictures are saved as .png")
    scene = Scene(standalone_context())
    result = bake_with_bar(args)
    scene.set_mesh(result.mesh)
    scene.set_radiosity(result.vertex_radiosity, display_scale(result.mesh, result.vertex_radiosity))
    width, height = args.window_size
    camera = start_camera(args, result.mesh, width / height)
    save_png(scene.picture((width, height), camera, args.exposure), path)
    if not args.quiet:
        print(f"saved {path}", file=sys.stderr)


if __name__ == "__main__":
    main()
