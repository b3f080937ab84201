"""Training pictures: each view of each frame cropped to its matte, in a bounded cache."""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass, replace

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from fourd.cameras import Camera
from fourd.capture import Capture
from fourd.model.sources import SourceViews
from fourd.training.cameras.rig import Rig
from fourd.training.memory import in_own_pages

CROP_MARGIN_PX = 16
STEP_PX = 32
"""Sides of crops are multiples of this: with few sizes, convolutions are set up once, and memory fits again."""


@dataclass(frozen=True)
class View:
    """One camera's picture of one frame, or the part of it around the object.

    Attributes:
        rgb: (H, W, 3) uint8.
        matte: (H, W) uint8, 255 on the object.
        camera: the camera of this part.
        left, top: where the part begins in the whole picture, in pixels.
    """

    rgb: NDArray[np.uint8]
    matte: NDArray[np.uint8]
    camera: Camera
    left: int
    top: int

    def target(self) -> tuple[Tensor, Tensor]:
        """RGB (H, W, 3) times matte, and matte (H, W), both float32 in [0, 1]."""
        matte = torch.from_numpy(self.matte).float() / 255
        return torch.from_numpy(self.rgb).float() / 255 * matte[..., None], matte


class ViewStore:
    """Views of a capture, decoded when asked for; at most ``memory_mb`` of them are kept.

    ``rig`` says how the cameras stand; it may be set to another one.
    """

    def __init__(self, capture: Capture, crop: bool, memory_mb: int) -> None:
        self.capture = capture
        self.rig = Rig(capture.cameras)
        self.crop = crop
        self._budget = memory_mb * 2**20
        self._used = 0
        self._kept: OrderedDict[tuple[int, int], View] = OrderedDict()

    def view(self, camera: int, frame: int) -> View:
        """The view of camera and frame (indices into the capture's selection)."""
        key = (camera, frame)
        if key in self._kept:
            self._kept.move_to_end(key)
            return self._aimed(self._kept[key], camera)
        view = self._decoded(camera, frame, None)
        self._kept[key] = view
        self._used += view.rgb.nbytes + view.matte.nbytes
        while self._used > self._budget and len(self._kept) > 1:
            _, dropped = self._kept.popitem(last=False)
            self._used -= dropped.rgb.nbytes + dropped.matte.nbytes
        return self._aimed(view, camera)

    def around(self, camera: int, frame: int, margin: int) -> View:
        """A view with up to ``margin`` pixels more on each side, in steps; decoded anew."""
        view, whole = self.view(camera, frame), self.capture.cameras[camera]
        margin -= margin % (STEP_PX // 2)
        height, width = view.matte.shape
        left, top = max(0, view.left - margin), max(0, view.top - margin)
        right, bottom = min(whole.width, view.left + width + margin), min(whole.height, view.top + height + margin)
        return self._aimed(self._decoded(camera, frame, (left, top, right - left, bottom - top)), camera)

    def sources(self, cameras: list[int], frame: int) -> SourceViews:
        """The views of several cameras, padded to a common size that is a multiple of 8."""
        views = [self.view(camera, frame) for camera in cameras]
        height = _rounded_up(max(view.rgb.shape[0] for view in views))
        width = _rounded_up(max(view.rgb.shape[1] for view in views))
        images = torch.zeros(len(views), 3, height, width)
        mattes = torch.zeros(len(views), height, width)
        for i, view in enumerate(views):
            rows, columns = view.matte.shape
            picture = torch.from_numpy(view.rgb).permute(2, 0, 1) / 255
            images[i, :, :rows, :columns] = self.rig.scene_colours(cameras[i], picture)
            mattes[i, :rows, :columns] = torch.from_numpy(view.matte) / 255
        padded = tuple(view.camera.crop(0, 0, width, height) for view in views)
        return SourceViews(images, mattes, None, padded)

    def _aimed(self, view: View, camera: int) -> View:
        """The view with its camera as the rig has it."""
        whole = self.rig.cameras[camera]
        if whole is self.capture.cameras[camera]:
            return view
        height, width = view.matte.shape
        return replace(view, camera=whole.crop(view.left, view.top, width, height))

    def _decoded(self, camera: int, frame: int, window: tuple[int, int, int, int] | None) -> View:
        """The part (left, top, width, height) of a picture; by default that of the matte, or all of it."""
        rgb, matte = self.capture.image(camera, frame), self.capture.mask(camera, frame)
        whole = self.capture.cameras[camera]
        if window is None:
            window = _matte_window(matte) if self.crop else (0, 0, whole.width, whole.height)
        left, top, width, height = window
        rows, columns = slice(top, top + height), slice(left, left + width)
        part = whole.crop(left, top, width, height)
        return View(in_own_pages(rgb[rows, columns]), in_own_pages(matte[rows, columns]), part, left, top)


def _matte_window(matte: NDArray[np.uint8]) -> tuple[int, int, int, int]:
    """(left, top, width, height) of the matte's box with a margin; a small corner where it is empty."""
    height, width = matte.shape
    left, top, box_width, box_height = cv2.boundingRect(matte)
    if box_width == 0:
        return 0, 0, min(16, width), min(16, height)
    left, width = _window(left, box_width, width)
    top, height = _window(top, box_height, height)
    return left, top, width, height


def _window(start: int, length: int, size: int) -> tuple[int, int]:
    """Start and length of a range with a margin, of a length in STEP_PX where ``size`` allows it."""
    wanted = min(size, _rounded_up(length + 2 * CROP_MARGIN_PX))
    return max(0, min(size - wanted, start - (wanted - length) // 2)), wanted


def _rounded_up(size: int) -> int:
    return -(-size // STEP_PX) * STEP_PX
