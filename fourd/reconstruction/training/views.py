"""Training images: views of all frames, cropped to their mattes, in a cache of bounded size."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
import torch
from cachetools import LRUCache
from numpy.typing import NDArray
from torch import Tensor

from fourd.base.cameras import Camera
from fourd.reconstruction.model.sources import SourceViews
from fourd.reconstruction.training.cameras.rig import Rig
from fourd.reconstruction.training.memory import array_outside_heap
from fourd.recording.capture import Capture
from fourd.rendering.ops.gpu import CPU
from fourd.rendering.ops.step_images.op import convert_views, premultiply

CROP_MARGIN_PX = 16
SIZE_STEP_PX = 32
"""The width and the height of crops are rounded up to a multiple of this number of pixels, so that crops have few
different sizes. Convolutions are therefore set up only a few times, and a new crop fits into memory that an older crop
has freed.
"""
EMPTY_CROP_PX = 16
"""Side of the crop for an empty matte, in pixels."""


@dataclass(frozen=True)
class View:
    """One camera's image of one frame, or a crop of it.

    Attributes:
        rgb: (H, W, 3) uint8 colours.
        matte: (H, W) uint8, 255 on the object.
        camera: the camera of the crop.
        left: first column of the crop in the whole image.
        top: first row of the crop in the whole image.
    """

    rgb: NDArray[np.uint8]
    matte: NDArray[np.uint8]
    camera: Camera
    left: int
    top: int

    @property
    def nbytes(self) -> int:
        return self.rgb.nbytes + self.matte.nbytes

    def premultiplied(self, device: torch.device = CPU) -> tuple[Tensor, Tensor]:
        """Return RGB (H, W, 3) multiplied by the matte, and the matte (H, W), as float32 tensors in [0, 1]."""
        return premultiply(self.rgb, self.matte, device)


class ViewStore:
    """Views of a capture. Views are decoded on demand and kept in a cache of at most ``memory_mb`` MiB.

    Attributes:
        capture: the selected views and frames.
        rig: the current cameras. To change the cameras of all views, assign another rig.
        device: device on which the scene is trained and on which :meth:`sources` returns its tensors. Cached images
            stay in CPU memory.
    """

    def __init__(self, capture: Capture, crop: bool, memory_mb: int, device: torch.device = CPU) -> None:
        """Open the store. If ``crop`` is true, views are crops around the matte; otherwise they are whole images."""
        self.capture = capture
        self.rig = Rig(capture.cameras)
        self.device = device
        self._crop = crop
        max_bytes = memory_mb * 2**20
        # cachetools raises an error for a value that is larger than the whole cache.
        self._cache: LRUCache[tuple[int, int], View] = LRUCache(
            max_bytes, getsizeof=lambda view: min(view.nbytes, max_bytes)
        )

    def view(self, camera: int, frame: int) -> View:
        """Return a camera's view of a frame. ``camera`` and ``frame`` are indices into the selected cameras and
        frames."""
        key = (camera, frame)
        if key not in self._cache:
            self._cache[key] = self._decode(camera, frame, None)
        return self._with_current_camera(self._cache[key], camera)

    def widened(self, camera: int, frame: int, margin_px: int) -> View:
        """Return a camera's view of a frame, extended by a margin on each side.

        The margin is ``margin_px``, rounded down to a multiple of SIZE_STEP_PX / 2. The extended view is clipped to the
        image and is not cached.
        """
        view, whole = self.view(camera, frame), self.capture.cameras[camera]
        margin_px -= margin_px % (SIZE_STEP_PX // 2)
        height, width = view.matte.shape
        left, top = max(0, view.left - margin_px), max(0, view.top - margin_px)
        right = min(whole.width, view.left + width + margin_px)
        bottom = min(whole.height, view.top + height + margin_px)
        window = (left, top, right - left, bottom - top)
        return self._with_current_camera(self._decode(camera, frame, window), camera)

    def sources(self, cameras: list[int], frame: int) -> SourceViews:
        """Return the views of several cameras, padded to a common size that is a multiple of SIZE_STEP_PX."""
        views = [self.view(camera, frame) for camera in cameras]
        height = _round_up(max(view.rgb.shape[0] for view in views))
        width = _round_up(max(view.rgb.shape[1] for view in views))
        images, mattes = convert_views([(view.rgb, view.matte) for view in views], (height, width), self.device)
        if self.rig.colours is not None:
            for i, view in enumerate(views):
                rows, columns = view.matte.shape
                part = images[i, :, :rows, :columns]
                part.copy_(self.rig.scene_colours(cameras[i], part))
        return SourceViews(images, mattes, None, tuple(view.camera.crop(0, 0, width, height) for view in views))

    def _with_current_camera(self, view: View, camera: int) -> View:
        whole = self.rig.cameras[camera]
        if whole is self.capture.cameras[camera]:
            return view
        height, width = view.matte.shape
        return replace(view, camera=whole.crop(view.left, view.top, width, height))

    def _decode(self, camera: int, frame: int, window: tuple[int, int, int, int] | None) -> View:
        """Decode the part ``window`` (left, top, width, height) of an image. If ``window`` is None, decode the crop
        around the matte, or the whole image if the store does not crop."""
        rgb, matte = self.capture.image(camera, frame), self.capture.mask(camera, frame)
        whole = self.capture.cameras[camera]
        if window is None:
            window = _matte_window(matte) if self._crop else (0, 0, whole.width, whole.height)
        left, top, width, height = window
        rows, columns = slice(top, top + height), slice(left, left + width)
        part = whole.crop(left, top, width, height)
        return View(array_outside_heap(rgb[rows, columns]), array_outside_heap(matte[rows, columns]), part, left, top)


def _matte_window(matte: NDArray[np.uint8]) -> tuple[int, int, int, int]:
    """Return (left, top, width, height) of the matte's bounding box with a margin. For an empty matte, the window is a
    square with sides of EMPTY_CROP_PX at the top left of the image."""
    height, width = matte.shape
    left, top, box_width, box_height = cv2.boundingRect(matte)
    if box_width == 0:
        return 0, 0, min(EMPTY_CROP_PX, width), min(EMPTY_CROP_PX, height)
    left, width = _widen(left, box_width, width)
    top, height = _widen(top, box_height, height)
    return left, top, width, height


def _widen(start: int, length: int, size: int) -> tuple[int, int]:
    """Extend a pixel range by the crop margin on both sides, and return its start and length. The length is rounded up
    to a multiple of SIZE_STEP_PX, but is at most ``size``."""
    wanted = min(size, _round_up(length + 2 * CROP_MARGIN_PX))
    return max(0, min(size - wanted, start - (wanted - length) // 2)), wanted


def _round_up(size: int) -> int:
    return -(-size // SIZE_STEP_PX) * SIZE_STEP_PX
