"""Stereo at a few moments of the recording: points on everything that the cameras see then."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fourd.base.cameras import Array
from fourd.base.progress import Track
from fourd.recording.capture import Capture
from fourd.recording.capture.focus import find_focus
from fourd.recording.capture.layout import sample_indices
from fourd.recording.stereo.depth_maps import reconstruct_surfaces
from fourd.recording.stereo.view import StereoView

MIN_CAMERAS = 10
"""Least number of cameras. With fewer, neighbouring cameras are mostly too far apart for stereo."""
MOMENTS = 4
MAX_DEPTH_MAPS = 120
"""Largest number of depth maps of all moments together, each of which takes about two seconds; but at least two moments
are reconstructed."""


@dataclass(frozen=True, eq=False)
class Moments:
    """Points at some of the frames from which the subject is learned.

    Attributes:
        frames: indices of the moments in the list of learning frames.
        points: for each moment, points (N, 3) on all surfaces in world units.
    """

    frames: tuple[int, ...]
    points: tuple[Array, ...]


def reconstruct_moments(capture: Capture, frames: list[int], seed: int, workers: int, track: Track) -> Moments | None:
    """Measure the surfaces that the cameras see in some of the ``frames``, or return None if the cameras are too few or
    have no common focus."""
    count = len(capture.cameras)
    if count < MIN_CAMERAS or find_focus(list(capture.cameras)) is None:
        return None
    chosen = sample_indices(len(frames), max(2, min(MOMENTS, MAX_DEPTH_MAPS // count)))
    points = tuple(_surface_points(capture, frames[index], seed, workers, track) for index in chosen)
    return Moments(tuple(chosen), points)


def _surface_points(capture: Capture, frame: int, seed: int, workers: int, track: Track) -> Array:
    """Return points (N, 3) on the surfaces that at least two cameras see in a frame."""
    views = []
    for index, (name, camera) in enumerate(zip(capture.names, capture.cameras, strict=True)):
        rgb = capture.image(index, frame)
        # Pixels outside the lens's field of view are black.
        views.append(StereoView(name, camera, rgb, np.asarray(rgb.any(axis=-1), np.bool_)))
    surfaces = reconstruct_surfaces(views, seed, workers, track).surfaces
    return np.concatenate([surface.points(np.flatnonzero(surface.known)) for surface in surfaces])
