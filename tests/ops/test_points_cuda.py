"""The CUDA point renderer compared with the reference. All tests run in the emulator on the CPU, and also on a GPU if
there is one."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import Tensor

from fourd.rendering import point_visibility, render_points
from fourd.rendering.ops.gpu import cuda_unavailable_reason, load_gpu
from fourd.rendering.ops.points.validation import pack_camera
from tests.ops.test_points_parity import NEAR, OUTPUTS, assert_parity, run
from tests.raster.clouds import Cloud, cloud_with_invalid_points, random_cloud, turned_camera


@pytest.mark.parametrize(("count", "size", "layers"), [(300, (41, 35), 15), (200, (16, 16), 1), (60, (3, 50), 40)])
def test_pictures_and_gradients_equal_the_reference(
    count: int, size: tuple[int, int], layers: int, gpu: torch.device, rng: np.random.Generator
) -> None:
    """Catches pixels of the wrong tile, points that are composited in the wrong order, errors from warp divergence, and
    missing terms in sums."""
    cloud = random_cloud(rng, count, 3)
    got = run(cloud, size, "auto", 1, layers=layers, device=gpu)
    assert_parity(got, run(cloud, size, "reference", 1, layers=layers))


@pytest.mark.parametrize("channels", [1, 2, 4, 5, 8, 9, 32])
def test_channel_counts(channels: int, gpu: torch.device, rng: np.random.Generator) -> None:
    """Catches a wrong stride in the general kernel. The channel counts 4, 8 and 32 have separate kernels."""
    cloud = random_cloud(rng, 80, channels)
    got = run(cloud, (19, 18), "auto", 2, device=gpu)
    assert_parity(got, run(cloud, (19, 18), "reference", 2))


@pytest.mark.parametrize("outputs", [(name,) for name in OUTPUTS])
def test_gradient_of_each_output_alone(outputs: tuple[str, ...], gpu: torch.device, rng: np.random.Generator) -> None:
    """Catches a gradient that ignores one of the outputs, and small gradients of alpha that are lost at opaque
    pixels."""
    cloud = random_cloud(rng, 150, 3)
    got = run(cloud, (33, 17), "auto", 3, outputs=outputs, device=gpu)
    assert_parity(got, run(cloud, (33, 17), "reference", 3, outputs=outputs))


def test_visibility_equals_the_reference(gpu: torch.device, rng: np.random.Generator) -> None:
    """Catches a visibility weight that is assigned to the wrong point."""
    cloud, camera = random_cloud(rng, 250, 1), turned_camera(40, 30)
    arrays = (cloud.xyz, cloud.radius, cloud.density)
    got = point_visibility(*(array.to(gpu) for array in arrays), camera, near=NEAR)
    expected = point_visibility(*arrays, camera, near=NEAR, backend="reference")
    assert float((got.cpu() - expected).abs().max()) <= 1e-5


def test_invalid_points_change_nothing_and_get_no_gradient(gpu: torch.device, rng: np.random.Generator) -> None:
    """Catches points of NaN depth that are sorted to the front, and uninitialized gradients of culled points."""
    cloud, valid = cloud_with_invalid_points(rng, 200)
    clean = Cloud(*(array[valid] for array in cloud.arrays))
    images, gradients = run(cloud, (40, 30), "auto", 5, device=gpu)
    expected = run(clean, (40, 30), "auto", 5, device=gpu)
    assert all(torch.equal(a, b) for a, b in zip(images, expected[0], strict=True))
    for value, wanted in zip(gradients, expected[1], strict=True):
        assert float(value[~valid].abs().max()) == 0
        assert float((value[valid] - wanted).abs().max()) <= 1e-5 * float(wanted.abs().max())


def test_weights_too_small_to_show_in_alpha(gpu: torch.device, rng: np.random.Generator) -> None:
    """Catches a depth gradient that is divided by a weight of 1e-42. All gradients of the point would then be NaN."""
    cloud = random_cloud(rng, 40, 2)
    cloud.density[:] = 1e-42
    gradients = run(cloud, (30, 20), "auto", 8, device=gpu)[1]
    expected = run(cloud, (30, 20), "reference", 8)[1]
    assert all(bool(torch.isfinite(gradient).all()) for gradient in gradients)
    torch.testing.assert_close(gradients[3], expected[3], rtol=1e-4, atol=1e-4)


def test_an_empty_cloud(gpu: torch.device) -> None:
    """Catches errors if there are no points: a kernel launch with an empty grid, and sorting of an empty array."""
    cloud = Cloud(torch.zeros(0, 3), torch.zeros(0, 3), torch.zeros(0), torch.zeros(0))
    images, gradients = run(cloud, (20, 10), "auto", 6, device=gpu)
    assert all(float(image.abs().max()) == 0 for image in images)
    assert [gradient.shape for gradient in gradients] == [array.shape for array in cloud.arrays]


@pytest.mark.parametrize("entries", [0, 1, 700])
def test_too_few_entries_give_the_same_picture(entries: int, gpu: torch.device, rng: np.random.Generator) -> None:
    """Catches writes past the memory for (point, tile) pairs, and points missing when this memory is too small."""
    cloud, camera = random_cloud(rng, 200, 3), turned_camera(50, 34)
    inputs = [array.to(gpu) for array in cloud.arrays]
    found = load_gpu(gpu)
    gradients = (torch.ones(34, 50, 3, device=gpu), torch.ones(34, 50, device=gpu), torch.ones(34, 50, device=gpu))
    pictures, sums = [], []
    for capacity in (entries, 200_000):
        # The workspace is larger than needed. Writes past the end of its memory for pairs therefore overwrite its other
        # arrays.
        workspace = torch.zeros(64 << 20, dtype=torch.uint8, device=gpu)
        memory = (found.estimator, capacity, workspace, found.stream)
        out = [torch.empty(34, 50, 3, device=gpu), torch.empty(34, 50, device=gpu), torch.empty(34, 50, device=gpu)]
        found.kernels.render_points(*inputs, pack_camera(camera), 15, NEAR, 0.0, *memory, *out)
        gradient_out = [torch.empty_like(array) for array in inputs]
        found.kernels.render_points_backward(*inputs, pack_camera(camera), 15, NEAR, *memory, *gradients, *gradient_out)
        pictures.append(out)
        sums.append(gradient_out)
    assert all(torch.equal(a, b) for a, b in zip(*pictures, strict=True))
    for value, wanted in zip(*sums, strict=True):
        assert float((value - wanted).abs().max()) <= 1e-5 * float(wanted.abs().max())


def test_the_entry_estimate_grows_to_the_need_of_pictures(gpu: torch.device) -> None:
    """Catches an estimate of the number of (point, tile) pairs that does not adapt to large points. Rendering would
    then remain slow."""
    kernels = load_gpu(gpu).kernels
    estimator, camera, count = kernels.EntryEstimator(), turned_camera(128, 128), 3000
    arrays = [torch.zeros(count, 3), torch.full((count,), 6.0), torch.full((count,), 0.5)]
    inputs = [array.to(gpu) for array in arrays]
    out = torch.empty(count, device=gpu)
    planned = []
    for _ in range(2):
        entries, size = kernels.plan_points(estimator, count, 0, 128, 128)
        memory = (estimator, entries, torch.empty(size, dtype=torch.uint8, device=gpu), load_gpu(gpu).stream)
        kernels.point_visibility(*inputs, pack_camera(camera), 128, 128, 15, NEAR, *memory, out)
        if gpu.type == "cuda":
            torch.cuda.synchronize()
        planned.append(entries)
    needed = count * 8 * 8
    assert planned[0] < needed < planned[1] < 2 * needed


def test_too_many_layers_for_the_gradient_kernel_are_named(gpu: torch.device, rng: np.random.Generator) -> None:
    """Catches a number of depth layers that is accepted although it is above the limit. The kernel would ignore some
    layers or write past a thread's memory.
    """
    cloud = random_cloud(rng, 100, 3)
    message = "layers: expected at most 64 where gradients are required on a GPU, got 65; backend='reference' takes any"
    with pytest.raises(ValueError, match=message):
        run(cloud, (20, 20), "auto", 7, layers=65, device=gpu)
    arrays = [array.to(gpu) for array in cloud.arrays]
    got = render_points(*arrays, turned_camera(20, 20), layers=100, near=NEAR).features.cpu()
    expected = render_points(*cloud.arrays, turned_camera(20, 20), layers=100, near=NEAR, backend="reference").features
    assert float((got - expected).abs().max()) <= 1e-5


def test_small_workspaces_and_wrong_shapes_are_rejected(gpu: torch.device, rng: np.random.Generator) -> None:
    """Catches a workspace that is too small but accepted. Kernels would write past its end."""
    found, camera = load_gpu(gpu), turned_camera(20, 10)
    inputs = [array.to(gpu) for array in random_cloud(rng, 30, 3).arrays]
    out = [torch.empty(10, 20, 3, device=gpu), torch.empty(10, 20, device=gpu), torch.empty(10, 20, device=gpu)]

    def draw(size: int, images: list[Tensor]) -> None:
        workspace = torch.empty(size, dtype=torch.uint8, device=gpu)
        memory = (found.estimator, 1000, workspace, found.stream)
        found.kernels.render_points(*inputs, pack_camera(camera), 15, NEAR, 0.0, *memory, *images)

    with pytest.raises(ValueError, match="workspace: expected the bytes that the plan names"):
        draw(1000, out)
    with pytest.raises(ValueError, match="out_depth: unexpected shape"):
        draw(1 << 24, [*out[:2], out[2][:5].contiguous()])


@pytest.mark.skipif(not cuda_unavailable_reason() and torch.cuda.is_available(), reason="the CUDA kernels run here")
def test_missing_cuda_is_a_one_line_error(rng: np.random.Generator) -> None:
    """Catches a traceback from torch, or a silent fallback to the CPU, if CUDA is not available."""
    cloud = random_cloud(rng, 3, 3)
    expected = (
        "built without.*install CUDA's compiler nvcc" if cuda_unavailable_reason() else "expected a tensor on 'cuda'"
    )
    with pytest.raises((RuntimeError, ValueError), match=expected) as caught:
        render_points(*cloud.arrays, turned_camera(8, 8), backend="cuda")
    assert "\n" not in str(caught.value)
