"""Fits the colours of light scenes (packed scenes without source views), which are stored only as low-degree spherical
harmonics."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fourd.rendering.ops.shade.harmonics import SH_TERMS
from fourd.scene.colour_fit import ColourFit
from fourd.scene.scene import BakedFrame, SceneManifest

LIGHT_SH_BASE, LIGHT_SH_RANGE = 0.5, 1.0
"""Constants of the colour ``base + range * tanh(dot(sh, Y(d)))`` in light scenes, where Y(d) are the spherical
harmonics in the viewing direction d."""
LIGHT_DEGREE = 2
"""Maximum degree of the fitted spherical harmonics."""
MAX_TANH = 0.95


class LightFit:
    """Converts point clouds for a light scene, which has no source views: fits spherical harmonics to the points'
    colours."""

    def __init__(self, manifest: SceneManifest) -> None:
        self._fit = ColourFit(manifest, _before_tanh, LIGHT_DEGREE)

    def convert(self, cloud: BakedFrame) -> BakedFrame:
        """Return the cloud without source views, and with the fitted spherical harmonics."""
        points = cloud.point_count
        sh = np.zeros((points, 3, SH_TERMS), np.float16)
        sh[..., : self._fit.terms] = self._fit.fit(cloud)
        weights, rgb = np.zeros((points, 0), np.float16), np.zeros((points, 0, 3), np.uint8)
        return replace(cloud, sh=sh, blend_weights=weights, rgb=rgb)


def _before_tanh(colour: NDArray[np.float32]) -> NDArray[np.float32]:
    scaled = np.clip((colour - LIGHT_SH_BASE) / LIGHT_SH_RANGE, -MAX_TANH, MAX_TANH)
    return np.asarray(np.arctanh(scaled), np.float32)
