"""The background of one camera as its sampled frames tell it: colour, spread, and how sure that is, by pixel."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from fourd.matting.motion.channels import channel_sum

Floats = NDArray[np.float32]
Picture = NDArray[np.uint8]

SHADOW_DARKEST = 0.55
SHADOW_BRIGHTEST = 1.1
SHADOW_LOG_ODDS = np.float32(-2.5)
"""A shadow is that much less likely than the background in plain light."""
FLOOR = np.float32(-20.0)
SURE_FRAMES = 3.0
"""Frames that must show one colour for a pixel's background to be taken as known."""
LOG_TWO_PI = float(np.log(2 * np.pi))


@dataclass(frozen=True, eq=False)
class Background:
    """A normal distribution of colour a pixel.

    Attributes:
        mean: (h, w, 3) float32, colours of 0 to 255.
        variance: (h, w, 3) float32.
        frames: (h, w) float32, weight of the frames that show this colour; 0 where none does.
    """

    mean: Floats
    variance: Floats
    frames: Floats

    @property
    def sureness(self) -> Floats:
        """(h, w) in [0, 1]: 1 where enough frames agree."""
        return np.clip(self.frames / SURE_FRAMES, 0, 1)

    def log_likelihood(self, rgb: Picture) -> Floats:
        """(h, w) log density of colours (h, w, 3), in plain light or in shadow, per unit of colour cubed."""
        scale = -0.5 * channel_sum(np.log(self.variance)) - np.float32(1.5 * LOG_TWO_PI)
        inverse: Floats = (1 / self.variance).astype(np.float32)
        value: Floats = rgb.astype(np.float32)
        plain = -0.5 * channel_sum(np.square(value - self.mean) * inverse)
        weighed = self.mean * inverse
        light = channel_sum(value * weighed) / np.maximum(channel_sum(self.mean * weighed), 1e-3)
        light = np.clip(light, SHADOW_DARKEST, SHADOW_BRIGHTEST)
        shaded = -0.5 * channel_sum(np.square(value - light[..., None] * self.mean) * inverse) + SHADOW_LOG_ODDS
        return np.maximum(np.maximum(plain, shaded) + scale, FLOOR)

    def likeness(self, rgb: Picture) -> Floats:
        """(h, w) in [0, 1]: 1 where colours (h, w, 3) are the mean."""
        return np.exp(-0.5 * channel_sum(np.square(rgb - self.mean) / (2 * self.variance)))

    def shown(self, rgb: Picture, weights: Floats, noise: float) -> Floats:
        """(h, w) weight (T, h, w) of the frames (T, h, w, 3) that show the mean."""
        total = np.zeros(rgb.shape[1:3], np.float32)
        for value, weight in zip(rgb, weights, strict=True):
            total += weight * _nearness(value.astype(np.float32) - self.mean, noise)
        return total

    def resized(self, width: int, height: int) -> Background:
        """The same background in pixels of another size."""
        mean, variance, frames = (
            np.asarray(cv2.resize(plane, (width, height), interpolation=cv2.INTER_LINEAR), np.float32)
            for plane in (self.mean, self.variance, self.frames)
        )
        return Background(mean, variance, frames)


def commonest(rgb: Picture, weights: Floats, noise: float) -> Background:
    """The colour that most of the weight of a pixel's frames lies near.

    Args:
        rgb: (T, h, w, 3) uint8.
        weights: (T, h, w), how likely each shows the background.
        noise: standard deviation of a still pixel's values.
    """
    values = rgb.astype(np.float32)
    most = np.zeros(rgb.shape[1:3], np.float32)
    mean = np.zeros(rgb.shape[1:], np.float32)
    variance = np.zeros_like(mean)
    for place, value in enumerate(values):
        near = weights * _nearness(values - value, noise)
        total = near.sum(axis=0)
        better = (total > most) & (weights[place] > 0.05 * weights.max(axis=0))
        if not better.any():
            continue
        share = near[:, better] / np.maximum(total[better], 1e-9)
        chosen = values[:, better]
        centre = np.einsum("tn,tnc->nc", share, chosen)
        mean[better] = centre
        variance[better] = np.einsum("tn,tnc->nc", share, np.square(chosen - centre))
        most[better] = total[better]
    return Background(mean, variance + np.float32((noise + 1) ** 2), most)


def _nearness(difference: Floats, noise: float) -> Floats:
    """(...,) in [0, 1]: 1 where colours that differ by (..., 3) are the same but for noise."""
    spread = 2.5 * noise + 3
    return np.asarray(np.exp(-channel_sum(np.square(difference)) / np.float32(6 * spread**2)), np.float32)
