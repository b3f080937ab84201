"""A common interface for rendering frames of trained runs and of baked scenes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray

from fourd.base.cameras import Camera
from fourd.base.errors import UserError
from fourd.base.storage import Location, StorageUrl
from fourd.recording.capture.frame_rate import DEFAULT_FPS
from fourd.recording.capture.layout import parse_frame_range
from fourd.scene.rendering import Scene, open_scene
from fourd.scene.splats.reader import is_splats

if TYPE_CHECKING:
    from fourd.reconstruction.training.run import TrainedRun
    from fourd.reconstruction.training.segments.segmented_run import SegmentedRun


Bounds = tuple[Sequence[float], Sequence[float]]


class Playable(Protocol):
    """Renders the frames of a run or a scene by index."""

    @property
    def views(self) -> dict[str, Camera]:
        """The capture's cameras by name."""

    @property
    def focus(self) -> NDArray[np.float64]:
        """Centre of the scene in world units, (3,)."""

    @property
    def bounds(self) -> Bounds | None:
        """Lower and upper corner of the box around the subject, in world units, or None if it is not known."""

    @property
    def is_whole(self) -> bool:
        """Whether the scene has surroundings, and not only a subject."""

    @property
    def frame_numbers(self) -> tuple[int, ...]:
        """For each frame, its number in the capture."""

    @property
    def fps(self) -> float:
        """Frames per second."""

    def render(
        self, camera: Camera, frame: int, layers: int | None, background: NDArray[np.float32]
    ) -> NDArray[np.float32]:
        """Render the frame with the 0-based index ``frame`` as RGB (H, W, 3) float32 in [0, 1].

        Args:
            layers: maximum number K of points that are composited per pixel. If ``layers`` is None, the value of the
                scene or run is used.
            background: (3,) colour in [0, 1] behind the points.
        """


@dataclass(frozen=True)
class PlayableScene:
    """A baked scene."""

    scene: Scene

    @property
    def views(self) -> dict[str, Camera]:
        manifest = self.scene.manifest
        return dict(zip(manifest.names, manifest.cameras, strict=True))

    @property
    def focus(self) -> NDArray[np.float64]:
        return np.asarray(self.scene.manifest.focus)

    @property
    def bounds(self) -> Bounds | None:
        return self.scene.manifest.bounds

    @property
    def is_whole(self) -> bool:
        return self.scene.manifest.background is not None

    @property
    def frame_numbers(self) -> tuple[int, ...]:
        return self.scene.manifest.frame_numbers

    @property
    def fps(self) -> float:
        return self.scene.manifest.fps

    def render(
        self, camera: Camera, frame: int, layers: int | None, background: NDArray[np.float32]
    ) -> NDArray[np.float32]:
        return self.scene.render(camera, frame, layers=layers, background=background).rgb


@dataclass(frozen=True)
class PlayableRun:
    """A trained run, with or without segments (ranges of frames with separate models). Rendering evaluates the
    networks of the run."""

    trained: TrainedRun | SegmentedRun

    @property
    def views(self) -> dict[str, Camera]:
        capture = self.trained.run.capture
        return dict(zip(capture.names, capture.cameras, strict=True))

    @property
    def focus(self) -> NDArray[np.float64]:
        return self.trained.run.focus

    @property
    def bounds(self) -> Bounds | None:
        scene = self.trained.run.config.scene
        return scene.lower, scene.upper

    @property
    def is_whole(self) -> bool:
        return self.trained.run.config.train.scene == "full"

    @property
    def frame_numbers(self) -> tuple[int, ...]:
        return self.trained.run.capture.frame_numbers

    @property
    def fps(self) -> float:
        return self.trained.run.capture.fps or DEFAULT_FPS

    def render(
        self, camera: Camera, frame: int, layers: int | None, background: NDArray[np.float32]
    ) -> NDArray[np.float32]:
        trained = self.trained
        layers = layers or trained.run.config.train.layers
        picture = trained.render(frame, camera, layers)
        over = (1 - picture.alpha)[..., None] * background
        return np.clip(picture.rgb + over, 0, 1).astype(np.float32)


def open_playable(path: Location) -> Playable:
    """Open a run folder, a `.4dv` or its URL, or Gaussian splats. torch is loaded only for a run. Raises UserError."""
    if isinstance(path, StorageUrl):
        return PlayableScene(open_scene(path))
    if not path.exists():
        raise UserError(
            f"{path}: expected a run's folder or a .4dv file, got a path that does not exist; check the path"
        )
    if path.is_dir() and not is_splats(path):
        from fourd.reconstruction.training.segments.segmented_run import open_trained

        return PlayableRun(open_trained(path))
    return PlayableScene(open_scene(path))


def find_view(views: Mapping[str, Camera], name: str) -> Camera:
    """Return the camera ``name``. Raises a UserError that lists the valid names if there is no such camera."""
    if name not in views:
        raise UserError(f"--views: expected names out of {', '.join(views)}, got {name}")
    return views[name]


def select_frames(playable: Playable, selection: str | None) -> list[int]:
    """Return the indices of the frames whose numbers in the capture are in the range ``selection``.

    The text A:B:S selects the frames A, A + S, A + 2 * S and so on, below B; A:B selects with step 1. If ``selection``
    is None, all frames are selected. Raises UserError.
    """
    numbers = playable.frame_numbers
    if selection is None:
        return list(range(len(numbers)))
    wanted = parse_frame_range(selection, max(numbers) + 1, "scene")
    chosen = [index for index, number in enumerate(numbers) if number in wanted]
    if not chosen:
        raise UserError(f"--frames: expected at least one frame from {numbers[0]} to {numbers[-1]}, got '{selection}'")
    return chosen


def selected_rate(playable: Playable, frames: Sequence[int]) -> float:
    """Return the frame rate at which the selected frames play at the speed of the recording. ``frames`` are evenly
    spaced frame indices."""
    return playable.fps if len(frames) < 2 else playable.fps / (frames[1] - frames[0])


def metres_per_unit(playable: Playable) -> float | None:
    """Return the length of a world unit in metres, or None if it is not known."""
    if isinstance(playable, PlayableScene):
        return playable.scene.manifest.metres_per_unit
    if isinstance(playable, PlayableRun):
        return playable.trained.run.capture.metres_per_unit
    return None
