"""Encoding and decoding of one cloud of points, whose members (files inside the ZIP) are in the folder of a frame or of
the background.

The cloud has N points in Morton order. Arithmetic on colours is modulo 256, except for the sum of a mean colour and a
view's difference, which is clamped to 0 to 255 if the colour step is larger than 1. The cloud has these members:

- ``points``: differences of successive Morton codes as byte planes (the lowest bytes of all values, then the next
  bytes, and so on), then radius codes (two byte planes), then density codes.
- ``sh``: zigzag-coded int16 factors (K, N), which are the weights of the K rows of ``sh_basis`` in units of
  ``sh_step``: first all low bytes, then all high bytes.
- ``colour``: mean colour of each point over the source views, as three planes: green, red - green and blue - green.
  Each plane stores the differences between successive points.
- ``views/VVV``: codes of the blend weights of source view V, then the colours as differences from the points' mean
  colours, in quantisation steps and in three planes: green, red - green and blue - green. If
  ``every_point_has_colours`` is False, no colour is stored for points whose weight code is 0. If the encoding has an
  ``image_scale``, an image follows the codes instead of colours (:mod:`fourd.scene.packed.images`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fourd.base.cameras import Camera
from fourd.rendering.ops.shade.harmonics import SH_TERMS
from fourd.rendering.ops.unpack.op import unpack_harmonics, unpack_positions, unpack_views
from fourd.scene.files.encoding import MAX_CODE, SH_NUMBERS, CloudEncoding
from fourd.scene.packed.colours import mean_colours
from fourd.scene.packed.images import decode_image, largest_image, project, sample_differences
from fourd.scene.packed.positions import encode_positions
from fourd.scene.packed.streams import StreamError, decompress, decompress_exactly, join_planes, split_planes, zigzag
from fourd.scene.scene import BakedFrame, SceneManifest

POINTS, SH, COLOUR = "points", "sh", "colour"
LARGEST_WEIGHT = 1024.0
"""Decoded value of each point's largest blend weight. It is so large that decoded weights down to 2^-24 times the
largest one are normal float16 numbers."""
_MAX_RADIUS_CODE = 2**16 - 1
_MAX_LEVEL = 127
"""Maximum difference between a point's colour and its mean colour, in quantisation steps. The difference is stored as a
signed byte."""


@dataclass(frozen=True)
class ColourRounding:
    """How the writer rounds colours, in addition to the encoding's ``colour_step``. Readers do not need these settings.

    Attributes:
        mean_step: mean colours are rounded to multiples of this number, in units of 1/255.
        unseen_step: in views in which a point's blend weight is 0, the difference between its colour and its mean
            colour is rounded to a multiple of this number, in units of 1/255. The number is a multiple of the
            encoding's ``colour_step``.
    """

    mean_step: int
    unseen_step: int


def view_member(view: int) -> str:
    """Return the name of the member of source view ``view``, inside the folder of the cloud."""
    return f"views/{view:03d}"


def optional_member(attribute: str) -> str:
    """Return the name of the member that stores an optional attribute, without quantisation."""
    return f"optional/{attribute}"


def packed_names(manifest: SceneManifest) -> tuple[str, ...]:
    """Return the names of all members of a cloud."""
    colour = (COLOUR, *map(view_member, range(manifest.view_count))) if manifest.view_count else ()
    return (POINTS, SH, *colour, *map(optional_member, manifest.optional_attributes))


def morton_sorted(frame: BakedFrame, encoding: CloudEncoding) -> NDArray[np.int64]:
    """Return the indices (N,) that sort the points into the order in which they are stored."""
    return np.argsort(encode_positions(frame.xyz, encoding), kind="stable")


def encode_cloud(frame: BakedFrame, encoding: CloudEncoding, rounding: ColourRounding) -> dict[str, bytes]:
    """Return the uncompressed content of each member. The points must be in the order of :func:`morton_sorted`.

    If the encoding has an ``image_scale``, the members of the views contain only the codes of the blend weights, and
    the caller appends the images.
    """
    members = {POINTS: _encode_points(frame, encoding), SH: _encode_sh(frame.sh, encoding)}
    if frame.view_count:
        mean = rounded_means(frame, rounding)
        members[COLOUR] = _encode_mean(mean)
        weights = _encode_weights(frame.blend_weights, encoding)
        for view in range(frame.view_count):
            if encoding.image_scale is not None:
                members[view_member(view)] = weights[:, view].tobytes()
                continue
            seen = weights[:, view] > 0
            steps = np.where(seen, encoding.colour_step, rounding.unseen_step)[:, None]
            levels = _colour_levels(frame.rgb[:, view], mean, steps, encoding.colour_step)
            stored = levels if encoding.every_point_has_colours else levels[seen]
            members[view_member(view)] = weights[:, view].tobytes() + _decorrelate(stored).tobytes()
    return members


def decode_cloud(
    members: Mapping[str, bytes], points: int, cameras: Sequence[Camera], encoding: CloudEncoding
) -> dict[str, NDArray[Any]]:
    """Return the arrays of a cloud, with the names in :data:`fourd.scene.attributes.ATTRIBUTES` as keys.

    Args:
        members: compressed content of every member of :func:`packed_names`, apart from optional attributes.
        points: number of points.
        cameras: cameras of the source views.
        encoding: encoding of the cloud.

    Raises:
        StreamError: if a member is damaged. The message has the form "expected ..., got ...".
        UserError: if the cloud has images, and PyAV is not installed.
    """
    views = len(cameras)
    # The number of points is untrusted, so memory for the results is allocated only after all sizes are checked.
    arrays = _decode_points(members[POINTS], points, encoding)
    factors = decompress_exactly(members[SH], 2 * len(encoding.sh_basis) * points)
    mean = _decode_mean(members[COLOUR], points) if views else np.zeros((points, 3), np.uint8)
    if encoding.image_scale is None:
        contents = [_decode_view(members[view_member(view)], points, encoding) for view in range(views)]
        colour_step = encoding.colour_step
    else:
        planes = np.ascontiguousarray(mean.T)
        contents = [
            _sample_view(members[view_member(view)], arrays["xyz"], planes, camera, encoding.image_scale)
            for view, camera in enumerate(cameras)
        ]
        colour_step = 1
    sh, weights, rgb = _allocate(points, views)
    basis = encoding.sh_basis * np.float32(encoding.sh_step)
    unpack_harmonics(factors, basis, encoding.sh_mean, points, sh)
    unpack_views(
        contents,
        mean,
        weight_table(encoding),
        colour_step,
        every_point_has_colours=encoding.every_point_has_colours,
        out=(weights, rgb),
    )
    return arrays | {"sh": sh.reshape(points, 3, SH_TERMS), "blend_weights": weights, "rgb": rgb}


def _allocate(points: int, views: int) -> tuple[NDArray[np.float16], NDArray[np.float16], NDArray[np.uint8]]:
    """Allocate one memory block for the harmonics (N, 48), the blend weights (N, V) and the colours (N, V, 3), and
    return the three arrays.

    One large block gets huge pages, which the system uses for arrays of 4 MB or more. They make the decoding of 40,000
    points with 17 views about 2 ms faster.
    """
    sh, weights = 2 * SH_NUMBERS * points, 2 * views * points
    memory = np.empty(sh + weights + 3 * views * points, np.uint8)
    return (
        memory[:sh].view(np.float16).reshape(points, SH_NUMBERS),
        memory[sh : sh + weights].view(np.float16).reshape(points, views),
        memory[sh + weights :].reshape(points, views, 3),
    )


def rounded_means(frame: BakedFrame, rounding: ColourRounding) -> NDArray[np.uint8]:
    """Return the mean colours (N, 3) that readers decode."""
    step = rounding.mean_step
    return np.clip(np.rint(mean_colours(frame) / step) * step, 0, 255).astype(np.uint8)


def weight_table(encoding: CloudEncoding) -> NDArray[np.float16]:
    """Return the blend weight of every code, (256,)."""
    codes = np.arange(MAX_CODE + 1)
    table = LARGEST_WEIGHT * 2.0 ** (-(codes - 1) / encoding.weight_steps)
    table[0] = 0
    return table.astype(np.float16)


def _encode_points(frame: BakedFrame, encoding: CloudEncoding) -> bytes:
    codes = encode_positions(frame.xyz, encoding)
    steps = np.diff(codes, prepend=np.uint64(0))
    radius = frame.radius.astype(np.float64)
    with np.errstate(divide="ignore"):
        octaves = np.log2(radius / encoding.radius_lower)
    radius_codes = np.clip(np.rint(octaves * encoding.radius_steps) + 1, 1, _MAX_RADIUS_CODE)
    radius_codes = np.where(radius > 0, radius_codes, 0).astype(np.uint16)
    density = np.rint(frame.density.astype(np.float32) * encoding.density_levels).astype(np.uint8)
    return split_planes(steps, encoding.code_bytes) + split_planes(radius_codes, 2) + density.tobytes()


def _decode_points(member: bytes, points: int, encoding: CloudEncoding) -> dict[str, NDArray[Any]]:
    size = points * (encoding.code_bytes + 3)
    content = decompress_exactly(member, size)
    code_end, radius_end = points * encoding.code_bytes, points * (encoding.code_bytes + 2)
    radius_codes = join_planes(content[code_end:radius_end], 2, np.uint16).astype(np.float32)
    # Overflow is allowed, because it gives an infinite radius, which the reader refuses.
    with np.errstate(over="ignore"):
        radius = np.exp2((radius_codes - 1) / encoding.radius_steps) * np.float32(encoding.radius_lower)
        halves = np.where(radius_codes > 0, radius, 0).astype(np.float16)
    density = content[radius_end:].astype(np.float32) / encoding.density_levels
    return {
        "xyz": unpack_positions(content[:code_end], encoding.lower, encoding.position_step, points),
        "radius": halves,
        "density": density.astype(np.float16),
    }


def _encode_sh(sh: NDArray[np.float16], encoding: CloudEncoding) -> bytes:
    flat = sh.reshape(len(sh), SH_NUMBERS).astype(np.float32) - encoding.sh_mean
    factors = np.rint(flat @ encoding.sh_basis.T / encoding.sh_step)
    codes = zigzag(np.clip(factors, -(2**15), 2**15 - 1).astype(np.int16).T.copy())
    return split_planes(codes.ravel(), 2)


def _encode_mean(mean: NDArray[np.uint8]) -> bytes:
    planes = _decorrelate(mean)
    return np.diff(planes, prepend=np.zeros((3, 1), np.uint8), axis=1).tobytes()


def _decode_mean(member: bytes, points: int) -> NDArray[np.uint8]:
    planes = decompress_exactly(member, 3 * points).reshape(3, points)
    return _correlate(np.cumsum(planes, axis=1, dtype=np.uint8))


def _encode_weights(weights: NDArray[np.float16], encoding: CloudEncoding) -> NDArray[np.uint8]:
    values = weights.astype(np.float64)
    largest = values.max(axis=1, keepdims=True)
    with np.errstate(divide="ignore", invalid="ignore"):
        codes = np.rint(np.log2(largest / values) * encoding.weight_steps) + 1
    return np.where(values > 0, np.clip(codes, 1, MAX_CODE), 0).astype(np.uint8)


def _decode_view(member: bytes, points: int, encoding: CloudEncoding) -> NDArray[np.uint8]:
    """Decompress the member of a view, and check the size of the content."""
    content = decompress(member, 4 * points)
    colours = points if encoding.every_point_has_colours else int(np.count_nonzero(content[:points]))
    if len(content) != points + 3 * colours:
        raise StreamError(f"expected {points + 3 * colours} bytes, got {len(content)}")
    return content


def _sample_view(
    member: bytes, xyz: NDArray[np.float32], mean: NDArray[np.uint8], camera: Camera, scale: float
) -> NDArray[np.uint8]:
    """Decode the member of a view in a scene that stores colours as images. Return the content that the member would
    have in a scene without images: the weight codes, then the differences of the points' colours from their mean
    colours, in steps of 1/255.

    The differences are sampled from the view's image. ``mean`` has the mean colours as planes (3, N).
    """
    points = len(xyz)
    content = decompress(member, points + largest_image(camera, scale))
    if len(content) < points:
        raise StreamError(f"expected at least {points} bytes, got {len(content)}")
    image = decode_image(content[points:].tobytes(), camera, scale)
    seen = np.flatnonzero(content[:points])
    differences = sample_differences(image, *project(xyz[seen], camera, scale))
    red, green, blue = (_rounded_sum(own[seen], part) - own[seen] for own, part in zip(mean, differences, strict=True))
    return np.concatenate([content[:points], green, red - green, blue - green])


def _rounded_sum(colours: NDArray[np.uint8], differences: NDArray[np.float32]) -> NDArray[np.uint8]:
    return np.clip(colours + differences + np.float32(0.5), 0, 255).astype(np.uint8)


def _colour_levels(
    rgb: NDArray[np.uint8], mean: NDArray[np.uint8], steps: NDArray[np.int64], unit: int
) -> NDArray[np.uint8]:
    """Return the differences (N, 3) of colours from mean colours in units of ``unit``, rounded to multiples of
    ``steps`` (N, 1)."""
    levels = np.rint((rgb.astype(np.int16) - mean.astype(np.int16)) / steps) * (steps // unit)
    return np.clip(levels, -_MAX_LEVEL, _MAX_LEVEL).astype(np.int16).astype(np.uint8)


def _decorrelate(colours: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return the planes (3, M) of green, red - green and blue - green for colours (M, 3)."""
    red, green, blue = colours.T
    return np.stack([green, red - green, blue - green])


def _correlate(planes: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return the colours (M, 3) of planes from :func:`_decorrelate`."""
    green, red, blue = planes
    return np.stack([red + green, green, blue + green], axis=-1)
