"""Cameras adjusted to what their pictures show: features, bundle adjustment, and again in narrower bands."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pycolmap
from numpy.typing import NDArray

from fourd.background.plates import PlateView
from fourd.background.stereo.features import (
    Features,
    Quiet,
    alike,
    extract,
    likely_pairs,
    read_features,
    write_pictures,
)
from fourd.bundle_adjustment.solver import Prior, adjusted, errors_px
from fourd.bundle_adjustment.tracks import Moment, Observations, observations, placed_points
from fourd.cameras import Camera
from fourd.capture.layout import evenly_spread
from fourd.carving.mask_source import MaskSource
from fourd.parallel import cores
from fourd.progress import Track

MOST_MOMENTS = 2
LEAST_FEATURES = 20
"""Of a camera; one with fewer stays as it was given."""
AGREES = 4.0
"""Features this many times the scale away count as wrong matches."""
NARROW_PX = 3.0
SHARP_PX = 1.0


@dataclass(frozen=True, eq=False)
class Adjustment:
    """Cameras that agree with the pictures.

    Attributes:
        cameras: in the order of those given.
        features: (V,) of each camera that took part.
        before_px, after_px: median distance of these from where their points project.
    """

    cameras: tuple[Camera, ...]
    features: NDArray[np.intp]
    before_px: float
    after_px: float


def adjust_cameras(capture: MaskSource, cameras: Sequence[int], prior: Prior, band: float, track: Track) -> Adjustment:
    """Adjust some of a capture's cameras (indices) by the features that their pictures of two moments share.

    Args:
        capture: its pictures are undistorted, its cameras nearly right.
        prior: how far they may be off.
        band: greatest distance of matched features from the given cameras' epipolar lines, as a share of a picture's
            longer side.

    Returns:
        the cameras in the order of ``cameras``; those that share too few features as they are given.
    """
    given = tuple(capture.cameras[index] for index in cameras)
    moments = []
    for frame in evenly_spread(capture.frame_count, MOST_MOMENTS):
        features = _features(capture, cameras, frame, track)
        matches = {(i, j): alike(features[i], features[j]) for i, j in likely_pairs(given)}
        moments.append(Moment(tuple(features), matches))
    return agreeing(given, moments, prior, band)


def agreeing(given: Sequence[Camera], moments: Sequence[Moment], prior: Prior, band: float) -> Adjustment:
    """The cameras that agree with what is matched in ``moments``; see :func:`adjust_cameras`."""
    wide = band * max(max(camera.width, camera.height) for camera in given)
    cameras, found, after = tuple(given), observations(moments, given, wide), float("nan")
    for band_px, scale_px in ((wide, wide / 4), (wide / 2, SHARP_PX), (NARROW_PX, SHARP_PX)):
        found = observations(moments, cameras, band_px)
        cameras, found, after = _round(given, cameras, found, prior, band_px, scale_px)
    xyz, _ = placed_points(found, given)
    before = float(np.median(errors_px(found, given, xyz))) if len(found.camera) else float("nan")
    return Adjustment(cameras, np.bincount(found.camera, minlength=len(given)), before, after)


def _round(
    given: Sequence[Camera],
    start: Sequence[Camera],
    found: Observations,
    prior: Prior,
    band_px: float,
    scale_px: float,
) -> tuple[tuple[Camera, ...], Observations, float]:
    """Cameras adjusted once from ``start``, the features that they agree with, and these's median error in pixels."""
    xyz, apart = placed_points(found, start)
    found = found.of_points(apart)
    xyz = xyz[apart]
    found = found.only(errors_px(found, start, xyz) < 2 * band_px)
    count = np.bincount(found.camera, minlength=len(given))
    found = found.only(count[found.camera] >= LEAST_FEATURES)
    if not len(found.camera):
        return tuple(given), found, float("nan")
    xyz, _ = placed_points(found, start)
    cameras, xyz = adjusted(given, start, found, xyz, prior, scale_px)
    errors = errors_px(found, cameras, xyz)
    good = errors < AGREES * scale_px
    return cameras, found.only(good), float(np.median(errors[good])) if good.any() else float("nan")


def _features(capture: MaskSource, cameras: Sequence[int], frame: int, track: Track) -> list[Features]:
    """The cameras' features in a frame."""
    views = []
    for index in cameras:
        picture = capture.image(index, frame)
        views.append(PlateView(capture.names[index], capture.cameras[index], picture, np.ones(picture.shape[:2], bool)))
    with tempfile.TemporaryDirectory(prefix="fourd-cameras-") as name, Quiet():
        folder = Path(name)
        database = folder / "database.db"
        names = write_pictures(folder, views)
        batch = cores()
        batches = [names[begin : begin + batch] for begin in range(0, len(names), batch)]
        for some in track(batches, len(batches), "features"):
            extract(folder, database, some)
        with closing(pycolmap.Database.open(database)) as store:
            images = sorted(store.read_all_images(), key=lambda image: image.name)
            return [read_features(store, image.image_id) for image in images]
