"""Finds the capture of a scene, and reads its pictures in a thread."""

from __future__ import annotations

import threading
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fourd.base.configs import read_text_entry
from fourd.base.errors import UserError
from fourd.reconstruction.training.run_layout import CONFIG_NAME
from fourd.recording.capture import Capture, open_capture
from fourd.recording.capture.layout import EXTRINSICS_NAME, INTRINSICS_NAME, VIDEOS, camera_folders, find_videos
from fourd.scene import SceneManifest

_WORK_SUFFIX, _WORK_RUN, _WORK_CAPTURES = ".work", "run", ("repaired", "capture")
"""Names that ``fourd make`` gives to the folder of intermediate results, and to the run and captures in it."""
_CACHE_MB = 128


def is_capture(folder: Path) -> bool:
    """Return whether a folder has the calibration and the images or videos of a capture."""
    has_pictures = (folder / "images").is_dir() or (folder / VIDEOS).is_dir()
    return has_pictures and all((folder / name).is_file() for name in (INTRINSICS_NAME, EXTRINSICS_NAME))


def require_capture(folder: Path) -> Path:
    """Return ``folder``. Raises UserError if it is not a capture."""
    if not is_capture(folder):
        raise UserError(
            f"--capture {folder}: expected a capture (images/ or videos/, intri.yml and extri.yml), got another path; "
            "name the capture of the scene"
        )
    return folder


def find_capture(scene: Path) -> Path | None:
    """Return the capture from which a scene or a run was made, or None if it is not found.

    It is the capture that the run names. The run of a scene is the folder that contains the scene, or the one in the
    folder of intermediate results that ``fourd make`` leaves beside the scene. A scene in the folder of a capture
    belongs to this capture.
    """
    scene = scene.resolve()
    work = scene.with_suffix(_WORK_SUFFIX)
    named = [_capture_of_run(run) for run in (scene, scene.parent, work / _WORK_RUN)]
    # The path in a run is absolute: it names nothing after the folder of intermediate results was moved.
    moved = [work / name for name in _WORK_CAPTURES]
    candidates = [*(each for each in named if each is not None), *moved, scene.parent]
    return next((folder for folder in candidates if is_capture(folder)), None)


def _capture_of_run(run: Path) -> Path | None:
    """Return the path of the capture in a run's config.yaml, or None if there is none."""
    try:
        named = read_text_entry(run / CONFIG_NAME, "capture")
    except (OSError, ValueError, UserError):
        return None
    return None if named is None else Path(named)


@dataclass(frozen=True, eq=False)
class CapturedPicture:
    """A picture of the capture.

    Attributes:
        camera: index of its camera in the scene's manifest.
        frame: index of its frame in the scene.
        pixels: undistorted RGB image (H, W, 3) uint8.
    """

    camera: int
    frame: int
    pixels: NDArray[np.uint8]


class CapturedPictures:
    """Reads the pictures of one scene's capture in a thread, so that the window does not wait for the disk.

    The thread reads the picture that was asked for last. Only one thread may call the methods.
    """

    def __init__(self, folder: Path, manifest: SceneManifest) -> None:
        self.folder = folder
        self._manifest = manifest
        self._changed = threading.Condition()
        self._wanted: tuple[int, int] | None = None
        self._found: CapturedPicture | None = None
        self._failed: tuple[int, int] | None = None
        self._error = ""
        self._is_stopped = False
        self._thread = threading.Thread(target=self._run, name="captured pictures", daemon=True)
        self._thread.start()

    def get(self, camera: int, frame: int) -> CapturedPicture | None:
        """Return the picture that was read last, and ask for the picture of a camera and a frame. The result is None
        until a picture has been read, and can be another picture than the one that was asked for."""
        with self._changed:
            if self._wanted != (camera, frame):
                self._wanted = (camera, frame)
                self._changed.notify_all()
            return self._found

    @property
    def is_reading(self) -> bool:
        """Whether the picture that was asked for last is still being read."""
        with self._changed:
            return self._next() is not None and not self._is_stopped

    def take_error(self) -> str:
        """Return the reason why a picture could not be read, once; an empty string if there is none."""
        with self._changed:
            error, self._error = self._error, ""
            return error

    def close(self) -> None:
        """Stop the thread and close the capture."""
        with self._changed:
            self._is_stopped = True
            self._changed.notify_all()
        self._thread.join()

    def _next(self) -> tuple[int, int] | None:
        """Return the picture to read, or None if there is nothing to do."""
        found = None if self._found is None else (self._found.camera, self._found.frame)
        return None if self._wanted in (None, found, self._failed) else self._wanted

    def _run(self) -> None:
        capture: Capture | None = None
        try:
            while (wanted := self._wait()) is not None:
                try:
                    capture = capture or _open(self.folder, self._manifest)
                    picture = _read(capture, self._manifest, *wanted)
                except (UserError, OSError) as error:
                    with self._changed:
                        self._failed, self._error, self._found = wanted, str(error), None
                    continue
                with self._changed:
                    self._found, self._failed = picture, None
        finally:
            if capture is not None:
                capture.close()

    def _wait(self) -> tuple[int, int] | None:
        """Wait until there is a picture to read. Returns None after :meth:`close`."""
        with self._changed:
            while not self._is_stopped and self._next() is None:
                self._changed.wait()
            return None if self._is_stopped else self._next()


def _open(folder: Path, manifest: SceneManifest) -> Capture:
    """Open the cameras of the capture that the scene has too. Raises UserError if there are none."""
    found = {*camera_folders(folder / "images"), *(find_videos(folder / VIDEOS) if (folder / VIDEOS).is_dir() else ())}
    views = [name for name in manifest.names if name in found]
    if not views:
        expected = ", ".join(manifest.names[:3])
        got = ", ".join(sorted(found)[:3]) or "none"
        raise UserError(
            f"{folder}: expected the scene's cameras {expected}, got {got}; "
            "name the capture of this scene with --capture"
        )
    return open_capture(folder, views=views, mattes=False, cache_mb=_CACHE_MB)


def _read(capture: Capture, manifest: SceneManifest, camera: int, frame: int) -> CapturedPicture:
    name, number = manifest.names[camera], manifest.frame_numbers[frame]
    if name not in capture.names:
        raise UserError(
            f"{capture.path}: expected pictures of camera {name}, got none; restore them or choose another camera"
        )
    if number >= capture.total_frames:
        raise UserError(
            f"{capture.path}: expected frame {number} of the scene, got {capture.total_frames} frames; "
            "name the capture of this scene with --capture"
        )
    return CapturedPicture(camera, frame, capture.image(capture.names.index(name), number))
