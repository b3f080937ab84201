"""The kernel of docs/guides/adding_a_kernel.md builds with the package's CMake functions and matches its reference."""

from __future__ import annotations

import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import torch

from fourd.rendering.ops.loading import load_native
from tests.example_kernel.saxpy import saxpy, saxpy_reference

HERE = Path(__file__).parent


@pytest.fixture(scope="module")
def example_module(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Build the module _example and add it to the import path."""
    nanobind = pytest.importorskip("nanobind")
    cmake = shutil.which("cmake", path=str(Path(sys.executable).parent)) or shutil.which("cmake")
    if cmake is None or not (shutil.which("c++") or shutil.which("g++") or shutil.which("clang++")):
        pytest.skip("no cmake or C++ compiler here")
    build = tmp_path_factory.mktemp("example_kernel")
    definitions = [
        f"-DPython_EXECUTABLE={sys.executable}",
        f"-Dnanobind_DIR={nanobind.cmake_dir()}",
        "-DCMAKE_BUILD_TYPE=Release",
        "-DFOURD_WERROR=ON",
    ]
    _run(cmake, "-S", str(HERE), "-B", str(build), *definitions)
    _run(cmake, "--build", str(build), "--parallel")
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(build))
        yield


@pytest.mark.slow
@pytest.mark.usefixtures("example_module")
def test_example_matches_its_reference(rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch) -> None:
    """Catches build functions or headers of the package that differ from the instructions in
    docs/guides/adding_a_kernel.md."""
    values = [torch.from_numpy(rng.standard_normal(1003).astype(np.float32)) for _ in range(2)]
    inputs = [tensor.requires_grad_() for tensor in values]
    expected = saxpy_reference(1.7, *inputs)
    for simd in ("baseline", "avx2", "avx512"):
        if not load_native().simd_available(simd):
            continue
        monkeypatch.setenv("FOURD_SIMD", simd)
        found = saxpy(1.7, *inputs)
        assert torch.equal(found, expected)
        gradients = torch.autograd.grad(found.square().sum(), inputs)
        references = torch.autograd.grad(expected.square().sum(), inputs, retain_graph=True)
        assert all(torch.allclose(a, b) for a, b in zip(gradients, references, strict=True))
    torch.library.opcheck(torch.ops.fourd_example.saxpy.default, (1.7, *inputs))


def test_wrong_shape_is_refused() -> None:
    """Catches a kernel that reads past the end of an array."""
    with pytest.raises(ValueError, match=r"y: expected float32 values \(N,\) on the CPU"):
        saxpy(1.0, torch.zeros(3), torch.zeros(3, 1))


def _run(*command: str) -> None:
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-2000:]
