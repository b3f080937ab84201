"""Background model of one camera: a Gaussian colour distribution and a confidence per pixel."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from fourd.recording.matting.channels import channel_sum
from fourd.recording.matting.shadows.floor_light import FloorLight
from fourd.recording.matting.shadows.observed_light import ObservedLight

Floats = NDArray[np.float32]
Picture = NDArray[np.uint8]

SHADOW_DARKEST = 0.55
SHADOW_BRIGHTEST = 1.1
MIN_SHARE = 0.002
"""Lower limit of the learned fractions in :class:`Deviations`.

The limit is above 0, because a deviation that does not occur in the frames from which the fractions are learned can
still occur in other frames.
"""
PRIOR_PIXELS = 500.0
"""Strength of the prior when :func:`fit_deviations` learns the two fractions in :class:`Deviations` from pixels. The
prior consists of the default values of the fractions, which count as much as this number of pixels."""
SHARE_ITERATIONS = 3
MIN_LOG_LIKELIHOOD = np.float32(-20.0)
CONFIDENT_FRAMES = 3.0
"""The confidence of a pixel's background colour is 1 if the total weight of the frames in which the pixel has this
colour is at least CONFIDENT_FRAMES."""
LOG_TWO_PI = float(np.log(2 * np.pi))
MAX_LIGHT_RESIDUAL = np.float32(14.0)
"""A colour is the background's colour in another light if their squared difference, in units of the variance and summed
over the channels, is below this value. For Gaussian noise, 0.3% of the pixels are above it."""
MIN_LIGHT_CONFIDENCE = np.float32(0.5)
LIGHT_SPREAD = np.float32(0.03)
"""Standard deviation of the light on the floor in one camera from the light that all cameras agree on."""
MIN_LIGHT_PROBABILITY = np.float32(0.01)


@dataclass(frozen=True)
class Deviations:
    """How large a fraction of the background pixels differs in colour from the background model, for two reasons.

    Attributes:
        shaded: fraction in (0, 1) of the background pixels that are in shadow or in reflected light.
        changed: fraction in (0, 1) of the background pixels whose colour differs from the model for other reasons than
            shadow and light.
    """

    shaded: float = 0.3
    changed: float = 0.05


@dataclass(frozen=True, eq=False)
class BackgroundModel:
    """A Gaussian colour distribution per pixel.

    Attributes:
        mean: (h, w, 3) float32 colours, 0 to 255.
        variance: (h, w, 3) float32 variances of the colours.
        frames: (h, w) float32 total weight of the frames whose colour matches the mean.
    """

    mean: Floats
    variance: Floats
    frames: Floats

    @property
    def confidence(self) -> Floats:
        """Confidence (h, w) in [0, 1] of each pixel's mean colour. It is proportional to the total weight of the frames
        that have this colour, up to 1 at the weight CONFIDENT_FRAMES."""
        return np.clip(self.frames / CONFIDENT_FRAMES, 0, 1)

    def log_likelihood(
        self, rgb: Picture, shaded_share: float = Deviations.shaded, floor: FloorLight | None = None
    ) -> Floats:
        """Return the log density (h, w) of each pixel's colour in an image (h, w, 3), over 8-bit RGB space.

        ``shaded_share`` is the probability that the background at a pixel is in shadow or in reflected light. ``floor``
        is the light on the floor that the cameras agree on, or None.
        """
        plain, shaded = self.plain_and_shaded(rgb)
        likelihood = np.maximum(plain, shaded + np.float32(np.log(shaded_share)))
        if floor is not None:
            in_light = self._log_likelihood_in_light(rgb, floor.light)
            in_light += np.log(np.maximum(floor.probability, np.float32(1e-6)))
            is_floor = floor.probability > MIN_LIGHT_PROBABILITY
            likelihood = np.where(is_floor, np.maximum(likelihood, in_light), likelihood)
        return np.maximum(likelihood, MIN_LOG_LIKELIHOOD)

    def observed_light(self, rgb: Picture) -> ObservedLight:
        """Compare the colours of an image (h, w, 3) with the background's."""
        inverse: Floats = (1 / self.variance).astype(np.float32)
        value: Floats = rgb.astype(np.float32)
        light, _ = self._fit_light(value, inverse)
        residual = channel_sum(np.square(value - light[..., None] * self.mean) * inverse)
        is_known = self.confidence > MIN_LIGHT_CONFIDENCE
        return ObservedLight(light, is_known & (residual < MAX_LIGHT_RESIDUAL), is_known)

    def _fit_light(self, value: Floats, inverse: Floats) -> tuple[Floats, Floats]:
        """Return the light (h, w) on the background that explains the colours ``value`` (h, w, 3) best, and its
        precision. ``inverse`` (h, w, 3) is the inverse variance."""
        weighted = self.mean * inverse
        precision = np.maximum(channel_sum(self.mean * weighted), np.float32(1e-3))
        return (channel_sum(value * weighted) / precision).astype(np.float32), precision.astype(np.float32)

    def _log_likelihood_in_light(self, rgb: Picture, light: Floats) -> Floats:
        """Return the log density (h, w) of each pixel's colour if the light (h, w) on the background is known."""
        variance = self.variance + np.square(LIGHT_SPREAD * self.mean)
        difference = rgb.astype(np.float32) - light[..., None] * self.mean
        distance = channel_sum(np.square(difference) / variance + np.log(variance))
        return np.asarray(-0.5 * distance - np.float32(1.5 * LOG_TWO_PI), np.float32)

    def plain_and_shaded(self, rgb: Picture) -> tuple[Floats, Floats]:
        """Return two log densities (h, w) of each pixel's colour in an image (h, w, 3): one for an unshaded background
        and one for a shaded background.

        The light on a shaded pixel is unknown and has a uniform prior from SHADOW_DARKEST to SHADOW_BRIGHTEST. The
        second density is therefore an integral over the light. It is computed by Laplace's approximation.
        """
        scale = -0.5 * channel_sum(np.log(self.variance)) - np.float32(1.5 * LOG_TWO_PI)
        inverse: Floats = (1 / self.variance).astype(np.float32)
        value: Floats = rgb.astype(np.float32)
        plain = -0.5 * channel_sum(np.square(value - self.mean) * inverse)
        light, precision = self._fit_light(value, inverse)
        light = np.clip(light, SHADOW_DARKEST, SHADOW_BRIGHTEST)
        shaded = -0.5 * channel_sum(np.square(value - light[..., None] * self.mean) * inverse)
        shaded += np.minimum(0.5 * (LOG_TWO_PI - np.log(precision)) - np.log(SHADOW_BRIGHTEST - SHADOW_DARKEST), 0)
        return plain + scale, (shaded + scale).astype(np.float32)

    def similarity(self, rgb: Picture) -> Floats:
        """Return the similarity (h, w) in [0, 1] between colours (h, w, 3) and the background's mean."""
        return np.exp(-0.5 * channel_sum(np.square(rgb - self.mean) / (2 * self.variance)))

    def matching_weight(self, rgb: Picture, weights: Floats, noise: float) -> Floats:
        """For each pixel, sum the ``weights`` (T, h, w) of the frames ``rgb`` (T, h, w, 3) whose colour matches the
        mean."""
        total = np.zeros(rgb.shape[1:3], np.float32)
        for value, weight in zip(rgb, weights, strict=True):
            total += weight * _match(value.astype(np.float32) - self.mean, noise)
        return total

    def crop(self, rows: slice, columns: slice) -> BackgroundModel:
        """Return the model of a part of the image."""
        return BackgroundModel(self.mean[rows, columns], self.variance[rows, columns], self.frames[rows, columns])

    def resize(self, width: int, height: int) -> BackgroundModel:
        """Resize the model to another image size."""
        mean, variance, frames = (
            np.asarray(cv2.resize(plane, (width, height), interpolation=cv2.INTER_LINEAR), np.float32)
            for plane in (self.mean, self.variance, self.frames)
        )
        return BackgroundModel(mean, variance, frames)


def fit_deviations(plain: Floats, shaded: Floats, changed: Floats) -> Deviations:
    """Estimate the fractions of shadowed pixels and of changed pixels from pixels that certainly show the background.

    The fractions are the weights of a mixture model and are estimated by expectation maximisation. The default
    fractions have the weight of PRIOR_PIXELS pixels, so a few pixels hardly change them.

    Args:
        plain: (N,) log densities of the pixels' colours according to the background model.
        shaded: (N,) log densities if the background is in shadow.
        changed: (N,) log densities of the pixels' colours according to the colour distribution of the surroundings.
    """
    default = np.array([1 - Deviations.shaded - Deviations.changed, Deviations.shaded, Deviations.changed])
    density = np.stack([plain, shaded, changed]).astype(np.float64)
    density = np.exp(density - density.max(axis=0))
    shares = default
    for _ in range(SHARE_ITERATIONS):
        joint = shares[:, None] * density
        counts = (joint / joint.sum(axis=0)).sum(axis=1) + PRIOR_PIXELS * default
        shares = np.maximum(counts / counts.sum(), MIN_SHARE)
    return Deviations(float(shares[1]), float(shares[2]))


def fit_background(rgb: Picture, weights: Floats, noise: float) -> BackgroundModel:
    """Fit a background model to frames.

    At each pixel, the most frequent colour is found: for each frame, the weights of all frames with a similar colour
    are summed, and the frame with the largest sum is chosen. The model is the weighted mean and variance of the colours
    that are similar to the chosen frame's colour.

    Args:
        rgb: (T, h, w, 3) uint8 frames.
        weights: (T, h, w) probabilities that a frame's pixel shows the background.
        noise: standard deviation of a static pixel's values, in 8-bit values.
    """
    values = rgb.astype(np.float32)
    largest = np.zeros(rgb.shape[1:3], np.float32)
    mean = np.zeros(rgb.shape[1:], np.float32)
    variance = np.zeros_like(mean)
    for frame, value in enumerate(values):
        matching = weights * _match(values - value, noise)
        total = matching.sum(axis=0)
        better = (total > largest) & (weights[frame] > 0.05 * weights.max(axis=0))
        if not better.any():
            continue
        share = matching[:, better] / np.maximum(total[better], 1e-9)
        chosen = values[:, better]
        centre = np.einsum("tn,tnc->nc", share, chosen)
        mean[better] = centre
        variance[better] = np.einsum("tn,tnc->nc", share, np.square(chosen - centre))
        largest[better] = total[better]
    return BackgroundModel(mean, variance + np.float32((noise + 1) ** 2), largest)


def _match(difference: Floats, noise: float) -> Floats:
    """Convert colour differences, an array of shape (..., 3), to similarities in [0, 1]: about 1 if the difference is
    within the noise. The result lacks the last axis."""
    spread = 2.5 * noise + 3
    return np.asarray(np.exp(-channel_sum(np.square(difference)) / np.float32(6 * spread**2)), np.float32)
