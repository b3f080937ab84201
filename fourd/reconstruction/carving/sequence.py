"""Carving of a whole capture: writes one PLY file per frame and the scene bounds.

Frames are processed one at a time, and an interrupted run can be resumed.
"""

from __future__ import annotations

import glob
import hashlib
import json
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from fourd.base.errors import UserError
from fourd.base.files import remove_unfinished, write_text_atomically
from fourd.base.formats.ply import read_ply, write_ply
from fourd.base.limits import read_json
from fourd.base.parallel import run_jobs, split_into_blocks
from fourd.base.progress import Track, untracked
from fourd.reconstruction.carving.bounds import Bounds, find_bounds
from fourd.reconstruction.carving.carve import carve_frame
from fourd.reconstruction.carving.colour import colour_points
from fourd.recording.capture.layout import refuse_symlinks
from fourd.recording.capture.pictures.mask_source import MaskSource, frame_masks

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

Corners = tuple[NDArray[np.float32], NDArray[np.float32]]

BOUNDS_NAME = "bounds.json"
VERSION = 3
MARGIN = 0.05
MAX_BOUNDS_FRAMES = 120
MIN_PARALLEL_SECONDS = 10.0
"""Worker processes are used only if one process would need at least this estimated number of seconds for the remaining
frames, because worker processes take some seconds to start."""
INPUTS = ("masks/{camera}/*", ".fourd/mattes/{camera}/*", "images/{camera}/*", "videos/{camera}.*", "videos.json")
"""Patterns of the files that carving reads from a capture. A key, which is a hash of all inputs of carving, shows
whether carved points are still valid. The hash covers the sizes and modification times of these files."""


@dataclass(frozen=True)
class CarveSettings:
    """Settings of :func:`fourd.reconstruction.carving.carve_frame`. The names of the fields are also used as keys in
    bounds.json."""

    points: int = 65536
    agreement: float = 0.95
    least_views: float = 1 / 2
    trim: bool = True
    inset: float = 0.0
    seed: int = 0


def carve_capture(
    capture: MaskSource,
    out_folder: Path | str,
    *,
    points: int = 65536,
    agreement: float = 0.95,
    least_views: float = 1 / 2,
    trim: bool = True,
    inset: float = 0.0,
    seed: int = 0,
    track: Track = untracked,
    workers: int = 1,
) -> Bounds:
    """Carve every frame, and write ``FRAME.ply`` (xyz, rgb) for each frame and ``bounds.json`` to ``out_folder``.

    FRAME is the six-digit frame number in the capture. Files are written atomically, and each process keeps only one
    frame in memory. If the capture and the settings are the same as in the last call, frames with a complete PLY file
    are skipped. Otherwise, all frames are carved again.

    Args:
        capture: cameras, images and masks.
        out_folder: folder for the files; it is created if missing.
        points: number of points per frame, at least 1.
        agreement: a fraction in (0, 1]. A point belongs to the hull only if it is inside the silhouettes of at least
            this fraction of the views that see it.
        least_views: a fraction in (0, 1]. A point belongs to the hull only if it is seen by at least this fraction of
            all views and by at least 3 views. If there are only 2 views, both must see it.
        trim: whether to remove protruding parts of the hull. The remaining hull still covers all silhouettes.
        inset: distance by which points are moved into the hull, as a multiple of the mean distance between neighbouring
            points.
        seed: seed of the random order of the points.
        track: callback that reports progress.
        workers: number of worker processes, which are started only if they save time, as estimated from the duration of
            the first frame. The capture must be picklable. The points do not depend on the number of workers.

    Returns:
        the bounding box of the points of all frames, with a margin of 5% of the longest side.

    Raises:
        UserError: if a frame's hull is empty or a file cannot be written.
    """
    settings = CarveSettings(points, agreement, least_views, trim, inset, seed)
    folder = Path(out_folder)
    key = settings_key(capture, settings)
    refuse_symlinks(capture.path, folder)
    try:
        remove_unfinished(folder)
        search = _search_box(capture, folder, settings, key, track)
        lower, upper = np.full(3, np.inf), np.full(3, -np.inf)
        job = _Job(capture, folder, search, settings, tuple(range(capture.frame_count)))
        for low, high in track(_carve_parallel(job, workers), capture.frame_count, "carving"):
            lower, upper = np.minimum(lower, low), np.maximum(upper, high)
        pad = MARGIN * float((upper - lower).max())
        bounds = Bounds(lower - pad, upper + pad)
        _save(folder, key, settings, search, bounds)
    except OSError as error:
        raise UserError(
            f"{folder}: expected a writable folder, got '{error.strerror}'; free disk space or choose another folder"
        ) from error
    return bounds


def read_bounds(folder: Path | str) -> Bounds:
    """Read the bounds that :func:`carve_capture` wrote to ``folder``.

    Raises:
        UserError: if bounds.json is missing or unreadable, or if carving did not finish.
    """
    path = Path(folder) / BOUNDS_NAME
    state = _load(path)
    try:
        return Bounds(np.array(state["lower"]), np.array(state["upper"]))
    except (KeyError, TypeError, ValueError) as error:
        raise UserError(
            f"{path}: expected the bounds of a finished carving, got none; run fourd carve again"
        ) from error


def settings_key(capture: MaskSource, settings: DataclassInstance) -> str:
    """Hash the inputs of carving: settings, cameras, frame numbers, and the name, size and modification time of each
    file that matches one of the patterns INPUTS."""
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
    """Return the search box in which the hull of each frame is carved.

    ``key`` is the hash of all inputs, see :func:`settings_key`. If bounds.json contains the same key, the search box is
    read from it. If the key differs or the file is missing, the search box is computed and written to bounds.json. If
    the capture has more than MAX_BOUNDS_FRAMES frames, only some frames are examined, and the margin of the box is
    three times as wide.
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
        margin=MARGIN if capture.frame_count <= MAX_BOUNDS_FRAMES else 3 * MARGIN,
        max_frames=MAX_BOUNDS_FRAMES,
        track=track,
    )
    _save(folder, key, settings, box, None)
    return box


def _load_or_carve(
    capture: MaskSource, frame: int, folder: Path, search: Bounds, settings: CarveSettings
) -> NDArray[np.float32]:
    """Read the points (N, 3) of one frame from its PLY file, or carve the frame if the file is not complete."""
    number = capture.frame_numbers[frame]
    path = _frame_path(folder, number)
    if path.exists():
        try:
            existing = read_ply(path).xyz
            if len(existing) == settings.points:
                return existing
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
    """Job of one process: the frames that it carves, and all inputs of the carving."""

    capture: MaskSource
    folder: Path
    search: Bounds
    settings: CarveSettings
    frames: tuple[int, ...]


def _carve_parallel(job: _Job, workers: int) -> Iterator[Corners]:
    """Carve the frames of a job. Worker processes are used if they save time.

    The function yields the same values as :func:`_carve_frames`, but in any order of the frames.
    """
    numbers = job.capture.frame_numbers
    missing = [frame for frame in job.frames if not _frame_path(job.folder, numbers[frame]).exists()]
    yield from _carve_frames(replace(job, frames=tuple(sorted(set(job.frames) - set(missing)))))
    start = monotonic()
    yield from _carve_frames(replace(job, frames=tuple(missing[:1])))
    missing = missing[1:]
    if workers == 1 or (monotonic() - start) * len(missing) < MIN_PARALLEL_SECONDS:
        yield from _carve_frames(replace(job, frames=tuple(missing)))
    else:
        jobs = [replace(job, frames=tuple(block)) for block in split_into_blocks(missing, workers)]
        yield from run_jobs(_carve_frames, jobs, workers)


def _carve_frames(job: _Job) -> Iterator[Corners]:
    """Carve the frames of a job. After each frame, yield the smallest and the largest coordinate of its points along
    each axis."""
    for frame in job.frames:
        xyz = _load_or_carve(job.capture, frame, job.folder, job.search, job.settings)
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
        state = read_json(path)
    except FileNotFoundError as error:
        if missing_is_empty:
            return {}
        raise UserError(f"{path}: expected the bounds of carved points, got no such file; run fourd carve") from error
    except ValueError:
        return {}
    return state if isinstance(state, dict) else {}


def _frame_path(folder: Path, number: int) -> Path:
    return folder / f"{number:06d}.ply"
