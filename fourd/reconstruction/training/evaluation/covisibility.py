"""Find the pixels of a held-out view that show surfaces that are also visible in a training view.

The colours of surfaces that no training view shows can only be guessed. The masked PSNR (mPSNR) of Gao et al.,
"Monocular Dynamic View Synthesis: A Reality Check" (2022), therefore leaves out all pixels that show such surfaces. Gao
et al. compute visibility from optical flow, whereas fourd computes it from the rendered depth of the static background.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from fourd.base.cameras import Camera
from fourd.base.progress import Track, untracked
from fourd.reconstruction.training.evaluation.metrics import psnr
from fourd.reconstruction.training.evaluation.render import ModelRenderer

DEPTH_TOLERANCE = 0.03
"""A surface point is visible in a training view if its depth in this view is at most (1 + DEPTH_TOLERANCE) times the
rendered depth at its pixel."""
SUBJECT = 128
"""Minimum matte value, from 0 to 255, of a pixel that belongs to the subject."""

Depth = NDArray[np.float32]
Mask = NDArray[np.bool_]


def covisible_masks(
    renderer: ModelRenderer, evaluated: dict[int, Camera], layers: int, track: Track = untracked
) -> dict[int, Mask]:
    """Compute, for each evaluated camera, the mask (H, W) of the pixels at which the surface of the static background
    is visible in a training view.

    Args:
        renderer: the renderer of a full scene.
        evaluated: the evaluated cameras by camera index.
        layers: maximum number of points that are composited at each pixel.
        track: reports progress.
    """
    cameras = [renderer.views.rig.cameras[index] for index in renderer.training]
    tracked = track(cameras, len(cameras), "depths of the training views")
    depths = [renderer.render_background(camera, layers).depth for camera in tracked]
    return {
        index: visible_in_any(camera, renderer.render_background(camera, layers).depth, cameras, depths)
        for index, camera in evaluated.items()
    }


def visible_in_any(camera: Camera, depth: Depth, cameras: Sequence[Camera], depths: Sequence[Depth]) -> Mask:
    """Compute the mask (H, W) of the pixels of ``camera`` that show a surface visible in at least one of ``cameras``.

    Args:
        camera: the evaluated camera, without lens distortion.
        depth: (H, W) camera depth of the surface in world units, 0 at pixels without a surface.
        cameras: the training cameras, without lens distortion.
        depths: for each training camera, its depth image in world units.

    Returns:
        (H, W) mask, which is false at pixels without a surface.
    """
    height, width = depth.shape
    y, x = np.mgrid[:height, :width] + 0.5
    xyz_world = camera.unproject(np.column_stack([x.ravel(), y.ravel()]), depth.ravel())
    visible = np.zeros(height * width, dtype=bool)
    for other, nearest in zip(cameras, depths, strict=True):
        pixels, distance = other.project(xyz_world)
        inside = np.flatnonzero(other.is_in_image(pixels, distance))
        column = np.minimum(pixels[inside, 0].astype(int), other.width - 1)
        row = np.minimum(pixels[inside, 1].astype(int), other.height - 1)
        visible[inside] |= distance[inside] <= nearest[row, column] * (1 + DEPTH_TOLERANCE)
    return visible.reshape(height, width) & (depth > 0)


def covisible_psnr(
    picture: NDArray[np.float32], truth: NDArray[np.float32], matte: NDArray[np.uint8], covisible: Mask
) -> float | None:
    """Compute the PSNR in dB over the union of two groups of pixels: those of the subject, and those of background
    surfaces that are visible in a training view.

    Args:
        picture: (H, W, 3) rendered colours in [0, 1].
        truth: (H, W, 3) true colours in [0, 1].
        matte: (H, W) uint8 matte of the subject, 255 on the subject.
        covisible: (H, W) mask of :func:`covisible_masks`.

    Returns:
        The PSNR, or None if both groups are empty.
    """
    mask = covisible | (matte >= SUBJECT)
    return float(psnr(picture, truth, mask)) if mask.any() else None
