"""Rendering of baked frames on a GPU.

The images match those that :mod:`fourd.scene.player` draws on the CPU. Frames and images stay in device memory.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from fourd.base.cameras import Camera
from fourd.rendering.ops.gpu import load_gpu
from fourd.rendering.ops.pixel_filter.cuda import filter_pixels_gpu
from fourd.rendering.ops.play.cuda import draw_points_gpu
from fourd.rendering.ops.shade.cuda import shade_points_gpu
from fourd.scene.scene import BakedFrame, SceneManifest
from fourd.scene.shade import make_shading


@dataclass(frozen=True)
class GpuFrame:
    """A :class:`fourd.scene.scene.BakedFrame` with N points and V source views, whose arrays are in device memory.

    Attributes:
        xyz: (N, 3) float32.
        radius, density: (N,) int16, the bits of float16.
        sh: (N, 3, 16) int16, the bits of float16.
        blend_weights: (N, V) int16, the bits of float16.
        rgb: (N, V, 3) uint8.
    """

    xyz: Tensor
    radius: Tensor
    density: Tensor
    sh: Tensor
    blend_weights: Tensor
    rgb: Tensor

    @classmethod
    def from_frame(cls, frame: BakedFrame, device: torch.device) -> GpuFrame:
        """Copy a frame to a device. The frame's arrays may be read-only."""
        halves = (frame.radius, frame.density, frame.sh, frame.blend_weights)
        arrays: list[NDArray[Any]] = [frame.xyz, *(half.view(np.int16) for half in halves), frame.rgb]
        # copy() avoids torch's warning about read-only arrays.
        return cls(*(torch.from_numpy(array.copy()).to(device) for array in arrays))


class GpuPlayer:
    """Draws frames on a CUDA device. For tests, an emulator runs the CUDA kernels on the CPU."""

    def __init__(self, device: torch.device) -> None:
        """Raises ImportError if the device's kernels are not built."""
        load_gpu(device)

    def draw(
        self,
        frame: GpuFrame,
        camera: Camera,
        manifest: SceneManifest,
        *,
        layers: int | None = None,
        background: tuple[float, float, float] = (0.0, 0.0, 0.0),
        out: Tensor | None = None,
    ) -> Tensor:
        """Draw the same image as :meth:`fourd.scene.player.Player.draw`, up to a difference of 1 per byte.

        The work is queued on torch's current CUDA stream, so the call returns before the image is complete.

        Returns:
            image (H, W, 4) uint8 on the device. If ``out`` is given, the image is drawn into ``out`` and ``out`` is
            returned.

        Raises:
            TypeError, ValueError: for an invalid argument. The message names the argument and the expected value.
        """
        side = manifest.pixel_filter
        image = draw_points_gpu(
            frame.xyz,
            frame.radius,
            frame.density,
            frame.sh,
            frame.blend_weights,
            frame.rgb,
            make_shading(camera, manifest),
            camera,
            layers=manifest.layers if layers is None else layers,
            near=manifest.near,
            background=background,
            out=out if side == 0 else None,
        )
        return image if side == 0 else filter_pixels_gpu(image, side, out)

    def shade(self, frame: GpuFrame, camera: Camera, manifest: SceneManifest) -> Tensor:
        """Compute the same colours as :func:`fourd.scene.shade.shade`, (N, 3) float32 on the device."""
        arrays = (frame.xyz, frame.sh, frame.blend_weights, frame.rgb)
        return shade_points_gpu(*arrays, make_shading(camera, manifest))
