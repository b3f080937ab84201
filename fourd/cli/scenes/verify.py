"""Verify that the files of a run, a scene or a capture are whole and unaltered."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from fourd.base.errors import UserError
from fourd.base.progress import Terminal, Tracker
from fourd.base.storage import Location, local_copy
from fourd.cli.loading import load_package
from fourd.cli.locations import PATH_OR_URL, transfer_progress
from fourd.cli.outputs import READS
from fourd.reconstruction.training.run_layout import CHECKPOINTS, CONFIG_NAME, checkpoint_files, segment_folders

if TYPE_CHECKING:
    from fourd.scene.container import SceneReader


@dataclass(frozen=True)
class Arguments:
    """For a run, the command compares every checkpoint, including checkpoints of segments, with its BLAKE2b digests.
    For a scene, the command compares every member of the file with its CRC-32 checksum and decodes all frames and the
    sound. For a capture, the command decodes every image, matte and video. No file is changed."""

    path: tyro.conf.Positional[Annotated[Location, READS, PATH_OR_URL, tyro.conf.arg(metavar="RUN|SCENE|CAPTURE")]]
    """A run folder, a .4dv file or a capture folder, or the URL of one."""


def run(arguments: Arguments) -> None:
    """Verify the files and print their number and kind. Raises UserError for the first damaged file."""
    with local_copy(arguments.path, transfer_progress()) as path:
        _verify(path, str(arguments.path))


def _verify(path: Path, name: str) -> None:
    if not path.exists():
        raise UserError(f"{path}: expected a run, a scene or a capture, got a path that does not exist; check the name")
    console, track = Terminal(), Tracker(Terminal(stderr=True))
    if path.is_file():
        line = _verify_scene(path, track)
    elif (path / CONFIG_NAME).is_file():
        line = _verify_run(path, console, track)
    else:
        line = _verify_capture(path, track)
    console.print(f"{name}: {line}", soft_wrap=True)


def _verify_scene(path: Path, track: Tracker) -> str:
    from fourd.scene.container import SceneReader
    from fourd.scene.files.archive import find_damaged_member

    member = find_damaged_member(path)
    if member is not None:
        raise UserError(f"{path}: expected unaltered members, got the altered member {member}; copy or export it again")
    reader = SceneReader(path)
    try:
        count = reader.manifest.frame_count
        for frame in track.track(range(count), count, "frames"):
            reader.read(frame)
        has_sound = _verify_sound(path, reader)
    finally:
        reader.close()
    return f"whole; {count} frames{' and sound' if has_sound else ''}"


def _verify_sound(path: Path, reader: SceneReader) -> bool:
    """Decode the sound of a scene. Returns whether it has one."""
    from fourd.recording.soundtrack.ogg import OggError
    from fourd.recording.soundtrack.opus import decode_opus

    sound = reader.read_sound()
    if sound is None:
        return False
    try:
        for _ in decode_opus(sound.content):
            pass
    except OggError as error:
        raise UserError(f"{path}: {error} in its sound; the file is damaged: copy or export it again") from error
    return True


def _verify_run(path: Path, console: Terminal, track: Tracker) -> str:
    load_package("torch")
    from fourd.reconstruction.training.checkpoints import verify_checkpoint

    runs = [path, *segment_folders(path)]
    found = [checkpoint for run in runs for checkpoint in checkpoint_files(run / CHECKPOINTS)]
    damaged: list[str] = []
    for checkpoint in track.track(found, len(found), "checkpoints"):
        try:
            files = verify_checkpoint(checkpoint)
        except UserError as error:
            damaged.append(str(error))
        else:
            console.print(f"{checkpoint}: whole; {files} files", soft_wrap=True)
    if damaged:
        more = f" (and {len(damaged) - 1} more checkpoints)" if len(damaged) > 1 else ""
        raise UserError(damaged[0] + more)
    if not found:
        raise UserError(f"{path}: expected checkpoints, got none; train the run first")
    return f"whole; {len(found)} checkpoints"


def _verify_capture(path: Path, track: Tracker) -> str:
    from fourd.recording.capture.check import check_capture

    report = check_capture(path, deep=True, track=track.track)
    if report.problems:
        more = len(report.problems) - 1
        raise UserError(report.problems[0] + (f" (and {more} more; see fourd check --deep)" if more else ""))
    return f"whole; {report.frames} frames of {len(report.cameras)} cameras"
