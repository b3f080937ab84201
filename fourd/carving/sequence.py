"""A whole capture: one PLY a frame and the scene's bounds, streaming and resumable."""

from __future__ import annotations

import glob
import hashlib
import json
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from time import monotonic
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fourd.capture.layout import refuse_symlinks
from fourd.carving.bounds import Bounds, find_bounds
from fourd.carving.carve import carve_frame
from fourd.carving.colour import colour_points
from fourd.carving.mask_source import MaskSource, frame_masks
from fourd.errors import UserError
from fourd.files import remove_unfinished, write_text_atomically
from fourd.parallel import blocks, spread
from fourd.ply import read_ply, write_ply
from fourd.progress import Track, untracked

Corners = tuple[NDArray[np.float32], NDArray[np.float32]]

BOUNDS_NAME = "bounds.json"
VERSION = 2
MARGIN = 0.05
MOST_SEARCHED = 120
WORTH_SPREADING_SECONDS = 10.0
"""Of carving that is left: processes take some seconds to start."""
INPUTS = ("masks/{camera}/*", ".fourd/mattes/{camera}/*", "images/{camera}/*", "videos/{camera}.*", "videos.json")


@dataclass(frozen=True)
class CarveSettings:
    """What carving depends on beside the capture; see :func:`fourd.carving.carve_frame`."""

    points: int = 65536
    agreement: float = 0.95
    least_views: float = 1 / 2
    seed: int = 0


def carve_capture(
    capture: MaskSource,
    out_folder: Path | str,
    *,
    points: int = 65536,
    agreement: float = 0.95,
    least_views: float = 1 / 2,
    seed: int = 0,
    track: Track = untracked,
    workers: int = 1,
) -> Bounds:
    """Carve every frame into ``out_folder``: ``FRAME.ply`` (xyz, rgb) each, and ``bounds.json``.

    FRAME is the frame's number in the capture, six digits. Files are written atomically and
    one frame is held at a time. A second call with the same capture and settings skips the
    frames whose PLY is there and whole; with others it carves all of them again.

    Args:
        capture: cameras, images and masks.
        out_folder: made when missing.
        points: points a frame, at least 1.
        agreement: share in (0, 1] of the views seeing a point that must hold it.
        least_views: share in (0, 1] of all views that must see a point (at least 3 views, or all of fewer).
        seed: of the points' order.
        track: for progress.
        workers: processes, between which frames are shared out once one has shown to be worth it. The capture goes to
            them pickled, and the points are the same for any number.

    Returns:
        the box of all frames' points with a margin of 5% of its longest side.

    Raises:
        UserError: when a frame's hull is empty, or a file cannot be written.
    """
    settings = CarveSettings(points, agreement, least_views, seed)
    folder = Path(out_folder)
    key = settings_key(capture, settings)
    refuse_symlinks(capture.path, folder)
    try:
        remove_unfinished(folder)
        search = _search_box(capture, folder, settings, key, track)
        lower, upper = np.full(3, np.inf), np.full(3, -np.inf)
        job = _Job(capture, folder, search, settings, tuple(range(capture.frame_count)))
        for low, high in track(_shared_out(job, workers), capture.frame_count, "carving"):
            lower, upper = np.minimum(lower, low), np.maximum(upper, high)
        pad = MARGIN * float((upper - lower).max())
        bounds = Bounds(lower - pad, upper + pad)
        _save(folder, key, settings, search, bounds)
    except OSError as error:
        raise UserError(
            f"{folder}: expected to write there, got '{error.strerror}'; free space or name another"
        ) from error
    return bounds


def read_bounds(folder: Path | str) -> Bounds:
    """The bounds that :func:`carve_capture` left in ``folder``.

    Raises:
        UserError: when bounds.json is missing, unreadable, or of a carving that did not finish.
    """
    path = Path(folder) / BOUNDS_NAME
    state = _load(path)
    try:
        return Bounds(np.array(state["lower"]), np.array(state["upper"]))
    except (KeyError, TypeError, ValueError) as error:
        raise UserError(
            f"{path}: expected the bounds of a finished carving, got none; run fourd carve again"
        ) from error


def settings_key(capture: MaskSource, settings: CarveSettings) -> str:
    """A hash of all that the points depend on: settings, calibration, frames, and the files' sizes and times."""
    digest = hashlib.sha256(json.dumps([VERSION, asdict(settings), capture.frame_numbers]).encode())
    for name, camera in zip(capture.names, capture.cameras, strict=True):
        digest.update(f"{name} {camera.width} {camera.height}".encode())
        for matrix in (camera.intrinsics, camera.rotation, camera.translation):
            digest.update(np.ascontiguousarray(matrix).tobytes())
        for pattern in INPUTS:
            for path in sorted(capture.path.glob(pattern.format(camera=glob.escape(name)))):
                status = path.stat()
                digest.update(f"{path.name} {status.st_size} {status.st_mtime_ns}".encode())
    return digest.hexdigest()


def _search_box(capture: MaskSource, folder: Path, settings: CarveSettings, key: str, track: Track) -> Bounds:
    """The box to carve in: as an earlier call with the same key found it, or else found and saved now.

    Frames that were not looked at get three margins.
    """
    state = _load(folder / BOUNDS_NAME, missing_is_empty=True)
    if state.get("key") == key:
        try:
            return Bounds(np.array(state["search"]["lower"]), np.array(state["search"]["upper"]))
        except (KeyError, TypeError, ValueError):
            state = {}
    for frame in capture.frame_numbers:
        _frame_path(folder, frame).unlink(missing_ok=True)
    box = find_bounds(
        capture,
        agreement=settings.agreement,
        least_views=settings.least_views,
        margin=MARGIN if capture.frame_count <= MOST_SEARCHED else 3 * MARGIN,
        most_frames=MOST_SEARCHED,
        track=track,
    )
    _save(folder, key, settings, box, None)
    return box


def _carved_points(
    capture: MaskSource, frame: int, folder: Path, search: Bounds, settings: CarveSettings
) -> NDArray[np.float32]:
    """Points (N, 3) of one frame, from its PLY when that is whole, carved and written otherwise."""
    number = capture.frame_numbers[frame]
    path = _frame_path(folder, number)
    if path.exists():
        try:
            done = read_ply(path).xyz
            if len(done) == settings.points:
                return done
        except UserError:
            path.unlink(missing_ok=True)
    carved = carve_frame(
        frame_masks(capture, frame),
        capture.cameras,
        search,
        **asdict(settings),
        names=capture.names,
        label=f"{capture.path} frame {number}",
    )
    images = [capture.image(camera, frame) for camera in range(len(capture.cameras))]
    rgb = colour_points(carved.xyz, carved.normals, carved.spacing, images, capture.cameras)
    write_ply(path, carved.xyz, rgb)
    return carved.xyz


@dataclass(frozen=True)
class _Job:
    """Frames for one process."""

    capture: MaskSource
    folder: Path
    search: Bounds
    settings: CarveSettings
    frames: tuple[int, ...]


def _shared_out(job: _Job, workers: int) -> Iterator[Corners]:
    """Each frame's corners, of frames in any order; by other processes where they are worth their start."""
    numbers = job.capture.frame_numbers
    left = [frame for frame in job.frames if not _frame_path(job.folder, numbers[frame]).exists()]
    yield from _carved(replace(job, frames=tuple(sorted(set(job.frames) - set(left)))))
    begun = monotonic()
    yield from _carved(replace(job, frames=tuple(left[:1])))
    left = left[1:]
    if workers == 1 or (monotonic() - begun) * len(left) < WORTH_SPREADING_SECONDS:
        yield from _carved(replace(job, frames=tuple(left)))
    else:
        jobs = [replace(job, frames=tuple(block)) for block in blocks(left, workers)]
        yield from spread(_carved, jobs, workers)


def _carved(job: _Job) -> Iterator[Corners]:
    """Carve a job's frames; the least and the greatest coordinates of each when its file is there."""
    for frame in job.frames:
        xyz = _carved_points(job.capture, frame, job.folder, job.search, job.settings)
        yield xyz.min(axis=0), xyz.max(axis=0)


def _save(folder: Path, key: str, settings: CarveSettings, search: Bounds, bounds: Bounds | None) -> None:
    state: dict[str, Any] = {
        "version": VERSION,
        "key": key,
        "settings": asdict(settings),
        "search": {"lower": search.lower.tolist(), "upper": search.upper.tolist()},
    }
    if bounds is not None:
        state |= {"lower": bounds.lower.tolist(), "upper": bounds.upper.tolist()}
    write_text_atomically(folder / BOUNDS_NAME, json.dumps(state, indent=1) + "\n")


def _load(path: Path, *, missing_is_empty: bool = False) -> dict[str, Any]:
    try:
        state = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError as error:
        if missing_is_empty:
            return {}
        raise UserError(f"{path}: expected the bounds of a carving, got no such file; run fourd carve") from error
    except (UnicodeDecodeError, json.JSONDecodeError):
        return {}
    return state if isinstance(state, dict) else {}


def _frame_path(folder: Path, number: int) -> Path:
    return folder / f"{number:06d}.ply"
