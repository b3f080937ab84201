"""The CPU point renderer compared with the reference: single elements, rare code paths and limits."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import Tensor

from fourd.rendering import point_visibility, render_points
from fourd.rendering.ops.loading import load_native
from fourd.rendering.ops.points.arrays import point_visibility_numpy, render_points_numpy
from fourd.rendering.ops.points.validation import MAX_SIDE_PX, pack_camera
from tests.raster.clouds import NAMES, Cloud, cloud_with_invalid_points, random_cloud, turned_camera

NEAR = 0.01
OUTPUTS = ("features", "alpha", "depth")
SIMD = ("baseline", "avx2", "avx512")


def run(
    cloud: Cloud,
    size: tuple[int, int],
    backend: str,
    seed: int,
    *,
    outputs: tuple[str, ...] = OUTPUTS,
    layers: int = 15,
    threads: int = 0,
    dtype: torch.dtype = torch.float32,
    device: torch.device | None = None,
) -> tuple[list[Tensor], list[Tensor]]:
    """Return the rendered features, alpha and depth, and the gradients of a random linear function of ``outputs``."""
    free = [array.to(device, dtype, copy=True).requires_grad_() for array in cloud.arrays]
    image = render_points(
        free[0],
        free[1],
        free[2],
        free[3],
        turned_camera(*size),
        layers=layers,
        near=NEAR,
        backend=backend,
        threads=threads,
    )
    rng = np.random.default_rng(seed)
    total = torch.zeros((), dtype=dtype, device=device)
    for name in OUTPUTS:
        values = getattr(image, name)
        weights = torch.from_numpy(rng.normal(size=tuple(values.shape)).astype(np.float32)).to(values)
        if name in outputs:
            total = total + (values * weights).sum()
    images = [getattr(image, name).detach().cpu() for name in OUTPUTS]
    return images, [gradient.cpu() for gradient in torch.autograd.grad(total, free, materialize_grads=True)]


def assert_parity(got: tuple[list[Tensor], list[Tensor]], wanted: tuple[list[Tensor], list[Tensor]]) -> None:
    """Assert that images and gradients match. The tolerance is 1e-5 for images. For gradients, the tolerance is 1e-4 of
    the largest gradient in the array."""
    for name, value, expected in zip(OUTPUTS, got[0], wanted[0], strict=True):
        assert float((value - expected).abs().max()) <= 1e-5, name
    for name, value, expected in zip(NAMES, got[1], wanted[1], strict=True):
        worst, scale = float((value - expected).abs().max()), float(expected.abs().max())
        assert worst <= 1e-4 * scale, f"{name}: off by {worst:.3g} at a scale of {scale:.3g}"


@pytest.mark.parametrize("channels", range(1, 33))
def test_every_channel_count(channels: int, rng: np.random.Generator) -> None:
    """Catches a wrong stride in the general loop. The loops for the channel counts 1, 3 and 4 are unrolled."""
    cloud = random_cloud(rng, 80, channels)
    assert_parity(run(cloud, (19, 18), "cpu", 1), run(cloud, (19, 18), "reference", 1))


@pytest.mark.parametrize("outputs", [(name,) for name in OUTPUTS] + [("features", "alpha")])
def test_gradient_of_each_output_alone(outputs: tuple[str, ...], rng: np.random.Generator) -> None:
    """Catches errors in the kernel that has no depth gradient, and small gradients of alpha that are lost at opaque
    pixels."""
    cloud = random_cloud(rng, 300, 3)
    got = run(cloud, (41, 35), "cpu", 2, outputs=outputs)
    assert_parity(got, run(cloud, (41, 35), "reference", 2, outputs=outputs))


def test_single_gradients_where_well_conditioned(rng: np.random.Generator) -> None:
    """Catches errors in small gradients, which a tolerance relative to the largest gradient would hide.

    A gradient is well conditioned if float32 rounding in the reference changes the gradient by less than 1e-5 of its
    value.
    """
    cloud = random_cloud(rng, 120, 3)
    cloud.radius[cloud.radius > 1] = 0.1
    got = run(cloud, (60, 44), "cpu", 3)[1]
    single = run(cloud, (60, 44), "reference", 3)[1]
    double = run(cloud, (60, 44), "reference", 3, dtype=torch.float64)[1]
    compared = 0
    for name, value, near_truth, truth in zip(NAMES, got, single, double, strict=True):
        stable = ((near_truth - truth).abs() < 1e-5 * truth.abs()) & (truth.abs() > 1e-3 * truth.abs().max())
        relative = ((value - truth).abs() / truth.abs())[stable]
        assert bool((relative <= 1e-4).all()), f"{name}: off by {float(relative.max()):.3g} of itself"
        compared += relative.numel()
    assert compared > 100


def test_instruction_sets_and_threads_give_the_same_bits(
    rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Catches results that depend on the machine or on the number of threads."""
    cloud = random_cloud(rng, 900, 5)
    available = [name for name in SIMD if load_native().simd_available(name)]
    results = []
    for simd in available:
        monkeypatch.setenv("FOURD_SIMD", simd)
        for threads in (1, 2, 3, 7):
            images, gradients = run(cloud, (70, 51), "cpu", 4, threads=threads)
            visibility = point_visibility(
                cloud.xyz, cloud.radius, cloud.density, turned_camera(70, 51), near=NEAR, threads=threads
            )
            results.append([*images, *gradients, visibility])
    for result in results[1:]:
        assert all(torch.equal(a, b) for a, b in zip(result, results[0], strict=True))


def test_an_unknown_instruction_set_is_named(rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch) -> None:
    """Catches a misspelt FOURD_SIMD that is silently ignored."""
    monkeypatch.setenv("FOURD_SIMD", "avx1024")
    with pytest.raises(ValueError, match=r"FOURD_SIMD: expected baseline, avx2 or avx512.*got avx1024"):
        run(random_cloud(rng, 3, 3), (8, 8), "cpu", 0)


def test_an_invalid_thread_count_is_named(rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch) -> None:
    """Catches an invalid value of FOURD_THREADS that is ignored."""
    monkeypatch.setenv("FOURD_THREADS", "two")
    with pytest.raises(ValueError, match="FOURD_THREADS: expected a whole number of at least 1, got 'two'"):
        run(random_cloud(rng, 3, 3), (8, 8), "cpu", 0)


def test_invalid_points_get_no_gradient_and_change_no_other(rng: np.random.Generator) -> None:
    """Catches NaN from invalid points that spreads to the gradients of other points although the image is valid."""
    cloud, valid = cloud_with_invalid_points(rng, 300)
    clean = Cloud(*(array[valid] for array in cloud.arrays))
    for backend in ("cpu", "reference"):
        gradients, expected = run(cloud, (40, 30), backend, 5)[1], run(clean, (40, 30), backend, 5)[1]
        for value, wanted in zip(gradients, expected, strict=True):
            assert float(value[~valid].abs().max()) == 0
            assert float((value[valid] - wanted).abs().max()) <= 1e-5 * float(wanted.abs().max())


def test_a_feature_that_is_not_finite_stays_in_its_pixels() -> None:
    """Catches NaN features that are multiplied by a weight of 0. A whole row of a tile would then be NaN."""
    xyz = torch.tensor([[0.0, 0.0, 0.0], [0.0, 0.0, 0.5]])
    features = torch.tensor([[float("nan")], [1.0]])
    camera = turned_camera(32, 32)
    for backend in ("cpu", "reference"):
        density = torch.ones(2) * 0.5
        out = render_points(xyz, features, torch.tensor([0.05, 2.0]), density, camera, near=NEAR, backend=backend)
        alone = render_points(
            xyz[:1], torch.ones(1, 1), torch.tensor([0.05]), density[:1], camera, near=NEAR, backend=backend
        )
        assert torch.equal(torch.isnan(out.features[..., 0]), alone.alpha > 0)


def test_tensors_that_are_not_contiguous(rng: np.random.Generator) -> None:
    """Catches a kernel that reads a strided tensor as if it were contiguous."""
    cloud = random_cloud(rng, 120, 3)
    strided = Cloud(
        cloud.xyz.t().contiguous().t(),
        torch.cat([cloud.features, cloud.features], 1)[:, ::2][:, [0, 2, 1]],
        torch.stack([cloud.radius, cloud.radius], 1)[:, 0],
        cloud.density.expand(2, -1)[1],
    )
    compact = Cloud(*(array.contiguous() for array in strided.arrays))
    camera = turned_camera(33, 29)
    got, wanted = (
        render_points(*each.arrays, camera, near=NEAR, backend="cpu").features for each in (strided, compact)
    )
    assert torch.equal(got, wanted)
    from_numpy = render_points_numpy(*(array.numpy() for array in strided.arrays), camera, near=NEAR)
    assert np.array_equal(from_numpy[0], wanted.numpy())


@pytest.mark.parametrize("whole_image", [False, True])
def test_background_gradients_equal_reference(whole_image: bool, rng: np.random.Generator) -> None:
    """Catches gradients through alpha that ignore the background."""
    cloud, camera = random_cloud(rng, 150, 3), turned_camera(29, 22)
    background = torch.from_numpy(rng.uniform(0, 1, (22, 29, 3) if whole_image else 3).astype(np.float32))
    weights = torch.from_numpy(rng.normal(size=(22, 29, 3)).astype(np.float32))
    results = []
    for backend in ("cpu", "reference"):
        free = [array.clone().requires_grad_() for array in (*cloud.arrays, background)]
        image = render_points(
            free[0], free[1], free[2], free[3], camera, near=NEAR, background=free[4], backend=backend
        )
        results.append([image.features, *torch.autograd.grad((image.features * weights).sum(), free)])
    for value, expected in zip(*results, strict=True):
        scale = float(expected.detach().abs().max())
        assert float((value - expected).detach().abs().max()) <= 1e-4 * scale
    arrays = [array.numpy() for array in cloud.arrays]
    flat = render_points_numpy(*arrays, camera, near=NEAR, background=background.numpy())[0]
    assert np.allclose(flat, results[0][0].detach().numpy(), atol=1e-6)


def test_early_termination_errs_by_at_most_the_transmittance(rng: np.random.Generator) -> None:
    """Catches early termination above the transmittance threshold, and early termination in training, which would give
    wrong gradients."""
    cloud, camera = random_cloud(rng, 600, 3), turned_camera(50, 41)
    exact = render_points(*cloud.arrays, camera, near=NEAR)
    early = render_points(*cloud.arrays, camera, near=NEAR, transmittance_min=1e-2)
    assert float((exact.features - early.features).abs().max()) <= 1e-2
    free = [array.clone().requires_grad_() for array in cloud.arrays]
    with pytest.raises(ValueError, match=r"transmittance_min: expected 0 where gradients are required, got 0\.01"):
        render_points(free[0], free[1], free[2], free[3], camera, transmittance_min=1e-2)


def test_gradient_and_visibility_operators_pass_opcheck(rng: np.random.Generator) -> None:
    """Catches a fake implementation whose shapes or strides would break torch.compile."""
    from fourd.rendering.ops.points import op as ops

    cloud, numbers = random_cloud(rng, 20, 2), pack_camera(turned_camera(18, 11))
    image = (torch.randn(11, 18, 2), torch.randn(11, 18))
    for grad_depth in (torch.randn(11, 18), None):
        torch.library.opcheck(ops.render_backward.defined, (*cloud.arrays, *image, grad_depth, numbers, 15, NEAR, 2))
    sizes = (cloud.xyz, cloud.radius, cloud.density, numbers, 18, 11, 15, NEAR, 2)
    torch.library.opcheck(ops.visibility.defined, sizes)


def test_gradients_do_not_depend_on_pictures_rendered_in_between(rng: np.random.Generator) -> None:
    """Catches a gradient that is computed from the points of the last image instead of its own image."""
    first, second = random_cloud(rng, 400, 3), random_cloud(rng, 500, 4)
    alone = run(first, (40, 30), "cpu", 5)[1]
    leaves = [[array.clone().requires_grad_() for array in cloud.arrays] for cloud in (first, second)]
    images = [render_points(*leaf, turned_camera(40, 30), near=NEAR) for leaf in leaves]
    point_visibility(first.xyz, first.radius, first.density, turned_camera(20, 50), near=NEAR)
    for _ in range(2):
        for leaf, image in zip(leaves, images, strict=True):
            total = image.features.square().sum() + image.alpha.sum() + image.depth.sum()
            found = torch.autograd.grad(total, leaf, retain_graph=True)
            fresh = [array.detach().clone().requires_grad_() for array in leaf]
            again = render_points(*fresh, turned_camera(40, 30), near=NEAR)
            total = again.features.square().sum() + again.alpha.sum() + again.depth.sum()
            expected = torch.autograd.grad(total, fresh)
            assert all(torch.equal(a, b) for a, b in zip(found, expected, strict=True))
    assert all(torch.equal(a, b) for a, b in zip(alone, run(first, (40, 30), "cpu", 5)[1], strict=True))


def test_an_empty_cloud() -> None:
    """Catches reads from an empty array, and an error when a frame without points is rendered."""
    cloud = Cloud(torch.zeros(0, 3), torch.zeros(0, 3), torch.zeros(0), torch.zeros(0))
    images, gradients = run(cloud, (20, 10), "cpu", 6)
    assert all(float(image.abs().max()) == 0 for image in images)
    assert [gradient.shape for gradient in gradients] == [array.shape for array in cloud.arrays]
    arrays = [array.numpy() for array in cloud.arrays]
    camera = turned_camera(20, 10)
    assert render_points_numpy(*arrays, camera)[0].shape == (10, 20, 3)
    assert point_visibility_numpy(arrays[0], arrays[2], arrays[3], camera).shape == (0,)


def test_an_image_with_too_many_tiles_is_rejected(rng: np.random.Generator) -> None:
    """Catches a number of tiles that exceeds 32 bits. Kernels would then write past the end of an array."""
    cloud = random_cloud(rng, 3, 1)
    camera = replace(turned_camera(8, 8), width=MAX_SIDE_PX + 1)
    with pytest.raises(ValueError, match=f"camera: expected sides of at most {MAX_SIDE_PX} pixels, got"):
        point_visibility(cloud.xyz, cloud.radius, cloud.density, camera)
    arrays = [array.numpy() for array in (cloud.xyz, cloud.radius, cloud.density)]
    with pytest.raises(ValueError, match="out of range"):
        load_native().point_visibility(
            *arrays, pack_camera(camera), 2**20, 2**20, 4, NEAR, 1, "", np.empty(3, np.float32)
        )


def test_native_shapes_are_checked_again(rng: np.random.Generator) -> None:
    """Catches a native kernel that does not check shapes itself and reads past an array if a caller bypasses the checks
    in Python."""
    cloud, camera = random_cloud(rng, 5, 3), turned_camera(8, 6)
    image = [np.empty((6, 8, 3), np.float32), np.empty((6, 8), np.float32), np.empty((6, 7), np.float32)]
    arrays = [array.numpy() for array in cloud.arrays]
    with pytest.raises(ValueError, match="out_depth: unexpected shape"):
        load_native().render_points(*arrays, pack_camera(camera), 4, NEAR, 0.0, 1, "", *image)
    with pytest.raises(ValueError, match="density: unexpected shape"):
        short = [*arrays[:3], arrays[3][:4]]
        load_native().render_points(*short, pack_camera(camera), 4, NEAR, 0.0, 1, "", *image)


def test_arguments_of_the_wrong_type_are_named() -> None:
    """Catches an internal AttributeError instead of an error message that names the argument."""
    camera = turned_camera(8, 8)
    arrays = [torch.zeros(5, 3), torch.zeros(5, 3), torch.ones(5), torch.ones(5)]
    with pytest.raises(TypeError, match=r"xyz: expected a torch.Tensor, got ndarray"):
        render_points(arrays[0].numpy(), *arrays[1:], camera)
    with pytest.raises(TypeError, match=r"camera: expected a fourd.Camera, got int"):
        render_points(*arrays, 3)
    distorted = replace(camera, distortion=np.array([0.1, 0, 0, 0]))
    with pytest.raises(ValueError, match=r"camera: expected an ideal pinhole.*undistort"):
        render_points(*arrays, distorted)
    with pytest.raises(ValueError, match=r"transmittance_min: expected 0 or more and below 1, got 1"):
        render_points(*arrays, camera, transmittance_min=1.0)
    with pytest.raises(ValueError, match=r"background: expected shape \(3,\) or \(8, 8, 3\), got \(2,\)"):
        render_points(*arrays, camera, background=torch.zeros(2))
    with pytest.raises(TypeError, match=r"radius: expected float32, got int64"):
        render_points(*arrays[:2], torch.ones(5, dtype=torch.int64), arrays[3], camera)
