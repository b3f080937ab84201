"""Filtered texture sampling (public API).

The mip level of a pixel is the base-2 logarithm of the longer axis of its footprint in the texture, in texels (Heckbert
1989, Fundamentals of Texture Mapping and Image Warping). Let (s, t) = (u * W, v * H) be the position in a texture of
W x H texels, and (X, Y) the position in the image in pixels. Let A = |d(s, t)/dX|^2 and B = |d(s, t)/dY|^2, and let C
be the dot product of d(s, t)/dX and d(s, t)/dY. The level is

    0.5 * log2(0.5 * (A + B) + sqrt(0.25 * (A - B)^2 + C^2)) + bias,

clamped to the existing levels, where ``bias`` is ``mip_level_bias``. For a cube map, u and v are the coordinates on the
cube's face, in [0, 1].
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from torch import Tensor

from fourd.rendering.ops.meshes.backends import Backend, select_backend
from fourd.rendering.ops.meshes.checks import check_tensor
from fourd.rendering.ops.texture import checks
from fourd.rendering.ops.texture.checks import BoundaryMode, FilterMode
from fourd.rendering.ops.texture.op import build_mips, mip_sizes, sample_texture
from fourd.rendering.ops.texture.reference import build_mips_reference, sample_texture_reference


@dataclass(frozen=True)
class Mip:
    """The mip levels of a texture, built by :func:`texture_construct_mip`.

    Attributes:
        levels: mip levels 1, 2 and so on, without gradients. Level k has the shape (B, H / 2^k, W / 2^k, C), in which
            sides below 1 texel are replaced by 1. The levels of a cube map have the six faces along the second axis.
        shape: shape of the texture.
    """

    levels: tuple[Tensor, ...]
    shape: tuple[int, ...]


def texture(
    tex: Tensor,
    uv: Tensor,
    uv_da: Tensor | None = None,
    mip_level_bias: Tensor | None = None,
    mip: Mip | Sequence[Tensor] | None = None,
    filter_mode: FilterMode = "auto",
    boundary_mode: BoundaryMode = "wrap",
    max_mip_level: int | None = None,
    *,
    backend: Backend = "auto",
    threads: int = 0,
) -> Tensor:
    """Sample a texture at every pixel, with the semantics of ``nvdiffrast.torch.texture``. Return an image
    (B, H', W', C).

    The centre of the texel in column j and row i is at (u, v) = ((j + 0.5) / W, (i + 0.5) / H). The result is
    differentiable in tex, uv, uv_da, mip_level_bias and mip levels that are given as tensors. If the mip levels are
    built from tex, the gradient of tex includes their gradients. On the CPU, results and gradients are bit-identical
    for any number of threads.

    Args:
        tex: (B or 1, H, W, C) float32, or (B or 1, 6, N, N, C) for boundary_mode "cube", with faces along +x, -x, +y,
            -y, +z and -z, oriented as in OpenGL. H and W are at most 32,768 texels, and C is at most 4,096.
        uv: (B, H', W', 2) texture coordinates, or (B, H', W', 3) directions of any length for a cube map. Pixels with
            non-finite coordinates or a zero direction have the result 0 and no gradient.
        uv_da: (B, H', W', 4) derivatives of the coordinates with respect to the pixel position in the image: du/dX,
            du/dY, dv/dX, dv/dY. For a cube map, (B, H', W', 6): dx/dX, dx/dY, dy/dX, dy/dY, dz/dX, dz/dY. Pixels whose
            derivatives are NaN use level 0.
        mip_level_bias: (B, H', W') numbers that are added to the mip level. If uv_da is None, they are the mip levels.
        mip: None to build the levels in this call, a :class:`Mip` that was built from tex, or a list of tensors with
            the levels 1, 2 and so on. Each level has half the side lengths of the previous one, rounded down, but at
            least 1.
        filter_mode: "nearest" reads one texel of level 0, and uv gets no gradient. "linear" is bilinear in level 0.
            "linear-mipmap-nearest" is bilinear in one mip level, the computed level rounded down, as in nvdiffrast;
            uv_da and mip_level_bias get no gradient. "linear-mipmap-linear" is trilinear. "auto" is
            "linear-mipmap-linear" if uv_da or mip_level_bias is given, and "linear" otherwise.
        boundary_mode: how coordinates outside [0, 1] are handled: "wrap" repeats the texture, "clamp" repeats the
            texels at its border, and "zero" gives 0. Use "cube" if tex is a cube map. Cube maps are continuous across
            edges; at a corner, where only three texels meet, their mean is used as the fourth.
        max_mip_level: index of the last level that is built and used. If None, all levels down to 1 x 1 are used.
        backend: "reference" for an implementation in plain torch (slow, float32 or float64), "cpu" or "cuda" for the
            float32 kernels, or "auto" for the kernels for the tensors' device.
        threads: number of CPU threads. 0 means the environment variable FOURD_THREADS, or torch.get_num_threads().

    Raises:
        TypeError, ValueError: for an invalid argument. The error message names the argument and the expected value.
        RuntimeError: if the backend was not built.
    """
    filter_mode = _checked_filter(tex, uv, uv_da, mip_level_bias, filter_mode, boundary_mode, max_mip_level, backend)
    pixels = (uv, uv_da, mip_level_bias) if "mipmap" in filter_mode else (uv, None, None)
    levels = _levels(tex, mip, max_mip_level, backend, threads) if "mipmap" in filter_mode else []
    if select_backend(backend, "tex", tex) == "reference":
        return sample_texture_reference([tex, *levels], *pixels, filter_mode, boundary_mode)
    is_chain = mip is None or isinstance(mip, Mip)
    return sample_texture(tex, levels, *pixels, filter_mode, boundary_mode, is_chain, threads)


def texture_construct_mip(
    tex: Tensor,
    max_mip_level: int | None = None,
    cube_mode: bool = False,
    *,
    backend: Backend = "auto",
    threads: int = 0,
) -> Mip:
    """Build the mip levels of a texture once, so that several calls of :func:`texture` can use them with the same
    ``tex``.

    Each texel is the mean of 2 x 2 texels of the previous level, or of 2 texels if that level has a side of one texel.
    Build the levels again if tex changes.

    Args:
        tex: (B, H, W, C) float32, or (B, 6, N, N, C) if cube_mode is True. In every level except the last, sides longer
            than 1 texel must have even lengths.
        max_mip_level: index of the last level. If None, all levels down to 1 x 1 are built.
        cube_mode: whether tex is a cube map.
        backend: as for :func:`texture`.
        threads: as for :func:`texture`.

    Raises:
        TypeError, ValueError: for an invalid argument. The error message names the argument and the expected value.
        RuntimeError: if the backend was not built.
    """
    checks.check_texture(tex, cube_mode, backend)
    checks.check_max_level(max_mip_level)
    return Mip(tuple(_levels(tex.detach(), None, max_mip_level, backend, threads)), tuple(tex.shape))


def _checked_filter(
    tex: Tensor,
    uv: Tensor,
    uv_da: Tensor | None,
    bias: Tensor | None,
    filter_mode: FilterMode,
    boundary_mode: BoundaryMode,
    max_mip_level: int | None,
    backend: Backend,
) -> FilterMode:
    """Check all arguments except ``mip``. Return the filter mode, with "auto" replaced by the mode that it stands
    for."""
    is_cube = boundary_mode == "cube"
    checks.check_modes(filter_mode, boundary_mode)
    checks.check_texture(tex, is_cube, backend)
    checks.check_pixels(tex, uv, uv_da, bias, is_cube)
    checks.check_max_level(max_mip_level)
    has_level = uv_da is not None or bias is not None
    if filter_mode == "auto":
        filter_mode = "linear-mipmap-linear" if has_level else "linear"
    if "mipmap" in filter_mode and not has_level:
        raise ValueError(f"uv_da: expected uv_da or mip_level_bias for filter_mode {filter_mode!r}, got neither")
    return "linear" if "mipmap" in filter_mode and max_mip_level == 0 else filter_mode


def _levels(
    tex: Tensor, mip: Mip | Sequence[Tensor] | None, max_mip_level: int | None, backend: Backend, threads: int
) -> list[Tensor]:
    """Return the mip levels that the caller has given, or build them. Levels that are built for the kernels are
    detached, because the backward pass of the kernels itself adds the gradients of the levels to the gradient of
    ``tex``."""
    is_reference = select_backend(backend, "tex", tex) == "reference"
    if mip is None:
        level_count = checks.count_levels(tex, max_mip_level)
        return (
            build_mips_reference(tex, level_count) if is_reference else build_mips(tex.detach(), level_count, threads)
        )
    given = _given_levels(tex, mip, max_mip_level)
    if not is_reference or not isinstance(mip, Mip):
        return given
    chain = build_mips_reference(tex, 1 + len(given))
    return [level + (one - one.detach()) for level, one in zip(given, chain, strict=True)]


def _given_levels(tex: Tensor, mip: Mip | Sequence[Tensor], max_mip_level: int | None) -> list[Tensor]:
    """Return the mip levels that the caller has given, from level 1 to at most ``max_mip_level``."""
    if isinstance(mip, Mip):
        if mip.shape != tuple(tex.shape):
            raise ValueError(
                f"mip: expected the levels of a texture of shape {tuple(tex.shape)}, got those of shape {mip.shape}"
            )
        levels: Sequence[Tensor] = mip.levels
    elif isinstance(mip, list | tuple):
        levels = mip
    else:
        raise TypeError(f"mip: expected None, a Mip or a list of tensors, got {type(mip).__name__}")
    levels = levels[:max_mip_level]
    sizes = mip_sizes(tex.shape[-3], tex.shape[-2], 1 + len(levels))
    if len(levels) > 1 and sizes[-2] == (1, 1):
        most = sizes.index((1, 1))
        raise ValueError(
            f"mip: expected at most {most} levels for {sizes[0][0]} x {sizes[0][1]} texels, got {len(levels)}"
        )
    for level, (one, size) in enumerate(zip(levels, sizes[1:], strict=True)):
        check_tensor(f"mip[{level}]", one, (*tex.shape[:-3], *size, tex.shape[-1]), like=("tex", tex))
    return list(levels)
