"""Renders videos and images of a scene without a window."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import track

from fourd.base.cameras import Camera
from fourd.base.errors import UserError
from fourd.viewer.camera_paths.plan import DEFAULT_SIZE, PathPlan, PathTiming, plan_path
from fourd.viewer.display import DisplaySettings, RenderRequest
from fourd.viewer.loaded_scene import LoadedScene
from fourd.viewer.navigation.paths import fit_camera
from fourd.viewer.output.png import with_alpha, write_png
from fourd.viewer.output.sound import sound_of_video
from fourd.viewer.output.video import write_video
from fourd.viewer.playback.sources import open_frame_source
from fourd.viewer.rendering.offscreen import OffscreenRenderer
from fourd.viewer.rendering.renderers import RendererName


@dataclass(frozen=True)
class Headless:
    """Renders one scene to files.

    Attributes:
        source: a `.4dv` file or a run's folder.
        renderer: name of the renderer, or "auto".
        size: width and height of the images in pixels. If ``size`` is None, screenshots have the size of the selected
            camera. Videos, and screenshots of scenes without cameras, have DEFAULT_SIZE.
        settings: display settings. If ``layers`` is 0, the scene's maximum number of layers is used.
    """

    source: Path
    renderer: RendererName | Literal["auto"]
    size: tuple[int, int] | None
    settings: DisplaySettings

    def video(self, out: Path, path: str, steps: int | None, fps: float | None, console: Console) -> int:
        """Write a video of the scene along a camera path. The suffix of ``out`` determines the format.

        ``path`` is "orbit", "spiral", "cameras" or a path file, see :func:`~fourd.viewer.camera_paths.plan.plan_path`.
        Returns the number of images.
        """
        scene = LoadedScene(self.source, open_frame_source(self.source))
        try:
            plan = _plan(scene, path, self.size, steps)
            with OffscreenRenderer(self.renderer) as renderer:
                console.print(f"renderer: {renderer.choice.name} ({renderer.choice.reason})", soft_wrap=True)
                views = track(list(zip(plan.cameras, plan.frames, strict=True)), description="render", console=console)
                rate = fps or plan.fps or scene.manifest.fps
                sound = sound_of_video(scene.sound, scene.manifest, plan.frames, rate)
                if isinstance(sound, str):
                    console.print(sound, soft_wrap=True)
                    sound = None
                return write_video(out, self._render(scene, renderer, views), rate, sound=sound)
        finally:
            scene.close()

    def screenshot(
        self, out: Path, camera: str | None, frame: int, console: Console, *, is_transparent: bool = False
    ) -> None:
        """Write a PNG of one frame from a capture camera.

        ``frame`` is an index from 0. ``camera`` is the name of a camera, or None for the first camera. If
        ``is_transparent`` is true, the image has an alpha channel instead of a background.
        """
        scene = LoadedScene(self.source, open_frame_source(self.source))
        try:
            if not 0 <= frame < scene.manifest.frame_count:
                raise UserError(f"--frame: expected 0 to {scene.manifest.frame_count - 1}, got {frame}")
            chosen = _select_camera(scene, camera, self.size)
            with OffscreenRenderer(self.renderer) as renderer:
                console.print(f"renderer: {renderer.choice.name} ({renderer.choice.reason})", soft_wrap=True)
                if is_transparent:
                    black, white = (self._on(value, scene, renderer, (chosen, frame)) for value in (0.0, 1.0))
                    write_png(out, with_alpha(black, white))
                else:
                    write_png(out, next(self._render(scene, renderer, [(chosen, frame)])))
        finally:
            scene.close()

    def _on(
        self, grey: float, scene: LoadedScene, renderer: OffscreenRenderer, view: tuple[Camera, int]
    ) -> NDArray[np.float32]:
        """Render a view in front of a grey value. Returns (H, W, 3) in [0, 1]."""
        settings = self.settings.with_background((grey, grey, grey))
        picture = next(replace(self, settings=settings)._render(scene, renderer, [view]))
        return picture.astype(np.float32) / np.float32(255)

    def _render(
        self, scene: LoadedScene, renderer: OffscreenRenderer, views: Iterable[tuple[Camera, int]]
    ) -> Iterator[NDArray[np.uint8]]:
        settings = replace(self.settings, layers=self.settings.layers or scene.manifest.layers)
        for camera, index in views:
            frame = scene.frames.get(index, wait=True)
            assert frame is not None
            yield renderer.render(RenderRequest(settings.scale_points(frame), camera, scene.manifest, settings.drawn))


def _plan(scene: LoadedScene, path: str, size: tuple[int, int] | None, steps: int | None) -> PathPlan:
    """Return the images of a video. Raises UserError."""
    start = None if scene.manifest.cameras else scene.initial_pose(size or DEFAULT_SIZE)
    return plan_path(path, scene.path_scene, PathTiming(steps), size, start=start, default_size=DEFAULT_SIZE)


def _select_camera(scene: LoadedScene, name: str | None, size: tuple[int, int] | None) -> Camera:
    manifest = scene.manifest
    if name is not None and name not in manifest.names:
        raise UserError(f"--camera: expected a name among {', '.join(manifest.names) or '(none)'}, got {name}")
    if not manifest.cameras:
        return scene.initial_pose(size or DEFAULT_SIZE).camera(*(size or DEFAULT_SIZE))
    camera = manifest.cameras[0] if name is None else manifest.camera(name)
    return camera if size is None else fit_camera(camera, *size)
