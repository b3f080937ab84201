"""Pictures of baked frames on a GPU: :mod:`fourd.baking.player` with frames and pictures in device memory."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from fourd.baking.scene import BakedFrame, SceneManifest
from fourd.baking.shade import make_shading
from fourd.cameras import Camera
from fourd.ops.gpu import load_gpu
from fourd.ops.play.cuda import draw_points_gpu
from fourd.ops.shade.cuda import shade_points_gpu


@dataclass(frozen=True)
class GpuFrame:
    """What the kernels read of a :class:`fourd.baking.scene.BakedFrame` of N points and V views, on a device.

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
        """Copy a frame, whose arrays may be read-only, to a device."""
        halves = (frame.radius, frame.density, frame.sh, frame.blend_weights)
        arrays: list[NDArray[Any]] = [frame.xyz, *(half.view(np.int16) for half in halves), frame.rgb]
        # The copy avoids torch's warning about read-only arrays.
        return cls(*(torch.from_numpy(array.copy()).to(device) for array in arrays))


class GpuPlayer:
    """Draws frames on a CUDA device. On the CPU it runs the emulated kernels, for tests."""

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
        """Draw the picture of :meth:`fourd.baking.player.Player.draw`, to one step of a byte.

        The work is queued on torch's current stream and not waited for.

        Returns:
            (H, W, 4) uint8 on the device, ``out`` if given.

        Raises:
            TypeError, ValueError: naming the argument, what was expected and what came.
        """
        return draw_points_gpu(
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
            out=out,
        )

    def shade(self, frame: GpuFrame, camera: Camera, manifest: SceneManifest) -> Tensor:
        """Compute the colours of :func:`fourd.baking.shade.shade`, (N, 3) float32 on the device."""
        arrays = (frame.xyz, frame.sh, frame.blend_weights, frame.rgb)
        return shade_points_gpu(*arrays, make_shading(camera, manifest))
