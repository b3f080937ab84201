"""Computes the plan that ``fourd make`` prints before the stages start: the stages that will run, and rough estimates
of their durations."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import av

from fourd.base.errors import UserError
from fourd.pipeline.capture_graph import has_masks, is_usable
from fourd.pipeline.stages.cameras.colours import FRAMES as COLOUR_FRAMES
from fourd.pipeline.stages.cameras.colours import measures_colours
from fourd.reconstruction.training.config import TrainConfig
from fourd.reconstruction.training.segments.plan import SegmentPlan
from fourd.recording.capture.decoding import picture_size
from fourd.recording.capture.layout import parse_frame_range
from fourd.recording.capture.streams.container import frame_count, open_container, video_stream
from fourd.recording.importing.detection import pick_format
from fourd.recording.importing.imported import EncodedPictures, Frames, Imported, PictureFiles, VideoFile

IMPORT_S_PER_MP = 1.2
"""Seconds to index, sample and match one megapixel of the sampled images. Measured: 32 s for 3 frames of 8.3
megapixels."""
MATTE_S_PER_MP = 0.66
"""Seconds on one core to make the mattes of one megapixel of images. Measured: 273 s on 2 cores for 400 images of 2.1
megapixels."""
CARVE_S_PER_FRAME = 0.7
"""Seconds on one core to carve one frame. Measured: 0.70 s for 20 cameras and 65,536 points."""
BACKGROUND_S = 170.0
"""Seconds to compute the background points of a full scene. Measured: 171 s for 20 plates of 512 x 512 pixels."""
TRAIN_S_PER_STEP = 0.3
"""Seconds per training step. Measured: 821 steps in 246 s with 20,000 points on 2 cores."""
SAMPLED_FRAMES = 3
"""Number of frames of each camera in which an import matches features; see
:mod:`fourd.recording.importing.importer`."""


@dataclass(frozen=True)
class SourceFacts:
    """Properties of a source from which the plan is computed.

    Attributes:
        cameras: number of cameras.
        frames: number of selected frames of each camera, or None if the video headers do not contain the number of
            frames.
        megapixels: size of one image in megapixels.
        has_mattes: whether the source has masks of any camera.
        is_partly_masked: whether the source has masks of some cameras only.
        needs_import: whether the source must be imported as a capture.
    """

    cameras: int
    frames: int | None
    megapixels: float
    has_mattes: bool
    needs_import: bool
    is_partly_masked: bool = False


def describe_plan(source: Path, train: TrainConfig, workers: int, has_points: bool = False) -> str:
    """Return one line of text with the stages from ``source`` to a scene and their expected durations.

    Args:
        source: a capture, or a source that :mod:`fourd.recording.importing` can read.
        train: the training config.
        workers: number of processes.
        has_points: whether the user provides the initial points.

    Raises:
        UserError: if the source needs an import and has no known format.
    """
    facts = _read_facts(source, train)
    stages = _stage_durations(facts, train, max(workers, 1), has_points)
    listed = ", ".join(name if seconds < 30 else f"{name} ({_minutes(seconds)})" for name, seconds in stages)
    frames = "an unknown number of frames" if facts.frames is None else f"{facts.frames} frames"
    total = sum(seconds for _, seconds in stages)
    return (
        f"plan: {listed}; about {_minutes(total)} for {facts.cameras} cameras and {frames}, "
        "less for stages that are up to date"
    )


def _stage_durations(facts: SourceFacts, train: TrainConfig, workers: int, has_points: bool) -> list[tuple[str, float]]:
    """Return the stages in the order in which they run: the name and the expected duration in seconds of each."""
    frames = facts.frames or 1
    pictures_mp = facts.cameras * frames * facts.megapixels
    stages = []
    if facts.needs_import:
        sampled = min(SAMPLED_FRAMES, frames)
        stages.append(("import", IMPORT_S_PER_MP * facts.cameras * sampled * facts.megapixels))
    repair_mp = facts.cameras * min(SAMPLED_FRAMES, frames) * facts.megapixels
    stages += [("check", 0.0), ("repair", IMPORT_S_PER_MP * repair_mp)]
    is_full = train.scene == "full"
    is_still = is_full and facts.frames == 1 and not facts.has_mattes and not has_points
    if is_still:
        stages += [("still", 0.0), ("points", 0.0)]
    elif not facts.has_mattes:
        stages += [("mattes", MATTE_S_PER_MP * pictures_mp / workers), ("plates", 0.0)]
    elif facts.is_partly_masked:
        stages.append(("mattes", 0.0))
    if measures_colours(train):
        matched_mp = facts.cameras * min(COLOUR_FRAMES, frames) * facts.megapixels
        stages.append(("colours", IMPORT_S_PER_MP * matched_mp))
    if train.refine.cameras:
        stages.append(("adjust", 0.0))
    carving = 0.0 if has_points else CARVE_S_PER_FRAME * frames / workers
    if not is_still:
        stages.append(("points" if has_points else "carve", carving))
    if is_full:
        stages += ([("plates", 0.0)] if facts.has_mattes or is_still else []) + [("background", BACKGROUND_S)]
    steps_s = float("inf") if train.max_steps is None else TRAIN_S_PER_STEP * train.max_steps
    budget_s = float("inf") if train.max_seconds is None else train.max_seconds
    segments = 1
    if train.segments.frames is not None:
        segments = len(SegmentPlan.divide(frames, train.segments).ranges)
    training = "train" if segments == 1 else f"train {segments} segments"
    return [*stages, (training, segments * min(steps_s, budget_s)), ("bake", 0.0)]


def _read_facts(source: Path, train: TrainConfig) -> SourceFacts:
    needs_import = not is_usable(source)
    if needs_import:
        imported = pick_format(None, source).read(source)
    else:
        # The plan ignores errors in a capture, because the check stage reports them later.
        imported = Imported((), ())
        with suppress(UserError):
            imported = pick_format(None, source).read(source)
    cameras = imported.cameras
    if not cameras:
        return SourceFacts(0, None, 0.0, has_masks(source), needs_import)
    count, size = _measure(cameras[0].frames)
    with suppress(UserError):
        count = None if count is None else len(parse_frame_range(train.frames, count))
    views = len(cameras) if train.views is None else len(train.views)
    has_mattes = any(camera.masks is not None for camera in cameras) if needs_import else has_masks(source)
    is_partly_masked = has_mattes and any(camera.masks is None for camera in cameras)
    return SourceFacts(views, count, size[0] * size[1] / 1e6, has_mattes, needs_import, is_partly_masked)


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
