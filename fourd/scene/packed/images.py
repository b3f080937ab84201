"""Images of source views in packed scenes of the tier "video": still images in VP9, from which colours are sampled.

The image of a source view stores how the points' colours in this view differ from their mean colours. A point's colour
in the view is its mean colour plus the difference at its projection.

An image is stored as a header and a key frame of VP9 (profile 0, 8 bits, 4:2:0). The texels form a grid over the camera
image: if s is the encoding's ``image_scale``, texel (i, j) covers the square from (i, j) / s to (i + 1, j + 1) / s in
pixels. Only one region of the grid is stored: it contains the projections of the points that the view sees. In all
three planes (Y, Cb and Cr) of the frame, the value 128 encodes the difference 0. The conversion to red, green and blue
is that of JFIF (BT.601, full range).
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fourd.base.cameras import Camera
from fourd.base.errors import UserError
from fourd.scene.packed.streams import StreamError

Floats = NDArray[np.floating[Any]]

HEADER = struct.Struct("<4HL")
"""Left and top texel, width and height in texels, and size of the VP9 frame in bytes."""
ZERO = np.float32(128)
"""Texel value that encodes the difference 0."""
RED_FROM_CR, GREEN_FROM_CB, GREEN_FROM_CR, BLUE_FROM_CB = np.array([1.402, -0.344136, -0.714136, 1.772], np.float32)
"""Coefficients of the conversion from Cb and Cr to red, green and blue (ITU-T T.871)."""
MAX_SIDE = 1 << 14
"""Largest width and height of an image in texels."""
_NEAR, _HALF = np.float32(1e-6), np.float32(0.5)
_FRAME_BYTES_PER_TEXEL = 2
"""Maximum size of a stored image in bytes per texel. Even lossless VP9 frames are smaller."""
_SMALLEST_FRAME = 1024
_KEY_FRAME = b"\x82", b"\x83"
"""The valid first bytes of a visible VP9 key frame of profile 0, without and with error resilience (VP9 specification,
6.2)."""
_SYNC_CODE = b"\x49\x83\x42"
_RGB_SPACE = 7


@dataclass(frozen=True, eq=False)
class ViewImage:
    """Decoded image of a source view. It contains the differences between the points' colours in this view and the
    points' mean colours.

    Attributes:
        left, top: position of the image's first texel in the camera's grid.
        planes: Y (H, W), Cb and Cr (ceil(H / 2), ceil(W / 2)), all uint8.
    """

    left: int
    top: int
    planes: tuple[NDArray[np.uint8], NDArray[np.uint8], NDArray[np.uint8]]


def load_av() -> ModuleType:
    """Import and return PyAV. It is not imported with this module, because the import is slow. Raises UserError if PyAV
    is not installed."""
    try:
        import av
    except ImportError as error:
        raise UserError(
            "a scene of the tier video: expected the package av, got none; install it: pip install av"
        ) from error
    return av


def grid_size(camera: Camera, scale: float) -> tuple[int, int]:
    """Return the width and the height, in texels, of the texel grid over the camera's image. One pixel spans ``scale``
    texels. The width and the height are even and at most MAX_SIDE."""
    width, height = (2 * int(np.ceil(side * scale / 2)) for side in (camera.width, camera.height))
    return min(width, MAX_SIDE), min(height, MAX_SIDE)


def largest_image(camera: Camera, scale: float) -> int:
    """Return the maximum size, in bytes, of a stored image of this camera."""
    width, height = grid_size(camera, scale)
    return HEADER.size + _SMALLEST_FRAME + _FRAME_BYTES_PER_TEXEL * width * height


def project(xyz: NDArray[np.float32], camera: Camera, scale: float) -> tuple[Floats, Floats]:
    """Return the positions x (N,) and y (N,) of points (N, 3), in texels of the grid.

    The centre of texel (i, j) is at (i + 1/2, j + 1/2).
    """
    matrix, offset = camera.intrinsics @ camera.rotation, camera.intrinsics @ camera.translation
    # float32 products are used because they are several times faster than float64, with errors below 1/1000 texel.
    with np.errstate(all="ignore"):  # Positions in damaged files can be infinite.
        local = xyz @ matrix.T.astype(np.float32) + offset.astype(np.float32)
        factor = np.float32(scale) / np.maximum(local[:, 2], _NEAR)
        return local[:, 0] * factor, local[:, 1] * factor


def decode_image(content: bytes, camera: Camera, scale: float) -> ViewImage:
    """Check the sizes of a stored image, and then decode it.

    Raises:
        StreamError: if the image is damaged. The message has the form "expected ..., got ...".
        UserError: if PyAV is not installed.
    """
    if len(content) < HEADER.size:
        raise StreamError(f"expected an image header of {HEADER.size} bytes, got {len(content)}")
    left, top, width, height, size = HEADER.unpack_from(content)
    if len(content) != HEADER.size + size:
        raise StreamError(f"expected an image of {size} bytes, got {len(content) - HEADER.size}")
    most_x, most_y = grid_size(camera, scale)
    if left + width > most_x or top + height > most_y:
        raise StreamError(
            f"expected an image inside {most_x} x {most_y} texels, got {width} x {height} at ({left}, {top})"
        )
    if width == 0 or height == 0:
        empty = np.full((1, 1), 128, np.uint8)
        return ViewImage(left, top, (empty, empty, empty))
    frame = content[HEADER.size :]
    declared = _frame_size(frame)
    if declared != (width, height):
        raise StreamError(f"expected a VP9 frame of {width} x {height}, got {declared[0]} x {declared[1]}")
    return ViewImage(left, top, _decode_frame(frame, width, height))


def sample_differences(image: ViewImage, x: Floats, y: Floats) -> tuple[Floats, Floats, Floats]:
    """Sample the colour differences that the image contains at the grid positions x (N,) and y (N,). Returns three
    arrays (N,), for red, green and blue, in units of 1/255.

    The planes are sampled bilinearly, and positions beyond a border are clamped to it.
    """
    x, y = x - np.float32(image.left), y - np.float32(image.top)
    (luma,) = bilinear(image.planes[:1], x, y)
    cb, cr = bilinear(image.planes[1:], x * _HALF, y * _HALF)
    luma, cb, cr = luma - ZERO, cb - ZERO, cr - ZERO
    return luma + RED_FROM_CR * cr, luma + GREEN_FROM_CB * cb + GREEN_FROM_CR * cr, luma + BLUE_FROM_CB * cb


def bilinear(planes: Sequence[NDArray[Any]], x: Floats, y: Floats) -> list[Floats]:
    """Sample planes (H, W) of equal size bilinearly at the positions x (N,) and y (N,), with texel centres at
    half-integers. NaN positions are sampled at a border.
    """
    height, width = planes[0].shape
    # fmax ignores NaN, so NaN positions become 0.
    x = np.minimum(np.fmax(x - np.float32(0.5), 0), width - 1)
    y = np.minimum(np.fmax(y - np.float32(0.5), 0), height - 1)
    left, top = x.astype(np.intp), y.astype(np.intp)
    right, below = x - left.astype(np.float32), y - top.astype(np.float32)
    first = top * (width + 1) + left
    corners = first, first + 1, first + (width + 1), first + (width + 2)
    shares = (1 - right) * (1 - below), right * (1 - below), (1 - right) * below, right * below
    sampled = []
    for plane in planes:
        texels = np.pad(plane.astype(np.float32), ((0, 1), (0, 1)), mode="edge").ravel()
        total = texels[corners[0]] * shares[0]
        for corner, share in zip(corners[1:], shares[1:], strict=True):
            total += texels[corner] * share
        sampled.append(total)
    return sampled


def _frame_size(frame: bytes) -> tuple[int, int]:
    """Return the width and the height that a VP9 frame declares. Raises StreamError unless the frame is the
    only frame of its packet and a visible key frame of profile 0."""
    if frame[:1] not in _KEY_FRAME or frame[1:4] != _SYNC_CODE or len(frame) < 10:
        raise StreamError(f"expected a key frame of VP9, got other content ({frame[:4].hex() or 'nothing'})")
    if _is_superframe(frame):
        raise StreamError("expected one frame of VP9, got several frames")
    bits = int.from_bytes(frame[4:9], "big")
    if bits >> 37 == _RGB_SPACE:
        raise StreamError("expected a VP9 frame in YCbCr, got RGB")
    return (bits >> 20 & 0xFFFF) + 1, (bits >> 4 & 0xFFFF) + 1


def _is_superframe(frame: bytes) -> bool:
    """Return True if a packet ends with a superframe index (VP9 specification, annex B)."""
    last = frame[-1]
    if last & 0xE0 != 0xC0:
        return False
    size = 2 + ((last >> 3 & 3) + 1) * ((last & 7) + 1)
    return len(frame) >= size and frame[-size] == last


def _decode_frame(
    frame: bytes, width: int, height: int
) -> tuple[NDArray[np.uint8], NDArray[np.uint8], NDArray[np.uint8]]:
    av = load_av()
    context = av.CodecContext.create("vp9", "r")
    context.thread_count = 1
    try:
        frames = context.decode(av.Packet(frame))
        frames += context.decode(None)
    except av.FFmpegError as error:
        raise StreamError(f"expected an intact VP9 frame, got {error.strerror or 'other content'}") from error
    if len(frames) != 1:
        raise StreamError(f"expected one frame of VP9, got {len(frames)}")
    picture = frames[0]
    if picture.format.name not in ("yuv420p", "yuvj420p") or (picture.width, picture.height) != (width, height):
        got = f"{picture.width} x {picture.height} in {picture.format.name}"
        raise StreamError(f"expected a frame of {width} x {height} in yuv420p, got {got}")
    half = (height + 1) // 2, (width + 1) // 2
    shapes = (height, width), half, half
    luma, cb, cr = (
        np.frombuffer(plane, np.uint8).reshape(-1, plane.line_size)[: shape[0], : shape[1]]
        for plane, shape in zip(picture.planes, shapes, strict=True)
    )
    return np.ascontiguousarray(luma), np.ascontiguousarray(cb), np.ascontiguousarray(cr)
