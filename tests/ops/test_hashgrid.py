"""The hash grid kernel compared with plain torch: values, gradients, extreme coordinates, threads and errors."""

from __future__ import annotations

import itertools
from collections.abc import Callable

import numpy as np
import pytest
import torch
from torch import Tensor

from fourd.rendering.ops.hashgrid.op import encode_hash_grid
from fourd.rendering.ops.hashgrid.reference import encode_hash_grid_reference
from fourd.rendering.ops.hashgrid.shape import HashGridShape
from fourd.rendering.ops.loading import load_native


def small_grid(features: int = 2) -> HashGridShape:
    """A grid of six levels. The first two levels store all samples, and the other levels are hashed. Several sizes are
    odd."""
    shape = HashGridShape(levels=6, features=features, log2_entries=9, coarsest=3, finest=70)
    assert [(side + 1) ** 3 <= 2**9 for side in shape.resolutions] == [True, True, False, False, False, False]
    return shape


def random_table(rng: np.random.Generator, shape: HashGridShape) -> Tensor:
    return torch.from_numpy(rng.standard_normal((shape.total_entries, shape.features)).astype(np.float32))


def points(rng: np.random.Generator, count: int = 3000) -> Tensor:
    return torch.from_numpy(rng.uniform(-0.1, 1.1, (count, 3)).astype(np.float32))


Encode = Callable[[Tensor, Tensor, HashGridShape], Tensor]


def results(
    function: Encode, shape: HashGridShape, coordinates: Tensor, table: Tensor, upstream: Tensor
) -> list[Tensor]:
    """Return the encoding and its gradients with respect to the coordinates and the table, as tensors on the CPU."""
    leaves = [tensor.clone().requires_grad_() for tensor in (coordinates, table)]
    out = function(*leaves, shape)
    return [tensor.detach().cpu() for tensor in (out, *torch.autograd.grad(out, leaves, upstream))]


def assert_close(found: list[Tensor], expected: list[Tensor]) -> None:
    for one, other in zip(found, expected, strict=True):
        torch.testing.assert_close(one, other, rtol=1e-4, atol=2e-6 * float(other.abs().max()))


@pytest.mark.parametrize("simd", ["baseline", "avx2"])
@pytest.mark.parametrize("features", [1, 2, 3, 4, 6, 8])
def test_values_and_gradients_equal_the_reference(
    features: int, simd: str, rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Catches swapped corner weights, levels that start in a wrong row, and missing points at the end of a chunk."""
    if not load_native().simd_available(simd):
        pytest.skip(f"this machine does not run {simd}")
    monkeypatch.setenv("FOURD_SIMD", simd)
    shape = small_grid(features)
    inputs = (shape, points(rng, 5003), random_table(rng, shape))
    upstream = torch.from_numpy(rng.standard_normal((5003, shape.out_features)).astype(np.float32))
    assert_close(results(encode_hash_grid, *inputs, upstream), results(encode_hash_grid_reference, *inputs, upstream))


@pytest.mark.parametrize("features", [2, 3])
def test_gpu_equals_the_reference(features: int, gpu: torch.device, rng: np.random.Generator) -> None:
    """Catches a result whose points and levels are swapped, and coordinate gradients that are not summed over
    levels."""
    shape = small_grid(features)
    tensors = [points(rng, 300), random_table(rng, shape)]
    tensors.append(torch.from_numpy(rng.standard_normal((300, shape.out_features)).astype(np.float32)))
    found = results(encode_hash_grid, shape, *(tensor.to(gpu) for tensor in tensors))
    assert_close(found, results(encode_hash_grid_reference, shape, *tensors))


def test_a_grid_of_default_size_equals_the_reference(rng: np.random.Generator) -> None:
    """Catches integer overflow in the hash, which occurs only in grids of high resolution. The finest level has 2^20
    cells per side."""
    shape = HashGridShape(levels=2, log2_entries=19, finest=2**20)
    table = random_table(rng, shape)
    # These coordinates have no rounding error in float32 at either level.
    coordinates = torch.from_numpy(rng.integers(0, 2**12, (200, 3)) / 2**12).float()
    torch.testing.assert_close(
        encode_hash_grid(coordinates, table, shape),
        encode_hash_grid_reference(coordinates, table, shape),
        rtol=1e-4,
        atol=1e-5,
    )


def test_entries_are_where_the_paper_puts_them(rng: np.random.Generator) -> None:
    """Catches a hash that is wrong in both kernel and reference, and hashing of a level that just fits into the table
    (4^3 = 2^6).

    At the position of a grid sample, one table entry has the whole weight. The formula of the paper gives the row of
    this entry.
    """
    shape = HashGridShape(levels=2, features=1, log2_entries=6, coarsest=3, finest=32)
    table = torch.arange(shape.total_entries, dtype=torch.float32)[:, None]
    for level, side in enumerate(shape.resolutions):
        samples = rng.integers(0, side + 1, (50, 3)).tolist()
        found = encode_hash_grid(torch.tensor(samples) / side, table, shape)[:, level]
        for (x, y, z), row in zip(samples, found.tolist(), strict=True):
            dense = x + y * (side + 1) + z * (side + 1) ** 2
            hashed = (x ^ (y * 2654435761 % 2**32) ^ (z * 805459861 % 2**32)) % 2**6
            assert row == shape.offsets[level] + (dense if level == 0 else hashed)


def test_gradient_equals_finite_differences(rng: np.random.Generator) -> None:
    """Catches an error that the gradients of the kernel and the gradients of the reference have in common."""
    shape = HashGridShape(levels=3, log2_entries=6, coarsest=2, finest=9)
    table, step = random_table(rng, shape).double(), 1e-6
    # Avoid the faces of grid cells, where the derivative is discontinuous.
    coordinates = torch.from_numpy(rng.uniform(0.02, 0.98, (200, 3)))
    scaled = coordinates[..., None] * torch.tensor(shape.resolutions)
    coordinates = coordinates[((scaled - scaled.round()).abs() > 1e-3).all(dim=2).all(dim=1)]
    assert len(coordinates) > 100

    def total(at: Tensor, values: Tensor) -> Tensor:
        return encode_hash_grid_reference(at, values, shape).sum(1)

    leaf, values = coordinates.float().requires_grad_(), table.float().requires_grad_()
    slopes, grad_table = torch.autograd.grad(encode_hash_grid(leaf, values, shape).sum(), [leaf, values])
    for axis in range(3):
        offset = step * torch.eye(3, dtype=torch.float64)[axis]
        slope = (total(coordinates + offset, table) - total(coordinates - offset, table)) / (2 * step)
        torch.testing.assert_close(slopes[:, axis].double(), slope, rtol=1e-3, atol=1e-3)
    for row in rng.integers(0, shape.total_entries, 20):
        offset = torch.zeros_like(table)
        offset[row, 1] = step
        slope = (total(coordinates, table + offset) - total(coordinates, table - offset)).sum() / (2 * step)
        assert float(grad_table[row, 1]) == pytest.approx(float(slope), rel=1e-4, abs=1e-4)


def test_extreme_coordinates_stay_inside_the_table(rng: np.random.Generator) -> None:
    """Catches reads past the last sample, NaN that spreads to other points, and coordinate gradients outside the
    grid."""
    shape = small_grid()
    table = random_table(rng, shape).requires_grad_()
    values = torch.tensor([0, 1, np.nan, np.inf, -np.inf, 3e38, -3e38, 1e-42, -0.0, 1 - 2**-24, 0.3])
    coordinates = torch.cartesian_prod(values, values, values).requires_grad_()
    found = encode_hash_grid(coordinates, table, shape)
    inside = coordinates.detach().nan_to_num(nan=0, posinf=1, neginf=0).clamp(0, 1)
    torch.testing.assert_close(found, encode_hash_grid_reference(inside, table, shape), rtol=1e-5, atol=1e-5)
    slopes, grad_table = torch.autograd.grad(found.sum(), [coordinates, table])
    assert slopes.isfinite().all()
    assert grad_table.isfinite().all()
    outside = ~((coordinates >= 0) & (coordinates <= 1))
    assert not slopes[outside].any()
    assert slopes[~outside].any()


def test_any_thread_count_gives_the_same_bits(rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch) -> None:
    """Catches threads that add gradients to the same table entry in random order."""
    shape = small_grid()
    inputs = (shape, points(rng, 20000), random_table(rng, shape))
    upstream = torch.from_numpy(rng.standard_normal((20000, shape.out_features)).astype(np.float32))
    found = []
    for threads in ("1", "2", "5"):
        monkeypatch.setenv("FOURD_THREADS", threads)
        found.append(results(encode_hash_grid, *inputs, upstream))
    for other in found[1:]:
        assert all(torch.equal(a, b) for a, b in zip(found[0], other, strict=True))


def test_no_points_give_zero_gradients(rng: np.random.Generator) -> None:
    """Catches gradients that are not initialized if there are no points."""
    shape = small_grid()
    table = random_table(rng, shape).requires_grad_()
    found = encode_hash_grid(torch.zeros(0, 3), table, shape)
    assert found.shape == (0, shape.out_features)
    (gradient,) = torch.autograd.grad(found.sum(), table)
    assert gradient.shape == table.shape
    assert not gradient.any()


ONE_GRADIENT = pytest.mark.parametrize(("needs_coordinates", "needs_table"), [(True, False), (False, True)])


@ONE_GRADIENT
def test_one_gradient_without_the_other(needs_coordinates: bool, needs_table: bool, rng: np.random.Generator) -> None:
    """Catches swapped gradients, and a gradient that changes if the other gradient is not required."""
    assert_one_gradient(needs_coordinates, needs_table, rng, torch.device("cpu"))


@ONE_GRADIENT
def test_one_gradient_without_the_other_on_gpu(
    needs_coordinates: bool, needs_table: bool, gpu: torch.device, rng: np.random.Generator
) -> None:
    """Catches a kernel that writes a gradient that is not required and has no memory."""
    assert_one_gradient(needs_coordinates, needs_table, rng, gpu)


def assert_one_gradient(
    needs_coordinates: bool, needs_table: bool, rng: np.random.Generator, device: torch.device
) -> None:
    shape = small_grid()
    upstream = torch.from_numpy(rng.standard_normal((100, shape.out_features)).astype(np.float32)).to(device)
    coordinates, table = points(rng, 100).to(device), random_table(rng, shape).to(device)
    both = results(encode_hash_grid, shape, coordinates, table, upstream)[1:]
    coordinates.requires_grad_(needs_coordinates)
    table.requires_grad_(needs_table)
    encode_hash_grid(coordinates, table, shape).backward(upstream)
    for leaf, needed, expected in ((coordinates, needs_coordinates, both[0]), (table, needs_table, both[1])):
        if needed:
            assert_close([leaf.grad.cpu()], [expected])
        else:
            assert leaf.grad is None


def test_float64_is_exact(rng: np.random.Generator) -> None:
    """Catches float64 inputs that are rounded by a float32 kernel."""
    shape = small_grid()
    table = random_table(rng, shape).double().requires_grad_()
    coordinates = torch.from_numpy(rng.uniform(0, 1, (50, 3))).requires_grad_()
    found = encode_hash_grid(coordinates, table, shape)
    assert found.dtype == torch.float64
    assert torch.equal(found, encode_hash_grid_reference(coordinates, table, shape))


def test_operator_passes_opcheck(rng: np.random.Generator) -> None:
    """Catches a fake implementation that returns wrong shapes, and an operator schema that omits a mutated argument."""
    shape = HashGridShape(levels=3, log2_entries=4, coarsest=2, finest=9)
    for needs_coordinates, needs_table in itertools.product((True, False), repeat=2):
        leaves = (
            points(rng, 5).requires_grad_(needs_coordinates),
            random_table(rng, shape).requires_grad_(needs_table),
        )
        arguments = (*leaves, list(shape.resolutions), shape.log2_entries)
        torch.library.opcheck(torch.ops.fourd.encode_hash_grid.default, arguments)


def test_default_sizes_equal_the_paper() -> None:
    """Catches a rounded growth factor, a finest level that is one cell too small, and overlapping table rows."""
    shape = HashGridShape()
    assert shape.resolutions == (16, 22, 30, 42, 58, 80, 111, 153, 212, 294, 406, 561, 776, 1072, 1482, 2048)
    assert shape.entries == (17**3, 23**3, 31**3, 43**3, 59**3, *[2**19] * 11)
    assert shape.out_features == 32
    ends = [offset + entries for offset, entries in zip(shape.offsets, shape.entries, strict=True)]
    assert all(0 <= start - end < 16 for start, end in zip(shape.offsets, [0, *ends[:-1]], strict=True))
    assert ends[-1] == shape.total_entries
    assert HashGridShape(levels=1, coarsest=5).resolutions == (5,)
    assert all(HashGridShape(levels=n, coarsest=3, finest=f).resolutions[-1] == f for n in (2, 7, 32) for f in (3, 999))


@pytest.mark.parametrize(
    ("field", "value", "expected"),
    [
        ("levels", 0, "1 to 32"),
        ("levels", 33, "1 to 32"),
        ("features", 9, "1 to 8"),
        ("log2_entries", 3, "4 to 24"),
        ("log2_entries", 25, "4 to 24"),
        ("coarsest", 0, "1 to 1048576"),
        ("finest", 15, "16 to 1048576"),
        ("finest", 2**20 + 1, "16 to 1048576"),
    ],
)
def test_invalid_sizes_are_named(field: str, value: int, expected: str) -> None:
    """Catches invalid sizes that are detected only inside a kernel or when memory is allocated."""
    with pytest.raises(ValueError, match=f"^{field}: expected {expected}, got {value}$"):
        HashGridShape(**{field: value})


def test_invalid_arguments_are_named(rng: np.random.Generator) -> None:
    """Catches arguments of wrong shape that reach a kernel. The kernel would read past the end of an array."""
    shape = small_grid()
    good, table = points(rng, 5), random_table(rng, shape)
    with pytest.raises(ValueError, match=r"coordinates: expected shape \(N, 3\), got \(5, 2\)"):
        encode_hash_grid(good[:, :2], table, shape)
    with pytest.raises(ValueError, match=rf"table: expected shape \({shape.total_entries}, 2\), got \(7, 2\)"):
        encode_hash_grid(good, table[:7], shape)
    with pytest.raises(TypeError, match="coordinates: expected float32 or float64, got float16"):
        encode_hash_grid(good.half(), table, shape)
    with pytest.raises(TypeError, match="table: expected float32 like coordinates, got float64"):
        encode_hash_grid(good, table.double(), shape)
    operator = torch.ops.fourd.encode_hash_grid
    with pytest.raises(ValueError, match="table: expected as many entries as the levels need"):
        operator(good, table[1:].clone(), list(shape.resolutions), shape.log2_entries)
    with pytest.raises(ValueError, match=r"resolutions: expected 1 to 2\^20 cells per side"):
        operator(good, table, [0], shape.log2_entries)
