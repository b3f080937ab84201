"""Masks from other programs, used as mattes. The files are FOLDER/CAM/FRAME.png, aligned with the recorded images."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from fourd.base.errors import UserError
from fourd.recording.capture import Capture
from fourd.recording.capture.pictures.listing import list_masks
from fourd.recording.capture.pictures.masks import MaskFolder
from fourd.recording.capture.reader import undistortion_maps

Picture = NDArray[np.uint8]


def find_masks(folder: Path, capture: Capture, frames: list[int]) -> dict[tuple[int, int], Path]:
    """Return the paths of all cameras' masks for ``frames``, keyed by camera index and frame index.

    Raises:
        UserError: if the folder or a mask is missing. The message names the first missing file.
    """
    if not folder.is_dir():
        got = "a file" if folder.exists() else "no such folder"
        raise UserError(f"--masks {folder}: expected a folder with CAM/FRAME.png, got {got}; check the path")
    paths: dict[tuple[int, int], Path] = {}
    for camera, name in enumerate(capture.names):
        found = list_masks(folder / name, capture.frame_names)
        missing = [frame for frame in frames if capture.frame_names[frame] not in found]
        if missing:
            more = f" ({len(missing) - 1} more masks of this camera are missing)" if len(missing) > 1 else ""
            raise UserError(
                f"{folder / name / capture.frame_names[missing[0]]}.png: expected a mask for each image of camera "
                f"'{name}', got no such file{more}; add the masks, or select other frames with --frames"
            )
        paths |= {(camera, frame): folder / name / found[capture.frame_names[frame]] for frame in frames}
    return paths


def read_mask(path: Path, masks: MaskFolder, capture: Capture, camera: int) -> Picture:
    """Read a mask and undistort it. Returns (H, W) uint8 at the size of the undistorted images, 255 = subject.

    Raises:
        UserError: if the file is damaged, the meaning of its values cannot be decided, or the mask does not have the
            size of the camera's images.
    """
    mask = masks.decode(path)
    stored = capture.distorted_cameras[camera]
    require_size(mask, path, stored.width, stored.height, capture.names[camera])
    if stored.distortion is not None:
        maps = undistortion_maps(stored)
        mask = np.asarray(cv2.remap(mask, maps[0], maps[1], cv2.INTER_LINEAR), np.uint8)
    return mask


def require_size(mask: Picture, path: Path, width: int, height: int, name: str) -> None:
    """Raise UserError unless a mask (H, W[, C]) has the size of the images of camera ``name``."""
    if mask.shape[:2] != (height, width):
        raise UserError(
            f"{path}: expected {width} x {height} pixels like camera '{name}', got {mask.shape[1]} x {mask.shape[0]}; "
            "export the mask again at the expected size"
        )
