"""The folder of a synthetic capture: its settings, its images, and the removal of an older synthetic capture."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from fourd.base.errors import UserError
from fourd.base.files import write_bytes_atomically, write_text_atomically
from fourd.base.limits import read_json
from fourd.base.progress import Terminal
from fourd.recording.capture.layout import VIDEOS

SETTINGS_NAME = "synth.json"
VERSION = 1
JPEG_QUALITY = 95


def read_settings(out: Path) -> dict[str, object] | None:
    """Read the content of synth.json. Returns None if the file is missing or invalid."""
    try:
        content = read_json(out / SETTINGS_NAME)
    except (OSError, ValueError):
        return None
    return content if isinstance(content, dict) and "version" in content else None


def write_settings(out: Path, settings: Mapping[str, object], *, finished: bool) -> None:
    """Write synth.json."""
    content = {"version": VERSION, **settings, "finished": finished}
    write_text_atomically(out / SETTINGS_NAME, json.dumps(content, indent=1) + "\n")


def has_finished(out: Path, settings: Mapping[str, object]) -> bool:
    """Return whether ``out`` contains a finished capture with these settings."""
    return read_settings(out) == {"version": VERSION, **settings, "finished": True}


def prepare_folder(out: Path) -> None:
    """Create the folder ``out``. An older synthetic capture is removed, so that its frames do not mix with the new
    frames.

    Raises:
        UserError: if ``out`` is a file, or contains files but no synthetic capture.
    """
    if out.exists() and not out.is_dir():
        raise UserError(f"{out}: expected a folder, got a file; name another folder")
    if out.is_dir() and any(out.iterdir()) and read_settings(out) is None:
        raise UserError(
            f"{out}: expected an empty folder or a synthetic capture ({SETTINGS_NAME}), got other files; "
            "name another folder"
        )
    out.mkdir(parents=True, exist_ok=True)
    for name in ("images", "masks", "truth", VIDEOS):
        if (out / name).exists():
            shutil.rmtree(out / name)
    for name in ("capture.json", "split.json", "videos.json"):
        (out / name).unlink(missing_ok=True)


def write_cameras(names: Sequence[str], frames: int, write: Callable[[int, Callable[[], None]], None]) -> None:
    """Call ``write(index, advance)`` once for each camera, in several threads. ``write`` calls ``advance`` after each
    frame."""
    workers = min(4, os.cpu_count() or 1, len(names))
    with _progress() as progress, ThreadPoolExecutor(workers) as pool:
        task = progress.add_task("synth", total=frames * len(names))
        jobs = [pool.submit(write, index, lambda: progress.advance(task)) for index in range(len(names))]
        try:
            for job in jobs:
                job.result()
        finally:
            pool.shutdown(wait=False, cancel_futures=True)


def write_image(path: Path, pixels: NDArray[np.uint8] | NDArray[np.uint16], jpeg_quality: int = JPEG_QUALITY) -> None:
    """Write an image in OpenCV's order of channels. The suffix of ``path`` determines the format."""
    options = [cv2.IMWRITE_JPEG_QUALITY, jpeg_quality] if path.suffix == ".jpg" else []
    done, content = cv2.imencode(path.suffix, np.ascontiguousarray(pixels), options)
    if not done:
        raise RuntimeError(f"{path}: the image could not be encoded")
    write_bytes_atomically(path, content.tobytes())


def _progress() -> Progress:
    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
        console=Terminal(stderr=True),
    )
