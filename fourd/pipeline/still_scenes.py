"""Detection of captures in which nothing moves, and the training config for such captures."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from fourd.base.errors import UserError
from fourd.base.progress import Log
from fourd.pipeline.facts import has_masks
from fourd.reconstruction.training.config import TrainConfig
from fourd.recording.capture import Capture, open_capture
from fourd.recording.capture.layout import MATTES, sample_indices

SAMPLED_FRAMES = 5
WIDTH_PX = 320
MIN_DIFFERENCE = 24.0
"""A pixel counts as changed if one of its channels, from 0 to 255, changes by more than this value. The images are
blurred before the comparison, so that changes by sensor noise stay below it."""
MAX_CHANGED = 1e-4
"""Maximum fraction of changed pixels in an image of a capture in which nothing moves."""


def stands_still(capture: Path, train: TrainConfig) -> bool:
    """Return True if a capture has neither masks nor mattes and shows no motion. A capture with only one selected frame
    shows no motion.

    Raises:
        UserError: if the capture cannot be opened, or if nothing moves and ``train.scene`` is ``object``, which needs
            mattes.
    """
    if has_masks(capture) or (capture / MATTES).is_dir():
        return False
    views = None if train.views is None else list(train.views)
    with open_capture(capture, views=views, frames=train.frames) as opened:
        count, widest = opened.frame_count, max(camera.width for camera in opened.cameras)
    if count > 1:
        with open_capture(capture, views=views, frames=train.frames, scale=min(1.0, WIDTH_PX / widest)) as opened:
            if _has_motion(opened):
                return False
    if train.scene != "full":
        what = "only one frame" if count == 1 else "images without motion"
        raise UserError(
            f"{capture}: expected a moving subject or a folder masks/, got {what} and no masks; add --scene full to "
            "reconstruct everything in the images as a static scene, or provide masks/CAM/FRAME.png"
        )
    return True


def _has_motion(capture: Capture) -> bool:
    """Return whether the images of any camera change between a few sampled frames."""
    frames = sample_indices(capture.frame_count, SAMPLED_FRAMES)
    for index in range(len(capture.names)):
        greys = [cv2.GaussianBlur(capture.image(index, frame).astype(np.float32), (0, 0), 1.0) for frame in frames]
        if any((np.abs(grey - greys[0]).max(axis=2) > MIN_DIFFERENCE).mean() > MAX_CHANGED for grey in greys):
            return True
    return False


def still_config(train: TrainConfig, capture: Path, log: Log) -> TrainConfig:
    """Return the config for a scene without foreground: only one frame is used, and all steps train the background."""
    views = None if train.views is None else list(train.views)
    with open_capture(capture, views=views, frames=train.frames) as opened:
        first, count = opened.frame_numbers[0], opened.frame_count
    which = "one frame" if count == 1 else f"{count} frames in which nothing moves"
    log(
        f"still scene: {which}: the background is made from the images of frame {first}, and there is no moving "
        "foreground"
    )
    return replace(train, frames=f"{first}:{first + 1}", background=replace(train.background, share=1.0))
