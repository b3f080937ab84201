"""Clean pictures at any time: rendered for the figure of fourd synth, and blended from frames for other captures."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fourd.base.cameras import Camera
from fourd.recording.capture import open_capture
from fourd.recording.capture.frame_rate import DEFAULT_FPS, standard_rate
from fourd.recording.synth.figure import make_figure, pose_figure
from fourd.recording.synth.generate import SynthSettings, gait_phase, ring_cameras
from fourd.recording.synth.render import composite_parts, render_plate

Array = NDArray[np.float64]

RENDERED_KNOTS = 16
"""Number of times per frame at which the figure is rendered. Its fastest parts then move by less than a pixel from one
time to the next."""


@dataclass(frozen=True, eq=False)
class Layer:
    """Something behind the subject and in front of everything else.

    Attributes:
        rgb: (H, W, 3) colours in [0, 1], multiplied by the coverage.
        coverage: (H, W) share of each pixel that is covered.
    """

    rgb: Array
    coverage: Array


@dataclass(frozen=True, eq=False)
class Moment:
    """A clean picture at one time.

    Attributes:
        rgb: (H, W, 3) grey levels from 0 to 255.
        matte: (H, W) share of the subject in each pixel, or None if it is not known.
    """

    rgb: Array
    matte: Array | None


View = Callable[[int, Layer | None], Moment]
"""Returns the picture of one camera at a knot, with a layer behind the subject or without one. A view belongs to one
thread."""


@dataclass(frozen=True)
class Source:
    """A clean multi-view video.

    Attributes:
        names: names of the cameras.
        cameras: the cameras, without distortion.
        frames: number of frames.
        rate: frame rate in 1/s.
        knots_per_frame: number of knots, the times at which pictures exist, from one frame to the next.
        has_mattes: whether the subject's mattes are known.
        open_view: opens the view of the camera with this index.
        metres_per_unit: length of a world unit in metres, or None if it is not known.
    """

    names: tuple[str, ...]
    cameras: tuple[Camera, ...]
    frames: int
    rate: Fraction
    knots_per_frame: int
    has_mattes: bool
    open_view: Callable[[int], View]
    metres_per_unit: float | None


def rendered_source(settings: SynthSettings) -> Source:
    """Return the figure of fourd synth, rendered between frames as well. Its motion is a loop."""
    figure = make_figure(settings.seed)
    cameras = ring_cameras(figure, settings)

    def open_view(index: int) -> View:
        camera = cameras[index]
        plate = render_plate(camera, 2 * np.pi * figure.start)

        def moment(knot: int, behind: Layer | None) -> Moment:
            parts = pose_figure(figure, gait_phase(knot / RENDERED_KNOTS, settings.frames))
            ground = plate if behind is None else plate * (1 - behind.coverage)[..., None] + behind.rgb
            rgb, coverage, _ = composite_parts(parts, camera, ground, settings.gloss)
            return Moment(255 * rgb, coverage)

        return moment

    names = tuple(f"{index:02d}" for index in range(settings.cameras))
    rate = standard_rate(settings.fps)
    return Source(names, tuple(cameras), settings.frames, rate, RENDERED_KNOTS, True, open_view, metres_per_unit=1.0)


def captured_source(capture: Path) -> Source:
    """Return the undistorted frames of a capture. The first and the last frame last longer than the others, because
    nothing is known before and after them.

    Raises:
        UserError: if the folder is not a valid capture.
    """
    with open_capture(capture) as opened:
        names, cameras, frames = opened.names, opened.cameras, opened.frame_count
        rate = standard_rate(opened.fps or DEFAULT_FPS)
        has_mattes, metres_per_unit = opened.has_masks, opened.metres_per_unit

    def open_view(index: int) -> View:
        # Each view opens the capture again, because an opened capture must not be used by several threads.
        own = open_capture(capture, views=[names[index]], mattes=has_mattes)

        def moment(knot: int, behind: Layer | None) -> Moment:
            frame = min(max(knot, 0), frames - 1)
            rgb = own.image(0, frame).astype(np.float64)
            matte = own.mask(0, frame) / 255.0 if has_mattes else None
            if behind is not None and matte is not None:
                # What is behind the subject in a pixel of its contour is not known. The pixel itself stands for it.
                free = (1 - matte)[..., None]
                rgb += free * (255 * behind.rgb - behind.coverage[..., None] * rgb)
            return Moment(rgb, matte)

        return moment

    return Source(names, cameras, frames, rate, 1, has_mattes, open_view, metres_per_unit)
