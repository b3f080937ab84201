"""Multiplies the colours of a scene by a gain for each channel."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fourd.rendering.ops.shade.harmonics import SH_CONSTANT
from fourd.scene.scene import BakedFrame, SceneManifest

_MAX_TANH = 0.999
_MAX_SLOPE = 8.0


@dataclass(frozen=True)
class Tint:
    """Gains of red, green and blue, above 0.

    The colours of the source views are multiplied, and clipped at white. The part of a colour that spherical harmonics
    describe, ``base + range * tanh(s)``, is multiplied exactly if the gains are equal, or if ``base`` is 0 and s is
    small. Otherwise, its mean over all directions is, and its changes with the direction are to first order.
    """

    gains: tuple[float, float, float]

    def manifest(self, manifest: SceneManifest) -> SceneManifest:
        """Return the manifest with the constants of the multiplied colours."""
        most = max(self.gains)
        return replace(manifest, sh_base=most * manifest.sh_base, sh_range=most * manifest.sh_range)

    def frame(self, frame: BakedFrame, manifest: SceneManifest) -> BakedFrame:
        """Return the frame with multiplied colours. ``manifest`` has the constants before the change."""
        gains = np.asarray(self.gains, np.float32)
        table = np.clip(np.rint(gains[:, None] * np.arange(256, dtype=np.float32)), 0, 255).astype(np.uint8)
        rgb = np.stack([table[channel][frame.rgb[..., channel]] for channel in range(3)], axis=-1)
        return replace(frame, rgb=rgb, sh=self._harmonics(frame.sh, manifest))

    def _harmonics(self, stored: NDArray[np.float16], manifest: SceneManifest) -> NDArray[np.float16]:
        shares = np.asarray(self.gains, np.float32) / np.float32(max(self.gains))
        if (shares == 1).all() or manifest.sh_range == 0:
            return stored
        sh = stored.astype(np.float32)
        before = np.tanh(SH_CONSTANT * sh[..., 0])
        offset = (shares - 1) * np.float32(manifest.sh_base / manifest.sh_range)
        after = np.clip(shares * before + offset, -_MAX_TANH, _MAX_TANH)
        slope = np.clip(shares * (1 - before**2) / (1 - after**2), 0, _MAX_SLOPE)
        sh[..., 1:] *= slope[..., None]
        sh[..., 0] = np.arctanh(after) / SH_CONSTANT
        return sh.astype(np.float16)
