"""Arguments that nvdiffrast accepts and fourd.rendering.triangles does not."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

import fourd.rendering.nvdiffrast as dr
from fourd.rendering import triangles

POS = torch.tensor([[[-0.8, -0.8, 0, 1], [0.8, -0.8, 0, 1], [-0.8, 0.8, 0, 1.0], [0.8, 0.8, 0.1, 1]]])
TRI = torch.tensor([[0, 1, 2], [1, 3, 2]], dtype=torch.int32)
ATTR = torch.tensor([[[0.0, 1, 2], [1, 0, 5], [3, 2, 1], [4, 4, 4]]])


def draw(tri: Tensor = TRI, **options: Any) -> tuple[Tensor, Tensor]:
    return dr.rasterize(dr.RasterizeCudaContext(), POS, tri, np.array([16, 17]), **options)


def test_ranges_are_ignored_with_a_mesh_for_each_image() -> None:
    """Catches an error for an argument that nvdiffrast ignores."""
    ranges = torch.tensor([[0, 1]], dtype=torch.int32)
    with pytest.warns(UserWarning, match=r"ranges: ignored, because pos \(B, V, 4\) has one mesh for each image"):
        found, _ = draw(ranges=ranges)
    assert torch.equal(found, draw()[0])


@pytest.mark.parametrize("chosen", [np.array([2, -3]), [np.int64(2), np.int32(-3)], torch.tensor([2, -3]), (2, -3)])
def test_diff_attrs_of_any_integers(chosen: Any) -> None:
    """Catches an error for NumPy integers and arrays."""
    rast, rast_db = draw()
    found = dr.interpolate(ATTR, rast, TRI, rast_db, diff_attrs=chosen)
    expected = triangles.interpolate(ATTR, rast, TRI, rast_db, [2, 0])
    assert all(torch.equal(a, b) for a, b in zip(found, expected, strict=True))


def test_diff_attrs_beyond_the_attributes_are_zero() -> None:
    """Catches an error, derivatives of another channel, and gradients that do not pass the inserted zeros."""
    rast, rast_db = draw()
    attr = ATTR.clone().requires_grad_()
    with pytest.warns(UserWarning, match="diff_attrs: attr has 3 channels; the derivatives of -4, 3 are 0"):
        _, found = dr.interpolate(attr, rast, TRI, rast_db, diff_attrs=[3, 1, -4, 1])
    expected = triangles.interpolate(ATTR, rast, TRI, rast_db, [1])[1]
    assert torch.equal(found[..., 2:4], expected)
    assert torch.equal(found[..., 6:8], expected)
    assert not found[..., [0, 1, 4, 5]].any()
    found.sum().backward()
    assert attr.grad is not None
    assert attr.grad[..., 1].any()
    assert not attr.grad[..., [0, 2]].any()
    with pytest.warns(UserWarning, match="the derivatives of 9 are 0"):
        assert dr.interpolate(ATTR, rast, TRI, rast_db, diff_attrs=[9])[1].shape == (1, 16, 17, 2)
    with pytest.raises(TypeError, match="diff_attrs: expected a list of channels or 'all', got 'none'"):
        dr.interpolate(ATTR, rast, TRI, rast_db, diff_attrs="none")  # type: ignore[arg-type]


@pytest.mark.parametrize("rast_db", [torch.zeros(1), torch.zeros(1, 16, 17, 0), torch.zeros(3, 2, 2, 4)])
@pytest.mark.parametrize("diff", [None, []])
def test_derivatives_that_are_not_used_have_any_shape(rast_db: Tensor, diff: Any) -> None:
    """Catches a check of ``rast_db`` that is not used."""
    rast, _ = draw()
    found, da = dr.interpolate(ATTR, rast, TRI, rast_db, diff)
    assert torch.equal(found, triangles.interpolate(ATTR, rast, TRI, rast_db, diff)[0])
    assert da.shape == (1, 16, 17, 0)


def test_texture_ignores_what_its_filter_does_not_use() -> None:
    """Catches an error for ``uv_da`` of width 0 and for a bias of any shape, and a bias without ``uv_da``."""
    tex, uv = torch.rand(1, 8, 8, 3), torch.rand(1, 5, 5, 2)
    expected = triangles.texture(tex, uv, filter_mode="linear")
    for uv_da, bias in ((torch.zeros(1, 5, 5, 0), None), (None, torch.ones(1, 5, 5)), (uv, torch.ones(2))):
        assert torch.equal(dr.texture(tex, uv, uv_da, bias, filter_mode="linear"), expected)
        nearest = triangles.texture(tex, uv, filter_mode="nearest")
        assert torch.equal(dr.texture(tex, uv, uv_da, bias, filter_mode="nearest"), nearest)
    level = torch.full((1, 5, 5), 1.2)
    given = [torch.rand(1, 4, 4, 3), torch.rand(1, 2, 2, 3)]
    for mode in ("auto", "linear-mipmap-nearest"):
        found = dr.texture(tex, uv, torch.zeros(1, 5, 5, 0), level, given, mode, max_mip_level=np.int64(1))
        assert torch.equal(found, triangles.texture(tex, uv, None, level, given, mode))  # type: ignore[arg-type]


def test_triangles_with_indices_out_of_range_are_skipped() -> None:
    """Catches an error, a read beyond the vertices, ids that are shifted, and attributes of another vertex."""
    tri = torch.tensor([[0, 1, 9], [0, 1, 2], [-1, 3, 2], [1, 3, 2]], dtype=torch.int32)
    with pytest.warns(UserWarning, match="tri: 2 of 4 triangles have a vertex index outside 0 to 3 and are skipped"):
        rast, rast_db = draw(tri)
    expected, _ = draw()
    assert torch.equal(rast[..., :3], expected[..., :3])
    assert torch.equal(rast[..., 3], 2 * expected[..., 3])
    shown = rast.clone()
    shown[:, :8, :, 3] = 1
    with pytest.warns(UserWarning, match="2 of 4 triangles"):
        out, out_da = dr.interpolate(ATTR, shown, tri, rast_db, "all")
    assert not out[:, :8].any()
    assert not out_da[:, :8].any()
    assert torch.equal(out[:, 8:], triangles.interpolate(ATTR, expected, TRI)[0][:, 8:])
    color = (rast[..., 3:] > 0).float()
    with pytest.warns(UserWarning, match="2 of 4 triangles"):
        found = dr.antialias(color, rast, POS, tri)
    assert torch.equal(found, triangles.antialias(color, expected, POS, TRI))
    with pytest.warns(UserWarning, match="outside 0 to"):
        topology = dr.antialias_construct_topology_hash(tri)
    with pytest.warns(UserWarning, match="2 of 4 triangles"):
        assert torch.equal(dr.antialias(color, rast, POS, tri, topology), found)
    with (
        pytest.warns(UserWarning, match="2 of 4"),
        dr.DepthPeeler(dr.RasterizeCudaContext(), POS, tri, (16, 17)) as peeler,
    ):
        assert torch.equal(peeler.rasterize_next_layer()[0], rast)


def test_valid_arguments_give_no_warning() -> None:
    """Catches a warning in every call."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        rast, rast_db = draw()
        uv, uv_da = dr.interpolate(ATTR[..., :2], rast, TRI, rast_db, "all")
        color = dr.texture(torch.rand(1, 8, 8, 3), uv, uv_da)
        dr.antialias(color, rast, POS, TRI)
