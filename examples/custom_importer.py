"""Import a capture from a format that fourd does not support.

    python examples/custom_importer.py SOURCE CAPTURE

SOURCE is a folder with `rig.json` and one folder of images per camera. `rig.json` is a list of cameras with the axes of
OpenGL and Blender (x right, y up, z backwards):

    [{"name": "left", "width": 640, "height": 480, "focal_px": 500.0,
      "R_world_camera": [[1, 0, 0], [0, 1, 0], [0, 0, 1]], "position_m": [0.0, 0.0, 3.0]}]

An importer is a function that reads a source and returns an `Imported`: the cameras in fourd's conventions (OpenCV
axes, pixel centres at half-integers, metres) and the image files of their frames. The importer does not decode images.
`import_source` checks names and sizes, links the files and writes `intri.yml` and `extri.yml`. To add an importer to
`fourd import` itself, see CONTRIBUTING.md.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tyro

from fourd.base.cameras import Camera
from fourd.base.errors import UserError, command_line
from fourd.base.progress import untracked
from fourd.recording.importing.detection import Format
from fourd.recording.importing.folders import picture_files
from fourd.recording.importing.imported import Imported, ImportedCamera
from fourd.recording.importing.importer import ImportOptions, import_source

RIG_NAME = "rig.json"
OPENCV_FROM_OPENGL = np.diag([1.0, -1.0, -1.0])
"""Rotation from OpenGL camera axes (x right, y up, z backwards) to OpenCV camera axes (x right, y down, z forward)."""


@dataclass(frozen=True)
class Arguments:
    """Source and destination."""

    source: tyro.conf.Positional[Path]
    """Folder with rig.json and one folder of images per camera."""
    out: tyro.conf.Positional[Path]
    """Folder of the capture: a new folder, or the result of an earlier import of the same source."""


def looks_like(source: Path) -> bool:
    """Return True if ``source`` has this format. Only file names are checked."""
    return (source / RIG_NAME).is_file()


def read(source: Path) -> Imported:
    """Read the cameras of ``source``.

    Raises:
        UserError: if rig.json is malformed or a camera has no images.
    """
    path = source / RIG_NAME
    try:
        entries = json.loads(path.read_text(encoding="utf-8"))
        cameras = tuple(read_camera(source, entry) for entry in entries)
    except (OSError, KeyError, TypeError, ValueError) as error:
        raise UserError(f"{path}: expected a list of cameras, got {error!r}; export the rig again") from error
    return Imported(cameras, notes=("camera axes converted from OpenGL's (y up) to OpenCV's (y down)",))


def read_camera(source: Path, entry: dict) -> ImportedCamera:
    """Convert one entry of rig.json to a camera with its image files."""
    name, width, height, focal = entry["name"], entry["width"], entry["height"], entry["focal_px"]
    R_world_camera = np.array(entry["R_world_camera"], dtype=np.float64)
    R_camera_world = OPENCV_FROM_OPENGL @ R_world_camera.T
    T_camera_world = -R_camera_world @ np.array(entry["position_m"], dtype=np.float64)
    intrinsics = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]])
    frames = picture_files(source / name)
    if frames is None:
        raise UserError(f"{source / name}: expected a folder of JPEG or PNG images, got none; restore the folder")
    return ImportedCamera(name, Camera(intrinsics, R_camera_world, T_camera_world, width, height), frames)


RIG = Format("rig", "rig.json and one folder of images per camera", looks_like, read)


def main(arguments: Arguments) -> None:
    """Import the source folder as a capture and print a summary."""
    import_source(RIG, arguments.source, arguments.out, ImportOptions(), log=print, warn=print, track=untracked)
    print(f"wrote {arguments.out}; next: {command_line('fourd', 'check', arguments.out)}")


if __name__ == "__main__":
    main(tyro.cli(Arguments, description=__doc__))
