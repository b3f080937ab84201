"""Filtered texture lookup: the operator ``torch.ops.fourd.sample_texture``, its gradient, and the mip levels."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

from fourd.rendering.ops.gpu import contiguous, load_gpu, uses_gpu_kernels
from fourd.rendering.ops.loading import as_array, load_native, simd_name, thread_count
from fourd.rendering.ops.operator import operator


def mip_sizes(height: int, width: int, level_count: int) -> list[tuple[int, int]]:
    """Return (height, width) of all levels. Each level has half the side lengths of the previous one, rounded down, but
    at least one texel."""
    return [(max(height >> level, 1), max(width >> level, 1)) for level in range(level_count)]


@operator("fourd::build_texture_mips", outputs=lambda tex, level_count: _empty_mips(tex, level_count))
def build_mips(tex: Tensor, level_count: int, threads: int) -> list[Tensor]:
    """Compute levels 1 to ``level_count`` - 1 of a float32 texture (B, H, W, C) or (B, 6, H, H, C).

    A texel is the mean of 2 x 2 texels of the finer level, or of 2 texels if an axis has only one texel. In all levels
    except the last, sides longer than 1 texel must be even. The function is not differentiable, because
    :func:`sample_texture` already adds the gradients of the levels to the gradient of ``tex``.
    """
    mips = _empty_mips(tex, level_count)
    if uses_gpu_kernels(tex):
        gpu = load_gpu(tex.device)
        with gpu.activate():
            gpu.kernels.build_mips(contiguous(_image(tex)), gpu.stream, [_image(mip) for mip in mips])
        return mips
    outputs = [_image(mip).numpy() for mip in mips]
    load_native().build_mips(as_array(_image(tex)), _threads(threads), simd_name(), outputs)
    return mips


@operator("fourd::sample_texture", outputs=lambda tex, uv: _empty_picture(tex, uv))
def sample_texture(
    tex: Tensor,
    mips: Sequence[Tensor],
    uv: Tensor,
    uv_da: Tensor | None,
    bias: Tensor | None,
    filter_mode: str,
    boundary_mode: str,
    is_chain: bool,
    threads: int,
) -> Tensor:
    """Sample a texture at the positions ``uv``. :func:`fourd.rendering.triangles.texture` checks the arguments, and
    documents those that are not listed below.

    Args:
        mips: levels 1 and up.
        is_chain: True if :func:`build_mips` has built ``mips``, so that the gradients of the mip levels are added to
            the gradient of ``tex``. If False, each level gets its own gradient.
    """
    out = _empty_picture(tex, uv)
    modes = (filter_mode, boundary_mode)
    if uses_gpu_kernels(tex):
        gpu = load_gpu(tex.device)
        tensors = ([contiguous(_image(level)) for level in (tex, *mips)], *_pixel_rows(uv, uv_da, bias))
        with gpu.activate():
            gpu.kernels.sample_texture(*tensors, *modes, gpu.stream, out.flatten(1, 2))
        return out
    arrays = ([as_array(_image(level)) for level in (tex, *mips)], *map(_optional_array, _pixel_rows(uv, uv_da, bias)))
    load_native().sample_texture(*arrays, *modes, _threads(threads), simd_name(), as_array(out.flatten(1, 2)))
    return out


@operator(
    "fourd::sample_texture_backward",
    outputs=lambda tex, mips, uv, uv_da, bias, is_chain, needs: _empty_gradients(tex, mips, uv, uv_da, bias, needs)[
        : 4 if is_chain else None
    ],
)
def _sample_backward(
    tex: Tensor,
    mips: Sequence[Tensor],
    uv: Tensor,
    uv_da: Tensor | None,
    bias: Tensor | None,
    filter_mode: str,
    boundary_mode: str,
    is_chain: bool,
    threads: int,
    gradient: Tensor,
    needs: Sequence[bool],
) -> list[Tensor]:
    """Compute the gradients of ``uv``, ``uv_da``, ``bias``, ``tex`` and ``mips``. The four bools ``needs`` select the
    gradients of ``uv``, ``uv_da``, ``bias`` and the texture; gradients that are not selected are empty tensors. If
    ``is_chain`` is True, the result has no gradients of ``mips``."""
    out = _empty_gradients(tex, mips, uv, uv_da, bias, needs)
    to_levels = [_image(level) for level in out[3:]] if needs[3] else []
    to_pixels = [one.flatten(1, 2) if needed else None for one, needed in zip(out[:3], needs[:3], strict=True)]
    modes = (filter_mode, boundary_mode)
    if uses_gpu_kernels(tex):
        gpu = load_gpu(tex.device)
        tensors = ([contiguous(_image(level)) for level in (tex, *mips)], *_pixel_rows(uv, uv_da, bias))
        with gpu.activate():
            gpu.kernels.sample_texture_backward(
                *tensors, *modes, gpu.stream, contiguous(gradient.flatten(1, 2)), is_chain, to_levels, *to_pixels
            )
        return out[:4] if is_chain else out
    load_native().sample_texture_backward(
        [as_array(_image(level)) for level in (tex, *mips)],
        *map(_optional_array, _pixel_rows(uv, uv_da, bias)),
        *modes,
        _threads(threads),
        simd_name(),
        as_array(gradient.flatten(1, 2)),
        is_chain,
        [level.numpy() for level in to_levels],
        *map(_optional_array, to_pixels),
    )
    return out[:4] if is_chain else out


def _setup(ctx: Any, inputs: tuple[Any, ...], output: Tensor) -> None:
    tex, mips, uv, uv_da, bias, *settings = inputs
    ctx.save_for_backward(tex, uv, uv_da, bias, *mips)
    ctx.settings = tuple(settings)


def _backward(ctx: Any, gradient: Tensor) -> tuple[Any, ...]:
    tex, uv, uv_da, bias, *mips = ctx.saved_tensors
    is_chain = ctx.settings[2]
    needs_tex, needs_mips, needs_uv, needs_uv_da, needs_bias, *_ = ctx.needs_input_grad
    needs_mips = not is_chain and (any(needs_mips) if isinstance(needs_mips, list | tuple) else bool(needs_mips))
    needs = [bool(needs_uv), bool(needs_uv_da), bool(needs_bias), bool(needs_tex or needs_mips)]
    found = _sample_backward(tex, mips, uv, uv_da, bias, *ctx.settings, gradient, needs)
    to_uv, to_uv_da, to_bias, to_tex, *to_mips = found
    return (
        to_tex if needs_tex else None,
        to_mips if needs_mips else [None] * len(mips),
        to_uv if needs[0] else None,
        to_uv_da if needs[1] else None,
        to_bias if needs[2] else None,
        None,
        None,
        None,
        None,
    )


sample_texture.register_autograd(_backward, setup_context=_setup)


def _image(tex: Tensor) -> Tensor:
    """Reshape a texture or a mip level to (items, faces, height, width, channels)."""
    return tex if tex.ndim == 5 else tex.unsqueeze(1)


def _threads(threads: int) -> int:
    return thread_count(threads, torch.get_num_threads())


def _pixel_rows(uv: Tensor, uv_da: Tensor | None, bias: Tensor | None) -> tuple[Tensor | None, ...]:
    """Flatten the rows and columns of the three inputs, which have one element per output pixel. Return contiguous
    tensors (B, H' * W', channels), or (B, H' * W') for the bias."""
    return tuple(None if value is None else contiguous(value).flatten(1, 2) for value in (uv, uv_da, bias))


def _optional_array(value: Tensor | None) -> Any:
    return None if value is None else as_array(value)


def _empty_mips(tex: Tensor, level_count: int) -> list[Tensor]:
    sizes = mip_sizes(tex.shape[-3], tex.shape[-2], level_count)[1:]
    return [tex.new_empty(*tex.shape[:-3], *size, tex.shape[-1]) for size in sizes]


def _empty_picture(tex: Tensor, uv: Tensor) -> Tensor:
    return tex.new_empty(*uv.shape[:3], tex.shape[-1])


def _empty_gradients(
    tex: Tensor,
    mips: Sequence[Tensor],
    uv: Tensor,
    uv_da: Tensor | None,
    bias: Tensor | None,
    needs: Sequence[bool],
) -> list[Tensor]:
    """Allocate the gradients of ``uv``, ``uv_da``, ``bias`` and all levels. Gradients that are not needed are empty
    tensors."""
    wanted = [*zip((uv, uv_da, bias), needs[:3], strict=True), *((level, needs[3]) for level in (tex, *mips))]
    return [
        uv.new_empty(0) if value is None or not needed else value.new_empty(value.shape) for value, needed in wanted
    ]
