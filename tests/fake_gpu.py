"""A device that behaves like a GPU in code that mixes devices, for machines without a GPU.

Tensors of the fake device compute on the CPU, but report the device ``meta``. As with a GPU, an operation on tensors
of both devices is an error, and NumPy cannot read the tensors.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any
from unittest.mock import patch

import torch
from torch import Tensor
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_flatten, tree_map

from fourd.rendering import points

FAKE_GPU = torch.device("meta")
COPIES = ("aten::_to_copy", "aten::copy_")
INDEXED = ("aten::index", "aten::index_put", "aten::index_put_", "aten::_index_put_impl_")


class FakeGpuTensor(Tensor):
    """A tensor that reports the device ``meta``. ``value`` is the tensor on the CPU that contains the numbers."""

    value: Tensor

    @staticmethod
    def __new__(cls: type[FakeGpuTensor], value: Tensor) -> FakeGpuTensor:
        return Tensor._make_wrapper_subclass(
            cls, value.shape, value.stride(), value.storage_offset(), dtype=value.dtype, device=FAKE_GPU
        )

    def __init__(self, value: Tensor) -> None:
        self.value = value

    def __float__(self) -> float:
        return float(self.value)

    def __int__(self) -> int:
        return int(self.value)

    def __bool__(self) -> bool:
        return bool(self.value)

    def tolist(self) -> Any:
        return self.value.tolist()

    @classmethod
    def __torch_dispatch__(cls, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        return _run(func, args, kwargs or {})


class FakeGpu(TorchDispatchMode):
    """Sends operations that create tensors on a CUDA device to the fake device."""

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        return _run(func, args, kwargs or {})


@contextmanager
def fake_gpu() -> Iterator[torch.device]:
    """In the ``with`` block, tensors can be created on the fake device and moved there. Python code that selects a
    kernel by the device accepts the fake device. The kernels of the CPU then run in place of CUDA kernels."""
    with (
        patch("torch.optim.optimizer._get_fused_kernels_supported_devices", lambda: ["cpu", FAKE_GPU.type]),
        patch.object(torch, "tensor", _tensor),
        patch.object(points, "_check", lambda *arguments: "native"),
        FakeGpu(),
    ):
        yield FAKE_GPU


def _tensor(data: Any, *, device: torch.device | None = None, _create: Any = torch.tensor, **options: Any) -> Tensor:
    """``torch.tensor``, which would create a tensor without numbers on the device ``meta``."""
    return _create(data, **options).to(device or "cpu")


def _run(func: Any, args: Any, kwargs: dict[str, Any]) -> Any:
    name = func._schema.name
    given = [value for value in tree_flatten((args, kwargs))[0] if isinstance(value, Tensor)]
    _require_numbers(name, given)
    on_gpu = any(isinstance(value, FakeGpuTensor) for value in given)
    device = kwargs.get("device")
    if on_gpu and name not in COPIES:
        _require_one_device(name, args, given)
    if device is not None:
        on_gpu = torch.device(device).type == FAKE_GPU.type
        kwargs = {**kwargs, "device": "cpu"}
        if name == "aten::_to_copy":
            kwargs.pop("non_blocking", None)
    values = tree_map(_value, (args, kwargs))
    result = func(*values[0], **values[1])
    if name == "aten::copy_" or (name.endswith("_") and on_gpu and isinstance(args[0], FakeGpuTensor)):
        return args[0]
    return tree_map(_wrapper(args, values[0]), result) if on_gpu else result


def _require_numbers(name: str, given: list[Tensor]) -> None:
    """Refuse tensors of the real device ``meta``, which contain no numbers: torch creates one without asking the fake
    device if a tensor is indexed with a list. The operation would read arbitrary memory."""
    if any(value.device.type == FAKE_GPU.type and not isinstance(value, FakeGpuTensor) for value in given):
        raise RuntimeError(f"{name}: expected a tensor with numbers, got one of the real device {FAKE_GPU}")


def _require_one_device(name: str, args: Any, given: list[Tensor]) -> None:
    if name in INDEXED:  # Indices may be on the CPU.
        given = [value for value in (args[0], *args[2:3]) if isinstance(value, Tensor)]
    others = [value for value in given if not isinstance(value, FakeGpuTensor) and value.ndim > 0]
    if others:
        raise RuntimeError(
            f"{name}: expected all tensors on {FAKE_GPU}, got one of shape {tuple(others[0].shape)} on cpu"
        )


def _value(value: Any) -> Any:
    return value.value if isinstance(value, FakeGpuTensor) else value


def _wrapper(args: Any, values: Any) -> Callable[[Any], Any]:
    """Wrap the results of an operation. An argument that the operation returns keeps its identity."""
    known = {id(value): arg for arg, value in zip(args, values, strict=True) if isinstance(arg, FakeGpuTensor)}

    def wrap(result: Any) -> Any:
        if not isinstance(result, Tensor):
            return result
        return known.get(id(result)) or FakeGpuTensor(result)

    return wrap
