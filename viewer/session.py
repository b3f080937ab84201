"""The part of the viewer's state that does not depend on a window: scene, playback, pose and display settings."""

from __future__ import annotations

import threading
from dataclasses import replace
from pathlib import Path

from fourd.base.cameras import Camera
from fourd.base.errors import UserError
from fourd.scene import BakedFrame
from fourd.scene.styles import PRESETS, Style, load_style
from fourd.scene.styles.tables import make_table
from fourd.viewer.display import DisplaySettings, RenderRequest
from fourd.viewer.loaded_scene import LoadedScene
from fourd.viewer.navigation.pose import Pose, interpolate_poses
from fourd.viewer.playback.clock import Playback
from fourd.viewer.playback.sources import open_frame_source

TRANSITION_SECONDS = 0.7


class Session:
    """The state of the viewer that the panel and the keys change.

    Scenes are opened in a thread. The previous scene stays on screen until the new scene is ready.

    Attributes:
        settings: display settings.
        scene: the open scene.
        playback: the playback clock of the scene.
        pose: the viewer's pose.
        message: the last error or notice for the user, or an empty string.
        error: the error of the last scene that could not be opened, or None.
        is_waiting: whether the current frame is still being read.
        style_name: name of the preset, or path of the style file, that the user chose last; None for the captured
            colours. The style in ``settings`` can differ from the chosen style, because the user can edit it.
        style_file: path of the style file that the user chose last, or None.
        opening_work: what is being done to open a scene, or an empty text.
        is_free: whether the user has moved the view away from the camera that was chosen last.
    """

    def __init__(self, settings: DisplaySettings, style_name: str | None = None) -> None:
        """Start without a scene.

        Args:
            settings: the display settings. If ``layers`` is 0, each scene's maximum number of layers is used.
            style_name: name of the preset, or path of the style file, from which the style in ``settings`` was loaded.
        """
        self.settings = settings
        self.style_name = style_name
        self.style_file = None if style_name in PRESETS else style_name
        self.scene: LoadedScene | None = None
        self.playback = Playback(1, 30.0)
        self.pose: Pose | None = None
        self.message = ""
        self.error: Exception | None = None
        self.is_waiting = False
        self.is_free = False
        self.opening_work = ""
        self._opener: threading.Thread | None = None
        self._opening: Path | None = None
        self._opened: LoadedScene | Exception | None = None
        self._transition: tuple[Pose, Pose, float] | None = None  # start, end, fraction
        self._scaled: tuple[BakedFrame, DisplaySettings, BakedFrame] | None = None
        self._last_camera: tuple[Pose, tuple[int, int], tuple[float, float], Camera] | None = None
        self._last_frame: BakedFrame | None = None
        self._has_user_layers = settings.layers > 0

    @property
    def opening(self) -> Path | None:
        """The path of the scene that is being opened, or None."""
        return self._opening if self._opener is not None else None

    @property
    def has_frame(self) -> bool:
        """Whether a frame of the open scene has been read, so that there is something to see."""
        return self._last_frame is not None

    @property
    def style_names(self) -> tuple[str | None, ...]:
        """The styles that the user can choose: None, the presets, and the style file that was chosen last, if any."""
        return (None, *PRESETS, *(() if self.style_file is None else (self.style_file,)))

    @property
    def is_moving(self) -> bool:
        """Whether a transition to another pose is running."""
        return self._transition is not None

    def open(self, path: Path) -> None:
        """Start to open a scene or a run. The call is ignored while another scene is being opened."""
        if self._opener is not None:
            return
        self._opened, self._opening, self.opening_work = None, path, ""
        self._opener = threading.Thread(target=self._open, args=(path,), name="opener", daemon=True)
        self._opener.start()

    def wait_opened(self, seconds: float) -> None:
        """Wait until the scene has been opened, but at most ``seconds``. Raises UserError if it cannot be opened."""
        if self._opener is None:
            return
        self._opener.join(seconds)
        if isinstance(self._opened, Exception):
            self.take_opened(wait=True)
            raise self._opened

    def take_opened(self, wait: bool = False) -> LoadedScene | None:
        """Return a newly opened scene, or None if no scene has finished opening since the last call.

        If opening has failed, the current scene stays and ``message`` contains the reason.
        """
        if self._opener is None or (self._opener.is_alive() and not wait):
            return None
        self._opener.join()
        self._opener, opened = None, self._opened
        if isinstance(opened, LoadedScene):
            return opened
        self.error, self.message = opened, str(opened)
        return None

    def show(self, scene: LoadedScene, pose: Pose) -> None:
        """Close the current scene, and show ``scene`` from ``pose``."""
        if self.scene is not None:
            self.scene.close()
        self.scene, self.pose, self.is_free = scene, pose, False
        manifest = scene.manifest
        self.playback = Playback(manifest.frame_count, manifest.fps, is_playing=not scene.checkpoint)
        if not self._has_user_layers:
            self.settings = replace(self.settings, layers=manifest.layers)
        self.settings = replace(self.settings, crop=None)
        self._transition, self._scaled, self._last_frame = None, None, None
        self.message = ""
        self._announce_estimates()

    def set_layers(self, layers: int) -> None:
        """Set the number of layers K, the maximum number of points composited per pixel, for this scene and for scenes
        that are opened later."""
        self._has_user_layers = True
        self.settings = replace(self.settings, layers=layers)

    def choose_style(self, name: str | None) -> None:
        """Choose the style of the scene: the name of a preset style, the path of a style file, or None for the captured
        colours.

        If the style cannot be loaded, the current style stays and ``message`` contains the reason.
        """
        try:
            style = None if name is None else load_style(name)
        except UserError as error:
            self.message = str(error)
            return
        is_first = self.settings.style is None
        self.settings = replace(self.settings, style=style)
        self.style_name, self.message = name, ""
        if name is not None and name not in PRESETS:
            self.style_file = name
        if is_first:
            self._announce_estimates()

    def choose_shade_map(self, path: Path) -> None:
        """Use a PNG as the shade map (the colours from unlit to lit) of the current style.

        If the style has no shade map, or if the PNG does not have the shape that the style needs, the current style
        stays and ``message`` contains the reason.
        """
        style = self.settings.style
        if style is None or style.shading not in ("toon", "xtoon"):
            got = "no style" if style is None else f"the shading {style.shading}"
            self.message = f"{path}: expected a style with a shade map, got {got}; choose toon or xtoon first"
            return
        self.message = ""
        self.set_style(replace(style, ramp=replace(style.ramp, map=path)))

    def set_style(self, style: Style) -> None:
        """Set a style that the user has changed.

        If the shade map does not have the shape that the style needs, the current style stays and ``message`` contains
        the reason.
        """
        before = self.settings.style
        if before is None or (before.shading, before.ramp.map) != (style.shading, style.ramp.map):
            try:
                make_table(style)
            except UserError as error:
                self.message = str(error)
                return
        # A paper that the user has just chosen replaces the background.
        has_paper = before is not None and before.paper != style.paper
        has_own_background = self.settings.has_own_background and not has_paper
        self.settings = replace(self.settings, style=style, has_own_background=has_own_background)

    def move_to(self, pose: Pose, *, is_free: bool = False) -> None:
        """Start a transition to ``pose``. ``is_free`` says that it is not the pose of a camera."""
        if self.pose is not None:
            self._transition, self.is_free = (self.pose, pose, 0.0), is_free

    def set_pose(self, pose: Pose) -> None:
        """Set the pose that the user has chosen, and end any transition."""
        self.pose, self._transition, self.is_free = pose, None, True

    def zoom(self, pose: Pose) -> None:
        """Set a pose at the same place that shows another part of the same view."""
        self.pose, self._transition = pose, None

    def advance(self, seconds: float, *, is_held: bool = False) -> bool:
        """Advance playback and the transition by ``seconds``. Playback waits while the current frame is being read, and
        if ``is_held`` is True.

        Returns True if the run has a new checkpoint, whose frames then replace the current frames.
        """
        has_new_checkpoint = self.scene is not None and self.scene.poll_checkpoint()
        if not (self.is_waiting or is_held):
            self.playback.advance(seconds)
        if self._transition is not None:
            start, end, fraction = self._transition
            fraction = min(1.0, fraction + seconds / TRANSITION_SECONDS)
            self.pose = interpolate_poses(start, end, fraction)
            self._transition = (start, end, fraction) if fraction < 1 else None
        return has_new_checkpoint

    def render_request(
        self, size: tuple[int, int], wait: bool = False, shift: tuple[float, float] = (0.0, 0.0)
    ) -> RenderRequest | None:
        """Return the render request for an image of ``size``, or None until the first frame of a scene has been read.

        ``shift`` moves the picture right and down, in pixels.

        The request contains the previous frame instead of the current frame in two cases: while the current frame is
        being read (``is_waiting`` is then True), and if the current frame cannot be read (``message`` then contains
        the reason). If ``wait`` is True, the method instead waits until the current frame has been read, and raises
        UserError if it cannot be read.
        """
        if self.scene is None or self.pose is None:
            return None
        frame = self._current_frame(wait)
        if frame is None:
            return None
        camera = self._camera(self.pose, size, shift)
        return RenderRequest(self._scale_points(frame), camera, self.scene.manifest, self.settings.drawn)

    def close(self) -> None:
        """Wait until no scene is being opened, then close all scenes."""
        if self._opener is not None:
            self._opener.join()
            self._opener = None
            if isinstance(self._opened, LoadedScene):
                self._opened.close()
        if self.scene is not None:
            self.scene.close()
            self.scene = None

    def _current_frame(self, wait: bool) -> BakedFrame | None:
        assert self.scene is not None
        try:
            found = self.scene.frames.get(self.playback.frame, self.playback.direction, wait)
        except UserError as error:
            if wait:
                raise
            self.message, self.is_waiting = str(error), False
            return self._last_frame
        self.is_waiting = found is None
        if found is not None:
            self._last_frame = found
        return self._last_frame

    def _camera(self, pose: Pose, size: tuple[int, int], shift: tuple[float, float]) -> Camera:
        """Return the camera of a pose.

        While its arguments do not change, each call returns the same object, so that renderers can reuse their depth
        order.
        """
        last = self._last_camera
        if last is None or last[0] is not pose or last[1:3] != (size, shift):
            last = self._last_camera = (pose, size, shift, pose.camera(*size, shift))
        return last[3]

    def _scale_points(self, frame: BakedFrame) -> BakedFrame:
        """Return the frame with radii and densities scaled by the settings.

        While the frame and the scales do not change, each call returns the same object.
        """
        scales = (self.settings.point_scale, self.settings.density_scale, self.settings.crop)
        if self._scaled is not None:
            source, settings, scaled = self._scaled
            if source is frame and (settings.point_scale, settings.density_scale, settings.crop) == scales:
                return scaled
        result = self.settings.scale_points(frame)
        self._scaled = (frame, self.settings, result)
        return result

    def _announce_estimates(self) -> None:
        """Tell the user why the first playback of a styled scene without normals is slow."""
        scene = self.scene
        if scene is not None and self.settings.style is not None and not scene.has_normals:
            self.message = (
                f"{scene.path.name}: expected normals for styles, got none; "
                "the normals of each frame are estimated when the frame is first drawn"
            )

    def _report(self, work: str) -> None:
        self.opening_work = work

    def _open(self, path: Path) -> None:
        try:
            self._opened = LoadedScene(path, open_frame_source(path, self._report))
        except Exception as error:  # take_opened() reports this error in the thread of the window
            self._opened = error
