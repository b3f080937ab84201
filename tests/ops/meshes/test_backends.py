"""The selection of a backend from the argument and from the device of the tensors."""

from __future__ import annotations

import pytest
import torch

from fourd.rendering.ops.gpu import cuda_unavailable_reason
from fourd.rendering.ops.meshes.backends import select_backend


def test_cpu_tensors_use_the_kernels_or_the_reference() -> None:
    """Catches a backend argument that is ignored."""
    single, double = torch.zeros(1), torch.zeros(1, dtype=torch.float64)
    assert select_backend("auto", "pos", single) == select_backend("cpu", "pos", single) == "native"
    assert select_backend("reference", "pos", double) == "reference"


def test_impossible_backends_are_named() -> None:
    """Catches a silent fallback to the reference, which is slow, and float64 values that a kernel reads as float32."""
    with pytest.raises(ValueError, match="backend: expected 'auto', 'reference', 'cpu' or 'cuda', got 'gpu'"):
        select_backend("gpu", "pos", torch.zeros(1))
    with pytest.raises(ValueError, match="pos: expected a tensor on 'cpu' for backend 'cpu', got one on 'meta'"):
        select_backend("cpu", "pos", torch.zeros(1, device="meta"))
    with pytest.raises(TypeError, match="pos: expected dtype float32 for backend 'auto', got float64"):
        select_backend("auto", "pos", torch.zeros(1, dtype=torch.float64))
    if cuda_unavailable_reason():
        with pytest.raises(RuntimeError, match="backend: expected an installed backend, got 'cuda'"):
            select_backend("cuda", "pos", torch.zeros(1))
