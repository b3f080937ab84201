"""An open scene with its frames, its cameras and its initial view."""

from __future__ import annotations

import time
from functools import cached_property
from pathlib import Path

import numpy as np

from fourd.base.cameras import estimate_up
from fourd.base.files import natural_key
from fourd.scene import SceneManifest
from fourd.viewer.camera_paths.scene import PathScene
from fourd.viewer.navigation.pose import Pose, pose_facing, pose_from_camera
from fourd.viewer.playback.prefetch import BUFFER_BYTES, MAX_FRAMES, MIN_FRAMES, BakedFrameSource, FramePrefetcher
from fourd.viewer.playback.sources import RunSource

_CHECKPOINT_POLL_SECONDS = 1.0


class LoadedScene:
    """An open scene: a `.4dv` file, Gaussian splats, or a training run.

    The frames of a training run are baked from its newest checkpoint.

    Attributes:
        path: path of the scene's file or folder.
        manifest: the manifest of the scene.
        frames: supplies the frames and prefetches them.
        up: up direction of the world, (3,).
        sound: the sound of the scene, or None if it has none.
        has_normals: whether the scene stores normals. Styles need normals, and estimate missing ones.
        checkpoint: file name of the displayed checkpoint of a run; empty for other scenes.
    """

    def __init__(self, path: Path, source: BakedFrameSource) -> None:
        """The scene takes ownership of ``source``, and :meth:`close` closes the source."""
        self.path = path
        self.manifest: SceneManifest = source.manifest
        self.sound = source.read_sound()
        self._run = source if isinstance(source, RunSource) else None
        # A run's frames are baked on demand, which slows training. Therefore only the next one is baked before it is
        # shown, but the baked frames are kept, so that the second round plays at once.
        self.frames = FramePrefetcher(source, BUFFER_BYTES, MIN_FRAMES if self._run else MAX_FRAMES)
        self.up = estimate_up(self.manifest.cameras) if self.manifest.cameras else np.array([0.0, 0.0, 1.0])
        self.has_normals = "normals" in self.manifest.optional_attributes
        self.checkpoint = self._run.checkpoint if self._run else ""
        self._last_poll = time.monotonic()

    @cached_property
    def camera_order(self) -> tuple[int, ...]:
        """Indices of the cameras in the order of their names. In the manifest, held-out cameras come last."""
        return tuple(sorted(range(len(self.manifest.names)), key=lambda index: natural_key(self.manifest.names[index])))

    @property
    def path_scene(self) -> PathScene:
        """What camera paths need to know of the scene."""
        manifest = self.manifest
        return PathScene(
            manifest.cameras,
            np.asarray(manifest.focus),
            manifest.frame_count,
            manifest.fps,
            manifest.bounds,
            manifest.background is not None,
        )

    @property
    def computed_share(self) -> float:
        """Share of the frame of a run that is being computed, from 0 to 1; 0 if it is not known."""
        return 0.0 if self._run is None else self._run.share

    def initial_pose(self, size: tuple[int, int], room: tuple[float, float] | None = None) -> Pose:
        """Return the pose of the first camera or, if there are no cameras, a pose that shows the whole scene."""
        if self.manifest.cameras:
            return self.camera_pose(0, size, room)
        lower, upper = (np.asarray(corner) for corner in self.manifest.bounds)
        diagonal = max(float(np.linalg.norm(upper - lower)), 1e-3)
        centre = (lower + upper) / 2
        side = np.array([0.0, -1.0, 0.0]) if abs(self.up[1]) < 0.9 else np.array([1.0, 0.0, 0.0])
        return pose_facing(centre + 1.2 * diagonal * side, centre, self.up, np.radians(50))

    def camera_pose(self, index: int, size: tuple[int, int], room: tuple[float, float] | None = None) -> Pose:
        """Return the pose of a camera of the capture. Its image fits into ``room`` (width, height) or ``size``."""
        return pose_from_camera(self.manifest.cameras[index], self.manifest.focus, self.up, size, room)

    def poll_checkpoint(self) -> bool:
        """Check for a new checkpoint of the run, at most once per second.

        Returns True if there is a new checkpoint. Its frames replace the buffered frames.
        """
        now = time.monotonic()
        if self._run is None or now - self._last_poll < _CHECKPOINT_POLL_SECONDS:
            return False
        self._last_poll = now
        newest = self._run.checkpoint
        if newest in ("", self.checkpoint):
            return False
        self.checkpoint = newest
        self.frames.invalidate()
        return True

    def close(self) -> None:
        """Stop prefetching and close the source."""
        self.frames.close()
