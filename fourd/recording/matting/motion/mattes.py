"""Mattes of all frames from learned colour models of the subject and of each camera's background.

The models give each pixel the log-odds that it shows the subject. The images from which the log-odds are computed are
larger than the images from which the models are learned.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from fourd.base.cameras import Camera
from fourd.recording.capture import Capture
from fourd.recording.matting.edges import refine_matte
from fourd.recording.matting.motion.agreement import VoxelGrid
from fourd.recording.matting.motion.background_model import BackgroundModel
from fourd.recording.matting.motion.evidence import Appearance, combine_views
from fourd.recording.matting.motion.local_evidence import LocalEvidence, local_evidence
from fourd.recording.matting.motion.paint import Strokes, strokes_in_frame
from fourd.recording.matting.motion.sampling import flow_frame, flow_length_px, learning_frames, reduce_picture
from fourd.recording.matting.motion.subject import Subject, floor_cells
from fourd.recording.matting.shadows.floor_light import FloorGrid
from fourd.recording.matting.solid.resting import RestingParts

Floats = NDArray[np.float32]
Picture = NDArray[np.uint8]

MAX_SIDE_PX = 640
"""Maximum length in pixels of the longest side of the images from which log-odds are computed.

If the recorded images are larger, :func:`fourd.recording.matting.edges.refine_matte` computes the mattes at full size
from these log-odds and the recorded images.
"""


@dataclass(frozen=True, eq=False)
class MatteMaker:
    """Makes mattes frame by frame.

    Attributes:
        appearances: colour models of the subject and the background, one object per camera, at the image size of
            ``cameras``.
        cameras: cameras of the reduced images from which log-odds are computed.
        grid: voxel grid of the visual hull, which combines the views. None for a single camera and for cameras with
            parallel optical axes, whose views are processed independently.
        local: local colours of each camera's background.
        floor: the floor on which the subject's shadow lies, or None.
        resting: the parts of the subject that rest between some frames, or None.
    """

    appearances: tuple[Appearance, ...]
    cameras: tuple[Camera, ...]
    grid: VoxelGrid | None
    local: tuple[LocalEvidence, ...]
    floor: FloorGrid | None = None
    resting: RestingParts | None = None

    @staticmethod
    def from_subject(
        subject: Subject,
        backgrounds: Sequence[BackgroundModel],
        cameras: Sequence[Camera],
        resting: RestingParts | None = None,
    ) -> MatteMaker:
        """Create a matte maker from a learned subject and backgrounds.

        The backgrounds have the image size of ``cameras``, which is larger than the image size at which the subject was
        learned.
        """
        appearances = tuple(
            appearance.with_background(fine) for appearance, fine in zip(subject.appearances, backgrounds, strict=True)
        )
        grid = None if subject.box is None else VoxelGrid.covering(*subject.box, cameras, min_seeing=subject.min_seeing)
        local = local_evidence(backgrounds, [appearance.region for appearance in appearances])
        floor = floor_cells(subject.floor, subject.box, grid)
        return MatteMaker(appearances, tuple(cameras), grid, tuple(local), floor, resting)

    def mattes(self, capture: Capture, frame: int, strokes: Sequence[Strokes] = ()) -> list[Picture]:
        """Compute the matte (H, W) uint8 of each camera for one frame. The user's ``strokes``, which may be on other
        frames, correct the mattes."""
        other = flow_frame(frame, capture.frame_count)
        pictures: list[Picture] = []
        small: list[Picture] = []
        motions: list[Floats | None] = []
        for index, camera in enumerate(self.cameras):
            pictures.append(capture.image(index, frame))
            small.append(reduce_picture(pictures[-1], camera))
            motions.append(None)
            if other is not None:
                # Optical flow needs only the frames ``frame`` and ``other``. The frames between them are also read, in
                # ascending order, so that they are cached: reading them later would require seeking backwards in the
                # video and decoding from the previous keyframe.
                ahead = [capture.image(index, number) for number in range(frame + 1, other + 1)]
                second = ahead[-1] if ahead else capture.image(index, other)
                motions[-1] = flow_length_px(small[-1], reduce_picture(second, camera))
        matched = [
            appearance.match_exposure(picture) for appearance, picture in zip(self.appearances, small, strict=True)
        ]
        painted: Sequence[Floats | None] | None = (
            None if self.resting is None else self.resting.log_odds(frame, self.cameras)
        )
        if strokes:
            painted = _over(strokes_in_frame(strokes, capture, self.cameras, frame), painted)
        views = combine_views(self.appearances, matched, motions, self.grid, self.local, painted, self.floor)
        return [
            refine_matte(odds, picture, _sharp_background(appearance, picture))
            for odds, picture, appearance in zip(views.log_odds, pictures, self.appearances, strict=True)
        ]


def _over(strokes: Sequence[Floats | None], under: Sequence[Floats | None] | None) -> Sequence[Floats | None]:
    """Return the log-odds (h, w) that the user painted for each camera, and ``under`` where nothing is painted."""
    if under is None:
        return strokes
    return [
        below if stroke is None or below is None else np.where(stroke == 0, below, stroke)
        for stroke, below in zip(strokes, under, strict=True)
    ]


def _sharp_background(appearance: Appearance, picture: Picture) -> Floats | None:
    """Return the background's colours and their confidence as one array (H, W, 4), or None if the background model does
    not have the size of the image."""
    background = appearance.background
    if background.frames.shape != picture.shape[:2]:
        return None
    return np.dstack([background.mean, background.confidence])


def matting_cameras(capture: Capture) -> tuple[Camera, ...]:
    """Return the capture's cameras, rescaled to the size of the images from which log-odds are computed."""
    longest = max(max(camera.width, camera.height) for camera in capture.cameras)
    return tuple(camera.rescale(min(1.0, MAX_SIDE_PX / longest)) for camera in capture.cameras)


def refine_background(capture: Capture, index: int, coarse: BackgroundModel, camera: Camera) -> BackgroundModel:
    """Recompute a background model at the image size of ``camera``.

    The mean of the new model is a weighted mean of frames. The weight of a pixel in a frame is the similarity of its
    colour to the background model ``coarse``.
    """
    height, width = coarse.frames.shape
    large = coarse.resize(camera.width, camera.height)
    total = np.zeros((camera.height, camera.width), np.float32)
    first = np.zeros((camera.height, camera.width, 3), np.float32)
    second = np.zeros_like(first)
    for frame in learning_frames(capture.frame_count):
        picture = reduce_picture(capture.image(index, frame), camera)
        similarity = coarse.similarity(reduce_picture(picture, camera.resize(width, height)))
        weight = cv2.resize(similarity, (camera.width, camera.height), interpolation=cv2.INTER_LINEAR)
        value = picture.astype(np.float32) - large.mean
        total += weight
        first += weight[..., None] * value
        second += weight[..., None] * value * value
    known = total > 0.2
    share = np.where(known, 1 / np.maximum(total, 1e-6), 0)[..., None]
    offset = first * share
    variance = np.where(known[..., None], np.maximum(second * share - offset**2, 0), 0) + float(coarse.variance.min())
    return BackgroundModel(large.mean + offset, np.maximum(variance, 0.5 * large.variance), large.frames)
