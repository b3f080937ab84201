"""Draws baked points from torch tensors with the CUDA kernels."""

from __future__ import annotations

import torch
from torch import Tensor

from fourd.base.cameras import Camera
from fourd.rendering.ops.gpu import load_gpu
from fourd.rendering.ops.play.op import MIN_TRANSMITTANCE
from fourd.rendering.ops.points.validation import check_canvas, check_points, pack_camera
from fourd.rendering.ops.shade.shading import Shading


def draw_points_gpu(
    xyz: Tensor,
    radius: Tensor,
    density: Tensor,
    sh: Tensor,
    blend_weights: Tensor,
    rgb: Tensor,
    shading: Shading,
    camera: Camera,
    *,
    layers: int,
    near: float,
    background: tuple[float, float, float] = (0.0, 0.0, 0.0),
    out: Tensor | None = None,
) -> Tensor:
    """Draw baked points on the tensors' device. Each byte of the image differs by at most 1 from the image of
    :meth:`fourd.rendering.ops.play.op.PointPlayer.draw`, which documents the arguments.

    Pass float16 arrays as int16 tensors with the same bits. All tensors must be contiguous. The kernels are queued on
    torch's current stream, and the call returns before they finish. For CPU tensors, they run in the emulator
    (:mod:`fourd.rendering.ops.gpu`).

    Returns:
        (H, W, 4) uint8 image on the device, which is ``out`` itself if given.

    Raises:
        TypeError, ValueError: for an invalid argument. The error message names the argument and the expected value.
    """
    check_points({"xyz": xyz, "radius": xyz[:, 0], "density": xyz[:, 0]}, camera, layers, near)
    gpu = load_gpu(xyz.device)
    shape = (camera.height, camera.width, 4)
    if out is None:
        out = torch.empty(shape, dtype=torch.uint8, device=gpu.device)
    check_canvas(out, shape, out.is_contiguous())
    entries, size = gpu.kernels.plan_draw(gpu.estimator, xyz.shape[0], camera.width, camera.height)
    with gpu.activate():
        gpu.kernels.draw(
            xyz,
            radius,
            density,
            sh,
            blend_weights,
            rgb,
            *shading.arguments(),
            pack_camera(camera),
            layers,
            near,
            MIN_TRANSMITTANCE,
            background,
            gpu.estimator,
            entries,
            gpu.allocate(size),
            gpu.stream,
            out,
        )
    return out
