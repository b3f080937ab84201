"""Silhouettes: the mattes of some cameras, made from the mattes of others through the visual hull."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2

from fourd.base.parallel import run_jobs, split_into_blocks
from fourd.pipeline.stage import Context
from fourd.reconstruction.carving.coherence import hull_silhouettes
from fourd.recording.matting.selection import Selection
from fourd.recording.matting.sequence import write_matte


def write_silhouettes(
    given: Selection, missing: Sequence[str], frames: Sequence[int], folder: Path, context: Context
) -> None:
    """Write the silhouettes of the visual hull as mattes FOLDER/CAM/FRAME.png. Existing files are kept.

    Args:
        given: the cameras whose masks or mattes form the hull.
        missing: names of the cameras that get silhouettes.
        frames: indices of the frames among those that ``given`` selects.
        folder: output folder.
        context: number of processes, and progress.
    """
    jobs = [
        _Job(given, tuple(missing), folder, tuple(block)) for block in split_into_blocks(list(frames), context.workers)
    ]
    for _ in context.track(run_jobs(_write_frames, jobs, context.workers), len(frames), "silhouettes"):
        pass


@dataclass(frozen=True)
class _Job:
    """Job of a worker process; see :func:`write_silhouettes` for the attributes."""

    given: Selection
    missing: tuple[str, ...]
    folder: Path
    frames: tuple[int, ...]


def _write_frames(job: _Job) -> Iterator[int]:
    """Write the silhouettes of some frames, and yield the index of each frame after its files are written."""
    cv2.setNumThreads(1)
    with job.given.open() as masked, replace(job.given, views=job.missing).open(mattes=False) as unmasked:
        for frame in job.frames:
            masks = [masked.mask(camera, frame) for camera in range(len(masked.names))]
            mattes = hull_silhouettes(masks, masked.cameras, unmasked.cameras)
            for name, matte in zip(unmasked.names, mattes, strict=True):
                target = job.folder / name / f"{unmasked.frame_names[frame]}.png"
                # Existing mattes are kept, because the user may have edited them.
                if not target.exists():
                    write_matte(target, matte)
            yield frame
