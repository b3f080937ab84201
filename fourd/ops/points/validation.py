"""What the point renderers check before they run, the same for torch tensors and NumPy arrays."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from fourd.cameras import Camera

MOST_CHANNELS = 32
MOST_POINTS = 2**31 - 1
# The kernels count tiles of 16 x 16 pixels in 32 bits: this leaves them a factor of 8.
LONGEST_SIDE = 2**18


def check_points(
    arrays: Mapping[str, Any], camera: Camera, layers: int, near: float, dtypes: tuple[str, ...] = ("float32",)
) -> None:
    """Check the arguments that all renderers share.

    ``arrays`` holds xyz (N, 3), radius (N,), density (N,) and, where the caller has them, features
    (N, C) with C in 1..32: all of one dtype, which must be among ``dtypes``, and on one device.
    Values of the arrays are not checked: what is not finite is culled by the renderers.

    Raises:
        TypeError: for a wrong type or dtype. ValueError: for a wrong shape or range. Both name the
        argument, what was expected and what came.
    """
    for name, array in arrays.items():
        if not hasattr(array, "shape") or not hasattr(array, "dtype"):
            raise TypeError(f"{name}: expected an array or tensor, got {type(array).__name__}")
    _check_shapes(arrays)
    _check_dtypes(arrays, dtypes)
    _check_camera(camera)
    if isinstance(layers, bool) or not isinstance(layers, int):
        raise TypeError(f"layers: expected an integer, got {type(layers).__name__}")
    if not 1 <= layers <= 2**20:
        raise ValueError(f"layers: expected at least 1, got {layers}")
    if not (near > 0 and math.isfinite(near)):
        raise ValueError(f"near: expected a finite distance above 0, got {near}")


def check_background(background: Any, camera: Camera, channels: int) -> None:
    """Check that a background is (C,) or (H, W, C)."""
    shapes = [(channels,), (camera.height, camera.width, channels)]
    if not hasattr(background, "shape"):
        raise TypeError(f"background: expected an array or tensor, got {type(background).__name__}")
    if tuple(background.shape) not in shapes:
        raise ValueError(f"background: expected shape {shapes[0]} or {shapes[1]}, got {tuple(background.shape)}")


def pack_camera(camera: Camera) -> list[float]:
    """K, R (row by row) and T: the 21 numbers that the kernels take."""
    return [*camera.intrinsics.ravel(), *camera.rotation.ravel(), *camera.translation]


def _check_shapes(arrays: Mapping[str, Any]) -> None:
    xyz = tuple(arrays["xyz"].shape)
    if len(xyz) != 2 or xyz[1] != 3:
        raise ValueError(f"xyz: expected shape (N, 3), got {xyz}")
    if xyz[0] > MOST_POINTS:
        raise ValueError(f"xyz: expected at most {MOST_POINTS} points, got {xyz[0]}")
    for name in ("radius", "density"):
        shape = tuple(arrays[name].shape)
        if shape != (xyz[0],):
            raise ValueError(f"{name}: expected shape ({xyz[0]},) to match xyz, got {shape}")
    if "features" in arrays:
        shape = tuple(arrays["features"].shape)
        if len(shape) != 2 or shape[0] != xyz[0] or not 1 <= shape[1] <= MOST_CHANNELS:
            raise ValueError(
                f"features: expected shape ({xyz[0]}, C) to match xyz, with C from 1 to {MOST_CHANNELS}, got {shape}"
            )


def _check_dtypes(arrays: Mapping[str, Any], dtypes: tuple[str, ...]) -> None:
    first = str(arrays["xyz"].dtype).removeprefix("torch.")
    for name, array in arrays.items():
        dtype = str(array.dtype).removeprefix("torch.")
        if dtype not in dtypes:
            mend = "; float64 is for backend='reference'" if dtype == "float64" else ""
            raise TypeError(f"{name}: expected {' or '.join(dtypes)}, got {dtype}{mend}")
        if dtype != first:
            raise TypeError(f"{name}: expected {first} as xyz has, got {dtype}")
        if str(getattr(array, "device", "cpu")) != str(getattr(arrays["xyz"], "device", "cpu")):
            raise ValueError(f"{name}: expected device {arrays['xyz'].device} as xyz has, got {array.device}")


def _check_camera(camera: Camera) -> None:
    if not isinstance(camera, Camera):
        raise TypeError(f"camera: expected a fourd.cameras.Camera, got {type(camera).__name__}")
    if camera.distortion is not None:
        raise ValueError(
            "camera: expected an ideal pinhole, got one with lens distortion; undistort the images and use "
            "dataclasses.replace(camera, distortion=None)"
        )
    if max(camera.width, camera.height) > LONGEST_SIDE:
        raise ValueError(
            f"camera: expected sides of at most {LONGEST_SIDE} pixels, got {camera.width} x {camera.height}"
        )
