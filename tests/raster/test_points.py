"""The CPU renderer compared with the reference, and the reference compared with finite differences."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import Tensor

from fourd.base.cameras import Camera
from fourd.rendering import point_visibility, render_points
from fourd.rendering.ops.loading import load_native
from fourd.rendering.ops.points.arrays import point_visibility_numpy, render_points_numpy
from tests.raster.clouds import NAMES, Cloud, cloud_with_invalid_points, random_cloud, turned_camera

NEAR = 0.01
SIMD = ("baseline", "avx2", "avx512")
ROUNDING = 2e-5
"""Rounding error of a sum over the pixels of an image whose terms, of the order of 1, cancel. If one disc covers the
whole image, its gradients are the only ones and can be this small."""


def render(cloud: Cloud, camera: Camera, layers: int, backend: str, **more: object) -> tuple[Tensor, Tensor, Tensor]:
    out = render_points(*cloud.arrays, camera, layers=layers, near=NEAR, backend=backend, **more)  # type: ignore[arg-type]
    return out.features, out.alpha, out.depth


def gradients(
    cloud: Cloud, camera: Camera, layers: int, backend: str, weights: tuple[Tensor, ...], **more: object
) -> list[Tensor]:
    """Return the gradients of a linear function of the rendered features, alpha and depth."""
    free = [array.clone().requires_grad_() for array in cloud.arrays]
    out = render(Cloud(*free), camera, layers, backend, **more)
    total = sum((part * weight).sum() for part, weight in zip(out, weights, strict=True))
    return list(torch.autograd.grad(total, free))


def output_weights(rng: np.random.Generator, camera: Camera, channels: int) -> tuple[Tensor, ...]:
    shape = (camera.height, camera.width)
    shapes = ((*shape, channels), shape, shape)
    return tuple(torch.from_numpy(rng.normal(size=shape).astype(np.float32)) for shape in shapes)


def assert_gradients_agree(got: list[Tensor], expected: list[Tensor]) -> None:
    """Assert that gradients match. The tolerance is 1e-4 of the largest gradient in the array, because rounding errors
    of sums are proportional to the largest gradient, plus ROUNDING."""
    for name, value, wanted in zip(NAMES, got, expected, strict=True):
        scale = float(wanted.abs().max()) if wanted.numel() else 0.0
        worst = float((value - wanted).abs().max()) if wanted.numel() else 0.0
        assert worst <= 1e-4 * scale + ROUNDING, f"{name}: off by {worst:.3g} at a scale of {scale:.3g}"


@pytest.mark.parametrize(
    ("count", "size", "layers", "channels"),
    [
        (600, (64, 48), 15, 3),
        (600, (37, 53), 4, 1),
        (300, (16, 16), 1, 3),
        (300, (17, 15), 12, 8),
        (200, (33, 31), 15, 32),
        (200, (31, 7), 30, 5),
        (1, (9, 9), 15, 3),
        (0, (20, 10), 15, 3),
        (400, (1, 1), 15, 2),
        (2000, (100, 70), 15, 3),
    ],
)
def test_kernel_equals_reference(
    count: int, size: tuple[int, int], layers: int, channels: int, rng: np.random.Generator
) -> None:
    """Catches missing points at tile borders, a wrong order of equal depths, an additional depth layer, and wrong
    derivatives."""
    camera = turned_camera(*size)
    cloud = random_cloud(rng, count, channels)
    for got, expected in zip(
        render(cloud, camera, layers, "cpu"), render(cloud, camera, layers, "reference"), strict=True
    ):
        assert got.shape == expected.shape
        assert float((got - expected).abs().max()) <= 1e-5
    weights = output_weights(rng, camera, channels)
    got_gradients = gradients(cloud, camera, layers, "cpu", weights)
    assert_gradients_agree(got_gradients, gradients(cloud, camera, layers, "reference", weights))


@pytest.mark.parametrize("simd", SIMD)
def test_every_instruction_set_equals_the_reference(
    simd: str, rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Catches errors in the kernels for instruction sets that this machine does not use by default."""
    monkeypatch.setenv("FOURD_SIMD", simd)
    camera = turned_camera(45, 38)
    cloud = random_cloud(rng, 500, 3)
    if not load_native().simd_available(simd):
        pytest.skip(f"this processor lacks {simd}")
    got = render(cloud, camera, 15, "cpu")
    for value, expected in zip(got, render(cloud, camera, 15, "reference"), strict=True):
        assert float((value - expected).abs().max()) <= 1e-5
    weights = output_weights(rng, camera, 3)
    got_gradients = gradients(cloud, camera, 15, "cpu", weights)
    assert_gradients_agree(got_gradients, gradients(cloud, camera, 15, "reference", weights))


def test_any_thread_count_gives_the_same_bits(rng: np.random.Generator) -> None:
    """Catches a sum in an order that depends on thread scheduling. Training would then not be reproducible."""
    camera = turned_camera(70, 51)
    cloud = random_cloud(rng, 1500, 3)
    weights = output_weights(rng, camera, 3)
    images = [render(cloud, camera, 15, "cpu", threads=threads) for threads in (1, 2, 3, 7)]
    repeated = [gradients(cloud, camera, 15, "cpu", weights, threads=threads) for threads in (1, 2, 3, 7)]
    for image in images[1:]:
        assert all(torch.equal(a, b) for a, b in zip(image, images[0], strict=True))
    for gradient in repeated[1:]:
        assert all(torch.equal(a, b) for a, b in zip(gradient, repeated[0], strict=True))


def test_reference_gradients_equal_finite_differences(rng: np.random.Generator) -> None:
    """Catches a derivative that is missing in the reference itself."""
    camera = turned_camera(9, 7)
    cloud = random_cloud(rng, 14, 2)
    cloud = Cloud(
        cloud.xyz + torch.from_numpy(rng.normal(0, 0.01, (14, 3)).astype(np.float32)),
        cloud.features,
        cloud.radius.clamp(0.2, 0.6),
        cloud.density.clamp(0.1, 0.9),
    ).to(torch.float64)
    weights = tuple(weight.double() for weight in output_weights(rng, camera, 2))
    exact = gradients(cloud, camera, 15, "reference", weights)
    step = 1e-6
    for argument, (array, gradient) in enumerate(zip(cloud.arrays, exact, strict=True)):
        numeric = torch.zeros_like(array)
        for index in np.ndindex(*array.shape):
            values = []
            for sign in (1, -1):
                shifted = [other.clone() for other in cloud.arrays]
                shifted[argument][index] += sign * step
                out = render(Cloud(*shifted), camera, 15, "reference")
                values.append(sum(float((part * weight).sum()) for part, weight in zip(out, weights, strict=True)))
            numeric[index] = (values[0] - values[1]) / (2 * step)
        # The numeric derivative is wrong if the rim of a disc crosses a pixel centre within the step. Less than 3% of
        # the entries are affected.
        close = (numeric - gradient).abs() <= 1e-5 * (1 + gradient.abs())
        assert float(close.double().mean()) > 0.97


def test_invalid_points_are_culled(rng: np.random.Generator) -> None:
    """Catches NaN of an invalid point that spreads to a whole tile or to the gradients of neighbouring points."""
    camera = turned_camera(40, 30)
    cloud, valid = cloud_with_invalid_points(rng, 300)
    clean = Cloud(*(array[valid] for array in cloud.arrays))
    weights = output_weights(rng, camera, 3)
    for backend in ("cpu", "reference"):
        image, expected = render(cloud, camera, 15, backend), render(clean, camera, 15, backend)
        for got, wanted in zip(image, expected, strict=True):
            assert torch.isfinite(got).all()
            assert float((got - wanted).abs().max()) <= 1e-6
    found = gradients(cloud, camera, 15, "cpu", weights)
    assert all(torch.isfinite(gradient).all() for gradient in found)
    assert all(float(gradient[~valid].abs().max()) == 0 for gradient in found)


def test_a_single_point_has_the_expected_pixels() -> None:
    """Catches a half-pixel shift of the image. A disc with a radius of 2 pixels must be centred on the pixel in row 4,
    column 6."""
    intrinsics = np.array([[10.0, 0, 6.5], [0, 10, 4.5], [0, 0, 1]])
    camera = Camera(intrinsics, np.eye(3), np.zeros(3), 12, 9)
    one = torch.ones(1)
    out = render_points(torch.tensor([[0.0, 0, 2]]), torch.tensor([[0.5]]), one * 0.4, one * 0.8, camera)
    assert float(out.alpha[4, 6]) == pytest.approx(0.8)
    assert float(out.alpha[4, 7]) == pytest.approx(0.8 * 0.75)
    assert float(out.features[5, 6, 0]) == pytest.approx(0.4 * 0.75)
    assert float(out.alpha[6, 6]) == 0
    assert float(out.depth[4, 6]) == pytest.approx(2)


def test_background_and_its_gradient(rng: np.random.Generator) -> None:
    """Catches a background that is added without the factor 1 - alpha, or whose gradient is missing."""
    camera = turned_camera(30, 20)
    cloud = random_cloud(rng, 100, 3)
    background = torch.rand(3, requires_grad=True)
    plain = render_points(*cloud.arrays, camera, near=NEAR)
    out = render_points(*cloud.arrays, camera, near=NEAR, background=background)
    assert torch.allclose(out.features, plain.features + (1 - plain.alpha)[..., None] * background.detach())
    out.features.sum().backward()
    assert background.grad is not None
    assert torch.allclose(background.grad, (1 - plain.alpha).sum().expand(3), rtol=1e-4)


def test_numpy_renderer_equals_torch_renderer(rng: np.random.Generator) -> None:
    """Catches differences between the NumPy renderer, which playback uses, and the torch renderer, which training
    uses."""
    camera = turned_camera(50, 34)
    cloud = random_cloud(rng, 400, 3)
    arrays = [array.numpy() for array in cloud.arrays]
    for got, expected in zip(
        render_points_numpy(*arrays, camera, layers=12, near=NEAR), render(cloud, camera, 12, "cpu"), strict=True
    ):
        assert np.array_equal(got, expected.numpy())
    visibility = point_visibility_numpy(arrays[0], arrays[2], arrays[3], camera, layers=12, near=NEAR)
    expected = point_visibility(cloud.xyz, cloud.radius, cloud.density, camera, layers=12, near=NEAR)
    assert np.array_equal(visibility, expected.numpy())


def test_visibility_equals_the_reference(rng: np.random.Generator) -> None:
    """Catches a visibility of 0 for points that at least one pixel composites."""
    camera = turned_camera(50, 34)
    cloud = random_cloud(rng, 500, 1)
    values = [
        point_visibility(cloud.xyz, cloud.radius, cloud.density, camera, layers=15, near=NEAR, backend=backend)
        for backend in ("cpu", "reference")
    ]
    assert float((values[0] - values[1]).abs().max()) <= 1e-5


def test_operator_passes_opcheck(rng: np.random.Generator) -> None:
    """Catches a fake implementation that returns wrong shapes, an undeclared mutation, and a gradient that is not
    registered."""
    from fourd.rendering.ops.points import op
    from fourd.rendering.ops.points.validation import pack_camera

    camera = turned_camera(20, 14)
    cloud = random_cloud(rng, 30, 3)
    free = [array.clone().requires_grad_() for array in cloud.arrays]
    torch.library.opcheck(op.render.defined, (*free, pack_camera(camera), 20, 14, 15, NEAR, 0.0, 1))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"features": torch.zeros(5, 33)}, r"features: expected shape \(5, C\) .* C from 1 to 32, got \(5, 33\)"),
        ({"xyz": torch.zeros(5, 2)}, r"xyz: expected shape \(N, 3\), got \(5, 2\)"),
        ({"radius": torch.zeros(4)}, r"radius: expected shape \(5,\) to match xyz, got \(4,\)"),
        ({"density": torch.zeros(5).double()}, r"density: expected float32, got float64"),
        ({"layers": 0}, r"layers: expected at least 1, got 0"),
        ({"layers": 2.5}, r"layers: expected an integer, got float"),
        ({"near": -1.0}, r"near: expected a finite distance above 0"),
        ({"background": torch.zeros(2)}, r"background: expected shape \(3,\)"),
        ({"backend": "gpu"}, r"backend: expected 'auto', 'reference', 'cpu' or 'cuda', got 'gpu'"),
        ({"threads": -2}, r"threads: expected 0"),
    ],
)
def test_invalid_arguments_are_named(change: dict[str, object], message: str) -> None:
    """Catches arguments of wrong shape or range that reach the kernel. The kernel would read out of bounds."""
    arguments: dict[str, object] = {
        "xyz": torch.zeros(5, 3),
        "features": torch.zeros(5, 3),
        "radius": torch.ones(5),
        "density": torch.ones(5),
        "camera": turned_camera(8, 8),
    }
    with pytest.raises((TypeError, ValueError, RuntimeError), match=message):
        render_points(**(arguments | change))  # type: ignore[arg-type]
