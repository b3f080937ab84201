"""Texture lookups compared with values computed by hand."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor

from fourd.rendering.triangles import texture, texture_construct_mip

BACKENDS = ["cpu", "reference"]


def at(*positions: tuple[float, ...]) -> Tensor:
    """Return positions as a picture of one row."""
    return torch.tensor(positions)[None, None]


def level_picture(size: int, levels: int) -> list[Tensor]:
    """Return mip levels. The value of each texel is the number of its level."""
    return [torch.full((1, max(size >> k, 1), max(size >> k, 1), 1), float(k)) for k in range(levels)]


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("level", [0, 1, 2, 3, 4.5])
@pytest.mark.parametrize("angle", [0, 0.7])
def test_a_footprint_of_two_to_the_k_texels_reads_level_k(level: float, angle: float, backend: str) -> None:
    """Catches a level that is off by one, that uses the shorter axis, or that ignores the size of the texture."""
    base, *mips = level_picture(64, 7)
    long, short = 2**level / 64, 0.3 * 2**level / 64
    # In the image, the long axis of the footprint is along Y. In the texture, it is rotated by ``angle``.
    da = [short * math.cos(angle), -long * math.sin(angle), short * math.sin(angle), long * math.cos(angle)]
    found = texture(base, at((0.3, 0.6)), torch.tensor(da)[None, None, None], mip=mips, backend=backend)
    assert found.item() == pytest.approx(level, abs=1e-5)
    biased = texture(base, at((0.3, 0.6)), torch.tensor(da)[None, None, None], torch.full((1, 1, 1), 0.75), mip=mips)
    assert biased.item() == pytest.approx(min(level + 0.75, 6), abs=1e-5)


@pytest.mark.parametrize("backend", BACKENDS)
def test_the_bias_alone_is_the_level(backend: str) -> None:
    """Catches levels that are not clamped. Also catches a lookup without uv_da whose level is not 0 before the bias is
    added."""
    base, *mips = level_picture(16, 5)
    bias = torch.tensor([-2.0, 0, 0.25, 1.5, 4, 9, math.nan, math.inf, -math.inf])[None, None]
    uv = torch.full((1, 1, 9, 2), 0.4)
    found = texture(base, uv, None, bias, mip=mips, backend=backend)
    torch.testing.assert_close(found.flatten(), torch.tensor([0, 0, 0.25, 1.5, 4, 4, 0, 4, 0]))
    nearest = texture(base, uv, None, bias, mip=mips, filter_mode="linear-mipmap-nearest", backend=backend)
    assert nearest.flatten().tolist() == [0, 0, 0, 1, 4, 4, 0, 4, 0]
    limited = texture(base, uv, None, bias, mip=mips, max_mip_level=2, backend=backend)
    assert limited.max() == 2


def assert_levels_are_rounded_down(backend: str, device: str | torch.device = "cpu") -> None:
    mips = [torch.full((1, side, side, 1), float(level), device=device) for level, side in ((1, 4), (2, 2), (3, 1))]
    bias = torch.tensor([-0.5, 0.5, 0.99, 1.0, 1.6, 2.5, 2.999, 3.0, 7.0], device=device)[None, None].requires_grad_()
    uv = torch.full((1, 1, 9, 2), 0.4, device=device)
    tex = torch.zeros(1, 8, 8, 1, device=device, requires_grad=True)
    found = texture(tex, uv, None, bias, mip=mips, filter_mode="linear-mipmap-nearest", backend=backend)
    assert found.flatten().tolist() == [0, 0, 0, 1, 1, 2, 2, 3, 3]
    (gradient,) = torch.autograd.grad(found.sum(), bias, allow_unused=True)
    assert gradient is None or not gradient.any()


@pytest.mark.parametrize("backend", BACKENDS)
def test_mipmap_nearest_reads_the_level_rounded_down(backend: str) -> None:
    """Catches a level that is rounded to the nearest one; nvdiffrast rounds down."""
    assert_levels_are_rounded_down(backend)


def test_mipmap_nearest_reads_the_level_rounded_down_on_a_gpu(gpu: torch.device) -> None:
    """Catches a GPU kernel that rounds levels in another way than the CPU kernel."""
    assert_levels_are_rounded_down("auto", gpu)


@pytest.mark.parametrize("backend", BACKENDS)
def test_a_ramp_is_reproduced_between_texel_centres(backend: str) -> None:
    """Catches texel centres at the corners of texels, and swapped axes."""
    columns, rows = torch.meshgrid(torch.arange(8.0), torch.arange(4.0), indexing="xy")
    tex = torch.stack([columns + 0.5, rows + 0.5], -1)[None]
    uv = torch.rand(1, 20, 20, 2, generator=torch.Generator().manual_seed(1)) * 0.75 + 0.125
    found = texture(tex, uv, backend=backend)
    torch.testing.assert_close(found, uv * torch.tensor([8.0, 4.0]))


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize(
    ("mode", "expected"),
    [
        # The texture is a row of the texels 1, 2, 3 and 4, with centres at u = 0.125, 0.375, 0.625 and 0.875. The
        # lookups are at u = -0.25, 0, 1 and 1.125.
        ("wrap", [3.5, 2.5, 2.5, 1.0]),
        ("clamp", [1.0, 1.0, 4.0, 4.0]),
        ("zero", [0.0, 0.5, 2.0, 0.0]),
    ],
)
def test_borders(mode: str, expected: list[float], backend: str) -> None:
    """Catches a border texel with the wrong neighbour, on either side and along either axis."""
    row = torch.tensor([1.0, 2, 3, 4])
    places = torch.tensor([-0.25, 0, 1, 1.125])
    across = torch.stack([places, torch.full((4,), 0.5)], -1)[None, None]
    found = texture(row.view(1, 1, 4, 1), across, boundary_mode=mode, backend=backend)  # type: ignore[arg-type]
    assert found.flatten().tolist() == pytest.approx(expected)
    found = texture(row.view(1, 4, 1, 1), across.flip(-1), boundary_mode=mode, backend=backend)  # type: ignore[arg-type]
    assert found.flatten().tolist() == pytest.approx(expected)


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize(
    ("mode", "expected"), [("wrap", [4, 1, 4, 1, 1]), ("clamp", [1, 1, 4, 4, 4]), ("zero", [0, 1, 4, 0, 0])]
)
def test_nearest_texels(mode: str, expected: list[float], backend: str) -> None:
    """Catches rounding to the nearest centre instead of the texel that contains the position."""
    row = torch.tensor([1.0, 2, 3, 4]).view(1, 1, 4, 1)
    uv = at((-0.001, 0.5), (0, 0.5), (0.999, 0.5), (1, 0.5), (1.001, 0.5))
    found = texture(row, uv, filter_mode="nearest", boundary_mode=mode, backend=backend)  # type: ignore[arg-type]
    assert found.flatten().tolist() == expected


@pytest.mark.parametrize("backend", BACKENDS)
def test_mips_are_means(backend: str) -> None:
    """Catches mip levels that drop texels, and an axis of one texel that is halved further."""
    tex = torch.arange(16.0).view(1, 2, 8, 1)
    levels = texture_construct_mip(tex, backend=backend).levels
    assert [tuple(one.shape[1:3]) for one in levels] == [(1, 4), (1, 2), (1, 1)]
    assert levels[0].flatten().tolist() == [4.5, 6.5, 8.5, 10.5]
    assert levels[1].flatten().tolist() == [5.5, 9.5]
    assert levels[2].item() == 7.5
    tall = texture_construct_mip(tex.view(1, 8, 2, 1), 2, backend=backend).levels
    assert tall[0].flatten().tolist() == [1.5, 5.5, 9.5, 13.5]
    assert tall[1].flatten().tolist() == [3.5, 11.5]


def test_odd_sizes_need_a_limit() -> None:
    """Catches a chain that drops the last row of an odd level, and a limit that is off by one."""
    tex = torch.zeros(1, 12, 20, 1)
    message = (
        r"tex: expected even sides in every level before the last, got 3 x 5 texels in level 2; resize tex, pass "
        r"max_mip_level=2, or pass mip levels as tensors"
    )
    with pytest.raises(ValueError, match=message):
        texture_construct_mip(tex)
    with pytest.raises(ValueError, match="tex: expected even sides"):
        texture(tex, torch.zeros(1, 1, 1, 2), torch.zeros(1, 1, 1, 4))
    assert len(texture_construct_mip(tex, 2).levels) == 2
    assert len(texture_construct_mip(torch.zeros(1, 1, 64, 1)).levels) == 6
    # A lookup without mip levels accepts any size.
    assert texture(torch.ones(1, 3, 5, 1), torch.zeros(1, 1, 1, 2)).item() == 1


@pytest.mark.parametrize("backend", BACKENDS)
def test_own_levels_may_have_odd_sizes(backend: str) -> None:
    """Catches expected sizes of given mip levels that are computed by rounding up."""
    base, first, second = torch.zeros(1, 5, 7, 1), torch.ones(1, 2, 3, 1), torch.full((1, 1, 1, 1), 2.0)
    bias = torch.tensor([[[0.5, 1.75]]])
    found = texture(base, at((0.1, 0.2), (0.8, 0.9)), None, bias, mip=[first, second], backend=backend)
    assert found.flatten().tolist() == pytest.approx([0.5, 1.75])


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("mode", ["wrap", "clamp", "zero", "cube"])
@pytest.mark.parametrize("filter_mode", ["nearest", "linear", "linear-mipmap-linear"])
def test_positions_that_are_not_finite_give_zero(filter_mode: str, mode: str, backend: str) -> None:
    """Catches NaN that spreads into the picture or into gradients, and reads at the index of a NaN."""
    is_cube = mode == "cube"
    tex = torch.ones(1, *((6, 4, 4, 1) if is_cube else (4, 4, 1))).requires_grad_()
    bad = [math.nan, math.inf, -math.inf]
    uv = torch.full((1, 1, 8, 3 if is_cube else 2), 0.5)
    for pixel, value in enumerate(bad):
        uv[0, 0, pixel, 0] = value
        uv[0, 0, 3 + pixel, -1] = value
    uv[0, 0, 6] = 0 if is_cube else math.nan
    uv.requires_grad_()
    da = torch.full((1, 1, 8, 6 if is_cube else 4), math.nan).requires_grad_()
    found = texture(tex, uv, da, filter_mode=filter_mode, boundary_mode=mode, backend=backend)  # type: ignore[arg-type]
    assert found.flatten().tolist() == [0] * 7 + [1]
    gradients = torch.autograd.grad(found.sum(), [tex, uv], allow_unused=True)
    assert gradients[0].sum() == 1
    assert gradients[1] is None or gradients[1][0, 0, :7].eq(0).all()


def test_huge_coordinates_stay_inside_the_texture() -> None:
    """Catches a conversion of a large float to an integer, which is undefined."""
    values = torch.tensor([3e38, -3e38, 1e20, 8388609.0, -8388609.5, 2147483648.0, 1e-42, -1e-42])
    uv = torch.cartesian_prod(values, values)[None, None]
    for mode in ("wrap", "clamp", "zero"):
        for filter_mode in ("nearest", "linear"):
            found = texture(torch.ones(1, 4, 4, 1), uv, filter_mode=filter_mode, boundary_mode=mode)  # type: ignore[arg-type]
            assert found.isfinite().all()
            assert mode == "zero" or found.eq(1).all()


def test_one_texture_serves_all_pictures() -> None:
    """Catches a batch of pictures that reads past the end of a texture without a batch axis. Also catches textures that
    are assigned to the wrong pictures.
    """
    tex = torch.tensor([1.0, 2]).view(2, 1, 1, 1)
    uv = torch.zeros(2, 1, 3, 2)
    assert texture(tex, uv).flatten().tolist() == [1, 1, 1, 2, 2, 2]
    assert texture(tex[:1], uv).flatten().tolist() == [1] * 6
