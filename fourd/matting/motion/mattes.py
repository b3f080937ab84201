"""Mattes of all frames by what was learned of the subject from a few, at a finer scale."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from fourd.cameras import Camera
from fourd.capture import Capture
from fourd.matting.edges import matte
from fourd.matting.motion.agreement import Cells
from fourd.matting.motion.background_model import Background
from fourd.matting.motion.evidence import Look, joined
from fourd.matting.motion.sampling import motion_px, neighbour, reduced, sampled_frames
from fourd.matting.motion.subject import Subject

Floats = NDArray[np.float32]
Picture = NDArray[np.uint8]

LONGEST_SIDE = 640
"""Of the pictures in which mattes are found; the rest of a larger one's detail comes from its edges."""


@dataclass(frozen=True, eq=False)
class Matter:
    """Makes mattes, frame by frame.

    Attributes:
        looks: per camera, in the pixels of ``cameras``.
        cameras: reduced.
        cells: for the views' agreement; None where they are not calibrated.
    """

    looks: tuple[Look, ...]
    cameras: tuple[Camera, ...]
    cells: Cells | None

    @staticmethod
    def of(subject: Subject, backgrounds: Sequence[Background], cameras: Sequence[Camera]) -> Matter:
        """With finer backgrounds, of ``cameras``' pixels."""
        looks = tuple(look.at_scale(fine) for look, fine in zip(subject.looks, backgrounds, strict=True))
        cells = None if subject.box is None else Cells.filling(*subject.box, cameras)
        return Matter(looks, tuple(cameras), cells)

    def mattes(self, capture: Capture, frame: int) -> list[Picture]:
        """Each camera's matte (H, W) uint8 of a frame."""
        beside = neighbour(frame, capture.frame_count)
        pictures: list[Picture] = []
        small: list[Picture] = []
        motions: list[Floats | None] = []
        for index, camera in enumerate(self.cameras):
            pictures.append(capture.image(index, frame))
            small.append(reduced(pictures[-1], camera))
            motions.append(None)
            if beside is not None:
                # Read in order: from a video, a step back costs a search from the keyframe before.
                ahead = [capture.image(index, place) for place in range(frame + 1, beside + 1)]
                other = ahead[-1] if ahead else capture.image(index, beside)
                motions[-1] = motion_px(small[-1], reduced(other, camera))
        lit = [look.at_exposure(picture) for look, picture in zip(self.looks, small, strict=True)]
        views = joined(self.looks, lit, motions, self.cells)
        return [
            matte(odds, picture, _behind(look, picture))
            for odds, picture, look in zip(views.log_odds, pictures, self.looks, strict=True)
        ]


def _behind(look: Look, picture: Picture) -> Floats | None:
    """The background's colours and sureness (H, W, 4) where they are as sharp as the picture; None otherwise."""
    background = look.background
    if background.frames.shape != picture.shape[:2]:
        return None
    return np.dstack([background.mean, background.sureness])


def matting_cameras(capture: Capture) -> tuple[Camera, ...]:
    """The capture's cameras at the size in which mattes are found."""
    longest = max(max(camera.width, camera.height) for camera in capture.cameras)
    return tuple(camera.rescale(min(1.0, LONGEST_SIDE / longest)) for camera in capture.cameras)


def fine_background(capture: Capture, index: int, look: Look, camera: Camera) -> Background:
    """A camera's background at ``camera``'s size: the mean of the frames whose reduced colours are the look's."""
    coarse = look.background
    height, width = coarse.frames.shape
    large = coarse.resized(camera.width, camera.height)
    total = np.zeros((camera.height, camera.width), np.float32)
    first = np.zeros((camera.height, camera.width, 3), np.float32)
    second = np.zeros_like(first)
    for frame in sampled_frames(capture.frame_count):
        picture = reduced(capture.image(index, frame), camera)
        likeness = coarse.likeness(reduced(picture, camera.resize(width, height)))
        weight = cv2.resize(likeness, (camera.width, camera.height), interpolation=cv2.INTER_LINEAR)
        value = picture.astype(np.float32) - large.mean
        total += weight
        first += weight[..., None] * value
        second += weight[..., None] * value * value
    known = total > 0.2
    share = np.where(known, 1 / np.maximum(total, 1e-6), 0)[..., None]
    offset = first * share
    variance = np.where(known[..., None], np.maximum(second * share - offset**2, 0), 0) + float(coarse.variance.min())
    return Background(large.mean + offset, np.maximum(variance, 0.5 * large.variance), large.frames)
