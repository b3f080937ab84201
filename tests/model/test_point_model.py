"""The point model: its parts compared with explicit formulas, and every ablation."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np
import pytest
import torch

from fourd.base.cameras import Camera, look_at
from fourd.reconstruction.model import ModelConfig, PlanesConfig, PointModel
from fourd.reconstruction.model.appearance import BlendHead, ImageEncoder, blend, mix_own_colours
from fourd.reconstruction.model.sources import SourceViews, project_points, sample_sources
from fourd.reconstruction.model.spherical_harmonics import sh_basis

SMALL = ModelConfig(planes=PlanesConfig(levels=2, features=4, base_resolution=8), hidden=16)
INTRINSICS = np.array([[40.0, 0, 16], [0, 40, 16], [0, 0, 1]])


def ring(count: int) -> tuple[Camera, ...]:
    up = np.array([0.0, 0, 1])
    angles = np.arange(count) * 2 * np.pi / count
    centres = [np.array([3 * np.cos(a), 3 * np.sin(a), 0.5]) for a in angles]
    return tuple(look_at(centre, np.zeros(3), up, INTRINSICS, 32, 32) for centre in centres)


def views(count: int = 3) -> SourceViews:
    generator = torch.Generator().manual_seed(5)
    images = torch.rand(count, 3, 32, 32, generator=generator)
    return SourceViews(images, torch.ones(count, 32, 32), None, ring(count))


def points(count: int = 20) -> torch.Tensor:
    return torch.rand(count, 3, generator=torch.Generator().manual_seed(6)) - 0.5


def model(config: ModelConfig) -> PointModel:
    torch.manual_seed(0)
    return PointModel(config, np.full(3, -0.5), np.full(3, 0.5), 0.02, frame_count=5)


def test_sh_basis_is_orthonormal() -> None:
    """Catches a wrong constant or swapped terms. For the vector Y of SH values, the mean of Y Y^T over the sphere,
    times 4 pi, must be the identity."""
    u, phi = np.meshgrid((np.arange(400) + 0.5) / 200 - 1, (np.arange(400) + 0.5) * np.pi / 200)
    ring_radius = np.sqrt(1 - u**2)
    directions = np.stack([ring_radius * np.cos(phi), ring_radius * np.sin(phi), u], axis=-1).reshape(-1, 3)
    basis = sh_basis(torch.from_numpy(directions))
    gram = (basis.T @ basis) / len(directions) * 4 * np.pi
    torch.testing.assert_close(gram, torch.eye(16, dtype=torch.float64), atol=1e-3, rtol=0)


def test_batched_projection_equals_camera_project() -> None:
    """Catches a transposed rotation in the batched projection."""
    cameras = ring(3)
    pixels, depth = project_points(points(), cameras)
    for i, camera in enumerate(cameras):
        expected, expected_depth = camera.project(points().numpy())
        np.testing.assert_allclose(pixels[i].numpy(), expected, atol=1e-3)
        np.testing.assert_allclose(depth[i].numpy(), expected_depth, atol=1e-5)


def test_samples_are_the_pixels_at_the_points() -> None:
    """Catches a half-pixel shift. A point at the centre of a pixel must get exactly the colour of that pixel."""
    camera = Camera(INTRINSICS, np.eye(3), np.zeros(3), 32, 32)
    images = torch.rand(1, 3, 32, 32, generator=torch.Generator().manual_seed(1))
    row, column = 9, 20
    xyz = torch.tensor([[(column + 0.5 - 16) / 40, (row + 0.5 - 16) / 40, 1.0]])
    sources = SourceViews(images, torch.ones(1, 32, 32), None, (camera,))
    samples = sample_sources(xyz, sources, None, torch.full((len(xyz),), 0.01))
    torch.testing.assert_close(samples.colours[0, 0], images[0, :, row, column], atol=1e-5, rtol=0)


def test_occluded_points_and_background_have_no_visibility() -> None:
    """Catches occlusion or mattes that do not reduce visibility, and points behind the camera that are visible."""
    camera = Camera(INTRINSICS, np.eye(3), np.zeros(3), 32, 32)
    matte = torch.ones(1, 32, 32)
    matte[:, :, :16] = 0
    depth = torch.full((1, 32, 32), 2.0)
    sources = SourceViews(torch.rand(1, 3, 32, 32), matte, depth, (camera,))
    xyz = torch.tensor([[0.1, 0, 2.0], [0.1, 0, 3.0], [-0.2, 0, 2.0], [0.1, 0, -2.0]])
    visibility = sample_sources(xyz, sources, None, torch.full((len(xyz),), 0.01)).visibility[0]
    torch.testing.assert_close(visibility, torch.tensor([1.0, 0, 0, 0]), atol=1e-4, rtol=0)


def test_blend_is_a_softmax_over_visible_views() -> None:
    logits = torch.tensor([[0.0], [0.0], [3.0]])
    colours = torch.tensor([[[1.0, 0, 0]], [[0, 1.0, 0]], [[0, 0, 1.0]]])
    mixed = blend(logits, torch.tensor([[1.0], [1.0], [0.0]]), colours)
    torch.testing.assert_close(mixed, torch.tensor([[0.5, 0.5, 0]]))


def test_view_weights_scale_the_softmax() -> None:
    """Catches view weights that are not normalized, and a point that no view sees and that ignores the view weights."""
    logits = torch.tensor([[0.0, 0.0], [0.0, 0.0]])
    colours = torch.tensor([[1.0, 0, 0], [0, 1.0, 0]])[:, None].expand(2, 2, 3)
    visibility = torch.tensor([[1.0, 0.0], [1.0, 0.0]])
    mixed = blend(logits, visibility, colours, view_weights=torch.tensor([0.6, 0.2]))
    torch.testing.assert_close(mixed, torch.tensor([[0.75, 0.25, 0], [0.75, 0.25, 0]]))


def test_own_colours_are_mixed_into_every_view_and_stay_bytes() -> None:
    """Catches view-independent colours that are mixed only into the colours of occluded views, and mixed colours that
    an exported scene cannot store."""
    colours, own = torch.tensor([[[0.2, 0.5, 1.0]], [[0.4, 0.0, 1.0]]]), torch.tensor([[1.0, -0.5, 1.5]])
    mixed = mix_own_colours(colours, torch.tensor([[1.0], [0.0]]), own, 0.4)
    torch.testing.assert_close(mixed, torch.tensor([[[0.52, 0.1, 1.0]], [[0.64, 0.0, 1.0]]]))


@pytest.mark.parametrize("visibility", [0.0, 1e-6, 0.9e-3])
def test_views_of_low_visibility_have_no_weight(visibility: float) -> None:
    """Catches colours from views in which the point is occluded, and missing colours of points that are visible in no
    view."""
    logits = torch.tensor([[0.0], [5.0]], requires_grad=True)
    colours = torch.tensor([[[0.2, 0.4, 0.6]], [[1.0, 0.0, 0.0]]])
    assert torch.equal(blend(logits, torch.tensor([[1.0], [visibility]]), colours), colours[0])
    unseen = blend(logits, torch.full((2, 1), visibility), colours)
    torch.testing.assert_close(unseen, colours.mean(0))
    (gradient,) = torch.autograd.grad(unseen.sum(), logits)
    assert torch.equal(gradient, torch.zeros(2, 1))


def test_occlusion_depends_on_the_point_s_own_spacing() -> None:
    """Catches one decay length of occlusion for all points. Sparse walls would then occlude themselves, or dense points
    would be visible through walls."""
    camera = Camera(INTRINSICS, np.eye(3), np.zeros(3), 32, 32)
    sources = SourceViews(torch.rand(1, 3, 32, 32), torch.ones(1, 32, 32), torch.full((1, 32, 32), 2.0), (camera,))
    xyz = torch.tensor([[0.0, 0, 2.1]]).expand(3, 3)
    visibility = sample_sources(xyz, sources, None, torch.tensor([0.1, 0.01, 0.0])).visibility[0]
    torch.testing.assert_close(visibility, torch.tensor([1.0, float(np.exp(-8)), 0.0]), atol=1e-5, rtol=0)


def test_the_split_first_layer_equals_the_joint_layer() -> None:
    """Catches an error in the part of the first layer that is computed once for all views."""
    head = BlendHead(6, 5, SMALL)
    features, samples = torch.rand(4, 6), torch.rand(3, 4, 5)
    concatenated = torch.cat([features.expand(3, -1, -1), samples], dim=-1)
    weight = torch.cat([head.point.weight, head.image.weight], dim=1)
    hidden = torch.relu(concatenated @ weight.T + head.point.bias)
    raw = head.out(hidden)[..., 0]
    torch.testing.assert_close(head(head.point(features), samples), 5 * torch.tanh(raw / 5))


@pytest.mark.parametrize("stride", [1, 2])
def test_a_crop_has_the_features_of_the_whole_image(stride: int) -> None:
    """Catches normalisation over the image. The features of training crops would then differ from those of whole
    images."""
    encoder = ImageEncoder(8, stride)
    side, margin = 96 * stride, 16 * stride
    image = torch.rand(1, 3, side, side)
    inside = slice(margin, side - margin)
    whole, crop = encoder(image), encoder(image[:, :, inside, inside])
    assert whole.shape == (1, 8, 96, 96)
    torch.testing.assert_close(whole[:, :, 40:56, 40:56], crop[:, :, 24:40, 24:40], atol=1e-5, rtol=0)


def test_features_of_half_resolution_are_aligned(rng: np.random.Generator) -> None:
    """Catches a half-pixel shift between the image and features of half resolution."""
    xyz = torch.from_numpy(rng.uniform(-0.3, 0.3, (50, 3)).astype(np.float32))
    seen = views()
    height, width = seen.images.shape[-2:]
    ramp = (torch.arange(width) + 0.5).expand(len(seen.cameras), 1, height, width)
    halved = torch.nn.functional.avg_pool2d(ramp, 2)
    fine = sample_sources(xyz, seen, ramp, torch.full((50,), 0.1)).channels[..., 0]
    coarse = sample_sources(xyz, seen, halved, torch.full((50,), 0.1)).channels[..., 0]
    torch.testing.assert_close(coarse, fine, atol=1e-3, rtol=0)


def test_initial_radius_and_density_follow_the_config() -> None:
    built = model(SMALL)
    evaluated = built.evaluate(points(), torch.full((20,), 0.02), 0.5)
    torch.testing.assert_close(evaluated.radius, torch.full((20,), 1.3 * 0.02), atol=1e-4, rtol=0)
    assert evaluated.density.min() > 0.98
    assert evaluated.density.max() < 1


@pytest.mark.parametrize(
    "config",
    [
        SMALL,
        replace(SMALL, appearance="ibr"),
        replace(SMALL, appearance="sh"),
        replace(SMALL, sh="explicit"),
        replace(SMALL, appearance="sh", sh="explicit"),
        replace(SMALL, continuous=True),
        replace(SMALL, residual=True),
        replace(SMALL, planes=replace(SMALL.planes, time=False)),
        replace(SMALL, planes=replace(SMALL.planes, reduction="sum")),
        replace(SMALL, planes=replace(SMALL.planes, reduction="product")),
    ],
    ids=lambda config: str(config)[-200:],
)
def test_all_parameters_have_a_gradient_under_every_switch(config: ModelConfig) -> None:
    """Catches network heads that are not used or get no gradient."""
    built = model(config)
    with torch.no_grad():
        for parameter in built.parameters():
            parameter += 0.05 * torch.randn(parameter.shape, generator=torch.Generator().manual_seed(7))
    xyz = points().requires_grad_()
    explicit = torch.rand(20, 48, requires_grad=True) if config.sh == "explicit" else None
    evaluated = built.evaluate(xyz, torch.full((20,), 0.02), 0.4, explicit_sh=explicit)
    sources = None if config.appearance == "sh" else views()
    colour = built.colour(evaluated, ring(7)[1], sources)
    assert colour.shape == (20, 3)
    (colour.square().sum() + evaluated.radius.sum() + evaluated.density.sum()).backward()
    without_gradient = [n for n, p in built.named_parameters() if p.grad is None or not p.grad.abs().sum() > 0]
    assert without_gradient == []
    assert explicit is None or explicit.grad is not None


def test_only_continuous_blending_depends_on_the_viewer() -> None:
    """Catches blend weights that depend on the viewing direction without the option ``continuous``. Export could not
    bake these weights."""
    xyz, sources = points(), views()
    for continuous in (False, True):
        built = model(replace(SMALL, appearance="ibr", continuous=continuous))
        evaluated = built.evaluate(xyz, torch.full((20,), 0.02), 0.1)
        first, second = (built.colour(evaluated, viewer, sources) for viewer in ring(5)[1:3])
        assert torch.equal(first, second) is not continuous


@pytest.mark.parametrize(("appearance", "share"), [("both", 0.5), ("sh", 1.0)])
def test_rendered_colours_have_a_share_of_the_high_sh_degrees(appearance: Literal["both", "sh"], share: float) -> None:
    """Catches a share that changes training or the degrees 0 and 1, and a share that changes models whose whole colour
    comes from SH."""
    built = model(replace(SMALL, appearance=appearance, sh="explicit", high_sh_share=0.5))
    explicit = torch.randn(20, 48, generator=torch.Generator().manual_seed(8))
    evaluated = built.evaluate(points(), torch.full((20,), 0.02), 0.4, explicit_sh=explicit)
    assert torch.equal(built.harmonics(evaluated, is_training=True), explicit.reshape(20, 3, 16))
    rendered = built.harmonics(evaluated, is_training=False)
    assert torch.equal(rendered[..., :4], explicit.reshape(20, 3, 16)[..., :4])
    assert torch.equal(rendered[..., 4:], share * explicit.reshape(20, 3, 16)[..., 4:])
    sources, viewer = None if appearance == "sh" else views(), ring(7)[1]
    shrunk = replace(evaluated, sh=rendered)
    expected = built.colour(shrunk, viewer, sources)
    torch.testing.assert_close(built.colour(evaluated, viewer, sources, is_training=False), expected)
