"""Images of the frames of a 4D scene through a lens, drawn on a GPU: :func:`draw_through_lens_gpu`."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from fourd.base.cameras import Camera
from fourd.rendering.ops.pixel_filter.reference import filter_pixels_reference
from fourd.rendering.ops.play.near_fade import fade_near
from fourd.rendering.ops.rays.cuda import GpuDiscTree
from fourd.scene.gpu_player import GpuFrame, GpuPlayer
from fourd.scene.lenses.lens import Lens
from fourd.scene.scene import SceneManifest

RAYS_PER_CHUNK = 1 << 21
"""Number of rays that are traced at once, limited to save memory."""


def draw_through_lens_gpu(
    frame: GpuFrame,
    camera: Camera,
    manifest: SceneManifest,
    lens: Lens,
    *,
    layers: int | None = None,
    background: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> Tensor:
    """Draw a frame through a lens on the frame's device. Returns RGB (H, W, 3) float32 in [0, 1] on the same device.

    Up to rounding, the image equals that of :func:`fourd.scene.lenses.picture.draw_through_lens` without mirrors and
    glass balls. The rays and the bounding volume hierarchy of the points are made on the CPU. If the frame is in CPU
    memory, the CUDA kernels are emulated on the CPU.

    Args:
        frame: the frame.
        camera: a pinhole camera without lens distortion, which determines the position, the axes and the image size.
        manifest: description of the scene.
        lens: the lens.
        layers: maximum number K of points that are composited for each ray; None for the scene's value.
        background: RGB colour behind the points, in [0, 1].
    """
    device = frame.xyz.device
    radius, density = (bits.view(torch.float16).float() for bits in (frame.radius, frame.density))
    rays = lens.rays(camera)
    facing = None if rays.facing is None else _to(device, rays.facing)
    if facing is not None:
        arrays = (frame.xyz.cpu().numpy(), density.cpu().numpy())
        density = _to(device, fade_near(*arrays, camera, manifest.near))
    tree = GpuDiscTree(frame.xyz, radius, density)
    colours = GpuPlayer(device).shade(frame, camera, manifest)
    near = 0.0 if facing is None else manifest.near
    behind = torch.tensor(background, device=device)
    sums = torch.zeros(rays.width * rays.height, 3, device=device)
    for begin in range(0, len(rays.pixels), RAYS_PER_CHUNK):
        part = slice(begin, begin + RAYS_PER_CHUNK)
        ends = (_to(device, array[part]) for array in (rays.origins, rays.directions))
        rgba = tree.composite(colours, *ends, facing=facing, t_min=near, layers=layers or manifest.layers)
        light = rgba[:, :3] + (1 - rgba[:, 3:]) * behind
        sums.index_add_(0, torch.from_numpy(rays.pixels[part]).to(device), light)
    counts = np.bincount(rays.pixels, minlength=len(sums))
    image = sums / _to(device, np.maximum(counts, 1))[:, None]
    picture = image.reshape(rays.height, rays.width, 3).clamp(0, 1)
    if counts.max(initial=0) > 1 or manifest.pixel_filter == 0:
        return picture
    return _to(device, filter_pixels_reference(picture.cpu().numpy(), manifest.pixel_filter))


def _to(device: torch.device, array: NDArray[np.generic]) -> Tensor:
    return torch.from_numpy(np.array(array, np.float32)).to(device)
