"""The state of the interactive viewer and the actions of its panel and keys."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fourd.base.cameras import nearest_views
from fourd.base.configs import save_config
from fourd.base.errors import UserError
from fourd.scene.styles.presets import STYLE_SUFFIXES
from fourd.viewer.camera_paths.editor import PathEditor
from fourd.viewer.camera_paths.reading import OWN_SUFFIX
from fourd.viewer.comparison.captured import is_capture
from fourd.viewer.comparison.comparison import MODES, Comparison, Mode
from fourd.viewer.comparison.placement import find_view_of_pose
from fourd.viewer.display import RenderRequest
from fourd.viewer.interface.file_dialog import FileDialog, has_file_dialogs
from fourd.viewer.interface.layout import Area, Layout, has_room_for_panel
from fourd.viewer.interface.notice_clock import NoticeClock
from fourd.viewer.loaded_scene import LoadedScene
from fourd.viewer.measuring.measurement import Measurement
from fourd.viewer.navigation.bookmarks import Bookmarks
from fourd.viewer.navigation.preferences import Preferences, PreferencesFile
from fourd.viewer.navigation.recorded_path import PathRecorder, PathSample, RecordedPath
from fourd.viewer.navigation.saved_views import SavedViews, default_file
from fourd.viewer.output.paths import unused_path
from fourd.viewer.output.png import with_alpha, write_png
from fourd.viewer.playback.sound import SoundPlayer
from fourd.viewer.rendering.renderer_name import RendererName
from fourd.viewer.session import Session
from fourd.viewer.timings import Timings
from fourd.viewer.window import Window
from fourd.viewer.window_renderer import WindowRenderer
from fourd.viewer.window_video.rendering import Cancelled, VideoPlan, plan_recorded, plan_turntable, render_images


class ViewerState:
    """The state of the viewer that the panel shows and changes.

    Attributes:
        window: the window of the viewer.
        session: the scene, the playback and the pose.
        renderer: draws the session into the window.
        timings: times of the last images.
        comparison: the comparison with the captured pictures.
        measurement: the distance that the user measures.
        sound: plays the sound of the scene.
        recorder: recorder of the camera path, or None while no path is being recorded.
        recorded_path: the last recording of this scene.
        notice: tells how strongly the session's message is visible.
        preferences: what the viewer remembers from one start to the next.
        is_help_open: whether the help is visible.
        is_box_shown: whether the edges of the crop box are drawn, because the section Crop is open.
        camera_index: index of the capture camera that was selected last.
        bookmarks: the views of the scene that the user has kept.
        path_editor: the camera path of key frames that the user makes.
        has_alpha: whether screenshots have an alpha channel instead of a background.
        typed_path: what the user has typed as the path of a scene to open.
        typed_camera_path: what the user has typed as the file of a camera path.
    """

    def __init__(
        self,
        window: Window,
        session: Session,
        renderer: WindowRenderer,
        capture: Path | None = None,
        beside: Path | None = None,
    ) -> None:
        """The first scene is compared with the pictures in the folder ``capture``, or with the scene ``beside``."""
        self.window = window
        self.session = session
        self.renderer = renderer
        self.timings = Timings()
        self.comparison = Comparison(renderer.context, capture, beside)
        self.measurement = Measurement()
        self.sound = SoundPlayer()
        self.recorder: PathRecorder | None = None
        self.recorded_path: RecordedPath | None = None
        self.path_editor = PathEditor()
        self.notice = NoticeClock()
        self.is_help_open = False
        self.is_box_shown = False
        self.camera_index = 0
        self.has_alpha = False
        self.typed_path = self.typed_camera_path = ""
        self._saved_views = SavedViews(default_file())
        self.bookmarks = Bookmarks(default_file().with_name("bookmarks.json"))
        self._preferences_file = PreferencesFile(default_file().with_name("window.json"))
        self.preferences = self._preferences_file.load()
        self._wants_panel = has_room_for_panel(window.size[0], self.text_scale)
        self._dialog: FileDialog | None = None
        self._deferred: list[Callable[[], None]] = []

    @property
    def text_scale(self) -> float:
        """Scale of text and widgets, which is usually the display's scale factor.

        If one window coordinate covers more than one pixel of the framebuffer, the result is 1. Sizes of text and
        widgets are in window coordinates, so on such a display, text is enlarged without an additional scale factor.
        """
        is_scaled = self.window.framebuffer_size[0] > self.window.size[0]
        return 1.0 if is_scaled else self.window.content_scale

    @property
    def layout(self) -> Layout:
        """The parts of the window."""
        has_scene = self.session.scene is not None
        return Layout(self.window.size, self.text_scale, self.is_panel_open, has_bar=has_scene)

    @property
    def is_panel_open(self) -> bool:
        """Whether the panel is visible."""
        return self._wants_panel and self.session.scene is not None

    def toggle_panel(self, is_open: bool | None = None) -> None:
        """Show or hide the panel, or set whether it is open."""
        self._wants_panel = not self._wants_panel if is_open is None else is_open

    @property
    def picture_shift(self) -> tuple[float, float]:
        """Distance (right, down) in whole pixels from the middle of the window to the middle of the free area."""
        return self.shift_to(self.rendered_area)

    def shift_to(self, area: Area) -> tuple[float, float]:
        """Distance (right, down) in whole pixels from the middle of the window to the middle of ``area``."""
        width, height = self.window.framebuffer_size
        x, y = area.scaled(self.pixels_per_unit).centre
        return float(round(x - width / 2)), float(round(y - height / 2))

    @property
    def _room(self) -> tuple[float, float]:
        """(width, height) in pixels of the area in whose middle the picture is."""
        free = self.rendered_area.scaled(self.pixels_per_unit)
        return free.width, free.height

    @property
    def rendered_area(self) -> Area:
        """The area in whose middle the picture is: the free area, or its right half beside a captured picture."""
        free = self.layout.free
        return free.split(0.5)[1] if self.comparison.mode == "side by side" else free

    @property
    def pixels_per_unit(self) -> float:
        """Pixels of the framebuffer per window coordinate."""
        return self.window.framebuffer_size[0] / max(self.window.size[0], 1)

    def defer(self, action: Callable[[], None]) -> None:
        """Run ``action`` after the current image is finished.

        Widgets call :meth:`defer` while the panel is being drawn. ``action`` may draw an image itself, so it must wait
        until the panel is finished.
        """
        self._deferred.append(action)

    def run_deferred(self) -> bool:
        """Run the deferred actions. Returns True if there were any."""
        actions, self._deferred = self._deferred, []
        for action in actions:
            action()
        return bool(actions)

    def show_scene(self, scene: LoadedScene) -> None:
        """Show ``scene`` instead of the open scene, from its saved view or, if it has none, its initial view."""
        self.save_view()
        saved, size = self._saved_views.load(scene.path), self.window.framebuffer_size
        self.comparison.start()
        self.session.show(scene, saved or scene.initial_pose(size))
        if saved is None:
            # The room for the picture depends on the panel and the bar, which are there from now on.
            self.session.pose = scene.initial_pose(size, self._room)
        shown = 0 if saved is None else find_view_of_pose(scene, saved, size)
        self.session.is_free, self.camera_index = shown is None, shown or 0
        self.bookmarks.open(scene.path)
        self.measurement.reset()
        self.set_preferences(self.preferences.with_recent(scene.path))
        self.renderer.reset()
        self.recorded_path = self.recorder = None
        self.path_editor = PathEditor()

    def open(self, path: Path) -> None:
        """Open what the user has dropped on the window: a style file, a shade map, a camera path, a scene, a run, or
        the capture of the open scene."""
        if path.suffix in STYLE_SUFFIXES:
            self.session.choose_style(str(path))
        elif path.suffix.lower() == ".png":
            self.session.choose_shade_map(path)
        elif path.name.endswith(OWN_SUFFIX):
            self.session.message = self.path_editor.try_load(path)
        elif self.session.scene is not None and is_capture(path):
            self.comparison.set_folder(path)
            self.compare(MODES[1])
        else:
            self.session.open(path)

    def choose_file(self) -> None:
        """Let the user choose the file of a scene in the system's dialog."""
        if not has_file_dialogs():
            self.session.message = "expected zenity or kdialog to choose a file, got none; drop the file on the window"
        elif self._dialog is None:
            self._dialog = FileDialog("file")

    def choose_folder(self) -> None:
        """Let the user choose the folder of a run in the system's dialog."""
        if self._dialog is None and has_file_dialogs():
            self._dialog = FileDialog("folder")

    def take_chosen_path(self) -> Path | None:
        """Return the path that the user has chosen in the dialog since the last call, or None."""
        if self._dialog is None or not self._dialog.is_done:
            return None
        dialog, self._dialog = self._dialog, None
        return dialog.result()

    def recent_scenes(self) -> list[Path]:
        """Return the scenes that were opened last and are still there, the newest first."""
        return [path for path in map(Path, self.preferences.recent) if path.exists()]

    def set_preferences(self, preferences: Preferences) -> None:
        """Change and store what the viewer remembers."""
        if preferences != self.preferences:
            self.preferences = preferences
            self._preferences_file.save(preferences)

    def save_style(self) -> None:
        """Write the style to a YAML file in the working directory."""
        style, name = self.session.settings.style, self.session.style_name
        if style is not None and name is not None:
            path = unused_path(Path(name).stem, ".yaml")
            self.write(path, lambda: save_config(style, path))

    def save_view(self) -> None:
        """Save the pose. When the scene is opened again, the viewer starts from this pose."""
        if self.session.scene is not None and self.session.pose is not None:
            self._saved_views.save(self.session.scene.path, self.session.pose)

    def switch_renderer(self, name: RendererName, reason: str = "as requested") -> None:
        """Switch to another renderer. If the switch fails, the current renderer stays."""
        try:
            self.renderer.switch(name, reason)
        except Exception as error:
            self.session.message = f"{name}: not available ({error})"

    def move_to_camera(self, index: int) -> None:
        """Start a transition to a camera of the capture."""
        if self.session.scene is not None:
            self.camera_index = index
            self.session.move_to(self.session.scene.camera_pose(index, self.window.framebuffer_size, self._room))

    def move_to_next_camera(self, step: int) -> None:
        """Start a transition to the next camera in the order of the names, or to the previous one if ``step`` is -1."""
        order = () if self.session.scene is None else self.session.scene.camera_order
        if order:
            self.move_to_camera(order[(order.index(self.camera_index) + step) % len(order)])

    def move_to_initial_view(self) -> None:
        """Start a transition to the initial view of the scene."""
        if self.session.scene is not None:
            self.camera_index = 0
            self.session.move_to(self.session.scene.initial_pose(self.window.framebuffer_size, self._room))

    def add_bookmark(self) -> None:
        """Keep the view and the frame as a bookmark."""
        if self.session.pose is not None:
            view = PathSample(self.session.pose, self.session.playback.frame)
            self.session.message = self.bookmarks.add(view)

    def move_to_bookmark(self, index: int) -> None:
        """Pause at the frame of a bookmark, and start a transition to its view. The call is ignored if there is no such
        bookmark."""
        if index < len(self.bookmarks.kept):
            view, playback = self.bookmarks.kept[index], self.session.playback
            playback.is_playing = False
            playback.seek(view.frame)
            self.session.move_to(view.pose, is_free=True)

    def compare(self, mode: Mode) -> None:
        """Compare the scene with the captured picture of the camera that is shown, or to which the view is nearest."""
        scene, pose = self.session.scene, self.session.pose
        if scene is None or pose is None:
            return
        self.session.message = self.comparison.choose(mode, scene)
        is_left = self.session.is_free and mode == "off"
        if self.session.message or is_left or self.comparison.other is not None:
            return
        if self.session.is_free:
            camera, cameras = pose.camera(*self.window.framebuffer_size), scene.manifest.cameras
            (self.camera_index,) = nearest_views(camera, cameras, 1, np.asarray(scene.manifest.focus))
        self.move_to_camera(self.camera_index)

    @property
    def compared_camera(self) -> int | None:
        """Index of the camera whose view is shown and compared with its captured picture, or None."""
        scene, pose = self.session.scene, self.session.pose
        if not self.comparison.is_on or self.comparison.other is not None or scene is None or pose is None:
            return None
        return find_view_of_pose(scene, pose, self.window.framebuffer_size, self.camera_index)

    def take_screenshot(self) -> None:
        """Write the image to a PNG in the working directory, without the panel and with the picture in its middle."""
        if self.session.scene is None:
            return
        try:
            request = self.session.render_request(self.window.framebuffer_size, wait=True)
            if request is None:
                return
            image = self._transparent_image(request) if self.has_alpha else self.renderer.draw_exact(request)
        except UserError as error:
            self.session.message = str(error)
            return
        path = unused_path(self.session.scene.path.stem, ".png")
        self.write(path, lambda: write_png(path, image))

    def _transparent_image(self, request: RenderRequest) -> NDArray[np.uint8]:
        """Return the image (H, W, 4) of a request without its background."""
        black, white = (
            self.renderer.draw_exact(
                replace(request, settings=request.settings.with_background((grey, grey, grey)).drawn)
            ).astype(np.float32)
            / np.float32(255)
            for grey in (0.0, 1.0)
        )
        return with_alpha(black, white)

    def toggle_recording(self) -> None:
        """Start or stop recording the camera path.

        At the end of a recording, the path is written to a file in the working directory.
        """
        if self.recorder is None:
            self.recorder = PathRecorder()
            return
        recorded, self.recorder = self.recorder.path(), None
        if not recorded.samples or self.session.scene is None:
            return
        self.recorded_path = recorded
        path = unused_path(self.session.scene.path.stem, ".path.json")
        self.write(path, lambda: recorded.save(path))

    def render_recorded_path(self) -> None:
        """Render the recorded path at the window's size to an MP4 in the working directory."""
        if self.recorded_path is not None and self.session.scene is not None:
            frames = self.session.scene.manifest.frame_count
            self._render(plan_recorded(self.recorded_path, self.window.framebuffer_size, frames), "")

    def follow_path(self, seconds: float) -> None:
        """Advance the camera path of key frames, if it is played, and show the view at its new time."""
        sample = self.path_editor.advance(seconds)
        if sample is not None:
            self.session.set_pose(sample.pose)
            if self.path_editor.has_frames:
                self.session.playback.is_playing = False
                self.session.playback.seek(sample.frame)

    def render_turntable(self) -> None:
        """Render a turn around the subject at the window's size to an MP4 in the working directory."""
        if self.session.scene is not None:
            self._render(plan_turntable(self.session, self.window.framebuffer_size), "-turntable")

    def release(self) -> None:
        """Save the view, close the scene and free all GL objects."""
        self.save_view()
        self.comparison.release()
        self.sound.close()
        self.session.close()
        self.renderer.release()

    def _render(self, plan: VideoPlan, suffix: str) -> None:
        """Render a video to an MP4 whose name is that of the scene with ``suffix``."""
        from fourd.viewer.output.sound import sound_of_video
        from fourd.viewer.output.video import write_video

        assert self.session.scene is not None
        path = unused_path(self.session.scene.path.stem + suffix, ".mp4")
        images = render_images(self.window, self.session, self.renderer, path, plan)
        scene = self.session.scene
        sound = sound_of_video(scene.sound, scene.manifest, plan.frames, plan.fps)
        try:
            self.write(
                path, lambda: write_video(path, images, plan.fps, sound=None if isinstance(sound, str) else sound)
            )
        except Cancelled:
            self.session.message = f"{path}: cancelled, nothing was written"
        self.renderer.invalidate()

    def write(self, path: Path, write: Callable[[], object]) -> None:
        """Write a file and report the result in the session's message."""
        try:
            write()
        except (OSError, UserError) as error:
            self.session.message = f"{path}: cannot be written ({error})"
            return
        self.session.message = f"{path.resolve()}: written"
