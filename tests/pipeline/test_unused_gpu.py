"""The notice that fourd cannot use the GPU of this machine."""

from __future__ import annotations

from pathlib import Path

import pytest

from fourd.pipeline import unused_gpu


def machine(monkeypatch: pytest.MonkeyPatch, has_gpu: bool, torch_sees_it: bool, reason: str) -> None:
    monkeypatch.setattr("torch.cuda.is_available", lambda: torch_sees_it)
    monkeypatch.setattr(unused_gpu.shutil, "which", lambda _: "/usr/bin/nvidia-smi" if has_gpu else None)
    monkeypatch.setattr(unused_gpu, "cuda_unavailable_reason", lambda: reason)


def test_a_wheel_on_a_machine_with_a_gpu_says_how_to_build(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Catches a GPU that stays idle without a word, and a notice that every training repeats."""
    machine(monkeypatch, has_gpu=True, torch_sees_it=True, reason="No module named 'fourd._cuda'")
    told: list[str] = []
    unused_gpu.tell_once(told.append, tmp_path / "state")
    unused_gpu.tell_once(told.append, tmp_path / "state")
    assert len(told) == 1
    assert "only CPU kernels" in told[0]
    assert "--no-binary fourd" in told[0]
    assert "\n" not in told[0]


def test_a_cpu_build_of_torch_is_named(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Catches advice to build kernels where only torch lacks CUDA."""
    machine(monkeypatch, has_gpu=True, torch_sees_it=False, reason="")
    told: list[str] = []
    unused_gpu.tell_once(told.append, tmp_path)
    assert len(told) == 1
    assert "CUDA build of torch" in told[0]


def test_a_used_gpu_needs_no_notice(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Catches a notice on machines where the GPU trains, and a file that is written there."""
    machine(monkeypatch, has_gpu=True, torch_sees_it=True, reason="")
    unused_gpu.tell_once(pytest.fail, tmp_path)
    assert not list(tmp_path.iterdir())


@pytest.mark.skipif(Path("/dev/nvidia0").exists(), reason="this machine has a GPU")
def test_a_machine_without_a_gpu_needs_no_notice(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Catches a notice about a GPU that does not exist."""
    machine(monkeypatch, has_gpu=False, torch_sees_it=False, reason="No module named 'fourd._cuda'")
    unused_gpu.tell_once(pytest.fail, tmp_path)


def test_a_read_only_home_does_not_stop_training(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Catches a training that ends because the notice cannot be remembered."""
    machine(monkeypatch, has_gpu=True, torch_sees_it=True, reason="missing")
    (tmp_path / "file").touch()
    told: list[str] = []
    unused_gpu.tell_once(told.append, tmp_path / "file")
    assert told
