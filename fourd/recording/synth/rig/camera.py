"""One camera of the rig: all that was drawn for it, and how it records a frame."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fourd.recording.synth.rig.blur import blur_lens, draw_blur
from fourd.recording.synth.rig.calibration import CalibrationError, draw_error
from fourd.recording.synth.rig.colours import apply_gain, draw_gain
from fourd.recording.synth.rig.noise import add_noise
from fourd.recording.synth.rig.settings import RigSettings
from fourd.recording.synth.rig.shutter import Shutter, draw_offset
from fourd.recording.synth.rig.sources import Moment
from fourd.recording.synth.rig.vignetting import draw_falloff, vignette

Array = NDArray[np.float64]

NOISE_STREAM = 26


@dataclass(frozen=True, eq=False)
class RigCamera:
    """A camera of the rig.

    Attributes:
        gain: (3,) factors by which red, green and blue are multiplied.
        falloff: share of the light that is missing in the corners.
        blur_px: standard deviation of the lens blur in pixels.
        shutter: when the rows of a frame are exposed.
        noise: standard deviation of the noise at the grey level 126.
        error: difference of the calibration from the truth.
        noise_seed: seed of the noise, to which the number of the frame is appended.
    """

    gain: Array
    falloff: float
    blur_px: float
    shutter: Shutter
    noise: float
    error: CalibrationError
    noise_seed: tuple[int, ...]

    def stored(self, fps: float) -> dict[str, object]:
        """Return what was drawn as plain data for JSON files."""
        milliseconds = 1000 / fps
        return {
            "gain": self.gain.tolist(),
            "vignetting": self.falloff,
            "blur_px": self.blur_px,
            "offset_ms": self.shutter.offset * milliseconds,
            "readout_ms": self.shutter.readout * milliseconds,
            "exposure_ms": self.shutter.exposure * milliseconds,
            "noise": self.noise,
            "calibration": self.error.stored(),
        }


def draw_camera(settings: RigSettings, index: int, distance: float) -> RigCamera:
    """Draw the properties of the camera with this index. Each factor has its own random numbers, so that a factor alone
    is the same as the factor among others.

    Args:
        settings: strengths of the factors.
        index: index of the camera.
        distance: the cameras' median distance from the point they look at, in world units.
    """

    def stream(number: int) -> np.random.Generator:
        return np.random.default_rng([settings.seed, number, index])

    return RigCamera(
        gain=draw_gain(settings.exposure, settings.white_balance, stream(21)),
        falloff=draw_falloff(settings.vignetting, stream(22)),
        blur_px=draw_blur(settings.blur, stream(23)),
        shutter=Shutter(draw_offset(settings.offset, stream(24)), settings.rolling_shutter, settings.motion_blur),
        noise=settings.noise,
        error=draw_error(settings.calibration, distance, stream(25)),
        noise_seed=(settings.seed, NOISE_STREAM, index),
    )


def expose(weights: Mapping[int, Array], moment: Callable[[int], Moment]) -> Moment:
    """Return the sharp picture that reaches the sensor while its rows are exposed, with its matte.

    Args:
        weights: weights (H,) of the rows for each knot; see :func:`fourd.recording.synth.rig.shutter.row_weights`.
        moment: returns the picture at a knot.
    """
    pictures = {knot: moment(knot) for knot in weights}
    rgb = sum(weight[:, None, None] * pictures[knot].rgb for knot, weight in weights.items())
    mattes = [
        weight[:, None] * matte for knot, weight in weights.items() if (matte := pictures[knot].matte) is not None
    ]
    return Moment(np.asarray(rgb), np.asarray(sum(mattes)) if mattes else None)


def record(camera: RigCamera, light: Moment, frame: int) -> tuple[NDArray[np.uint8], NDArray[np.uint8] | None]:
    """Return the picture that the camera stores, and the true matte of this picture, 255 for the subject."""
    height, width = light.rgb.shape[:2]
    picture = blur_lens(light.rgb, camera.blur_px) * vignette(width, height, camera.falloff)
    picture = apply_gain(picture, camera.gain)
    picture = add_noise(picture, camera.noise, np.random.default_rng([*camera.noise_seed, frame]))
    matte = None if light.matte is None else _levels(255 * blur_lens(light.matte, camera.blur_px))
    return _levels(picture), matte


def _levels(values: Array) -> NDArray[np.uint8]:
    return np.asarray(np.clip(np.rint(values), 0, 255), np.uint8)
