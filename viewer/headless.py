"""Videos and pictures of a scene without a window."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import track

from fourd.cameras import Camera
from fourd.errors import UserError
from fourd.viewer.display import DisplaySettings, RenderRequest
from fourd.viewer.navigation.paths import PathKind, camera_path, fit_camera
from fourd.viewer.navigation.recorded_path import load_recorded_path
from fourd.viewer.output.png import write_png
from fourd.viewer.output.video import write_video
from fourd.viewer.playback.sources import open_frame_source
from fourd.viewer.rendering.offscreen import OffscreenRenderer
from fourd.viewer.rendering.renderers import RendererName
from fourd.viewer.session import LoadedScene

DEFAULT_SIZE = (1280, 720)
LEAST_STEPS = 120


@dataclass(frozen=True)
class Headless:
    """What to make of a scene.

    Attributes:
        source: a `.4dv` or a run.
        renderer: by name, or "auto".
        size: width and height in pixels; None for the camera's, or for DEFAULT_SIZE.
        settings: as in the window; layers 0 for the scene's own.
    """

    source: Path
    renderer: RendererName | Literal["auto"]
    size: tuple[int, int] | None
    settings: DisplaySettings

    def video(self, out: Path, path: str, steps: int | None, fps: float | None, console: Console) -> int:
        """Write an MP4 along ``path``: orbit, spiral, cameras, or a file that the window recorded.

        The scene plays in a loop meanwhile. Returns the number of pictures.
        """
        scene = LoadedScene(self.source, open_frame_source(self.source))
        try:
            cameras, frames, pace = _route(scene, path, self.size or DEFAULT_SIZE, steps)
            with OffscreenRenderer(self.renderer) as offscreen:
                console.print(f"renderer: {offscreen.chosen.name} ({offscreen.chosen.reason})", soft_wrap=True)
                jobs = track(list(zip(cameras, frames, strict=True)), description="render", console=console)
                return write_video(out, self._pictures(scene, offscreen, jobs), fps or pace)
        finally:
            scene.close()

    def screenshot(self, out: Path, camera: str | None, frame: int, console: Console) -> None:
        """Write a PNG of a frame (from 0) from a camera of the capture, by name; None for the first."""
        scene = LoadedScene(self.source, open_frame_source(self.source))
        try:
            if not 0 <= frame < scene.manifest.frame_count:
                raise UserError(f"--frame: expected 0 to {scene.manifest.frame_count - 1}, got {frame}")
            seen = _camera(scene, camera, self.size)
            with OffscreenRenderer(self.renderer) as offscreen:
                console.print(f"renderer: {offscreen.chosen.name} ({offscreen.chosen.reason})", soft_wrap=True)
                write_png(out, next(self._pictures(scene, offscreen, [(seen, frame)])))
        finally:
            scene.close()

    def _pictures(
        self, scene: LoadedScene, offscreen: OffscreenRenderer, jobs: Iterable[tuple[Camera, int]]
    ) -> Iterator[NDArray[np.uint8]]:
        settings = replace(self.settings, layers=self.settings.layers or scene.manifest.layers)
        for camera, index in jobs:
            frame = scene.stream.get(index, wait=True)
            assert frame is not None
            yield offscreen.picture(RenderRequest(settings.applied(frame), camera, scene.manifest, settings))


def _route(
    scene: LoadedScene, path: str, size: tuple[int, int], steps: int | None
) -> tuple[list[Camera], list[int], float]:
    """Cameras, frames and pictures a second."""
    manifest = scene.manifest
    kinds: dict[str, PathKind] = {kind: kind for kind in get_args(PathKind)}
    if path not in kinds:
        if not Path(path).exists():
            names = ", ".join(kinds)
            raise UserError(f"--path: expected {names} or a file that the window recorded, got '{path}'")
        flight = load_recorded_path(Path(path))
        cameras = [stop.pose.camera(*size) for stop in flight.stops]
        return cameras, [min(max(stop.frame, 0), manifest.frame_count - 1) for stop in flight.stops], flight.fps
    count = steps or max(LEAST_STEPS, manifest.frame_count)
    if manifest.cameras:
        cameras = camera_path(kinds[path], manifest.cameras, manifest.focus, count, size=size)
    else:
        start = scene.start(size)
        cameras = [start.orbited(2 * np.pi * step / count, 0.0).camera(*size) for step in range(count)]
    return cameras, [step % manifest.frame_count for step in range(count)], manifest.fps


def _camera(scene: LoadedScene, name: str | None, size: tuple[int, int] | None) -> Camera:
    manifest = scene.manifest
    if name is not None and name not in manifest.names:
        raise UserError(f"--camera: expected a name among {', '.join(manifest.names) or '(none)'}, got {name}")
    if not manifest.cameras:
        return scene.start(size or DEFAULT_SIZE).camera(*(size or DEFAULT_SIZE))
    camera = manifest.cameras[0] if name is None else manifest.camera(name)
    return camera if size is None else fit_camera(camera, *size)
