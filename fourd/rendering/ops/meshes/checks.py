"""Argument checks that all triangle operators share."""

from __future__ import annotations

import torch
from torch import Tensor

from fourd.rendering.ops.meshes.ids import MAX_TRIANGLES

MAX_SIDE_PX = 2**15
"""Maximum width or height of an image. Subpixel positions in larger images would overflow the kernels' integers."""

ALL_LAYERS = 2**20
"""Largest accepted limit of the number of composited triangles per pixel. It is also used if the caller passes None for
"no limit"."""

Axis = int | str
"""The size of an axis, or a letter that stands for any size."""


def check_tensor(
    name: str,
    value: object,
    shape: tuple[Axis, ...],
    *,
    like: tuple[str, Tensor] | None = None,
    dtypes: tuple[torch.dtype, ...] = (torch.float32,),
) -> Tensor:
    """Check the type, shape, dtype and device of an argument, and return it.

    Args:
        name: name of the argument, for the error message.
        value: the argument. Its elements are not checked.
        shape: expected shape. A letter stands for any size, including 0. Axes with the same letter may have different
            sizes.
        like: name and value of a reference argument. ``value`` must be on the reference's device. If the reference has
            a floating-point dtype, ``value`` must have the same dtype.
        dtypes: accepted dtypes, ignored if ``like`` has a floating-point dtype.

    Raises:
        TypeError: for a wrong type or dtype.
        ValueError: for a wrong shape or device. The message names the argument, the expected value and the found value.
    """
    if not isinstance(value, Tensor):
        raise TypeError(f"{name}: expected a torch.Tensor, got {type(value).__name__}")
    if value.ndim != len(shape) or any(
        isinstance(axis, int) and axis != size for axis, size in zip(shape, value.shape, strict=True)
    ):
        raise ValueError(f"{name}: expected shape ({_shape_text(shape)}), got {tuple(value.shape)}")
    if like is not None and like[1].dtype.is_floating_point:
        dtypes = (like[1].dtype,)
    if value.dtype not in dtypes:
        expected = " or ".join(str(dtype).removeprefix("torch.") for dtype in dtypes)
        raise TypeError(f"{name}: expected dtype {expected}, got {str(value.dtype).removeprefix('torch.')}")
    if like is not None and value.device != like[1].device:
        raise ValueError(f"{name}: expected device {like[1].device}, that of {like[0]}, got {value.device}")
    return value


def check_triangles(tri: object, vertices: int, like: tuple[str, Tensor], *, check_values: bool = True) -> Tensor:
    """Check that ``tri`` is an int32 tensor (T, 3) of vertex indices from 0 to ``vertices`` - 1, and return it.

    Args:
        tri: the argument.
        vertices: number of vertices.
        like: name and value of an argument on the expected device.
        check_values: whether to check that the indices are in range. For a tensor on a GPU, this check waits for the
            GPU.

    Raises:
        TypeError, ValueError: for a wrong type, shape, dtype or device, for too many triangles, or for an index that is
            out of range. The message names the argument, the expected value and the found value.
    """
    if not isinstance(tri, Tensor):
        raise TypeError(f"tri: expected a torch.Tensor, got {type(tri).__name__}")
    if tri.ndim != 2 or tri.shape[1] != 3:
        raise ValueError(f"tri: expected shape (T, 3), got {tuple(tri.shape)}")
    if tri.dtype != torch.int32:
        raise TypeError(f"tri: expected dtype int32, got {str(tri.dtype).removeprefix('torch.')}; use tri.int()")
    if tri.device != like[1].device:
        raise ValueError(f"tri: expected device {like[1].device}, that of {like[0]}, got {tri.device}")
    if tri.shape[0] > MAX_TRIANGLES:
        raise ValueError(f"tri: expected at most {MAX_TRIANGLES} triangles, got {tri.shape[0]}")
    if check_values and tri.numel() > 0:
        low, high = _value_range(tri)
        if low < 0 or high >= vertices:
            wrong = low if low < 0 else high
            raise ValueError(f"tri: expected vertex indices from 0 to {vertices - 1}, got {wrong}")
    return tri


def check_layers(layers: int | None) -> int:
    """Check the maximum number of composited triangles per pixel, and return it. None becomes ALL_LAYERS.

    Raises:
        TypeError, ValueError: with a message that names the argument.
    """
    if layers is None:
        return ALL_LAYERS
    if isinstance(layers, bool) or not isinstance(layers, int):
        raise TypeError(f"layers: expected an integer or None, got {type(layers).__name__}")
    if not 1 <= layers <= ALL_LAYERS:
        raise ValueError(f"layers: expected 1 to {ALL_LAYERS}, got {layers}")
    return layers


def _value_range(values: Tensor) -> tuple[int, int]:
    """Return the smallest and the largest value of an integer tensor with at least one element."""
    if values.device.type == "cpu":
        # torch.aminmax would start OpenMP threads, which keep spinning and delay the threads of the kernels.
        array = values.numpy()
        return int(array.min()), int(array.max())
    low, high = torch.aminmax(values)
    return int(low), int(high)


def check_resolution(resolution: object) -> tuple[int, int]:
    """Check an image size (height, width) in pixels and return it. Raises TypeError, ValueError."""
    if not isinstance(resolution, tuple | list) or len(resolution) != 2:
        raise TypeError(f"resolution: expected (height, width), got {resolution!r}")
    height, width = resolution
    for side in (height, width):
        if isinstance(side, bool) or not isinstance(side, int):
            raise TypeError(f"resolution: expected two integers (height, width), got {tuple(resolution)!r}")
        if not 1 <= side <= MAX_SIDE_PX:
            raise ValueError(f"resolution: expected sides from 1 to {MAX_SIDE_PX} pixels, got {tuple(resolution)}")
    return height, width


def _shape_text(shape: tuple[Axis, ...]) -> str:
    return ", ".join(str(axis) for axis in shape) + ("," if len(shape) == 1 else "")
