"""The plan that ``fourd make`` prints before the stages start: the stages that are expected to run, and rough estimates
of their durations."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

import av

from fourd.base.errors import UserError
from fourd.pipeline.facts import MaskFacts
from fourd.pipeline.graphs.capture import needs_import
from fourd.pipeline.graphs.scene import SceneStages
from fourd.pipeline.runner import AnyStage
from fourd.pipeline.segments import DIVIDE
from fourd.pipeline.workload import Workload
from fourd.reconstruction.training.config import TrainConfig
from fourd.recording.board_calibration.search import BoardRecording, find_board_recording
from fourd.recording.capture.decoding import picture_size
from fourd.recording.capture.layout import parse_frame_range, select_views
from fourd.recording.capture.streams.container import frame_count, open_container, video_stream
from fourd.recording.importing.detection import pick_format
from fourd.recording.importing.imported import EncodedPictures, Frames, ImportedCamera, PictureFiles, VideoFile
from fourd.recording.matting.sequence import MatteSettings


def describe_plan(stages: SceneStages, workers: int) -> str:
    """Return one line of text with the stages from a source to a scene and their expected durations.

    Args:
        stages: the list of stages.
        workers: number of processes.

    Raises:
        UserError: if the source needs an import and has no known format.
    """
    forecast, workload = _forecast(stages, max(workers, 1))
    # Errors in the names of cameras are reported by the stages. The plan does not depend on these names.
    train = replace(stages.run.train, views=None, test_views=())
    expected = replace(stages, run=replace(stages.run, train=train)).groups(forecast)
    durations = _durations([stage for group in expected for stage in group], workload)
    listed = ", ".join(name if seconds < 30 else f"{name} ({_minutes(seconds)})" for name, seconds in durations)
    frames = "an unknown number of frames" if workload.frames is None else f"{workload.frames} frames"
    total = sum(seconds for _, seconds in durations)
    return (
        f"plan: {listed}; about {_minutes(total)} for {workload.cameras} cameras and {frames}, "
        "less for stages that are up to date"
    )


def _durations(stages: Sequence[AnyStage], workload: Workload) -> list[tuple[str, float]]:
    """Return the name and the expected duration in seconds of each stage. The stages that train segments are listed as
    one."""
    seconds = [(stage.name, stage.duration_s(workload)) for stage in stages if stage.name != DIVIDE]
    segments = [each for name, each in seconds if name.startswith("train ")]
    if not segments:
        return seconds
    merged = (f"train {len(segments)} segments" if len(segments) > 1 else "train", sum(segments))
    first = next(index for index, (name, _) in enumerate(seconds) if name.startswith("train "))
    return [*seconds[:first], merged, *seconds[first + len(segments) :]]


@dataclass(frozen=True)
class Forecast:
    """What the stages are expected to find, from the source alone; see :class:`fourd.pipeline.graphs.scene.Look`.

    Attributes:
        given: which cameras of the source have masks from the user.
        frames: number of selected frames, or None if it is not known.
    """

    given: MaskFacts
    frames: int | None

    def board(self, source: Path) -> BoardRecording | None:
        return find_board_recording(source, lambda line: None)

    def require_frames(self, capture: Path, train: TrainConfig) -> None:
        pass

    def held_out(self, train: TrainConfig, capture: Path) -> TrainConfig:
        return train

    def repaired(self, capture: Path, repaired: Path) -> Path:
        return capture

    def still(self, capture: Path, train: TrainConfig) -> TrainConfig | None:
        is_still = train.scene == "full" and self.frames == 1 and not self.given.has_masks
        return train if is_still else None

    def masks(self, capture: Path) -> MaskFacts:
        return self.given

    def mattes(self, capture: Path, masks: MaskFacts, train: TrainConfig) -> MatteSettings | None:
        return MatteSettings()

    def frame_numbers(self, capture: Path, train: TrainConfig) -> Sequence[int]:
        return range(self.frames or 1)


def _forecast(stages: SceneStages, workers: int) -> tuple[Forecast, Workload]:
    source, train = stages.source, stages.run.train
    cameras: tuple[ImportedCamera, ...] = ()
    masks = MaskFacts((), (), False)
    if not needs_import(source, stages.imports):
        # Errors in a capture are ignored here, because the check stage reports them.
        with suppress(UserError):
            masks = MaskFacts.read(source)
            cameras = pick_format(None, source).read(source).cameras
    else:
        cameras = pick_format(None, source).read(source).cameras
        masked = tuple(camera.name for camera in cameras if camera.masks is not None)
        masks = MaskFacts(tuple(camera.name for camera in cameras), masked, bool(masked))
    if not cameras:
        return Forecast(masks, None), Workload(0, None, 0.0, workers)
    count, size = _measure(cameras[0].frames)
    with suppress(UserError):
        count = None if count is None else len(parse_frame_range(train.frames, count))
    views = len(cameras)
    with suppress(UserError):
        views = len(select_views(train.views, [camera.name for camera in cameras]))
    return Forecast(masks, count), Workload(views, count, size[0] * size[1] / 1e6, workers)


def _measure(frames: Frames) -> tuple[int | None, tuple[int, int]]:
    """Return the number of frames and the image size (width, height) of a camera. The number is None if the video
    header does not contain it."""
    if isinstance(frames, PictureFiles):
        return len(frames.paths), picture_size(frames.paths[0])
    if isinstance(frames, EncodedPictures):
        return frames.count, (0, 0)
    assert isinstance(frames, VideoFile)
    try:
        with open_container(frames.path) as container:
            stream = video_stream(frames.path, container)
            return frame_count(stream) or None, (stream.width, stream.height)
    except (av.FFmpegError, OSError, ValueError, IndexError, TypeError, UserError):
        return None, (0, 0)


def _minutes(seconds: float) -> str:
    return f"{seconds:.0f} s" if seconds < 90 else f"{seconds / 60:.0f} min"
