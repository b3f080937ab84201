"""Scripts with calls for a CUDA device on a machine without one: ``run_on_cpu`` and ``python -m``."""

from __future__ import annotations

import io
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

from fourd.rendering.nvdiffrast import run_on_cpu

SCRIPTS = Path(__file__).parent / "scripts"


def run(*arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "fourd.rendering.nvdiffrast", *arguments]
    return subprocess.run(command, capture_output=True, text=True, env={**os.environ, "OMP_NUM_THREADS": "1"})


def test_a_script_for_cuda_runs_unchanged_and_its_replaced_calls_are_named() -> None:
    """Catches a device call that fails, a module nvdiffrast that is not found, arguments that do not reach the script,
    and calls that are replaced without a message."""
    done = run("--cpu", str(SCRIPTS / "cuda_cube.py"), "--steps", "50")
    assert done.returncode == 0, done.stderr
    assert 0.9 < float(done.stdout.split()[-1]) < 1.1
    for call in ("Tensor.cuda()", 'torch.as_tensor(device="cuda")', 'torch.Generator("cuda")', "torch.cuda.Event()"):
        lines = [line for line in done.stderr.splitlines() if call in line]
        assert len(lines) == 1
        assert lines[0].startswith("run_on_cpu: cuda_cube.py:")
    assert "import nvdiffrast.torch gives fourd.rendering.nvdiffrast" in done.stderr


def test_a_missing_script_is_named() -> None:
    """Catches a traceback for a wrong path."""
    done = run("missing.py")
    assert done.returncode == 2
    assert done.stderr == (
        "error: SCRIPT: expected a Python file, got missing.py; see python -m fourd.rendering.nvdiffrast --help\n"
    )
    assert run("--help").stdout.startswith("usage: python -m fourd.rendering.nvdiffrast [--cpu] SCRIPT")


def test_everything_is_restored_at_the_end() -> None:
    """Catches functions of torch that stay replaced after the with block."""
    names = ("is_available", "synchronize", "Event", "FloatTensor", "device")
    before = [getattr(torch.cuda, name) for name in names]
    others = (torch.Generator, torch.load, torch.set_default_device, torch.cuda.nvtx.mark)
    with run_on_cpu(io.StringIO()):
        assert torch.cuda.is_available()
        assert torch.zeros(2, device="cuda").device.type == "cpu"
    assert [getattr(torch.cuda, name) for name in names] == before
    assert (torch.Generator, torch.load, torch.set_default_device, torch.cuda.nvtx.mark) == others
    if not torch.cuda.is_available():
        with pytest.raises((RuntimeError, AssertionError)):
            torch.zeros(2, device="cuda")


def test_every_kind_of_device_argument_is_replaced() -> None:
    """Catches devices as objects, numbers, positional arguments, defaults and contexts."""
    with run_on_cpu(io.StringIO()):
        x = torch.eye(3)
        found = [
            torch.zeros(2, device=torch.device("cuda")),
            torch.zeros(2, device=0),
            torch.rand(2, device="cuda:0", generator=torch.Generator("cuda")),
            torch.zeros_like(x, device="cuda"),
            x.new_ones(3, device="cuda"),
            x.to("cuda"),
            x.to(0),
            x.to("cuda", torch.float64, non_blocking=True),
            x.to(device=torch.device("cuda:0")),
            x.cuda(non_blocking=True),
            x.type("torch.cuda.DoubleTensor"),
            torch.cuda.FloatTensor([1, 2]),
            torch.nn.Linear(2, 2, device="cuda").weight,
            torch.nn.Linear(2, 2).to(0).weight,
            torch.nn.Linear(2, 2).to(torch.device("cuda"), torch.float64).weight,
            x.pin_memory(),
        ]
        with torch.device("cuda"):
            found.append(torch.zeros(2))
        torch.set_default_device("cuda")
        try:
            found.append(torch.zeros(2))
        finally:
            torch.set_default_device(None)
        with torch.cuda.stream(torch.cuda.Stream()), torch.cuda.device(0), torch.random.fork_rng():
            torch.cuda.current_stream().wait_stream(torch.cuda.Stream())
        assert isinstance(torch.default_generator, torch.Generator)
    assert {tensor.device.type for tensor in found} == {"cpu"}
    assert found[7].dtype == found[10].dtype == found[14].dtype == torch.float64


def test_transfers_copy_as_between_a_cpu_and_a_gpu() -> None:
    """Catches a script that changes an array through a tensor on the device, or a history of parameters in which all
    entries are the last one."""
    array = np.zeros(3, np.float32)
    with run_on_cpu(io.StringIO()):
        for tensor in (
            torch.from_numpy(array).cuda(),
            torch.as_tensor(array, device="cuda"),
            torch.from_numpy(array).to("cuda"),
            torch.from_numpy(array).to(torch.device("cuda")),
        ):
            tensor += 1
            snapshots = [tensor.cpu(), tensor.to("cpu"), tensor.detach().cpu()]
            tensor += 1
            assert [float(one[0]) for one in snapshots] == [1, 1, 1]
        parameter = torch.zeros(3, device="cuda", requires_grad=True)
        device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
        for same in (parameter.cuda(), parameter.to("cuda"), parameter.to(device)):
            assert same is parameter
    assert not array.any()


def test_torch_itself_gets_the_truth() -> None:
    """Catches torch functions that would use a device because they are told that there is one."""
    with run_on_cpu(io.StringIO()), torch.amp.autocast("cuda", enabled=torch.cuda.is_available()):
        loader = torch.utils.data.DataLoader(torch.arange(4), batch_size=2, pin_memory=True)
        assert [batch.tolist() for batch in loader] == [[0, 1], [2, 3]]


def test_a_checkpoint_is_loaded_onto_the_cpu(tmp_path: Path) -> None:
    """Catches map_location="cuda", which fails without a device."""
    torch.save({"a": torch.ones(2)}, tmp_path / "a.pt")
    with run_on_cpu(io.StringIO()):
        assert torch.load(tmp_path / "a.pt", map_location="cuda")["a"].tolist() == [1, 1]
