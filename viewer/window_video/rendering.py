"""Renders videos in the window, which shows the progress and lets the user stop."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fourd.base.cameras import Camera
from fourd.viewer.display import RenderRequest
from fourd.viewer.gl.canvas import Canvas
from fourd.viewer.navigation.paths import camera_path
from fourd.viewer.navigation.recorded_path import RecordedPath
from fourd.viewer.session import Session
from fourd.viewer.window import Window
from fourd.viewer.window_renderer import WindowRenderer
from fourd.viewer.window_video.progress_window import draw_progress

_TURNTABLE_SECONDS = 6.0
"""Least duration of a turntable. A faster turn is unpleasant to watch."""


class Cancelled(Exception):
    """Raised when the user stops a video."""


@dataclass(frozen=True)
class VideoPlan:
    """The images of a video.

    Attributes:
        cameras: the camera of each image.
        frames: index of the scene's frame that each image shows.
        fps: images per second.
    """

    cameras: Sequence[Camera]
    frames: Sequence[int]
    fps: float


def plan_recorded(recorded: RecordedPath, size: tuple[int, int], frame_count: int) -> VideoPlan:
    """Return the plan of a recorded path in images of ``size``, of a scene with ``frame_count`` frames."""
    cameras = [sample.pose.camera(*size) for sample in recorded.samples]
    return VideoPlan(cameras, [min(sample.frame, frame_count - 1) for sample in recorded.samples], recorded.fps)


def plan_turntable(session: Session, size: tuple[int, int]) -> VideoPlan:
    """Return the plan of a turn around the subject, as ``fourd view --headless --path orbit`` makes it. The scene plays
    in a loop, a whole number of times if that is possible, so that the end of the video joins its beginning."""
    assert session.scene is not None
    manifest = session.scene.manifest
    frames = manifest.frame_count
    loops = max(1, round(_TURNTABLE_SECONDS * manifest.fps / frames))
    count = frames * loops
    if manifest.cameras:
        is_whole = manifest.background is not None
        cameras = camera_path(
            "orbit", manifest.cameras, manifest.focus, count, size=size, is_whole=is_whole, bounds=manifest.bounds
        )
    else:
        start = session.scene.initial_pose(size)
        cameras = [start.orbit(2 * np.pi * step / count, 0.0).camera(*size) for step in range(count)]
    return VideoPlan(cameras, [step % frames for step in range(count)], manifest.fps)


def render_images(
    window: Window, session: Session, renderer: WindowRenderer, path: Path, plan: VideoPlan
) -> Iterator[NDArray[np.uint8]]:
    """Yield the images of a plan, and draw the progress before each of them. Raises Cancelled."""
    canvas = Canvas(renderer.context)
    try:
        for index, (camera, frame) in enumerate(zip(plan.cameras, plan.frames, strict=True)):
            _show_progress(window, renderer, path, (index, len(plan.frames)))
            yield _render_image(session, renderer, canvas, camera, frame)
    finally:
        canvas.release()


def _render_image(
    session: Session, renderer: WindowRenderer, canvas: Canvas, camera: Camera, index: int
) -> NDArray[np.uint8]:
    scene, settings = session.scene, session.settings
    assert scene is not None
    frame = scene.frames.get(index, wait=True)
    assert frame is not None
    request = RenderRequest(settings.scale_points(frame), camera, scene.manifest, settings.drawn)
    renderer.renderer.draw(request, canvas, wait=True)
    return canvas.read_rgb8()


def _show_progress(window: Window, renderer: WindowRenderer, path: Path, progress: tuple[int, int]) -> None:
    """Handle events and draw the progress window. Raises Cancelled."""
    window.wait_events(0)
    renderer.present(shows_image=True)
    window.begin_ui()
    is_cancelled = draw_progress(window, path, *progress)
    window.end_ui()
    window.swap_buffers()
    if is_cancelled or window.should_close:
        raise Cancelled
