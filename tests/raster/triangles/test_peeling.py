"""Depth layers, and the clip matrix of a camera."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch

from fourd.base.cameras import Camera
from fourd.rendering.ops.meshes.ids import decode_ids
from fourd.rendering.triangles import DepthPeeler, clip_matrix, interpolate, rasterize
from tests.raster.triangles.scenes import soup, with_w

SIZE = (40, 50)


@pytest.mark.parametrize("backend", ["cpu", "reference"])
def test_layers_are_all_triangles_in_order_of_depth(backend: str, rng: np.random.Generator) -> None:
    """Catches triangles that are lost, repeated or out of order. Each triangle is drawn alone to see its pixels."""
    pos, tri = soup(rng, images=1, triangles=12)
    alone = torch.stack([torch.arange(12), torch.ones(12, dtype=torch.int64)], 1).int()
    expected = rasterize(pos[0], tri, SIZE, ranges=alone)[0]
    layers = []
    with DepthPeeler(pos, tri, SIZE, backend=backend) as peeler:
        for _ in range(13):
            layers.append(peeler.rasterize_next_layer()[0][0])
    assert torch.equal(layers[0], rasterize(pos, tri, SIZE, backend=backend)[0][0])
    assert not layers[-1].any()
    stack = torch.stack(layers)
    assert torch.equal((stack[..., 3] > 0).sum(0), (expected[..., 3] > 0).sum(0))
    ids = decode_ids(stack[..., 3])
    for one, other in zip(range(12), range(1, 13), strict=True):
        both = ids[other] >= 0
        assert bool((stack[other, ..., 2] >= stack[one, ..., 2])[both].all())
    for triangle in range(12):
        assert torch.equal((ids == triangle).sum(0), (expected[triangle, ..., 3] > 0).long())


@pytest.mark.parametrize("backend", ["cpu", "reference"])
def test_coincident_triangles_are_in_consecutive_layers(backend: str) -> None:
    """Catches a strict depth test, which loses all but one of the triangles of equal depth."""
    pos = with_w(torch.tensor([[-1.0, -1], [3, -1], [-1, 3]]), 0.25)[None]
    tri = torch.tensor([[0, 1, 2]] * 3, dtype=torch.int32)
    with DepthPeeler(pos, tri, SIZE, backend=backend) as peeler:
        for expected in (1, 2, 3, 0):
            rast, _ = peeler.rasterize_next_layer()
            assert torch.equal(rast[..., 3], torch.full_like(rast[..., 3], expected))


def test_a_layer_behind_has_gradients(rng: np.random.Generator) -> None:
    """Catches layers that pass no gradient to pos, and a peeler that does not start with the nearest layer when it is
    used again.
    """
    pos, tri = soup(rng, images=2)
    pos.requires_grad_()
    with DepthPeeler(pos, tri, SIZE, output_db=False) as peeler:
        peeler.rasterize_next_layer()
        second, rast_db = peeler.rasterize_next_layer()
    assert rast_db.shape[-1] == 0
    assert torch.autograd.grad(second[..., 0].sum(), pos)[0].any()
    with peeler:
        assert torch.equal(peeler.rasterize_next_layer()[0], rasterize(pos, tri, SIZE)[0])
    with pytest.raises(RuntimeError, match="DepthPeeler: expected a call inside `with"):
        peeler.rasterize_next_layer()


def test_the_clip_matrix_keeps_pixels_and_depths(rng: np.random.Generator) -> None:
    """Catches a flipped image, a shift by half a pixel and swapped planes. The interpolated world position of every
    pixel must project to the centre of that pixel."""
    angle = 0.4
    rotation = np.array([[math.cos(angle), 0, math.sin(angle)], [0, 1, 0], [-math.sin(angle), 0, math.cos(angle)]])
    intrinsics = np.array([[60.0, 0.5, 27.0], [0, 55.0, 22.0], [0, 0, 1]])
    camera = Camera(intrinsics, rotation, np.array([0.1, -0.2, 0.3]), 50, 40)
    camera_space = rng.uniform(-1, 1, (30, 3)) + np.array([0, 0, 3.0])
    world = torch.from_numpy((camera_space - camera.translation) @ rotation).float()
    matrix = clip_matrix(camera, 1.0, 10.0)
    pos = torch.cat([world, torch.ones(30, 1)], 1) @ matrix.T
    torch.testing.assert_close(pos[:, 3].double(), torch.from_numpy(camera_space[:, 2]), rtol=1e-5, atol=1e-5)
    tri = torch.from_numpy(rng.permutation(30).reshape(10, 3)).int()
    rast, _ = rasterize(pos[None], tri, (40, 50))
    xyz, _ = interpolate(world, rast, tri)
    row, column = (rast[0, ..., 3] > 0).nonzero(as_tuple=True)
    assert len(row) > 50
    points = xyz[0, row, column].double().numpy() @ rotation.T + camera.translation
    pixels = points @ intrinsics.T
    pixels = pixels[:, :2] / pixels[:, 2:]
    centres = np.stack([column + 0.5, row + 0.5], 1)
    # Coverage is rounded to 1/256 pixel and the weights are clamped.
    np.testing.assert_allclose(pixels, centres, atol=0.02)
    assert np.abs(np.median(pixels - centres, axis=0)).max() < 1e-4
    expected = (11 - 20 / points[:, 2]) / 9
    np.testing.assert_allclose(rast[0, row, column, 2].numpy(), expected, atol=1e-2)


def test_wrong_depths_and_cameras_are_named() -> None:
    """Catches matrices with infinite or negative elements."""
    camera = Camera(np.diag([50.0, 50, 1]), np.eye(3), np.zeros(3), 8, 8)
    with pytest.raises(ValueError, match="near, far: expected 0 < near < far, both finite, got 2 and 1"):
        clip_matrix(camera, 2, 1)
    bent = Camera(np.diag([50.0, 50, 1]), np.eye(3), np.zeros(3), 8, 8, np.array([0.1, 0, 0, 0]))
    with pytest.raises(ValueError, match="camera: expected a pinhole camera without lens distortion"):
        clip_matrix(bent, 1, 2)
    with pytest.raises(TypeError, match=r"camera: expected a fourd\.Camera, got str"):
        clip_matrix("camera", 1, 2)  # type: ignore[arg-type]
