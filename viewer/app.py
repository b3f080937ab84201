"""The event loop of the interactive viewer."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Literal

from rich.console import Console

from fourd.base.errors import UserError
from fourd.scene.styles.tables import ShadeMapError
from fourd.viewer.comparison.placement import compared_area
from fourd.viewer.controls import handle_navigation
from fourd.viewer.display import DisplaySettings, RenderRequest
from fourd.viewer.interface.theme import PALETTES
from fourd.viewer.keys import handle_keys
from fourd.viewer.overlay.overlay import draw_overlay
from fourd.viewer.rendering.renderers import RendererName
from fourd.viewer.session import Session
from fourd.viewer.state import ViewerState
from fourd.viewer.window import Window
from fourd.viewer.window_renderer import WindowRenderer

_MAX_STEP_SECONDS = 0.1
"""Maximum duration of a time step of playback, in seconds.

Because of this maximum, playback after a long stall of the event loop continues near the frame at which the stall
began.
"""
_IDLE_SECONDS = 0.25
"""Seconds between checks for new frames and checkpoints while the image does not change."""
_LOADING_SECONDS = 0.1
"""Seconds between two images of the loading bar. The interval is long, because loading a scene also needs the CPU."""
_READING_SECONDS = 0.01
"""Seconds between two looks at whether the captured picture has been read."""
_PATIENCE_SECONDS = 0.3
"""The window appears after this time, even if the scene has not been opened yet."""
_FADE_SECONDS = 0.03
"""Seconds between two images of a message that fades."""
_IMAGES_AFTER_INPUT = 8
"""Number of images that are drawn after each input event.

One image per input event is not enough, because imgui handles a press, a motion and a release in separate images.
"""


def run_viewer(
    source: Path | None,
    requested: RendererName | Literal["auto"],
    size: tuple[int, int],
    settings: DisplaySettings,
    console: Console,
    style_name: str | None = None,
    capture: Path | None = None,
    beside: Path | None = None,
) -> None:
    """Open a window that shows ``source``, and run the viewer until the user closes the window.

    ``style_name`` is the name of the preset, or the path of the style file, from which the style in ``settings`` was
    loaded. ``capture`` is the folder with the captured pictures, or None to look for it.
    ``beside`` is another scene to compare the first one with, or None.

    Raises UserError when the source cannot be opened, when there is no display, or when OpenGL is not available.
    """
    session = Session(settings, style_name)
    try:
        if source is not None:
            session.open(source)
            session.wait_opened(_PATIENCE_SECONDS)
        with Window(size, "fourd") as window:
            state = ViewerState(window, session, WindowRenderer(window, requested), capture, beside)
            choice = state.renderer.choice
            console.print(f"renderer: {choice.name} ({choice.reason})", soft_wrap=True)
            try:
                App(state, needs_scene=source is not None).run()
            finally:
                state.release()
    finally:
        session.close()


class App:
    """The event loop of the viewer."""

    def __init__(self, state: ViewerState, *, needs_scene: bool) -> None:
        """``needs_scene`` is True if the user has named a scene, without which the viewer ends."""
        self._state = state
        self._needs_scene = needs_scene
        self._images_left = _IMAGES_AFTER_INPUT
        self._was_active = True  # whether the image could change after the last step

    def run(self) -> None:
        """Run the event loop until the user closes the window. Raises UserError if a scene that the user has named at
        the start cannot be opened."""
        window, session = self._state.window, self._state.session
        last = time.monotonic()
        while not window.should_close:
            window.wait_events(self._seconds_to_wait())
            now = time.monotonic()
            elapsed, last = min(now - last, _MAX_STEP_SECONDS), now
            chosen = self._state.take_chosen_path()
            for path in (*window.take_dropped_paths(), *(() if chosen is None else (chosen,))):
                self._state.open(path)
                self._images_left = _IMAGES_AFTER_INPUT
            if window.take_input_flag():
                self._images_left = _IMAGES_AFTER_INPUT
            if not window.is_hidden:
                self._step(elapsed)
            if self._needs_scene and session.scene is None and session.error is not None:
                raise session.error
            if self._state.comparison.given_error is not None:
                raise self._state.comparison.given_error

    def _step(self, elapsed: float) -> None:
        """Advance the session by ``elapsed`` seconds, and draw an image if the image may have changed."""
        state, session, window = self._state, self._state.session, self._state.window
        scene = session.take_opened()
        if scene is not None:
            state.show_scene(scene)
        has_news = session.advance(elapsed, is_held=state.comparison.is_reading)
        state.follow_path(elapsed)
        is_waiting = session.is_waiting or state.comparison.is_reading
        state.sound.follow(session.scene, session.playback, is_waiting=is_waiting)
        session.message = state.sound.take_problem() or session.message
        was_active, self._was_active = self._was_active, not self._is_idle()
        # The image after the last change shows the end of a transition, or what a thread has just read.
        if not (has_news or was_active or self._was_active):
            return
        self._images_left = max(0, self._images_left - 1)
        if state.recorder is not None and session.pose is not None:
            state.recorder.advance(elapsed, session.pose, session.playback.frame)
        request = session.render_request(window.framebuffer_size, shift=state.picture_shift)
        is_drawn = request is not None and (state.renderer.needs_draw(request) or self._is_settling)
        if request is not None and is_drawn:
            self._draw(request)
        self._draw_other()
        with state.timings.measure("panel"):
            state.renderer.present(shows_image=request is not None, empty=PALETTES[state.preferences.theme].start)
            window.begin_ui()
            handle_keys(state)
            draw_overlay(state)
            centre = state.rendered_area.centre if state.compared_camera is not None else None
            if handle_navigation(session, window.size, elapsed, centre):
                self._images_left = _IMAGES_AFTER_INPUT
            window.end_ui()
        with state.timings.measure("present"):
            window.swap_buffers()
        if is_drawn:
            state.timings.count_image(time.monotonic())
            # The stylizer's time is moved to the part "style". The cpu renderer runs the stylizer during "draw". OpenGL
            # renderers run it on the GPU, and its time is part of "present", which waits for the GPU.
            source = "draw" if state.renderer.choice.name == "cpu" else "present"
            state.timings.move(source, "style", state.renderer.renderer.style_seconds)
        state.timings.finish_image()
        if state.run_deferred():
            self._images_left = _IMAGES_AFTER_INPUT
        window.set_title(self._title())

    def _draw_other(self) -> None:
        """Draw the other scene, if one is compared."""
        state, other = self._state, self._state.comparison.other
        if other is not None and state.comparison.is_on:
            shift = state.shift_to(compared_area(state.layout.free, state.comparison.mode))
            other.follow(state.session, state.window.framebuffer_size, shift, state.renderer.choice.name)

    def _draw(self, request: RenderRequest) -> None:
        """Draw the scene. If the renderer fails, switch to the cpu renderer.

        If the shade map of the style (a PNG with the colours of its light steps) cannot be read, switch the style off.
        """
        state = self._state
        try:
            with state.timings.measure("draw"):
                state.renderer.draw(request)
        except ShadeMapError as error:
            state.session.choose_style(None)
            state.session.message = str(error)
        except UserError as error:
            state.session.message = str(error)
            name = state.renderer.choice.name
            if name != "cpu":
                state.switch_renderer("cpu", f"{name} cannot draw this scene on this machine")

    def _seconds_to_wait(self) -> float:
        """Return the maximum time in seconds to wait for window events before the next image is drawn."""
        state, session = self._state, self._state.session
        if state.window.is_hidden:
            return _IDLE_SECONDS
        if self._is_idle():
            return 0.0 if self._was_active else _IDLE_SECONDS
        if session.opening is not None or session.is_waiting:
            return _LOADING_SECONDS
        if state.comparison.needs_image:
            return _READING_SECONDS
        is_moving = session.is_moving or state.recorder is not None or state.path_editor.is_playing
        if is_moving or state.renderer.is_stale or self._is_settling or self._images_left > 0:
            return 0.0
        if self._is_fading:
            return _FADE_SECONDS
        return min(session.playback.seconds_to_next_frame(), _IDLE_SECONDS)

    def _is_idle(self) -> bool:
        """Return True if the next image would be equal to the current one."""
        state, session = self._state, self._state.session
        is_active = (
            session.opening is not None or session.is_waiting or session.is_moving or session.playback.is_playing
        )
        is_active |= state.comparison.needs_image or state.path_editor.is_playing
        is_changing = state.recorder is not None or state.renderer.is_stale or self._is_settling or self._is_fading
        is_changing |= state.is_panel_open and state.timings.images_per_second(time.monotonic()) > 0
        return not (is_active or is_changing or self._images_left > 0)

    @property
    def _is_settling(self) -> bool:
        """Return True if playback is paused but more images must be drawn, because lines of a style are fading in."""
        return self._state.renderer.is_settling and not self._state.session.playback.is_playing

    @property
    def _is_fading(self) -> bool:
        """Return True if a message to the user is about to vanish."""
        return self._state.notice.is_fading(self._state.session.message, time.monotonic())

    def _title(self) -> str:
        scene, playback = self._state.session.scene, self._state.session.playback
        if scene is None:
            return "fourd"
        status = "playing" if playback.is_playing else "paused"
        frame = f"frame {playback.frame + 1}/{playback.frame_count} {status}"
        return f"fourd - {scene.path.name} - {frame} - {self._state.renderer.choice.name}"
