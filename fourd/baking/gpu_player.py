"""Pictures of baked frames on a GPU: as :mod:`fourd.baking.player`, with frames and pictures in its memory."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from fourd.baking.player import HIDDEN
from fourd.baking.scene import BakedFrame, SceneManifest
from fourd.baking.shade import shading_arguments
from fourd.cameras import Camera
from fourd.ops.gpu import load_gpu
from fourd.ops.points.validation import check_points, pack_camera


@dataclass(frozen=True)
class GpuFrame:
    """A :class:`fourd.baking.scene.BakedFrame` of N points and V views on a device.

    Attributes:
        xyz: (N, 3) float32.
        radius, density: (N,) the bits of float16 as int16, as are
        sh: (N, 3, 16), and
        blend_weights: (N, V).
        rgb: (N, V, 3) uint8.
    """

    xyz: Tensor
    radius: Tensor
    density: Tensor
    sh: Tensor
    blend_weights: Tensor
    rgb: Tensor

    @classmethod
    def of(cls, frame: BakedFrame, device: torch.device) -> GpuFrame:
        """Copy a frame, whose arrays may be read-only, to a device."""
        halves = (frame.radius, frame.density, frame.sh, frame.blend_weights)
        arrays: list[NDArray[Any]] = [frame.xyz, *(half.view(np.int16) for half in halves), frame.rgb]
        # Copied first: torch warns of arrays that it may not write to.
        return cls(*(torch.from_numpy(array.copy()).to(device) for array in arrays))


class GpuPlayer:
    """Draws frames on a CUDA device; on the CPU it runs the same kernels emulated, which is for tests."""

    def __init__(self, device: torch.device) -> None:
        """Raises ImportError where the device's kernels are not built."""
        self._gpu = load_gpu(device)

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
        """The frame from ``camera``, (H, W, 4) uint8 on the device: colour over the background, and alpha.

        The same picture as :meth:`fourd.baking.player.Player.draw` gives, to a byte's last step. It is
        there once torch's current stream has come to it; nothing is waited for.

        Raises:
            TypeError, ValueError: naming the argument, what was expected and what came.
        """
        layers = manifest.layers if layers is None else layers
        count = frame.xyz.shape[0]
        check_points(
            {"xyz": frame.xyz, "radius": frame.xyz[:, 0], "density": frame.xyz[:, 0]}, camera, layers, manifest.near
        )
        shape = (camera.height, camera.width, 4)
        gpu = self._gpu
        if out is None:
            out = torch.empty(shape, dtype=torch.uint8, device=gpu.device)
        elif tuple(out.shape) != shape or out.dtype != torch.uint8 or not out.is_contiguous():
            raise ValueError(f"out: expected contiguous uint8 of shape {shape}, got {out.dtype} of {tuple(out.shape)}")
        entries, size = gpu.kernels.plan_draw(gpu.rooms, count, camera.width, camera.height)
        with gpu.current():
            gpu.kernels.draw(
                frame.xyz,
                frame.radius,
                frame.density,
                frame.sh,
                frame.blend_weights,
                frame.rgb,
                *shading_arguments(camera, manifest),
                pack_camera(camera),
                layers,
                manifest.near,
                HIDDEN,
                background,
                gpu.rooms,
                entries,
                gpu.memory(size),
                gpu.stream,
                out,
            )
        return out

    def shade(self, frame: GpuFrame, camera: Camera, manifest: SceneManifest) -> Tensor:
        """The points' colours (N, 3) float32 on the device, as :func:`fourd.baking.shade.shade` gives them."""
        gpu = self._gpu
        out = torch.empty_like(frame.xyz)
        with gpu.current():
            gpu.kernels.shade(
                frame.xyz,
                frame.sh,
                frame.blend_weights,
                frame.rgb,
                *shading_arguments(camera, manifest),
                gpu.stream,
                out,
            )
        return out
