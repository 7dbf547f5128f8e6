"""OpenGL contexts, with and without a window; nothing is drawn here."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from clsss.errors import DeviceError

if TYPE_CHECKING:
    import moderngl

VERSION = 330
# By their runtime names: looking libraries up by bare name needs development packages or a compiler.
EGL = {"backend": "egl", "libgl": "libGL.so.1", "libegl": "libEGL.so.1"}


def _reason(error: Exception) -> str:
    return " ".join(str(error).split())[:150] or type(error).__name__


def open_window(
    size: tuple[int, int], title: str = "clsss", visible: bool = True
) -> tuple[Any, moderngl.Context]:
    """A GLFW window and its OpenGL context, current in this thread.

    Raises
    ------
    DeviceError
        There is no display, or no OpenGL 3.3.
    """
    try:
        import glfw
        import moderngl

        glfw.ERROR_REPORTING = "ignore"
        if not glfw.init():
            raise DeviceError(_glfw_error("no display"))
        glfw.window_hint(glfw.VISIBLE, visible)
        glfw.window_hint(glfw.CONTEXT_VERSION_MAJOR, VERSION // 100)
        glfw.window_hint(glfw.CONTEXT_VERSION_MINOR, VERSION // 10 % 10)
        glfw.window_hint(glfw.OPENGL_PROFILE, glfw.OPENGL_CORE_PROFILE)
        glfw.window_hint(glfw.OPENGL_FORWARD_COMPAT, True)
        glfw.window_hint(glfw.SCALE_TO_MONITOR, True)
        window = glfw.create_window(*size, title, None, None)
        if not window:
            raise DeviceError(_glfw_error("no OpenGL 3.3"))
        glfw.make_context_current(window)
        glfw.swap_interval(1)
        return window, moderngl.create_context(require=VERSION)
    except Exception as error:  # missing libraries and drivers: each raises its own
        raise DeviceError(
            f"no window can be opened ({_reason(error)}); --screenshot FILE.png needs none"
        ) from error


def _glfw_error(otherwise: str) -> str:
    import glfw

    _, description = glfw.get_error()
    return description.decode(errors="replace") if isinstance(description, bytes) else otherwise


def standalone_context() -> moderngl.Context:
    """An OpenGL 3.3 context without a visible window: EGL, or else a hidden window.

    Raises
    ------
    DeviceError
        Neither can be had.
    """
    import moderngl

    try:
        return moderngl.create_context(standalone=True, require=VERSION, **EGL)  # type: ignore[arg-type]
    except Exception as error:
        no_egl = _reason(error)
    try:
        return open_window((16, 16), visible=False)[1]
    except DeviceError as error:
        raise DeviceError(
            f"no OpenGL 3.3 to draw with (EGL: {no_egl}; window: {_reason(error.__cause__ or error)}); "  # type: ignore[arg-type]
            "on Debian or Ubuntu: sudo apt install libegl1 libgl1-mesa-dri"
        ) from error
