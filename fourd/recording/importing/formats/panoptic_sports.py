"""PanopticSports, the layout of Dynamic 3D Gaussians: train_meta.json and test_meta.json beside ims/ and seg/.

The lists ``k``, ``w2c``, ``fn`` and ``cam_id`` of a JSON file have one entry per frame, which contains one value per
camera: intrinsics in pixels, the 4 x 4 world-to-camera pose (OpenCV axes), the image's path in ims/, and the camera's
number. A mask has the same path in seg/ as its image in ims/. The cameras of test_meta.json are the recording's test
split.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from fourd.base.errors import UserError
from fourd.base.files import sort_names
from fourd.recording.capture.focus import camera_to_world_hint, is_reflection
from fourd.recording.capture.layout import find_pictures, frame_name
from fourd.recording.importing.folders import Array, make_camera, parse_numbers, read_file
from fourd.recording.importing.imported import Imported, ImportedCamera, PictureFiles

TRAIN_NAME, TEST_NAME = "train_meta.json", "test_meta.json"
PICTURES, MASKS = "ims", "seg"
LISTS = ("k", "w2c", "fn", "cam_id")
MAX_PIXELS = 1 << 20
MAX_POSE_CHANGE = 1e-4
"""A camera is static if no element of its pose changes by more than this fraction of the largest element."""
MAX_INTRINSICS_CHANGE_PX = 0.01

Frames = dict[int, PurePosixPath]


@dataclass(frozen=True, eq=False)
class _View:
    """One camera of a JSON file.

    Attributes:
        where: file and camera, for error messages.
        intrinsics: (3, 3) matrix in pixels.
        pose: (3, 4) world-to-camera pose.
        files: paths of the images in ims/, by the index of the frame.
    """

    where: str
    intrinsics: Array
    pose: Array
    files: Frames


def looks_like(source: Path) -> bool:
    """Return whether ``source`` is a folder with train_meta.json."""
    return os.path.isfile(source / TRAIN_NAME)


def read(source: Path) -> Imported:
    """Read the cameras of ``source``, which are named after their numbers with at least two digits.

    The cameras that only test_meta.json contains become the test split. This file may be missing.

    Raises:
        UserError: when a JSON file lacks a key or has invalid values, a camera moves or zooms, a pose is a reflection,
            or an image is missing or is outside the folder ims/.
    """
    views, size = _read_views(source / TRAIN_NAME)
    trained = set(views)
    if os.path.isfile(source / TEST_NAME):
        others, other_size = _read_views(source / TEST_NAME)
        if other_size != size:
            raise UserError(
                f"{source / TEST_NAME}: expected w and h of {size[0]} x {size[1]} as in {TRAIN_NAME}, got "
                f"{other_size[0]} x {other_size[1]}; correct the values"
            )
        for name, view in others.items():
            if name in views:
                _require_static(view.where, views[name], view.intrinsics, view.pose, f"as in {TRAIN_NAME}")
        # The frames of cameras that are in both files are merged.
        views |= {name: _merged(views.get(name), view) for name, view in others.items()}
    _refuse_reflections(views)
    names = _frame_names(source, views)
    cameras = tuple(_import_view(source, name, views[name], size, names) for name in sort_names(views))
    test = tuple(camera.name for camera in cameras if camera.name not in trained)
    notes = ["lengths, axes and pixel coordinates are kept; the unit of length is unknown"]
    if test:
        notes.append(f"test split of {TEST_NAME}, which training holds out: {', '.join(test)}")
    unmasked = [camera.name for camera in cameras if camera.masks is None]
    if 0 < len(unmasked) < len(cameras):
        notes.append(f"some cameras have no mattes: {', '.join(unmasked)}")
    return Imported(cameras, tuple(notes), test_views=test)


def _read_views(path: Path) -> tuple[dict[str, _View], tuple[int, int]]:
    """Return the cameras of a JSON file by name, and the width and height of the images."""
    try:
        data = json.loads(read_file(path))
    except (ValueError, RecursionError) as error:
        raise UserError(f"{path}: expected JSON, got '{error}'; copy it again") from error
    missing = [key for key in ("w", "h", *LISTS) if not isinstance(data, dict) or key not in data]
    if missing:
        raise UserError(f"{path}: expected the keys w, h, {', '.join(LISTS)}, got no {missing[0]}; copy it again")
    width, height = (float(parse_numbers(f"{path}: {key}", data[key], ())) for key in ("w", "h"))
    if not (1 <= width <= MAX_PIXELS and 1 <= height <= MAX_PIXELS):
        raise UserError(f"{path}: expected w and h in pixels, got {width:g} x {height:g}; correct the values")
    views: dict[str, _View] = {}
    for frame, rows in enumerate(_frames(path, data)):
        seen = set()
        for intrinsics, pose, file, number in rows:
            name = _camera_name(path, frame, number)
            where = f"{path}: camera '{name}'"
            if name in seen:
                raise UserError(f"{where}: frame {frame}: expected the camera once, got it twice; remove one entry")
            seen.add(name)
            K, T_camera_world = _matrices(f"{where}: frame {frame}", intrinsics, pose)
            if name not in views:
                views[name] = _View(where, K, T_camera_world, {})
            else:
                _require_static(f"{where}: frame {frame}", views[name], K, T_camera_world, "as in its first frame")
            views[name].files[frame] = _relative_path(f"{where}: frame {frame}: fn", file)
    return views, (round(width), round(height))


def _frames(path: Path, data: Mapping[str, Any]) -> list[list[tuple[Any, ...]]]:
    """Return, for each frame and camera, the values of the four lists."""
    counts = {key: len(data[key]) if isinstance(data[key], list) else 0 for key in LISTS}
    if len(set(counts.values())) != 1 or not counts["fn"]:
        got = ", ".join(f"{count} of {key}" for key, count in counts.items())
        raise UserError(f"{path}: expected lists with the same number of frames, got {got}; copy it again")
    frames = []
    for frame, lists in enumerate(zip(*(data[key] for key in LISTS), strict=True)):
        lengths = [len(values) if isinstance(values, list) else 0 for values in lists]
        if len(set(lengths)) != 1 or not lengths[0]:
            got = ", ".join(f"{count} of {key}" for key, count in zip(LISTS, lengths, strict=True))
            raise UserError(
                f"{path}: frame {frame}: expected the same number of values for each key, got {got}; copy it again"
            )
        frames.append(list(zip(*lists, strict=True)))
    return frames


def _camera_name(path: Path, frame: int, number: object) -> str:
    if isinstance(number, str) and number:
        return f"{int(number):02d}" if number.isascii() and number.isdecimal() and len(number) < 9 else number
    if isinstance(number, bool) or not isinstance(number, int) or not 0 <= number < 10**9:
        got = str(number)[:40]
        raise UserError(f"{path}: frame {frame}: cam_id: expected camera numbers from 0, got {got!a}; correct it")
    return f"{number:02d}"


def _matrices(where: str, intrinsics: object, pose: object) -> tuple[Array, Array]:
    """Return the intrinsics (3, 3) and the world-to-camera pose (3, 4)."""
    K = parse_numbers(f"{where}: k", intrinsics, (3, 3))
    rows = 3 if isinstance(pose, list) and len(pose) == 3 else 4
    T_camera_world = parse_numbers(f"{where}: w2c", pose, (rows, 4))
    if rows == 4 and not np.allclose(T_camera_world[3], (0, 0, 0, 1)):
        raise UserError(
            f"{where}: w2c: expected a last row of 0 0 0 1, got {T_camera_world[3].tolist()}; correct the pose"
        )
    return K, T_camera_world[:3]


def _require_static(where: str, view: _View, intrinsics: Array, pose: Array, wanted: str) -> None:
    """Raise UserError if a camera's intrinsics or pose differ from those of ``view``."""
    for key, first, other, limit in (
        ("k", view.intrinsics, intrinsics, MAX_INTRINSICS_CHANGE_PX),
        ("w2c", view.pose, pose, MAX_POSE_CHANGE * max(1.0, float(np.abs(view.pose).max()))),
    ):
        change = float(np.abs(first - other).max())
        if not change <= limit:
            raise UserError(
                f"{where}: expected a static camera with the same {key} {wanted}, got a value that differs by "
                f"{change:.3g}; leave out this camera, because moving cameras cannot be imported"
            )


def _merged(first: _View | None, second: _View) -> _View:
    return second if first is None else _View(first.where, first.intrinsics, first.pose, second.files | first.files)


def _refuse_reflections(views: Mapping[str, _View]) -> None:
    """Raise UserError if a pose is a reflection. The message also says if the poses look like camera-to-world."""
    names = [name for name, view in views.items() if is_reflection(view.pose[:, :3])]
    if not names:
        return
    poses = np.stack([view.pose for view in views.values()])
    hint = camera_to_world_hint(poses[:, :, :3], poses[:, :, 3])
    also = "" if hint is None else f", and {hint.reason}"
    fix = "flip one axis of the world" if hint is None else "flip one axis of the world and invert the matrices"
    raise UserError(
        f"{views[names[0]].where}: w2c: expected a rotation of determinant +1, got a reflection (determinant -1, "
        f"{len(names)} of {len(views)} cameras){also}; {fix}"
    )


def _relative_path(where: str, value: object) -> PurePosixPath:
    if not isinstance(value, str) or not value or "\0" in value:
        raise UserError(f"{where}: expected an image's path in {PICTURES}/, got {str(value)[:40]!a}; correct it")
    relative = PurePosixPath(value.replace("\\", "/"))
    if relative.is_absolute() or ".." in relative.parts or not relative.parts or ":" in relative.parts[0]:
        raise UserError(f"{where}: expected a path within {PICTURES}/, got {value!a}; write a relative path")
    return relative


def _frame_names(source: Path, views: Mapping[str, _View]) -> dict[int, str]:
    """Return the names of the frames by index: the names of the image files, or the indices if these names differ
    between cameras or repeat."""
    stems: dict[int, set[str]] = {}
    for view in views.values():
        for frame, file in view.files.items():
            stems.setdefault(frame, set()).add(file.stem)
    if all(len(names) == 1 for names in stems.values()) and len(set.union(*stems.values())) == len(stems):
        return {frame: next(iter(names)) for frame, names in stems.items()}
    counts = sorted({len(view.files) for view in views.values()})
    if len(counts) > 1:
        raise UserError(
            f"{source}: expected images of a frame with the same file name in all cameras, or the same number of "
            f"frames of all cameras, got {counts[0]} to {counts[-1]} frames; rename the images"
        )
    return {frame: frame_name(frame) for frame in stems}


def _import_view(
    source: Path, name: str, view: _View, size: tuple[int, int], frame_names: Mapping[int, str]
) -> ImportedCamera:
    camera = make_camera(view.where, view.intrinsics, view.pose[:, :3], view.pose[:, 3], size)
    frames = sorted(view.files)
    listed: dict[PurePosixPath, dict[str, str]] = {}
    files = [_find(source / PICTURES, view.files[frame], listed) for frame in frames]
    lost = [view.files[frame] for frame, file in zip(frames, files, strict=True) if file is None]
    if lost:
        more = f" ({len(lost) - 1} more images of this camera are missing)" if len(lost) > 1 else ""
        raise UserError(
            f"{source / PICTURES / lost[0]}: expected an image of camera '{name}', got no such file{more}; restore it"
        )
    names = tuple(frame_names[frame] for frame in frames)
    pictures = PictureFiles(tuple(file for file in files if file is not None), names)
    return ImportedCamera(name, camera, pictures, _find_masks(source, [view.files[frame] for frame in frames], names))


def _find_masks(source: Path, files: Sequence[PurePosixPath], names: tuple[str, ...]) -> PictureFiles | None:
    """Return the masks of a camera's images, or None if there are none. Raises UserError if only some are missing."""
    listed: dict[PurePosixPath, dict[str, str]] = {}
    masks = [_find(source / MASKS, file, listed) for file in files]
    found = tuple(mask for mask in masks if mask is not None)
    if not found:
        return None
    if len(found) < len(masks):
        lost = files[masks.index(None)]
        raise UserError(
            f"{source / MASKS / lost.with_suffix('.png')}: expected a mask for each image of the camera, got no such "
            f"file ({len(masks) - len(found)} of {len(masks)} are missing); restore it, or move all masks of this "
            "camera away"
        )
    return PictureFiles(found, names)


def _find(folder: Path, relative: PurePosixPath, listed: dict[PurePosixPath, dict[str, str]]) -> Path | None:
    """Find the image with this path and any suffix of images. ``listed`` caches the files of the folders."""
    parent = relative.parent
    if parent not in listed:
        listed[parent] = find_pictures(folder / parent)
    name = listed[parent].get(relative.stem)
    return None if name is None else folder / parent / name
