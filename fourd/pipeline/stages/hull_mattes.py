"""Hull mattes: if the user provided masks of some cameras, the mattes of the other cameras are silhouettes of the
visual hull of these masks."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from fourd.base.errors import UserError
from fourd.pipeline.stage import Artefact, Context, Stage
from fourd.pipeline.stages.check import INPUT_PATTERNS
from fourd.pipeline.stages.edited_mattes import kept_if_edited
from fourd.pipeline.stages.mattes import MatteFiles
from fourd.pipeline.stages.silhouettes import write_silhouettes
from fourd.recording.capture import open_capture
from fourd.recording.capture.layout import parse_frame_range, refuse_symlinks
from fourd.recording.matting.output import MatteOutput
from fourd.recording.matting.selection import Selection

VERSION = 1
MIN_MASKED = 3
"""Minimum number of cameras with masks. The hull of two silhouettes is too large for a matte."""
MIN_MASKED_TO_SCORE = 2
"""Minimum number of cameras with masks if only held-out cameras have none. Their mattes select the scored pixels."""


@dataclass(frozen=True)
class HullMatteSettings:
    """Cameras and frames of hull mattes.

    Attributes:
        given: names of the cameras whose masks form the hull. Held-out cameras are not among them, because their images
            must not influence the scene.
        missing: names of the cameras without masks, for which mattes are made.
        frames: range of frames, or None for all frames.
    """

    given: tuple[str, ...]
    missing: tuple[str, ...]
    frames: str | None


def hull_mattes_stage(capture: Path, settings: HullMatteSettings) -> Stage[MatteFiles, HullMatteSettings]:
    """Create the stage that makes the mattes of cameras without masks from the masks of the others."""
    return Stage(
        "mattes",
        run_hull_mattes,
        MatteFiles(capture),
        settings,
        inputs=(Artefact(capture, INPUT_PATTERNS),),
        outputs=(capture / ".fourd" / "mattes",),
    )


def run_hull_mattes(files: MatteFiles, settings: HullMatteSettings, context: Context) -> None:
    """Make the missing mattes. Mattes that an earlier call made from the same masks are kept."""
    path, names = files.capture, ", ".join(settings.missing)
    if not os.access(path, os.W_OK):
        raise UserError(
            f"{path}: expected a writable folder, in which the mattes of {names} are stored, got a read-only one; make "
            "it writable, or leave these cameras out with --views"
        )
    with open_capture(path, views=list(settings.given)) as capture:
        frame_names = capture.frame_names
    key = _key(path, settings, frame_names)
    output = MatteOutput(path, key, key)
    refuse_symlinks(path, output.folder)
    output.prepare()
    chosen = parse_frame_range(settings.frames, len(frame_names))
    missing = [chosen[index] for index in output.missing(settings.missing, [frame_names[frame] for frame in chosen])]
    folder = output.start() if missing else output.folder
    with kept_if_edited(path, context.log):
        write_silhouettes(Selection(path, settings.given), settings.missing, missing, folder, context)
        output.finish()
    context.log(
        f"{path}: no masks of {names}; their mattes are the silhouettes of the visual hull of the masks of "
        f"{len(settings.given)} other cameras ({len(missing)} frames made)"
    )


def _key(capture: Path, settings: HullMatteSettings, frames: Sequence[str]) -> str:
    """Hash all inputs of the mattes except the range of frames."""
    digest = hashlib.sha256(json.dumps([VERSION, settings.given, settings.missing, frames]).encode())
    paths = [path for name in settings.given for path in sorted((capture / "masks" / name).glob("*"))]
    for path in [*sorted(capture.glob("*.yml")), *paths]:
        status = path.stat()
        digest.update(f"{path.name} {status.st_size} {status.st_mtime_ns}\n".encode())
    return digest.hexdigest()
