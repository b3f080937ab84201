"""A GLFW window with an OpenGL 3.3 core context, and the ImGui backend that draws the user interface in it."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from types import TracebackType
from typing import Any

from fourd.base.errors import UserError


class Window:
    """A window whose OpenGL context is current. Use a Window as a context manager.

    Raises UserError if there is no display, or if OpenGL 3.3 is not available.
    """

    def __init__(self, size: tuple[int, int], title: str) -> None:
        import glfw

        self._glfw = glfw
        self._error = ""
        self._dropped: list[Path] = []
        self._had_input = True
        self._title = title
        self._windowed: tuple[int, int, int, int] | None = None  # position and size before full screen
        glfw.ERROR_REPORTING = "ignore"
        glfw.set_error_callback(self._store_error)
        if not glfw.init():
            raise UserError(_no_display_message(self._error))
        glfw.window_hint(glfw.CONTEXT_VERSION_MAJOR, 3)
        glfw.window_hint(glfw.CONTEXT_VERSION_MINOR, 3)
        glfw.window_hint(glfw.OPENGL_PROFILE, glfw.OPENGL_CORE_PROFILE)
        glfw.window_hint(glfw.OPENGL_FORWARD_COMPAT, glfw.TRUE)
        glfw.window_hint(glfw.SCALE_TO_MONITOR, glfw.TRUE)
        self.handle: Any = glfw.create_window(*size, title, None, None)
        if not self.handle:
            glfw.terminate()
            raise UserError(
                f"OpenGL: expected version 3.3 core for a window, got '{self._error}'; update the graphics driver, "
                "or add --headless FILE.mp4 or --screenshot FILE.png --renderer cpu"
            )
        glfw.make_context_current(self.handle)
        glfw.swap_interval(1)
        self._ui = _make_ui_backend(self.handle)
        self._register_callbacks()

    @property
    def framebuffer_size(self) -> tuple[int, int]:
        """(width, height) of the framebuffer in pixels."""
        width, height = self._glfw.get_framebuffer_size(self.handle)
        return int(width), int(height)

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) in window coordinates, which are the units of mouse positions."""
        width, height = self._glfw.get_window_size(self.handle)
        return int(width), int(height)

    @property
    def content_scale(self) -> float:
        """The display's scale factor for text, such as 2 for 200%."""
        return float(self._glfw.get_window_content_scale(self.handle)[0])

    @property
    def is_hidden(self) -> bool:
        """Whether the window is minimised or has zero size."""
        return bool(self._glfw.get_window_attrib(self.handle, self._glfw.ICONIFIED)) or 0 in self.framebuffer_size

    @property
    def should_close(self) -> bool:
        """Whether the user has closed the window."""
        return bool(self._glfw.window_should_close(self.handle))

    @property
    def is_full_screen(self) -> bool:
        """Whether the window fills the screen, without a frame."""
        return self._windowed is not None

    def toggle_full_screen(self) -> None:
        """Fill the screen that has most of the window, or return to the previous position and size."""
        glfw = self._glfw
        if self._windowed is not None:
            glfw.set_window_monitor(self.handle, None, *self._windowed, glfw.DONT_CARE)
            self._windowed = None
            return
        position, size = glfw.get_window_pos(self.handle), glfw.get_window_size(self.handle)
        monitor = self._nearest_monitor(position[0] + size[0] / 2, position[1] + size[1] / 2)
        if monitor is None:
            return
        self._windowed = (*position, *size)
        mode = glfw.get_video_mode(monitor)
        glfw.set_window_monitor(self.handle, monitor, 0, 0, mode.size.width, mode.size.height, mode.refresh_rate)

    def close(self) -> None:
        """Ask the event loop to end, as if the user had closed the window."""
        self._glfw.set_window_should_close(self.handle, True)

    def set_title(self, text: str) -> None:
        """Set the title if ``text`` differs from the current title.

        Setting an equal title would cause an event, which would make :meth:`wait_events` return too early.
        """
        if text != self._title:
            self._glfw.set_window_title(self.handle, text)
            self._title = text

    def wait_events(self, seconds: float) -> None:
        """Wait up to ``seconds`` for events, and handle them."""
        if seconds > 0:
            self._glfw.wait_events_timeout(seconds)
        else:
            self._glfw.poll_events()

    def take_input_flag(self) -> bool:
        """Return True if there has been input since the last call."""
        had_input, self._had_input = self._had_input, False
        return had_input

    def take_dropped_paths(self) -> list[Path]:
        """Return the files that were dropped on the window since the last call."""
        paths, self._dropped = self._dropped, []
        return paths

    def begin_ui(self) -> None:
        """Start a frame of the user interface."""
        from imgui_bundle import imgui

        self._ui.process_inputs()
        imgui.new_frame()

    def end_ui(self) -> None:
        """Draw the user interface over the window."""
        from imgui_bundle import imgui
        from OpenGL import GL

        # Unbind the current shader program. The backend of the user interface would bind it again after drawing, which
        # fails if the program has been deleted.
        GL.glUseProgram(0)
        imgui.render()
        self._ui.render(imgui.get_draw_data())

    def copy_framebuffer(self, framebuffer: int) -> None:
        """Copy a framebuffer to the window.

        ``framebuffer`` is the OpenGL name of a framebuffer of the window's size. It stays bound for reading.
        """
        from OpenGL import GL

        # moderngl cannot copy to the window, because its names for the buffers of the default framebuffer are not valid
        # in OpenGL 3.3.
        width, height = self.framebuffer_size
        GL.glBindFramebuffer(GL.GL_READ_FRAMEBUFFER, framebuffer)
        GL.glBindFramebuffer(GL.GL_DRAW_FRAMEBUFFER, 0)
        GL.glBlitFramebuffer(0, 0, width, height, 0, 0, width, height, GL.GL_COLOR_BUFFER_BIT, GL.GL_NEAREST)

    def swap_buffers(self) -> None:
        """Show the drawn image."""
        self._glfw.swap_buffers(self.handle)

    def __enter__(self) -> Window:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        from imgui_bundle import imgui, implot

        self._ui.shutdown()
        implot.destroy_context()
        imgui.destroy_context()
        self._glfw.destroy_window(self.handle)
        self._glfw.terminate()

    def _nearest_monitor(self, x: float, y: float) -> Any:
        """Return the monitor whose middle is nearest to a position, or None if there are no monitors."""

        def distance(monitor: Any) -> float:
            left, top = self._glfw.get_monitor_pos(monitor)
            size = self._glfw.get_video_mode(monitor).size
            return abs(left + size.width / 2 - x) + abs(top + size.height / 2 - y)

        return min(self._glfw.get_monitors(), key=distance, default=None)

    def _store_error(self, code: int, text: str) -> None:
        self._error = text.decode(errors="replace") if isinstance(text, bytes) else text

    def _register_callbacks(self) -> None:
        """Forward the window's events to the user interface, and record that there was input."""
        glfw, ui, handle = self._glfw, self._ui, self.handle

        def with_input_flag(handler: Any) -> Any:
            def handle_event(*event: Any) -> None:
                self._had_input = True
                handler(*event)

            return handle_event

        def move_cursor(_: Any, x: float, y: float) -> None:
            ui.io.add_mouse_pos_event(x, y)

        def drop(_: Any, paths: list[str]) -> None:
            self._dropped.extend(Path(path) for path in paths)

        glfw.set_key_callback(handle, with_input_flag(ui.keyboard_callback))
        glfw.set_char_callback(handle, with_input_flag(ui.char_callback))
        glfw.set_cursor_pos_callback(handle, with_input_flag(move_cursor))
        glfw.set_mouse_button_callback(handle, with_input_flag(ui.mouse_button_callback))
        glfw.set_scroll_callback(handle, with_input_flag(ui.scroll_callback))
        glfw.set_window_size_callback(handle, with_input_flag(ui.resize_callback))
        glfw.set_window_refresh_callback(handle, with_input_flag(lambda _: None))
        glfw.set_window_iconify_callback(handle, with_input_flag(lambda _, __: None))
        glfw.set_drop_callback(handle, with_input_flag(drop))


def _make_ui_backend(handle: Any) -> Any:
    from imgui_bundle import imgui, implot
    from imgui_bundle.python_backends.glfw_backend import GlfwRenderer

    from fourd.viewer.interface.theme import load_fonts

    imgui.create_context()
    implot.create_context()
    imgui.get_io().set_ini_filename("")  # do not write imgui.ini to the working directory
    load_fonts()
    return GlfwRenderer(handle, attach_callbacks=False)


def _no_display_message(error: str) -> str:
    missing = sys.platform.startswith("linux") and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
    got = "none (DISPLAY is not set)" if missing else f"'{error}'"
    return (
        f"display: expected a display for the window, got {got}; "
        "add --headless FILE.mp4 or --screenshot FILE.png, which need no display"
    )
