"""Images of source views for packed scenes of the tier "video". :mod:`fourd.scene.packed.images` describes the images.

The image of a view is fitted to the colours of the points that the view sees, such that the colours that readers sample
from it are close to those of the scene. The camera recordings are not needed.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from fractions import Fraction

import cv2
import numpy as np
from numpy.typing import NDArray

from fourd.base.cameras import Camera
from fourd.scene.files.encoding import MIN_IMAGE_SCALE, CloudEncoding
from fourd.scene.packed.images import (
    BLUE_FROM_CB,
    GREEN_FROM_CB,
    GREEN_FROM_CR,
    HEADER,
    RED_FROM_CR,
    ZERO,
    Floats,
    bilinear,
    grid_size,
    load_av,
    project,
)
from fourd.scene.packed.members import rounded_means, view_member
from fourd.scene.packed.positions import rounded_positions
from fourd.scene.packing.precision import Precision
from fourd.scene.scene import BakedFrame, SceneManifest

BLURS = (2.0, 1.0, 0.7, 0.0, 0.0)
"""Standard deviation, in texels, of the blur in each iteration of :func:`fit_plane`. An iteration blurs its correction,
and then adds it to the plane. The first iterations blur most, to fill the gaps between points."""
_OPTIONS = {"b": "0", "lag-in-frames": "0", "deadline": "good", "cpu-used": "1", "aq-mode": "0"}
"""Options of libvpx-vp9: constant quality, and a packet for each frame."""
_DAMPING = 0.02
"""Regularisation that is added to the sum of the points' weights in each texel. If this sum is small, the
regularisation keeps the texel's value, which is a difference from the points' mean colours, near 0."""
_FROM_YCC = np.array([[1, 0, RED_FROM_CR], [1, GREEN_FROM_CB, GREEN_FROM_CR], [1, BLUE_FROM_CB, 0]], np.float64)
_TO_YCC = np.linalg.inv(_FROM_YCC).astype(np.float32)
"""Matrix from red, green and blue to Y, Cb and Cr."""


def choose_scale(cloud: BakedFrame, manifest: SceneManifest, precision: Precision) -> float | None:
    """Choose the scale of the images from ``cloud``, which is a typical frame or the background. Returns None if the
    tier has no images.

    For each view, the median radius of the visible points in pixels is computed. The scale is chosen such that the
    largest of these medians spans ``precision.texels_per_radius`` texels. The images have at most the resolution of the
    cameras.
    """
    if precision.crf is None or manifest.view_count == 0:
        return None
    largest = 0.0
    for view, camera in enumerate(manifest.source_cameras):
        seen = cloud.blend_weights[:, view] > 0
        depth = camera.project(cloud.xyz[seen])[1]
        if seen.any():
            sizes = cloud.radius[seen] * camera.intrinsics[0, 0] / np.maximum(depth, manifest.near)
            largest = max(largest, float(np.median(sizes)))
    return min(max(precision.texels_per_radius / largest, MIN_IMAGE_SCALE), 1.0) if largest > 0 else 1.0


def add_images(
    members: dict[str, bytes],
    cloud: BakedFrame,
    cameras: Sequence[Camera],
    encoding: CloudEncoding,
    precision: Precision,
) -> None:
    """If the encoding has images, append the image of each source view to the view's member.

    ``members`` is the result of :func:`fourd.scene.packed.members.encode_cloud` for ``cloud``.
    """
    if encoding.image_scale is None or precision.crf is None or cloud.view_count == 0:
        return
    xyz = rounded_positions(cloud.xyz, encoding)
    mean = rounded_means(cloud, precision.colour_rounding).astype(np.float32)
    largest = cloud.blend_weights.max(axis=1)
    for view, camera in enumerate(cameras):
        weights = cloud.blend_weights[:, view]
        seen = weights > 0
        shares = weights[seen].astype(np.float32) / largest[seen].astype(np.float32)
        differences = cloud.rgb[seen, view] - mean[seen]
        image = make_image(xyz[seen], differences, shares, camera, encoding.image_scale, precision.crf)
        members[view_member(view)] += image


def make_image(
    xyz: NDArray[np.float32],
    differences: NDArray[np.float32],
    weights: NDArray[np.float32],
    camera: Camera,
    scale: float,
    crf: int,
) -> bytes:
    """Make the image that stores the points' colours in one source view. It stores each colour as the difference from
    the point's mean colour over all source views. The image is fitted to the differences of all points, and encoded as
    a header and a VP9 key frame. If there are no points, the result is only the header of an empty image.

    Args:
        xyz: (M, 3) positions of the points that the view sees, as readers decode them.
        differences: (M, 3) colours of the points in the view minus their mean colours, in units of 1/255.
        weights: (M,) importance of each point, above 0.
        camera: camera of the view.
        scale: texels per pixel.
        crf: constant quality of libvpx-vp9, from 0 (best) to 63.
    """
    if len(xyz) == 0:
        return HEADER.pack(0, 0, 0, 0, 0)
    x, y = project(xyz, camera, scale)
    left, top, width, height = _crop(x, y, grid_size(camera, scale))
    x, y = x - np.float32(left), y - np.float32(top)
    luma, cb, cr = (differences @ _TO_YCC.T).T
    planes = [
        fit_plane(luma, x, y, weights, (width, height)),
        *(fit_plane(chroma, x / 2, y / 2, weights, (width // 2, height // 2)) for chroma in (cb, cr)),
    ]
    frame = _encode_frame([np.clip(np.rint(plane + ZERO), 0, 255).astype(np.uint8) for plane in planes], crf)
    return HEADER.pack(left, top, width, height, len(frame)) + frame


def fit_plane(
    values: Floats,
    x: Floats,
    y: Floats,
    weights: Floats,
    size: tuple[int, int],
) -> NDArray[np.float32]:
    """Fit a plane (H, W) whose bilinear samples at the positions x (M,) and y (M,) are near ``values`` (M,).

    The method is simultaneous algebraic reconstruction (Andersen and Kak 1984): each iteration distributes the
    remaining errors to the texels with the weights of bilinear interpolation. Texels far from all points are 0.

    Args:
        values: (M,) values to approximate.
        x, y: (M,) positions in texels of the plane. Texel centres are at half-integers.
        weights: (M,) importance of each point.
        size: (W, H).
    """
    width, height = size
    corners, shares = _corners(x, y, size)
    shares = shares * weights
    plane = np.zeros((height, width), np.float32)
    mass = _scatter(corners, shares, size)
    for blur in BLURS:
        (sampled,) = bilinear([plane], x, y)
        sums, weight = _scatter(corners, shares * (values - sampled), size), mass
        if blur:
            sums, weight = (np.asarray(cv2.GaussianBlur(array, (0, 0), blur), np.float32) for array in (sums, mass))
        plane += sums / (weight + _DAMPING)
    return plane


def _scatter(corners: NDArray[np.int64], shares: Floats, size: tuple[int, int]) -> NDArray[np.float32]:
    """Return the plane (H, W) in which ``shares`` (4, M) are summed at the texels ``corners`` (4, M)."""
    width, height = size
    return np.bincount(corners.ravel(), shares.ravel(), width * height).reshape(height, width).astype(np.float32)


def _corners(x: Floats, y: Floats, size: tuple[int, int]) -> tuple[NDArray[np.int64], Floats]:
    """Return the indices (4, M) of the texels around positions, and their weights (4, M) in bilinear interpolation."""
    width, height = size
    x, y = np.clip(x - np.float32(0.5), 0, width - 1), np.clip(y - np.float32(0.5), 0, height - 1)
    left, top = x.astype(np.int64), y.astype(np.int64)
    right, bottom = np.minimum(left + 1, width - 1), np.minimum(top + 1, height - 1)
    fx, fy = (x - left).astype(np.float32), (y - top).astype(np.float32)
    corners = np.stack([top * width + left, top * width + right, bottom * width + left, bottom * width + right])
    return corners, np.stack([(1 - fy) * (1 - fx), (1 - fy) * fx, fy * (1 - fx), fy * fx])


def _crop(x: Floats, y: Floats, grid: tuple[int, int]) -> tuple[int, int, int, int]:
    """Return left, top, width and height, all even, of the region of the grid that contains the positions and a
    margin."""
    starts, sizes = [], []
    for positions, side in zip((x, y), grid, strict=True):
        start = min(max(math.floor(positions.min()) - 1, 0), side - 2) // 2 * 2
        end = min(max(math.ceil(positions.max()) + 1, start + 2), side)
        starts.append(start)
        sizes.append((end - start + 1) // 2 * 2)
    return starts[0], starts[1], sizes[0], sizes[1]


def _encode_frame(planes: list[NDArray[np.uint8]], crf: int) -> bytes:
    """Encode three planes (4:2:0) as a key frame of VP9. Equal planes give equal bytes."""
    av = load_av()
    height, width = planes[0].shape
    context = av.CodecContext.create("libvpx-vp9", "w")
    context.width, context.height, context.pix_fmt = width, height, "yuv420p"
    context.time_base = Fraction(1)
    context.thread_count = 1
    context.options = _OPTIONS | {"crf": str(crf)}
    frame = av.VideoFrame(width, height, "yuv420p")
    for plane, content in zip(frame.planes, planes, strict=True):
        padded = np.zeros((plane.height, plane.line_size), np.uint8)
        padded[:, : plane.width] = content
        plane.update(padded)
    frame.pts = 0
    packets = [bytes(packet) for packet in [*context.encode(frame), *context.encode(None)] if packet.size]
    if len(packets) != 1:
        raise RuntimeError(f"expected one packet of libvpx-vp9, got {len(packets)}")
    return packets[0]
