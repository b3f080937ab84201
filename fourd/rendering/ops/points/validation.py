"""Checks the arguments of the point renderers, for torch tensors and NumPy arrays."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from fourd.base.cameras import Camera

MAX_CHANNELS = 32
MAX_POINTS = 2**31 - 1
MAX_SIDE_PX = 2**18
"""Maximum width or height of an image.

The kernels count tiles of 16 x 16 pixels in signed 32-bit integers. An image with this width and height has 2^28 tiles,
an eighth of these integers' limit.
"""


def check_points(
    arrays: Mapping[str, Any], camera: Camera, layers: int, near: float, dtypes: tuple[str, ...] = ("float32",)
) -> None:
    """Check the arguments that all point renderers share.

    Args:
        arrays: xyz (N, 3), radius (N,), density (N,) and optionally features (N, C) with C from 1 to 32, all on the
            same device and with the same dtype, one of ``dtypes``. Their elements are not checked, because the
            renderers cull points with non-finite values.
        camera: must be a pinhole camera without lens distortion.
        layers: must be an integer from 1 to 2^20.
        near: must be finite and positive.
        dtypes: names of the accepted dtypes.

    Raises:
        TypeError: for a wrong type or dtype.
        ValueError: for a wrong shape or range. The error message names the argument and the expected value.
    """
    for name, array in arrays.items():
        if not hasattr(array, "shape") or not hasattr(array, "dtype"):
            raise TypeError(f"{name}: expected an array or tensor, got {type(array).__name__}")
    _check_shapes(arrays)
    _check_dtypes(arrays, dtypes)
    check_camera(camera)
    if isinstance(layers, bool) or not isinstance(layers, int):
        raise TypeError(f"layers: expected an integer, got {type(layers).__name__}")
    if not 1 <= layers <= 2**20:
        raise ValueError(f"layers: expected at least 1, got {layers}")
    if not (near > 0 and math.isfinite(near)):
        raise ValueError(f"near: expected a finite distance above 0, got {near}")


def check_background(background: Any, camera: Camera, channels: int) -> None:
    """Check that a background is an array of shape (C,) or (H, W, C). Raises TypeError, ValueError."""
    shapes = [(channels,), (camera.height, camera.width, channels)]
    if not hasattr(background, "shape"):
        raise TypeError(f"background: expected an array or tensor, got {type(background).__name__}")
    if tuple(background.shape) not in shapes:
        raise ValueError(f"background: expected shape {shapes[0]} or {shapes[1]}, got {tuple(background.shape)}")


def pack_camera(camera: Camera) -> list[float]:
    """Return the camera as the 21 numbers that the kernels expect: the intrinsic matrix and the rotation, each row by
    row, and the translation."""
    return [*camera.intrinsics.ravel(), *camera.rotation.ravel(), *camera.translation]


def _check_shapes(arrays: Mapping[str, Any]) -> None:
    xyz = tuple(arrays["xyz"].shape)
    if len(xyz) != 2 or xyz[1] != 3:
        raise ValueError(f"xyz: expected shape (N, 3), got {xyz}")
    if xyz[0] > MAX_POINTS:
        raise ValueError(f"xyz: expected at most {MAX_POINTS} points, got {xyz[0]}")
    for name in ("radius", "density"):
        shape = tuple(arrays[name].shape)
        if shape != (xyz[0],):
            raise ValueError(f"{name}: expected shape ({xyz[0]},) to match xyz, got {shape}")
    if "features" in arrays:
        shape = tuple(arrays["features"].shape)
        if len(shape) != 2 or shape[0] != xyz[0] or not 1 <= shape[1] <= MAX_CHANNELS:
            raise ValueError(
                f"features: expected shape ({xyz[0]}, C) to match xyz, with C from 1 to {MAX_CHANNELS}, got {shape}"
            )


def _check_dtypes(arrays: Mapping[str, Any], dtypes: tuple[str, ...]) -> None:
    first = str(arrays["xyz"].dtype).removeprefix("torch.")
    for name, array in arrays.items():
        dtype = str(array.dtype).removeprefix("torch.")
        if dtype not in dtypes:
            fix = "; float64 needs backend='reference'" if dtype == "float64" else ""
            raise TypeError(f"{name}: expected {' or '.join(dtypes)}, got {dtype}{fix}")
        if dtype != first:
            raise TypeError(f"{name}: expected {first}, the dtype of xyz, got {dtype}")
        if str(getattr(array, "device", "cpu")) != str(getattr(arrays["xyz"], "device", "cpu")):
            raise ValueError(f"{name}: expected device {arrays['xyz'].device}, that of xyz, got {array.device}")


def check_camera(camera: Camera) -> None:
    """Check that a camera is a pinhole camera that a renderer can use. Raises TypeError, ValueError."""
    if not isinstance(camera, Camera):
        raise TypeError(f"camera: expected a fourd.Camera, got {type(camera).__name__}")
    if camera.distortion is not None:
        raise ValueError(
            "camera: expected an ideal pinhole, got one with lens distortion; undistort the images and use "
            "dataclasses.replace(camera, distortion=None)"
        )
    if max(camera.width, camera.height) > MAX_SIDE_PX:
        raise ValueError(
            f"camera: expected sides of at most {MAX_SIDE_PX} pixels, got {camera.width} x {camera.height}"
        )


def check_canvas(out: Any, shape: tuple[int, int, int], is_contiguous: bool) -> None:
    """Raise a ValueError unless the array or tensor ``out`` is contiguous, of dtype uint8 and of shape ``shape``."""
    if tuple(out.shape) != shape or str(out.dtype) not in ("uint8", "torch.uint8") or not is_contiguous:
        raise ValueError(
            f"out: expected contiguous uint8 of shape {shape}, got {out.dtype} of shape {tuple(out.shape)}"
        )
