"""Cameras of another calibration for `fourd render`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from fourd.base.errors import UserError

if TYPE_CHECKING:
    from rich.console import Console

    from fourd.base.cameras import Camera


def read_cameras(
    text: str, size: tuple[int, int] | None, known: dict[str, Camera], console: Console
) -> dict[str, Camera]:
    """Read the calibration that --cameras names, as pinhole cameras in the order of the file.

    Args:
        text: a folder with intri.yml and extri.yml, or the two files, separated by a comma.
        size: width and height that the user has chosen, or None.
        known: cameras of the scene. A camera without image size has the size of the camera of the same name.

    Raises:
        UserError: if a file is missing or invalid, or if the size of a camera is not known.
    """
    from dataclasses import replace

    from fourd.recording.capture.calibration import EXTRINSICS_NAME, INTRINSICS_NAME, require_calibration

    parts = [part.strip() for part in text.split(",") if part.strip()]
    if len(parts) == 1:
        folder = Path(parts[0])
        if not folder.is_dir():
            raise UserError(
                f"--cameras {text}: expected a folder with {INTRINSICS_NAME} and {EXTRINSICS_NAME}, or both files "
                f"separated by a comma, got {'one file' if folder.exists() else 'nothing there'}; name both"
            )
        report = require_calibration(folder)
    elif len(parts) == 2:
        report = require_calibration(Path(), (parts[0], parts[1]))
    else:
        raise UserError(f"--cameras {text}: expected a folder or two files, got {len(parts)} names")
    for note in report.notes:
        console.print(note, soft_wrap=True)
    cameras, distorted = {}, []
    for name, each in report.calibrations.items():
        like = known.get(name)
        width = each.width if like is None or each.width is not None else like.width
        height = each.height if like is None or each.height is not None else like.height
        if width is None or height is None:
            if size is None:
                raise UserError(
                    f"--cameras {text}: expected the keys W_{name} and H_{name} with the size of the images in pixels, "
                    "got none; add them, or add --size with the size of the images"
                )
            width, height = size
        camera = each.camera(width, height)
        if camera.distortion is not None:
            distorted.append(name)
        cameras[name] = replace(camera, distortion=None)
    if distorted:
        console.print(
            f"lens distortion of {len(distorted)} cameras: not rendered; the images match undistorted pictures",
            soft_wrap=True,
        )
    return cameras
