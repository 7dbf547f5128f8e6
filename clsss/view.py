"""`python -m clsss.view MESH`: bake a mesh and look at it, in a window or as a picture.

The window opens at once and shows the mesh in grey; a thread bakes and the window shows how far it is. What is
imported is imported inside `main`, where Ctrl-C ends the program without a traceback.
"""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

from clsss.running import bake_with_bar, interruptible, run_and_leave

if TYPE_CHECKING:
    import argparse


def main(argv: list[str] | None = None) -> None:
    """Run the command line and exit."""

    def command() -> None:
        from clsss import scenefile

        args = scenefile.parse(_parser(), argv)
        if args.save_scene:
            scenefile.check(args.save_scene)
        if args.screenshot:
            screenshot(args)
        else:
            from clsss.request import check
            from clsss.window import Window

            interruptible(lambda: check(args))
            window = Window(args)
            window.run()
            args = window.seen()
        if args.save_scene:
            scenefile.save(args, args.save_scene)
            if not args.quiet:
                print(f"saved {args.save_scene}", file=sys.stderr)

    run_and_leave(command)


def _parser() -> argparse.ArgumentParser:
    import argparse

    from clsss.options import LIGHT_HELP, WINDOW_HELP, Parser, add_camera, add_shared, add_window_size

    parser = Parser(
        prog="python -m clsss.view",
        description="Bake how light scatters inside a mesh, and look at it.",
        epilog="window: " + ", ".join(line.replace("\t", " ") for line in WINDOW_HELP) + "\n\n" + LIGHT_HELP,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add_shared(parser)
    parser.add_argument("--screenshot", metavar="OUT.png", help="write this picture and open no window")
    add_window_size(parser)
    add_camera(parser)
    return parser


def screenshot(args: argparse.Namespace) -> None:
    """``--screenshot``: bake, then draw the window's picture into a file."""
    from clsss.baker import seen_from
    from clsss.errors import InputError
    from clsss.export import check_writable
    from clsss.exposure import display_scale
    from clsss.opengl import standalone_context
    from clsss.renderer import Renderer
    from clsss.request import eye_from
    from clsss.window import save_png, start_camera

    path = check_writable(args.screenshot)
    if path.suffix.lower() != ".png":
        raise InputError(f"{path}: pictures are saved as .png")
    renderer = Renderer(standalone_context())
    renderer.picture(args.window_size, None)  # before the bake, if it is too large
    result = bake_with_bar(args)
    renderer.set_mesh(result.mesh)
    width, height = args.window_size
    camera = start_camera(args, result.mesh, width / height)
    radiosity = seen_from(result, camera.eye)
    renderer.set_radiosity(radiosity, display_scale(result.mesh, radiosity, eye_from(args)))
    save_png(renderer.picture((width, height), camera, args.exposure), path)
    if not args.quiet:
        print(f"saved {path}", file=sys.stderr)


if __name__ == "__main__":
    main()
