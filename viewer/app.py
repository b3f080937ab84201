"""The interactive viewer: its loop, and what its panel's buttons do."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import moderngl
import numpy as np
from numpy.typing import NDArray
from rich.console import Console

from fourd.errors import UserError
from fourd.viewer import controls
from fourd.viewer.display import DisplaySettings, RenderRequest
from fourd.viewer.gl.canvas import Canvas
from fourd.viewer.gl.context import driver_name
from fourd.viewer.navigation.recorded_path import PathRecorder, PathSample, RecordedPath
from fourd.viewer.navigation.saved_views import SavedViews, default_file
from fourd.viewer.output.png import write_png
from fourd.viewer.panel import draw_panel, draw_progress
from fourd.viewer.rendering.renderers import Renderer, RendererChoice, RendererName, choose_renderer, make_renderer
from fourd.viewer.session import LoadedScene, Session
from fourd.viewer.timings import Timings
from fourd.viewer.window import Window

_LONGEST_TICK = 0.1
"""Seconds: after a pause, such as a dragged window, the scene goes on where it was."""
_IDLE = 0.25
"""Seconds between looks at the background while nothing moves."""
_SHORT = 0.1
"""Seconds between pictures of the spinner: what it waits for needs the processor."""
_RESTLESS = 8
"""Pictures to draw after anything was done: a press, a move and a release are taken in one after another."""


class Stopped(Exception):
    """The user stopped a rendering."""


@dataclass(frozen=True)
class Rendering:
    """A video that is being made."""

    path: Path
    done: int
    count: int


class App:
    """A window on a session."""

    def __init__(
        self, window: Window, session: Session, wanted: RendererName | Literal["auto"], console: Console
    ) -> None:
        """Raises UserError when the renderer cannot be made."""
        self.window = window
        self.session = session
        self.context = moderngl.create_context(require=330)
        self.chosen: RendererChoice = choose_renderer(wanted, driver_name(self.context))
        self.renderer: Renderer = make_renderer(self.chosen.name, self.context)
        console.print(f"renderer: {self.chosen.name} ({self.chosen.reason})", soft_wrap=True)
        self.timings = Timings()
        self.recorder: PathRecorder | None = None
        self.flight: RecordedPath | None = None
        self.panel_open = True
        self.camera_index = 0
        self._canvas = Canvas(self.context)
        self._views = SavedViews(default_file())
        self._screen: moderngl.Framebuffer | None = None
        self._drawn: RenderRequest | None = None
        self._restless = _RESTLESS
        self._stop = False
        self._pending: list[Callable[[], None]] = []

    def run(self) -> None:
        """Until the window is closed."""
        last = time.monotonic()
        while not self.window.closing:
            self.window.wait(self._sleep())
            now = time.monotonic()
            elapsed, last = min(now - last, _LONGEST_TICK), now
            for path in self.window.dropped():
                self.session.open(path)
            if self.window.touched():
                self._restless = _RESTLESS
            if not self.window.hidden:
                self._tick(elapsed)

    def show(self, opened: LoadedScene) -> None:
        """Show a scene from where it was seen last."""
        size = self.window.framebuffer_size
        self.session.show(opened, self._views.recall(opened.path) or opened.start(size))
        # With its own textures and threads: the arrays of the scene before are let go.
        self.renderer.release()
        self.renderer, self._drawn = make_renderer(self.chosen.name, self.context), None
        self.flight = self.recorder = None

    def later(self, action: Callable[[], None]) -> None:
        """Do something after the picture that is being made: while a panel is built, nothing else may draw."""
        self._pending.append(action)

    def use(self, name: RendererName, reason: str = "as asked") -> None:
        """Change to a renderer; the one before stays where it cannot be made."""
        try:
            fresh = make_renderer(name, self.context)
        except Exception as error:
            self.session.message = f"{name}: cannot be used here ({error})"
            return
        self.renderer.release()
        self.renderer, self.chosen, self._drawn = fresh, RendererChoice(name, reason), None

    def screenshot(self) -> None:
        """Write what is seen, without the panel, beside where the viewer was started."""
        if self._drawn is None or self.session.scene is None:
            return
        path = free_name(self.session.scene.path.stem, ".png")
        self.renderer.draw(self._drawn, self._canvas, wait=True)
        self._save(path, lambda: write_png(path, self._canvas.pixels()))

    def toggle_recording(self) -> None:
        """Begin to record the camera's path; or end, and keep it as the flight and as a file."""
        if self.recorder is None:
            self.recorder = PathRecorder()
            return
        flight, self.recorder = self.recorder.flight(), None
        if not flight.stops or self.session.scene is None:
            return
        self.flight = flight
        path = free_name(self.session.scene.path.stem, ".path.json")
        self._save(path, lambda: flight.save(path))

    def render_flight(self) -> None:
        """Write the recorded path as an MP4 of the window's size."""
        if self.flight is None or self.session.scene is None:
            return
        from fourd.viewer.output.video import write_video

        path, flight = free_name(self.session.scene.path.stem, ".mp4"), self.flight
        self._stop = False
        try:
            self._save(path, lambda: write_video(path, self._flown(path, flight), flight.fps))
        except Stopped:
            self.session.message = f"{path}: stopped, nothing was written"
        self._drawn = None

    def stop_rendering(self) -> None:
        """End :meth:`render_flight` before its end."""
        self._stop = True

    def camera_pose(self, index: int) -> None:
        """Glide to a camera of the capture."""
        if self.session.scene is not None:
            self.session.glide_to(self.session.scene.camera_pose(index, self.window.framebuffer_size))

    def release(self) -> None:
        """Remember the view, and let go of everything."""
        self._remember()
        self.session.close()
        self.renderer.release()
        self._canvas.release()

    def _tick(self, elapsed: float) -> None:
        self._take_over_what_was_opened()
        if not self.session.advance(elapsed) and self._still():
            return
        self._restless = max(0, self._restless - 1)
        if self.recorder is not None and self.session.pose is not None:
            self.recorder.advance(elapsed, self.session.pose, self.session.playback.frame)
        request = self.session.request(self.window.framebuffer_size)
        self._draw(request)
        with self.timings.part("panel"):
            self._present(request is not None)
            self.window.begin_panel()
            draw_panel(self)
            if controls.steer(self.session, self.window.size[1], elapsed):
                self._restless = _RESTLESS
            controls.play(self.session)
            self.window.end_panel()
        with self.timings.part("show"):
            self.window.swap()
        self.timings.finish()
        pending, self._pending = self._pending, []
        for action in pending:
            action()
            self._restless = _RESTLESS
        self.window.title(self._title())

    def _take_over_what_was_opened(self) -> None:
        opened = self.session.settle_opening()
        if opened is None:
            return
        self._remember()
        self.show(opened)

    def _draw(self, request: RenderRequest | None) -> None:
        if request is None or (self._drawn is not None and _same(request, self._drawn) and self.renderer.behind == 0):
            return
        try:
            with self.timings.part("draw"):
                self.renderer.draw(request, self._canvas)
        except UserError as error:
            self.session.message = str(error)
            if self.chosen.name != "cpu":
                self.use("cpu", f"{self.chosen.name} cannot draw this scene here")
            return
        self._drawn = request

    def _present(self, picture: bool) -> None:
        """Copy what was drawn to the window, or clear it."""
        size = self.window.framebuffer_size
        if self._screen is None or self._screen.size != size:
            self._screen = self.context.detect_framebuffer(0)
        self._screen.use()
        if picture and self._canvas.size == size:
            self.window.copy(self._canvas.sized(*size).glo)
            self._screen.use()
        else:
            self._screen.clear()

    def _flown(self, path: Path, flight: RecordedPath) -> Iterator[NDArray[np.uint8]]:
        """The flight's pictures, with the window's panel kept alive between them."""
        assert self.session.scene is not None
        size, canvas = self.window.framebuffer_size, Canvas(self.context)
        try:
            for number, stop in enumerate(flight.stops):
                self._progress(Rendering(path, number, len(flight.stops)))
                yield self._pictured(stop, size, canvas)
        finally:
            canvas.release()

    def _pictured(self, stop: PathSample, size: tuple[int, int], canvas: Canvas) -> NDArray[np.uint8]:
        scene, settings = self.session.scene, self.session.settings
        assert scene is not None
        frame = scene.stream.get(min(stop.frame, scene.manifest.frame_count - 1), wait=True)
        assert frame is not None
        request = RenderRequest(settings.applied(frame), stop.pose.camera(*size), scene.manifest, settings)
        self.renderer.draw(request, canvas, wait=True)
        return canvas.pixels()

    def _progress(self, rendering: Rendering) -> None:
        self.window.wait(0)
        if self._stop or self.window.closing:
            raise Stopped
        self._present(False)
        self.window.begin_panel()
        draw_progress(self, rendering)
        self.window.end_panel()
        self.window.swap()

    def _save(self, path: Path, write: Callable[[], object]) -> None:
        try:
            write()
        except (OSError, UserError) as error:
            self.session.message = f"{path}: cannot be written ({error})"
            return
        self.session.message = f"{path.resolve()}: written"

    def _remember(self) -> None:
        if self.session.scene is not None and self.session.pose is not None:
            self._views.remember(self.session.scene.path, self.session.pose)

    def _sleep(self) -> float:
        """How long nothing will change, in seconds, unless the user does something."""
        session = self.session
        if self.window.hidden or self._still():
            return _IDLE
        if session.opening or session.waiting:
            return _SHORT
        if session.gliding or self.recorder is not None or self.renderer.behind > 0 or self._restless > 0:
            return 0.0
        return min(session.playback.seconds_to_next(), _IDLE)

    def _still(self) -> bool:
        """Whether the next picture would be the one that is shown."""
        session = self.session
        going = session.opening or session.waiting or session.gliding or session.playback.playing
        return not (going or self.recorder is not None or self.renderer.behind > 0 or self._restless > 0)

    def _title(self) -> str:
        scene, playback = self.session.scene, self.session.playback
        if scene is None:
            return "fourd"
        state = "playing" if playback.playing else "paused"
        return f"fourd - {scene.path.name} - frame {playback.frame + 1}/{playback.frames} {state} - {self.chosen.name}"


def show(
    source: Path | None,
    wanted: RendererName | Literal["auto"],
    size: tuple[int, int],
    settings: DisplaySettings,
    console: Console,
) -> None:
    """Open a window on ``source`` and stay until it is closed.

    Raises UserError when the source cannot be opened, or there is no display or no OpenGL.
    """
    session = Session(settings)
    opened = None
    try:
        if source is not None:
            session.open(source)
            opened = session.settle_opening(wait=True)
            if opened is None:
                assert session.failure is not None
                raise session.failure
        with Window(size, "fourd") as window:
            app = App(window, session, wanted, console)
            try:
                if opened is not None:
                    app.show(opened)
                app.run()
            finally:
                app.release()
    finally:
        session.close()


def free_name(stem: str, suffix: str) -> Path:
    """A file beside where the viewer was started that does not exist yet."""
    number = 1
    while (path := Path(f"{stem}-{number:03d}{suffix}")).exists():
        number += 1
    return path


def _same(one: RenderRequest, other: RenderRequest) -> bool:
    return one.frame is other.frame and one.camera is other.camera and one.settings == other.settings
