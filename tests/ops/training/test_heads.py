"""The kernel of the point model's networks compared with plain torch: values, gradients and number of threads."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import Tensor
from torch.nn.functional import linear

from fourd.rendering.ops.heads.layers import NO_TIME_PLANES, HeadSettings, HeadWeights, TimePlanes
from fourd.rendering.ops.heads.op import evaluate_heads
from fourd.rendering.ops.heads.reference import evaluate_heads_reference
from fourd.rendering.ops.loading import load_native

SETTINGS = HeadSettings(0.5, 6.0, -1.8, 1.0, 5.0, 0.25, 0.6, 1e-3, (0.5, -0.25, -4.0))
NAMES = ("radius", "density", "sh", "colour")


def make_weights(rng: np.random.Generator, features: int, hidden: int, channels: int) -> HeadWeights:
    def layer(rows: int, columns: int) -> list[Tensor]:
        weight = rng.standard_normal((rows, columns)) / np.sqrt(columns)
        return [torch.from_numpy(each.astype(np.float32)) for each in (weight, 0.3 * rng.standard_normal(rows))]

    geometry = [*layer(hidden, features), *layer(hidden, hidden), *layer(2, hidden)]
    blend = [*layer(hidden, features), layer(hidden, channels)[0], *layer(1, hidden)]
    return HeadWeights(*geometry, *blend, *layer(hidden, features), *layer(48, hidden))


def make_points(
    rng: np.random.Generator, count: int, features: int, channels: int, views: int, has_own: bool
) -> list[Tensor | None]:
    """Return the arguments of the operator before the weights. Every fifth point is visible in no view."""
    visibility = np.clip(rng.uniform(-0.4, 1.4, (views, count)), 0, 1)
    visibility[:, ::5] = rng.uniform(0, 9e-4, visibility[:, ::5].shape)
    samples = rng.standard_normal((views, channels, count))
    samples[:, -3:] = rng.uniform(0, 1, (views, 3, count))
    arrays = [
        rng.standard_normal((count, features)),
        samples,
        visibility,
        rng.uniform(0.1, 1, views),
        rng.uniform(-0.5, 1.5, (count, 3)) if has_own else None,
        rng.standard_normal((count, 3)),
        rng.uniform(0.01, 0.1, count),
    ]
    return [None if each is None else torch.from_numpy(each.astype(np.float32)) for each in arrays]


def make_time_planes(
    rng: np.random.Generator, count: int, features: int, columns: list[int], time: float
) -> TimePlanes:
    """Return one plane for each of the given columns, over x, y, z, x and so on. Some points are outside the planes."""
    coordinates = rng.uniform(-1.1, 1.1, (count, 4))
    coordinates[::7, :3] = np.linspace(-1, 1, 8)[rng.integers(0, 8, (len(coordinates[::7]), 3))]
    samples = (8, 15, 2, 23, 8, 4)
    arrays = [rng.standard_normal((rows + 2, samples[rows % 6], features)) for rows in range(len(columns))]
    planes = [torch.from_numpy(each.astype(np.float32)) for each in arrays]
    axes = [index % 3 for index in range(len(columns))]
    return TimePlanes(planes, axes, columns, torch.from_numpy(coordinates.astype(np.float32)), time)


def values_and_gradients(
    function,
    points: list[Tensor | None],
    weights: HeadWeights,
    settings: HeadSettings,
    upstream: list[Tensor],
    time_planes: TimePlanes = NO_TIME_PLANES,
) -> dict[str, Tensor]:
    names = ("features", "samples", "visibility", "view_weights", "own", "xyz", "spacing")
    given = dict(zip(names, points, strict=True))
    differentiable = {name: given[name] for name in ("features", "samples", "own", "xyz")}
    leaves = {name: each.clone().requires_grad_() for name, each in differentiable.items() if each is not None}
    free = HeadWeights(*(weight.clone().requires_grad_() for weight in weights.tensors))
    planes = [plane.clone().requires_grad_() for plane in time_planes.planes]
    found = function(*{**given, **leaves}.values(), free, settings, replace(time_planes, planes=planes))
    total = sum((one * other.to(one)).sum() for one, other in zip(found, upstream, strict=True))
    everything = {**leaves, **vars(free), **{f"plane {index}": plane for index, plane in enumerate(planes)}}
    gradients = torch.autograd.grad(total, list(everything.values()))
    values = {name: value.detach() for name, value in zip(NAMES, found, strict=True)}
    return {**values, **{f"gradient of {name}": each for name, each in zip(everything, gradients, strict=True)}}


def make_upstream(rng: np.random.Generator, count: int) -> list[Tensor]:
    shapes = [(count,), (count,), (count, 48), (count, 3)]
    return [torch.from_numpy(rng.standard_normal(shape).astype(np.float32)) for shape in shapes]


def well_posed(points: list[Tensor | None], weights: HeadWeights, count: int) -> list[Tensor | None]:
    """Keep the first ``count`` points that have no hidden value so near 0 that rounding decides whether ReLU clamps it,
    because one such value changes the gradients of a whole layer."""
    given = [None if each is None else each.double() for each in points]
    features, samples = given[0], given[1]
    assert features is not None
    assert samples is not None
    w = HeadWeights(*(weight.double() for weight in weights.tensors))
    first = linear(features, w.geometry_first, w.geometry_first_bias)
    second = linear(first.relu(), w.geometry_second, w.geometry_second_bias)
    blend = linear(features, w.blend_point, w.blend_point_bias) + samples.transpose(1, 2) @ w.blend_image.T
    hidden = torch.cat([torch.stack([first, second, linear(features, w.sh_first, w.sh_first_bias)]), blend])
    kept = (hidden.abs().amin(dim=(0, 2)) > 1e-5).nonzero()[:count, 0]
    assert len(kept) == count
    axes = (0, -1, -1, None, 0, 0, 0)
    return [
        each if each is None or axis is None else each.index_select(axis, kept)
        for each, axis in zip(points, axes, strict=True)
    ]


def stacked(results: list[dict[str, Tensor]]) -> dict[str, Tensor]:
    return {name: torch.stack([each[name] for each in results]) for name in results[0]}


@pytest.mark.parametrize("simd", ["baseline", "avx2", "avx512"])
@pytest.mark.parametrize(
    ("count", "features", "hidden", "channels", "views", "own_share"),
    [(1500, 144, 64, 11, 4, 0.6), (333, 96, 40, 11, 3, 0.0), (65, 7, 5, 3, 1, None), (1, 1, 1, 5, 2, 0.3)],
)
def test_values_and_gradients_equal_the_reference(
    count: int,
    features: int,
    hidden: int,
    channels: int,
    views: int,
    own_share: float | None,
    simd: str,
    rng: np.random.Generator,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Catches a transposed weight matrix, padding that enters a sum, a wrong derivative of an SH function, gradients
    through clamped colours or points that no view sees, and errors in the last, incomplete block of points."""
    if not load_native().simd_available(simd):
        pytest.skip(f"this machine does not run {simd}")
    monkeypatch.setenv("FOURD_SIMD", simd)
    settings = replace(SETTINGS, own_share=own_share or 0.0)
    weights = make_weights(rng, features, hidden, channels)
    exact = HeadWeights(*(weight.double() for weight in weights.tensors))
    ours, references = [], []
    # The terms of one number can cancel, so errors of single points are compared with the largest of many values.
    for _ in range(64 if count == 1 else 1):
        points = well_posed(
            make_points(rng, count + 40, features, channels, views, own_share is not None), weights, count
        )
        upstream = make_upstream(rng, count)
        doubles = [None if each is None else each.double() for each in points]
        ours.append(values_and_gradients(evaluate_heads, points, weights, settings, upstream))
        references.append(values_and_gradients(evaluate_heads_reference, doubles, exact, settings, upstream))
    found, expected = stacked(ours), stacked(references)
    for name, other in expected.items():
        # A gradient of weights is a sum over points whose terms may cancel. Rounding errors are proportional to the
        # terms, not to the sum.
        is_sum = name.removeprefix("gradient of ") in vars(weights)
        scale = max(float(other.abs().max()), 0.1 * count**0.5 if is_sum else 0.0)
        error = (found[name] - other).abs()
        assert float(error.mean()) <= 3e-6 * scale, name
        assert float((error > 1e-4 * scale).float().mean()) <= 1e-3, name


@pytest.mark.parametrize("simd", ["baseline", "avx2", "avx512"])
@pytest.mark.parametrize(
    ("count", "features", "columns", "time"),
    [(1500, 8, [24, 32, 40, 72, 80, 88], 0.3), (90, 5, [40, 0], 1.0), (65, 3, [7, 1, 10, 4], -2.0)],
)
def test_features_of_time_planes_equal_the_reference(
    count: int,
    features: int,
    columns: list[int],
    time: float,
    simd: str,
    rng: np.random.Generator,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Catches knots of planes with different resolutions that are mixed up, times between two rows, weights of columns
    that are exchanged, and axes without planes."""
    if not load_native().simd_available(simd):
        pytest.skip(f"this machine does not run {simd}")
    monkeypatch.setenv("FOURD_SIMD", simd)
    others = 51
    weights = make_weights(rng, others + len(columns) * features, 24, 5)
    exact = HeadWeights(*(weight.double() for weight in weights.tensors))
    points, upstream = make_points(rng, count, others, 5, 2, True), make_upstream(rng, count)
    planes = make_time_planes(rng, count, features, columns, time)
    assert planes.coordinates is not None
    doubles = [None if each is None else each.double() for each in points]
    exact_planes = replace(
        planes, planes=[plane.double() for plane in planes.planes], coordinates=planes.coordinates.double()
    )
    found = values_and_gradients(evaluate_heads, points, weights, SETTINGS, upstream, planes)
    expected = values_and_gradients(evaluate_heads_reference, doubles, exact, SETTINGS, upstream, exact_planes)
    for name, other in expected.items():
        # Some hidden values are so near 0 that rounding decides whether ReLU clamps them. This changes few gradients.
        is_sum = name.removeprefix("gradient of ") in vars(weights) or "plane" in name
        scale = max(float(other.abs().max()), 0.1 * count**0.5 if is_sum else 0.0)
        error = (found[name] - other).abs()
        assert float(error.mean()) <= 1e-5 * scale, name
        assert float((error > 1e-3 * scale).float().mean()) <= 1e-2, name


@pytest.mark.parametrize("needed", [("colour",), ("radius", "density"), ("sh",)])
def test_outputs_that_the_loss_does_not_use_add_nothing(needed: tuple[str, ...], rng: np.random.Generator) -> None:
    """Catches gradients of unused outputs that are read although they do not exist."""
    weights, points = make_weights(rng, 20, 12, 5), make_points(rng, 70, 20, 5, 2, True)
    upstream = [each * (name in needed) for name, each in zip(NAMES, make_upstream(rng, 70), strict=True)]
    expected = values_and_gradients(evaluate_heads, points, weights, SETTINGS, upstream)

    def partial(*arguments):
        outputs = evaluate_heads(*arguments)
        return [one if name in needed else one.detach() for name, one in zip(NAMES, outputs, strict=True)]

    found = values_and_gradients(partial, points, weights, SETTINGS, upstream)
    assert all(torch.equal(found[name], other) for name, other in expected.items())


def test_any_thread_count_gives_the_same_bits(rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch) -> None:
    """Catches a sum over points in an order that depends on thread scheduling."""
    weights, points = make_weights(rng, 72, 32, 11), make_points(rng, 9001, 48, 11, 4, True)
    upstream, planes = make_upstream(rng, 9001), make_time_planes(rng, 9001, 8, [8, 24, 64], 0.1)
    results = []
    for threads in ("1", "2", "5"):
        monkeypatch.setenv("FOURD_THREADS", threads)
        results.append(values_and_gradients(evaluate_heads, points, weights, SETTINGS, upstream, planes))
    for other in results[1:]:
        assert all(torch.equal(value, other[name]) for name, value in results[0].items())


def test_no_points_give_zero_gradients(rng: np.random.Generator) -> None:
    """Catches gradients of weights that are not initialised if there are no points."""
    weights, points = make_weights(rng, 12, 8, 11), make_points(rng, 0, 8, 11, 4, True)
    planes = make_time_planes(rng, 0, 2, [2, 6], 0.5)
    found = values_and_gradients(evaluate_heads, points, weights, SETTINGS, make_upstream(rng, 0), planes)
    assert found["colour"].shape == (0, 3)
    assert all(not value.any() for name, value in found.items() if name.startswith("gradient"))


def test_operator_passes_opcheck(rng: np.random.Generator) -> None:
    """Catches a fake implementation that returns wrong shapes, and an operator schema that omits a mutated argument."""
    weights, points = make_weights(rng, 13, 8, 5), make_points(rng, 6, 9, 5, 2, True)
    for index in (0, 1, 4, 5):
        points[index].requires_grad_()  # type: ignore[union-attr]
    free = [weight.requires_grad_() for weight in weights.tensors]
    planes = make_time_planes(rng, 6, 2, [3, 9], 0.5)
    values = [plane.requires_grad_() for plane in planes.planes]
    lines = (values, planes.axes, planes.columns, planes.coordinates, planes.time)
    torch.library.opcheck(torch.ops.fourd.evaluate_heads.default, (*points, *lines, free, SETTINGS.numbers))


def test_mismatched_shapes_are_named(rng: np.random.Generator) -> None:
    """Catches arguments of wrong shape that reach a kernel. The kernel would read past the end of an array."""
    weights, points = make_weights(rng, 9, 8, 5), make_points(rng, 6, 9, 5, 2, True)
    with pytest.raises(ValueError, match=r"samples: expected shape \(views, channels, points\)"):
        evaluate_heads(points[0], points[1][:, :, :4], *points[2:], weights, SETTINGS)
    with pytest.raises(ValueError, match="weights: expected the shapes of the layers"):
        evaluate_heads(*points, replace(weights, sh_last=weights.sh_last[:47]), SETTINGS)
    planes = make_time_planes(rng, 6, 2, [0, 1], 0.5)
    with pytest.raises(ValueError, match="columns: expected different inputs for different planes"):
        evaluate_heads(*points, make_weights(rng, 13, 8, 5), SETTINGS, planes)
    with pytest.raises(ValueError, match="axes: expected 0, 1 or 2"):
        evaluate_heads(*points, make_weights(rng, 13, 8, 5), SETTINGS, replace(planes, axes=[0, 3], columns=[0, 4]))
