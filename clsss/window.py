"""The viewer's window: grey mesh first, then the bake's progress, then its colours; mouse and keys."""

from __future__ import annotations

import argparse
import io
import time
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from clsss.baker import Baker, View
from clsss.camera import Camera, fitted
from clsss.export import check_writable, write_atomically
from clsss.grammar import LightOption
from clsss.opengl import open_window
from clsss.options import WINDOW_HELP, default_lights
from clsss.overlay import panel
from clsss.renderer import Renderer

if TYPE_CHECKING:
    from clsss.lights import Light
    from clsss.mesh import Mesh

DEGREES_PER_POINT = 0.4
MESSAGE_SECONDS = 4.0


def start_camera(args: argparse.Namespace, mesh: Mesh, aspect: float) -> Camera:
    """The camera that the options ask for, with the whole mesh in the picture at zoom 1."""
    azimuth, elevation, zoom, *aside = args.camera
    camera = Camera(np.zeros(3), 1.0, azimuth, elevation, args.up)
    camera = fitted(mesh.vertices[np.unique(mesh.faces)], camera, aspect).zoomed(zoom)
    return camera.panned(*aside) if aside else camera


def save_png(picture: np.ndarray, path: Path) -> None:
    """Write an RGB picture (h, w, 3) of bytes."""
    from PIL import Image

    out = io.BytesIO()
    Image.fromarray(picture).save(out, "PNG")
    write_atomically(path, out.getvalue())


class Window:
    """What the window shows, and what mouse and keys do to it."""

    def __init__(self, args: argparse.Namespace):
        import glfw

        self.args, self.name = args, Path(args.mesh).stem
        self.window, context = open_window(args.window_size, f"clsss – {self.name}")
        self.screen, self.renderer = context.detect_framebuffer(), Renderer(context)
        self.baker = Baker(args, glfw.post_empty_event)
        self.camera: Camera | None = None
        self.view: View | None = None
        self.lights: list[Light] = []
        self.exposure = args.exposure
        self.message, self.message_ends = "", 0.0
        self.shows_help = self.moves_light = self.turned = False
        self.pointer = glfw.get_cursor_pos(self.window)
        self._shown: object = None

    def run(self) -> None:
        """Show the window until it is closed; raises what went wrong in the bake."""
        import glfw

        glfw.set_key_callback(self.window, self._key)
        glfw.set_char_callback(self.window, lambda _, code: self._typed(chr(code).upper()))
        glfw.set_scroll_callback(self.window, self._scrolled)
        glfw.set_cursor_pos_callback(self.window, self._dragged)
        glfw.set_window_refresh_callback(self.window, lambda _: self._draw(force=True))
        self._draw()
        self.baker.start()
        while not glfw.window_should_close(self.window):
            glfw.wait_events_timeout(0.25)
            while not self.baker.events.empty():
                self._take(self.baker.events.get())
            self._draw()

    def seen(self) -> argparse.Namespace:
        """The options that show what the window shows: its camera, exposure and lights in them."""
        args = argparse.Namespace(**vars(self.args))
        args.exposure = self.exposure
        if self.camera is not None and self.renderer.mesh is not None:
            width, height = self._size()
            angles = round(self.camera.azimuth, 2), round(self.camera.elevation, 2)
            args.camera = (*angles, 1.0)
            args.camera = (*angles, *moved(self.camera, start_camera(args, self.renderer.mesh, width / height)))
        if self.turned:
            options = args.lights or default_lights(args.up)
            args.lights = [as_option(*pair) for pair in zip(options, self.lights, strict=True)]
        return args

    def _take(self, event: Any) -> None:
        if isinstance(event, BaseException):
            raise event
        if self.camera is None:
            self.renderer.set_mesh(event)
            self._reset()
            return
        if self.view is None:
            self.lights = list(event.result.lights)
            self._say("drag turns the light" if self.moves_light else "press H for help")
        self.view = event
        self.renderer.set_radiosity(event.radiosity, event.scale)

    def _say(self, message: str) -> None:
        self.message, self.message_ends = message, time.monotonic() + MESSAGE_SECONDS

    def _reset(self) -> None:
        width, height = self._size()
        assert self.renderer.mesh is not None
        self.camera = start_camera(self.args, self.renderer.mesh, width / height)
        self.exposure = self.args.exposure

    def _look(self) -> None:
        """Let the baker know from where the result is seen: the exposure follows, and what depends on the view."""
        assert self.camera is not None
        if self.camera is not self.baker.camera:
            self.baker.camera = self.camera
            if self.view is not None:
                self.baker.wishes.put(None)

    def _size(self) -> tuple[int, int]:
        import glfw

        width, height = glfw.get_framebuffer_size(self.window)
        return max(width, 1), max(height, 1)

    def _draw(self, force: bool = False) -> None:
        """Draw, unless the picture would be the one that is shown already."""
        import glfw

        if self.camera is not None:
            self._look()
        doing = self.baker.doing
        stage = "" if doing is None else f"{doing[0]}  {100 * doing[1]:.0f} %" if doing[1] else doing[0]
        words = list(filter(None, (self.message if time.monotonic() < self.message_ends else "", stage)))
        state = (
            self._size(),
            self.camera,
            self.exposure,
            self.renderer.scale,
            self.view,
            words,
            self.shows_help,
        )
        if state == self._shown and not force:
            return
        lines = [*(WINDOW_HELP if self.shows_help else ()), *words]
        density = glfw.get_window_content_scale(self.window)[0]
        self.renderer.set_overlay(panel(lines, density, doing and doing[1]) if lines else None)
        glfw.set_window_title(self.window, " – ".join(filter(None, ("clsss", self.name, stage))))
        self.renderer.draw(self.screen, self._size(), self.camera, self.exposure)
        glfw.swap_buffers(self.window)
        self._shown = state

    def _key(self, window: Any, key: int, scancode: int, action: int, modifiers: int) -> None:
        import glfw

        if key == glfw.KEY_ESCAPE and action == glfw.PRESS:
            glfw.set_window_should_close(window, True)

    def _typed(self, letter: str) -> None:
        if letter in "+=-_":
            self.exposure += 0.25 if letter in "+=" else -0.25
            self._say(f"exposure {self.exposure:+.2f} EV")
        elif letter == "H":
            self.shows_help, self.message = not self.shows_help, ""
        elif letter == "R" and self.camera is not None:
            self._reset()
        elif letter == "S" and self.camera is not None:
            self._save()
        elif letter == "L" and self._lit_from_all_around():
            self._say("light from all around cannot be turned")
        elif letter == "L":
            self.moves_light = not self.moves_light
            then = " as soon as it is baked" if self.moves_light and self.view is None else ""
            self._say(f"drag turns the {'light' if self.moves_light else 'camera'}{then}")

    def _lit_from_all_around(self) -> bool:
        return all(option.kind == "env" for option in self.args.lights or default_lights(self.args.up))

    def _save(self) -> None:
        number = 1
        while (path := Path(f"clsss-{self.name}-{number}.png")).exists():
            number += 1
        self.renderer.set_overlay(None)
        try:
            save_png(self.renderer.picture(self._size(), self.camera, self.exposure), check_writable(path))
            self._say(f"saved {path}")
        except ValueError as error:
            self._say(str(error))

    def _scrolled(self, window: Any, across: float, down: float) -> None:
        if self.camera is not None:
            self.camera = self.camera.zoomed(1.12**down)

    def _dragged(self, window: Any, x: float, y: float) -> None:
        import glfw

        dx, dy = x - self.pointer[0], y - self.pointer[1]
        self.pointer = (x, y)
        if self.camera is None:
            return
        left, middle, right = (
            glfw.get_mouse_button(window, button) == glfw.PRESS
            for button in (glfw.MOUSE_BUTTON_LEFT, glfw.MOUSE_BUTTON_MIDDLE, glfw.MOUSE_BUTTON_RIGHT)
        )
        shift = glfw.PRESS in (glfw.get_key(window, k) for k in (glfw.KEY_LEFT_SHIFT, glfw.KEY_RIGHT_SHIFT))
        if middle or right or (left and shift):
            height = glfw.get_window_size(window)[1]
            self.camera = self.camera.panned(-dx / height, dy / height)
        elif left and self.moves_light and self.view is not None:
            self._turn_lights(np.radians(DEGREES_PER_POINT) * dx, np.radians(DEGREES_PER_POINT) * dy)
        elif left:
            self.camera = self.camera.orbited(-DEGREES_PER_POINT * dx, DEGREES_PER_POINT * dy)

    def _turn_lights(self, across: float, down: float) -> None:
        assert self.camera is not None
        assert self.renderer.mesh is not None
        right, over, _ = self.camera.axes()
        turn = rotation(right, down) @ rotation(over, across)
        self.lights = [turned(light, turn, self.renderer.mesh.bounds.mean(axis=0)) for light in self.lights]
        self.turned = True
        self.baker.wishes.put(self.lights)


def moved(camera: Camera, start: Camera) -> tuple[float, ...]:
    """Zoom from one camera to another that looks the same way, and how far that is moved aside, if it is.

    Where it has moved past what the first looks at, no zoom shows what it sees; one that options take comes nearest.
    """
    right, over, nearer = (camera.axes() @ (camera.target - start.target)).tolist()
    distance = max(camera.distance + nearer, camera.distance / 100)
    height = replace(camera, distance=distance).picture_height
    zoom, aside = float(f"{start.distance / distance:.4g}"), (round(right / height, 4), round(over / height, 4))
    return (zoom, *aside) if any(aside) else (zoom,)


def rotation(axis: np.ndarray, angle: float) -> np.ndarray:
    """The right-handed rotation (3, 3) by `angle` radians around a unit axis (Rodrigues)."""
    x, y, z = axis
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross


def turned(light: Light, turn: np.ndarray, centre: np.ndarray) -> Light:
    """The light turned around the centre of the mesh; light from all around and from inside stays."""
    from clsss.lights import DirectionalLight, PointLight

    if isinstance(light, DirectionalLight):
        return replace(light, direction=turn @ light.direction)
    if isinstance(light, PointLight):
        return replace(light, position=centre + turn @ (light.position - centre))
    return light


def as_option(option: LightOption, light: Light) -> LightOption:
    """The option that gives the light, which was turned since its own option gave it."""
    from clsss.lights import DirectionalLight, PointLight

    if isinstance(light, DirectionalLight):
        vector, strength = light.direction, light.irradiance
    elif isinstance(light, PointLight):
        vector, strength = light.position, light.intensity
    else:
        return option
    return LightOption(option.kind, tuple(map(_rounded, vector)), tuple(map(_rounded, strength)))


def _rounded(value: float) -> float:
    return float(f"{value:.6g}")
