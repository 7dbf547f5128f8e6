"""The picture: a mesh with its radiosity, drawn with OpenGL into a window or into a file alike.

    pixel = sRGB(tone(radiosity * scale))

Radiosity is interpolated linearly across triangles and nothing is shaded: below the shoulder of the tone
curve (0.8 of white) a pixel is the simulated exitance. Input: vertices [mm], radiosity [W/mm^2].
"""

from __future__ import annotations

import itertools
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from clsss.errors import DeviceError

if TYPE_CHECKING:
    import moderngl

    from clsss.camera import Camera
    from clsss.mesh import Mesh

SAMPLES = 4

_FULLSCREEN = """
#version 330
void main() { gl_Position = vec4(vec2(gl_VertexID & 1, gl_VertexID >> 1) * 4.0 - 1.0, 0.0, 1.0); }
"""
_BACKGROUND = """
#version 330
uniform vec2 size;
out vec4 colour;
void main() {
    float r = length(gl_FragCoord.xy / size - vec2(0.5, 0.55));
    colour = vec4(vec3(mix(0.050, 0.012, smoothstep(0.0, 0.85, r))), 1.0);
}
"""
_MESH_VERTEX = """
#version 330
uniform mat4 matrix;
in vec3 position, normal, radiosity;
out vec3 n, m;
void main() { gl_Position = matrix * vec4(position, 1.0); n = normal; m = radiosity; }
"""
# The shoulder is that of Khronos PBR Neutral: colours below `knee` stay as they are, brighter ones approach
# white without changing hue.
_MESH_FRAGMENT = """
#version 330
uniform float scale;
uniform bool baked;
uniform vec3 towards_eye;
in vec3 n, m;
out vec4 colour;
vec3 tone(vec3 c) {
    const float knee = 0.8, room = 1.0 - knee;
    float peak = max(c.r, max(c.g, c.b));
    if (peak <= knee) return c;
    float top = 1.0 - room * room / (peak + room - knee);
    return mix(c * top / peak, vec3(top), 1.0 - 1.0 / (0.15 * (peak - top) + 1.0));
}
void main() {
    float facing = abs(dot(normalize(n + 1e-9), towards_eye));
    colour = vec4(baked ? tone(max(m, 0.0) * scale) : vec3(0.05 + 0.25 * facing * facing), 1.0);
}
"""
# Noise of half a step hides the bands that 8 bits leave in dark gradients.
_ENCODE = """
#version 330
uniform sampler2D linear;
out vec4 colour;
void main() {
    vec3 x = clamp(texelFetch(linear, ivec2(gl_FragCoord.xy), 0).rgb, 0.0, 1.0);
    vec3 curved = 1.055 * pow(max(x, 0.0031308), vec3(1.0 / 2.4)) - 0.055;
    vec3 srgb = mix(curved, 12.92 * x, lessThan(x, vec3(0.0031308)));
    float noise = fract(52.9829189 * fract(dot(gl_FragCoord.xy, vec2(0.06711056, 0.00583715)))) - 0.5;
    colour = vec4(srgb + noise / 255.0, 1.0);
}
"""
_OVERLAY = """
#version 330
uniform sampler2D picture;
out vec4 colour;
void main() {
    ivec2 at = ivec2(gl_FragCoord.x, textureSize(picture, 0).y - 1 - int(gl_FragCoord.y));
    colour = texelFetch(picture, at, 0);
}
"""


class Renderer:
    """What is drawn, and the OpenGL objects that draw it.

    Parameters
    ----------
    context : moderngl.Context
        Current in the calling thread.
    """

    def __init__(self, context: moderngl.Context):
        self.context = context
        self._mesh_program = context.program(_MESH_VERTEX, _MESH_FRAGMENT)
        self._background = self._pass(_BACKGROUND)
        self._encode = self._pass(_ENCODE)
        self._overlay = self._pass(_OVERLAY)
        self._overlay_picture: moderngl.Texture | None = None
        self._vertices: moderngl.VertexArray | None = None
        self._radiosity: moderngl.Buffer | None = None
        self._targets: tuple[Any, ...] = ()
        self._centre = self._corners = np.zeros(3)
        self.mesh: Mesh | None = None
        self.scale = 0.0

    def _pass(self, fragment: str) -> moderngl.VertexArray:
        program = self.context.program(vertex_shader=_FULLSCREEN, fragment_shader=fragment)
        return self.context.vertex_array(program, [])

    def set_mesh(self, mesh: Mesh) -> None:
        """Show this mesh, grey until `set_radiosity`."""
        x, y, z = (axis[mesh.faces] for axis in mesh.vertices.T)
        self._centre = np.array([x.mean(), y.mean(), z.mean()])  # far from the origin, floats are coarse
        self._corners = np.array(list(itertools.product(*((a.min(), a.max()) for a in (x, y, z)))))
        geometry = np.hstack([mesh.vertices - self._centre, mesh.normals]).astype("f4")
        self._radiosity = self.context.buffer(reserve=12 * len(mesh.vertices))
        self._vertices = self.context.vertex_array(
            self._mesh_program,
            [
                (self.context.buffer(geometry), "3f 3f", "position", "normal"),
                (self._radiosity, "3f", "radiosity"),
            ],
            self.context.buffer(mesh.faces.astype("i4")),
        )
        self.mesh, self.scale = mesh, 0.0

    def set_radiosity(self, radiosity: np.ndarray, scale: float) -> None:
        """Colour the mesh by radiosity (v, 3) [W/mm^2] times `scale` [mm^2/W]."""
        assert self._radiosity is not None
        self._radiosity.write(np.nan_to_num(radiosity).astype("f4"))
        self.scale = scale

    def set_overlay(self, picture: np.ndarray | None) -> None:
        """Lay an RGBA picture (h, w, 4) of bytes over the lower left, or none."""
        if self._overlay_picture is not None:
            self._overlay_picture.release()
            self._overlay_picture = None
        if picture is not None:
            height, width = picture.shape[:2]
            self._overlay_picture = self.context.texture((width, height), 4, np.ascontiguousarray(picture))

    def draw(self, target: moderngl.Framebuffer, size: tuple[int, int], camera: Camera | None, exposure: float) -> None:
        """Draw the picture.

        Parameters
        ----------
        target : moderngl.Framebuffer
            The window's or another of 8 bits a channel.
        size : (int, int)
            Its width and height in pixels.
        camera : Camera or None
            None while there is no mesh yet.
        exposure : float
            Stops added to the scale of `set_radiosity`.
        """
        import moderngl

        multisampled, resolved, texture = self._targets_of(size)
        multisampled.use()
        multisampled.clear(depth=1.0)
        self.context.disable(moderngl.DEPTH_TEST | moderngl.BLEND)
        self._background.program["size"] = size
        self._background.render(moderngl.TRIANGLES, 3)
        if self._vertices is not None and self.mesh is not None and camera is not None:
            radius = float(np.linalg.norm(self._corners - camera.target, axis=1).max())
            centred = replace(camera, target=camera.target - self._centre)
            matrix = centred.matrix(size[0] / size[1], 1.01 * radius)
            self._mesh_program["matrix"] = tuple(matrix.T.ravel())
            self._mesh_program["towards_eye"] = tuple(camera.axes()[2])
            self._mesh_program["baked"] = self.scale > 0
            self._mesh_program["scale"] = self.scale * 2.0**exposure
            self.context.enable(moderngl.DEPTH_TEST)
            self._vertices.render(moderngl.TRIANGLES)
            self.context.disable(moderngl.DEPTH_TEST)
        self.context.copy_framebuffer(resolved, multisampled)
        target.use()
        target.viewport = (0, 0, *size)
        texture.use(0)
        self._encode.render(moderngl.TRIANGLES, 3)
        self._draw_overlay(target)

    def _draw_overlay(self, target: moderngl.Framebuffer) -> None:
        import moderngl

        if self._overlay_picture is None:
            return
        target.viewport = (0, 0, *self._overlay_picture.size)
        self.context.enable(moderngl.BLEND)
        self._overlay_picture.use(0)
        self._overlay.render(moderngl.TRIANGLES, 3)

    def _targets_of(self, size: tuple[int, int]) -> tuple[Any, ...]:
        import moderngl

        if not self._targets or self._targets[2].size != size:
            for part in self._targets:
                part.release()
            self._targets = ()
            try:
                self._targets = self._new_targets(size)
            except moderngl.Error as error:
                text = f"OpenGL cannot hold a picture of {size[0]} x {size[1]} pixels ({error}); make it smaller"
                raise DeviceError(text) from error
        return self._targets

    def _new_targets(self, size: tuple[int, int]) -> tuple[Any, ...]:
        samples = min(SAMPLES, self.context.max_samples)
        texture = self.context.texture(size, 4, dtype="f2")
        multisampled = self.context.framebuffer(
            [self.context.renderbuffer(size, 4, samples=samples, dtype="f2")],
            self.context.depth_renderbuffer(size, samples=samples),
        )
        return multisampled, self.context.framebuffer([texture]), texture

    def picture(self, size: tuple[int, int], camera: Camera | None, exposure: float = 0.0) -> np.ndarray:
        """The picture as sRGB bytes (h, w, 3), top row first; `draw` into memory.

        Raises
        ------
        DeviceError
            It is too large for OpenGL or its memory.
        """
        self._targets_of(size)  # tells where it is too large
        target = self.context.simple_framebuffer(size, 3)
        self.draw(target, size, camera, exposure)
        rows = np.frombuffer(target.read(components=3, alignment=1), np.uint8)
        target.release()
        return rows.reshape(size[1], size[0], 3)[::-1]
