"""The thread that bakes beside the viewer's window, and what is seen of a result from where the camera is.

Input: the options, then lights and cameras. Output: a Mesh, then Views.
"""

from __future__ import annotations

import argparse
import queue
import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from clsss.exposure import display_scale
from clsss.request import camera_from
from clsss.running import bake, load, overall

if TYPE_CHECKING:
    from clsss.lights import Light
    from clsss.simulate import Result

LOOK, GLANCE = 24, 8  # points on each ray where light was scattered once: at rest, and while the camera moves
GRAZING = 0.25  # least cosine at which a vertex is seen: pixels of its triangles may be seen at more


def seen_from(result: Result, eye: np.ndarray, depths: int = LOOK) -> np.ndarray:
    """Radiosity (v, 3) of a matt surface that looks from `eye` as the result does [W/mm^2].

    That of the result itself, unless it knows what was scattered once, which depends on the view.
    """
    if result.vertex_radiosity_single is None:
        return result.vertex_radiosity
    return np.pi * result.radiance(eye, depths, GRAZING)


@dataclass(frozen=True, eq=False)
class View:
    """A result, what is seen of it, as of `seen_from`, and the automatic exposure of that, as of `display_scale`."""

    result: Result
    radiosity: np.ndarray
    scale: float


class Baker(threading.Thread):
    """Loads and bakes beside the window, then bakes again for every new set of lights.

    `events` receives a Mesh, then Views, or the error that ended it; `doing` is (stage, share done) while it bakes.
    `wishes` takes lights, or None where only `camera` is another.
    """

    def __init__(self, args: argparse.Namespace, wake: Callable[[], None]):
        super().__init__(daemon=True)
        self._args, self._wake = args, wake
        self.events: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self.wishes: queue.SimpleQueue[list[Light] | None] = queue.SimpleQueue()
        self.camera = camera_from(args)
        self.doing: tuple[str, float] | None = ("reading the mesh", 0.0)

    def run(self) -> None:
        """The thread's work."""
        try:
            mesh = load(self._args)
            self._post(mesh)
            result = bake(self._args, mesh, self._progress)
            while True:
                self._show(result)
                lights = self._wish()
                if lights is not None:
                    result = result.relight(lights, self._progress)
        except BaseException as error:
            self._post(error)

    def _show(self, result: Result) -> None:
        """Post what is seen of a result; more exactly while nothing else is wished for."""
        self.doing = None
        self._post(self._look(result, GLANCE))
        if result.vertex_radiosity_single is not None and self.wishes.empty():
            self._post(self._look(result, LOOK))

    def _look(self, result: Result, depths: int) -> View:
        camera = self.camera
        radiosity = seen_from(result, camera.eye, depths)
        return View(result, radiosity, display_scale(result.mesh, radiosity, camera.axes()[2]))

    def _wish(self) -> list[Light] | None:
        """The last lights that are wished for, or None for another look."""
        lights = self.wishes.get()
        while not self.wishes.empty():  # while it baked the light moved on
            lights = self.wishes.get() or lights
        return lights

    def _progress(self, stage: str, fraction: float) -> None:
        self.doing = (stage, overall(stage, fraction))
        self._wake()

    def _post(self, event: Any) -> None:
        self.events.put(event)
        self._wake()
