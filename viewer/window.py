"""A window with an OpenGL 3.3 core context, by GLFW, and the panel's backend."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from types import TracebackType
from typing import Any

from fourd.errors import UserError


class Window:
    """Opens with the panel's context current. Use as a context manager.

    Raises UserError where there is no display, or no OpenGL 3.3.
    """

    def __init__(self, size: tuple[int, int], title: str) -> None:
        import glfw

        self._glfw = glfw
        self._problem = ""
        self._dropped: list[Path] = []
        self._touched = True
        self._title = title
        glfw.ERROR_REPORTING = "ignore"
        glfw.set_error_callback(self._remember_problem)
        if not glfw.init():
            raise UserError(_no_display(self._problem))
        glfw.window_hint(glfw.CONTEXT_VERSION_MAJOR, 3)
        glfw.window_hint(glfw.CONTEXT_VERSION_MINOR, 3)
        glfw.window_hint(glfw.OPENGL_PROFILE, glfw.OPENGL_CORE_PROFILE)
        glfw.window_hint(glfw.OPENGL_FORWARD_COMPAT, glfw.TRUE)
        glfw.window_hint(glfw.SCALE_TO_MONITOR, glfw.TRUE)
        self.handle: Any = glfw.create_window(*size, title, None, None)
        if not self.handle:
            glfw.terminate()
            raise UserError(
                f"OpenGL: expected version 3.3 core for a window, got '{self._problem}'; update the graphics driver, "
                "or add --headless FILE.mp4 or --screenshot FILE.png --renderer cpu"
            )
        glfw.make_context_current(self.handle)
        glfw.swap_interval(1)
        self._panel = _panel_backend(self.handle)
        self._listen()

    @property
    def framebuffer_size(self) -> tuple[int, int]:
        """(width, height) in pixels."""
        width, height = self._glfw.get_framebuffer_size(self.handle)
        return int(width), int(height)

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) in the units of the mouse."""
        width, height = self._glfw.get_window_size(self.handle)
        return int(width), int(height)

    @property
    def scale(self) -> float:
        """Of text: pixels a point where the system asks for more than one."""
        return float(self._glfw.get_window_content_scale(self.handle)[0])

    @property
    def hidden(self) -> bool:
        """Whether nothing of it can be seen: minimised, or of no size."""
        return bool(self._glfw.get_window_attrib(self.handle, self._glfw.ICONIFIED)) or 0 in self.framebuffer_size

    @property
    def closing(self) -> bool:
        return bool(self._glfw.window_should_close(self.handle))

    def title(self, text: str) -> None:
        """Set the title where it is another: every change is an event, which would end :meth:`wait`."""
        if text != self._title:
            self._glfw.set_window_title(self.handle, text)
            self._title = text

    def wait(self, seconds: float) -> None:
        """Handle events; sleep until one comes or the time is over."""
        if seconds > 0:
            self._glfw.wait_events_timeout(seconds)
        else:
            self._glfw.poll_events()

    def touched(self) -> bool:
        """Whether the user did anything since the last call."""
        touched, self._touched = self._touched, False
        return touched

    def dropped(self) -> list[Path]:
        """Files dropped since the last call."""
        paths, self._dropped = self._dropped, []
        return paths

    def begin_panel(self) -> None:
        """Start a panel; its widgets follow."""
        from imgui_bundle import imgui

        self._panel.process_inputs()
        imgui.new_frame()

    def end_panel(self) -> None:
        """Draw the panel over the window."""
        from imgui_bundle import imgui
        from OpenGL import GL

        # The panel's backend comes back to the program in use, which lives no longer if it was released meanwhile.
        GL.glUseProgram(0)
        imgui.render()
        self._panel.render(imgui.get_draw_data())

    def copy(self, framebuffer: int) -> None:
        """Copy a framebuffer of the window's size, by its GL name, to the window's; it stays bound for reading."""
        from OpenGL import GL

        # Not moderngl's copy: it names the window's buffers in a way that OpenGL 3.3 refuses.
        width, height = self.framebuffer_size
        GL.glBindFramebuffer(GL.GL_READ_FRAMEBUFFER, framebuffer)
        GL.glBindFramebuffer(GL.GL_DRAW_FRAMEBUFFER, 0)
        GL.glBlitFramebuffer(0, 0, width, height, 0, 0, width, height, GL.GL_COLOR_BUFFER_BIT, GL.GL_NEAREST)

    def swap(self) -> None:
        """Show what was drawn."""
        self._glfw.swap_buffers(self.handle)

    def __enter__(self) -> Window:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        from imgui_bundle import imgui, implot

        self._panel.shutdown()
        implot.destroy_context()
        imgui.destroy_context()
        self._glfw.destroy_window(self.handle)
        self._glfw.terminate()

    def _remember_problem(self, code: int, text: str) -> None:
        self._problem = text.decode(errors="replace") if isinstance(text, bytes) else text

    def _listen(self) -> None:
        """What is done to the window goes to the panel, and wakes it."""
        glfw, panel, handle = self._glfw, self._panel, self.handle

        def woken(handler: Any) -> Any:
            def handle_event(*event: Any) -> None:
                self._touched = True
                handler(*event)

            return handle_event

        def moved(_: Any, x: float, y: float) -> None:
            panel.io.add_mouse_pos_event(x, y)

        glfw.set_key_callback(handle, woken(panel.keyboard_callback))
        glfw.set_char_callback(handle, woken(panel.char_callback))
        glfw.set_cursor_pos_callback(handle, woken(moved))
        glfw.set_mouse_button_callback(handle, woken(panel.mouse_button_callback))
        glfw.set_scroll_callback(handle, woken(panel.scroll_callback))
        glfw.set_window_size_callback(handle, woken(panel.resize_callback))
        glfw.set_window_refresh_callback(handle, woken(lambda _: None))
        glfw.set_window_iconify_callback(handle, woken(lambda _, __: None))
        glfw.set_drop_callback(handle, woken(lambda _, paths: self._dropped.extend(Path(path) for path in paths)))


def _panel_backend(handle: Any) -> Any:
    from imgui_bundle import imgui, implot
    from imgui_bundle.python_backends.glfw_backend import GlfwRenderer

    imgui.create_context()
    implot.create_context()
    imgui.get_io().set_ini_filename("")  # the panel's place is not kept: no files beside the user's
    imgui.style_colors_dark()
    return GlfwRenderer(handle, attach_callbacks=False)


def _no_display(problem: str) -> str:
    missing = sys.platform.startswith("linux") and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
    got = "none (DISPLAY is not set)" if missing else f"'{problem}'"
    return (
        f"display: expected one to open a window on, got {got}; "
        "add --headless FILE.mp4 or --screenshot FILE.png to work without"
    )
