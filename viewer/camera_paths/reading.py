"""The reader of all kinds of camera path files, and their writer."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from fourd.base.errors import UserError
from fourd.base.files import write_text_atomically
from fourd.base.limits import read_json
from fourd.viewer.camera_paths.keys import KeyedPath, keys_from_json
from fourd.viewer.camera_paths.nerfstudio import from_nerfstudio, is_nerfstudio, to_nerfstudio
from fourd.viewer.camera_paths.path import CameraPath
from fourd.viewer.camera_paths.scene import PathScene
from fourd.viewer.camera_paths.transforms import from_transforms, is_transforms, to_transforms
from fourd.viewer.camera_paths.world import SAME_WORLD, World
from fourd.viewer.navigation.recorded_path import MAX_PATH_BYTES, RecordedPath, recording_from_json

OWN_SUFFIX = ".path.json"
"""End of the names of fourd's own path files."""
_KINDS = "a path of fourd's window or page, a camera path of nerfstudio, or a transforms.json"


def read_path(path: Path, scene: PathScene, world: World = SAME_WORLD) -> CameraPath:
    """Read a path file of any kind.

    Args:
        path: the file.
        scene: the scene, from whose frames the frames of the images are chosen.
        world: relation of the world of nerfstudio's files to that of the capture. fourd's own files are always in the
            world of the capture.

    Raises:
        UserError: if the file cannot be read or is not a path. The message names the file.
    """
    content = _load(path)
    try:
        if is_nerfstudio(content):
            return from_nerfstudio(content, scene, world)
        if is_transforms(content):
            return from_transforms(path, content, scene, world)
        own = own_path_from_json(content)
    except ValueError as error:
        kind = "nerfstudio's viewer" if is_nerfstudio(content) else "the viewer"
        raise UserError(f"{path}: expected a camera path recorded by {kind}, got another file ({error})") from error
    if isinstance(own, KeyedPath):
        return own.path()
    return CameraPath(own.samples, own.fps)


def read_own_path(path: Path) -> KeyedPath | RecordedPath:
    """Read one of fourd's own files, with its key frames or its samples. Raises UserError."""
    content = _load(path)
    try:
        return own_path_from_json(content)
    except ValueError as error:
        raise UserError(f"{path}: expected a camera path recorded by the viewer, got another file ({error})") from error


def own_path_from_json(content: Any) -> KeyedPath | RecordedPath:
    """Convert the parsed JSON of one of fourd's own files. Raises ValueError for other content."""
    if not isinstance(content, dict) or content.get("format") != "fourd-path":
        raise ValueError(f"expected {_KINDS}")
    return keys_from_json(content) if content.get("version") == 2 else recording_from_json(content)


def write_path(
    target: Path, path: CameraPath, size: tuple[int, int], scene: PathScene, world: World = SAME_WORLD
) -> None:
    """Write a path to a file atomically. Its name determines its kind: transforms*.json has the poses as nerfstudio's
    data sets have them, names that end in .path.json are files of fourd, and other .json files are camera paths of
    nerfstudio.

    Args:
        size: width and height of the images in pixels, which nerfstudio's files contain.
        scene, world: see :func:`read_path`.
    """
    if target.name.endswith(OWN_SUFFIX):
        RecordedPath(path.samples, path.fps).save(target)
        return
    convert = to_transforms if target.name.startswith("transforms") else to_nerfstudio
    write_text_atomically(target, json.dumps(convert(path, size, scene, world)))


def _load(path: Path) -> Any:
    try:
        return read_json(path, MAX_PATH_BYTES)
    except OSError as error:
        reason = (error.strerror or "").lower()
        raise UserError(f"{path}: expected a camera path, got '{reason}'; check the file") from error
    except ValueError as error:
        raise UserError(f"{path}: expected a camera path recorded by the viewer, got another file ({error})") from error
