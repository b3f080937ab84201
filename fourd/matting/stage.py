"""Mattes of a whole capture: learned once, made frame by frame on all cores, each file written once."""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from fourd.capture import Capture
from fourd.capture.layout import MATTES, refuse_symlinks, sample_indices
from fourd.errors import UserError
from fourd.files import atomic_path, remove_unfinished, write_text_atomically
from fourd.matting.chroma import ScreenColour, chroma_matte, find_screen, given_screen
from fourd.matting.motion.mattes import fine_background, matting_cameras
from fourd.matting.motion.sampling import take_sample
from fourd.matting.motion.saved_model import load_matter, save_subject
from fourd.matting.motion.subject import learn_subject
from fourd.matting.rvm import load_rvm
from fourd.matting.selection import Selection
from fourd.parallel import run_jobs, split_into_blocks
from fourd.progress import Track

Picture = NDArray[np.uint8]

VERSION = 2
STATE = "mattes.json"
LEARNED = "subject.npz"
SHEET = Path(".fourd") / "mattes.png"
INPUTS = ("*.yml", "videos.json", "videos/*", "images/*/*")
SCREEN_FRAMES = 5
FASTEST_PNG = [cv2.IMWRITE_PNG_COMPRESSION, 1]


@dataclass(frozen=True)
class MatteSettings:
    """How mattes are made.

    Attributes:
        method: "motion" needs no weights; "chroma" a screen of one colour; "rvm" a network's file.
        seed: of the colours drawn for distributions.
        screen: "R,G,B" of 0 to 255; None finds it, camera by camera.
        rvm: TorchScript file of Robust Video Matting.
    """

    method: Literal["motion", "chroma", "rvm"] = "motion"
    seed: int = 0
    screen: str | None = None
    rvm: Path | None = None


def make_mattes(selection: Selection, settings: MatteSettings, workers: int, track: Track) -> int:
    """Make a capture's mattes into ``.fourd/mattes/CAM/FRAME.png``, of the undistorted pictures.

    What an earlier call with the same input and settings made is kept; with others all is made anew.

    Args:
        selection: the capture; all of its cameras help each other.
        settings: the method.
        workers: processes.
        track: for progress.

    Returns:
        number of frames made now.

    Raises:
        UserError: when nothing moves or the views do not agree on where, there is no screen, or the network's file
            is none.
    """
    capture = selection.open(mattes=False)
    folder = capture.path / MATTES
    refuse_symlinks(capture.path, folder)
    _begin(folder, matte_key(capture, settings))
    missing = [frame for frame in range(capture.frame_count) if not _is_made(folder, capture, frame)]
    if not missing:
        return 0
    if settings.method == "rvm":
        _by_network(capture, settings, folder, missing, track)
        return len(missing)
    by: Path | tuple[ScreenColour, ...]
    if settings.method == "chroma":
        by = _screens(capture, settings, track)
    else:
        by = folder.parent / LEARNED
        if not by.exists():
            _learn(capture, settings, by, track)
    jobs = [_Job(selection, by, folder, tuple(block)) for block in split_into_blocks(missing, workers)]
    for _ in track(run_jobs(_mattes, jobs, workers), len(missing), "mattes"):
        pass
    return len(missing)


def matte_key(capture: Capture, settings: MatteSettings) -> str:
    """A hash of all that mattes depend on: settings, selection, and the input files' sizes and times."""
    digest = hashlib.sha256(
        json.dumps([VERSION, asdict(settings), capture.names, capture.frame_names], default=str).encode()
    )
    for pattern in INPUTS:
        for path in sorted(capture.path.glob(pattern)):
            status = path.stat()
            digest.update(f"{path.name} {status.st_size} {status.st_mtime_ns}".encode())
    return digest.hexdigest()


def _begin(folder: Path, key: str) -> None:
    """Clear what was made of another input or by other settings, and what a killed process left half-written."""
    state = folder.parent / STATE
    try:
        known = json.loads(state.read_text(encoding="utf-8")).get("key")
    except (OSError, ValueError, AttributeError):
        known = None
    if known != key:
        shutil.rmtree(folder, ignore_errors=True)
        (folder.parent / LEARNED).unlink(missing_ok=True)
        (folder.parent / SHEET.name).unlink(missing_ok=True)
        write_text_atomically(state, json.dumps({"version": VERSION, "key": key}) + "\n")
    remove_unfinished(folder.parent)
    remove_unfinished(folder, deep=True)


def _is_made(folder: Path, capture: Capture, frame: int) -> bool:
    return all((folder / name / f"{capture.frame_names[frame]}.png").exists() for name in capture.names)


def _learn(capture: Capture, settings: MatteSettings, learned: Path, track: Track) -> None:
    samples = take_sample(capture, track)
    subject = learn_subject(samples, capture.names, settings.seed, track)
    cameras = matting_cameras(capture)
    numbers = range(len(cameras))
    backgrounds = [
        fine_background(capture, index, subject.looks[index], cameras[index])
        for index in track(numbers, len(numbers), "background")
    ]
    save_subject(learned, subject, backgrounds)


def _screens(capture: Capture, settings: MatteSettings, track: Track) -> tuple[ScreenColour, ...]:
    """Each camera's screen: the given one, or as a few of its pictures show it."""
    numbers = range(len(capture.names))
    if settings.screen is not None:
        return tuple(given_screen(settings.screen) for _ in numbers)
    frames = sample_indices(capture.frame_count, SCREEN_FRAMES)
    return tuple(
        find_screen([capture.image(index, frame) for frame in frames])
        for index in track(numbers, len(numbers), "screens")
    )


def _by_network(capture: Capture, settings: MatteSettings, folder: Path, missing: Sequence[int], track: Track) -> None:
    """Each camera's frames in order, from its first: what the network remembers must be the same in every run."""
    if settings.rvm is None:
        raise UserError("--rvm: expected the file of the network for --method rvm, got none; name it")
    network = load_rvm(settings.rvm)
    for index, name in enumerate(capture.names):
        left = [frame for frame in missing if not (folder / name / f"{capture.frame_names[frame]}.png").exists()]
        if not left:
            continue
        frames = range(left[-1] + 1)
        made = network.mattes(capture.image(index, frame) for frame in frames)
        for frame, matte in zip(frames, track(made, len(frames), f"mattes {name}"), strict=True):
            if frame in left:
                write_matte(folder / name / f"{capture.frame_names[frame]}.png", matte)


@dataclass(frozen=True)
class _Job:
    """Frames for one process, which opens everything itself; ``by`` what was learned, or each camera's screen."""

    selection: Selection
    by: Path | tuple[ScreenColour, ...]
    folder: Path
    frames: tuple[int, ...]


def _mattes(job: _Job) -> Iterator[int]:
    """Make the mattes of a job's frames; each frame when its files are there."""
    cv2.setNumThreads(1)
    capture = job.selection.open(mattes=False)
    matter = load_matter(job.by, matting_cameras(capture)) if isinstance(job.by, Path) else None
    for frame in job.frames:
        if matter is not None:
            mattes = matter.mattes(capture, frame)
        elif isinstance(job.by, tuple):
            mattes = [chroma_matte(capture.image(index, frame), screen) for index, screen in enumerate(job.by)]
        for name, made in zip(capture.names, mattes, strict=True):
            path = job.folder / name / f"{capture.frame_names[frame]}.png"
            if not path.exists():  # others of an unfinished frame may have been mended by hand since
                write_matte(path, made)
        yield frame


def write_matte(path: Path, matte: Picture) -> None:
    """Write a matte (H, W) uint8 as PNG, atomically."""
    with atomic_path(path) as temporary:
        if not cv2.imwrite(str(temporary), matte, FASTEST_PNG):
            raise OSError(f"{path}: cannot be written")
