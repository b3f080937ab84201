"""Checkpoints are exact and written atomically. Loading a checkpoint into another model is an error."""

from __future__ import annotations

import errno
import itertools
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors import SafetensorError
from safetensors.torch import save_file
from torch import Tensor, nn

from fourd.base.errors import UserError
from fourd.reconstruction.training import checkpoints
from fourd.reconstruction.training.checkpoints import (
    checkpoint_path,
    latest_checkpoint,
    load_checkpoint,
    pack_optimizer,
    restore,
    save_checkpoint,
    unpack_optimizer,
)


def bits(value: Tensor) -> bytes:
    return value.contiguous().reshape(-1).view(torch.uint8).numpy().tobytes() if value.numel() else b""


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_round_trip_is_bit_exact(tmp_path: Path) -> None:
    """Catches saved tensors that have another dtype, are transposed, or have lost NaN values or scalars."""
    torch.manual_seed(1)
    tensors = {
        "float": torch.tensor([1e-45, -0.0, float("nan"), float("inf")]),
        "transposed": torch.rand(3, 5).T,
        "half": torch.rand(4).half(),
        "bfloat16": torch.rand(4).bfloat16(),
        "double": torch.rand(2, 2, dtype=torch.float64),
        "step": torch.tensor(7.0),
        "integers": torch.arange(5),
        "bytes": torch.arange(256).to(torch.uint8),
        "flags": torch.tensor([True, False]),
        "empty": torch.zeros(0, 3),
        "trained": nn.Parameter(torch.rand(3)),
    }
    state = {"seconds": 0.1 + 0.2, "names": ["05", "ü"], "nested": {"big": 2**127 + 1, "none": None}}
    path = save_checkpoint(tmp_path / "new", 42, tensors, state)
    assert path == checkpoint_path(tmp_path / "new", 42)
    step, loaded, loaded_state = load_checkpoint(path)
    assert (step, loaded_state) == (42, state)
    assert loaded.keys() == tensors.keys()
    for name, value in tensors.items():
        assert loaded[name].dtype == value.dtype, name
        assert loaded[name].shape == value.shape, name
        assert bits(loaded[name]) == bits(value.detach()), name
    with pytest.raises(ValueError, match="JSON"):
        save_checkpoint(tmp_path / "new", 43, tensors, {"psnr": float("nan")})


def test_the_two_newest_checkpoints_are_kept(tmp_path: Path) -> None:
    """Catches checkpoints in alphabetical order, in which step 9 follows step 10, and the deletion of other files."""
    (tmp_path / "mine.safetensors").write_bytes(b"")
    (tmp_path / "00000009.points").mkdir()
    for step in (9, 10, 123456789):
        save_checkpoint(tmp_path, step, {"a": torch.zeros(1)}, {})
    expected = ["00000009.points", "00000010.safetensors", "123456789.safetensors", "mine.safetensors"]
    assert names(tmp_path) == expected
    found, note = latest_checkpoint(tmp_path)
    assert (found, note) == (checkpoint_path(tmp_path, 123456789), "")


def test_a_folder_without_checkpoints_has_none(tmp_path: Path) -> None:
    assert latest_checkpoint(tmp_path / "absent") == (None, "")
    assert latest_checkpoint(tmp_path) == (None, "")


def cut_in_half(content: bytes) -> bytes:
    return content[: len(content) // 2]


def cut_last_byte(content: bytes) -> bytes:
    return content[:-1]


def empty(content: bytes) -> bytes:
    return b""


def flip_a_bit(content: bytes) -> bytes:
    return content[:-3] + bytes([content[-3] ^ 4]) + content[-2:]


def zero(content: bytes) -> bytes:
    """Replace the content by zeros. After a power failure, some file systems contain files of zeros."""
    return bytes(len(content))


@pytest.mark.parametrize("damage", [cut_in_half, cut_last_byte, empty, flip_a_bit, zero])
def test_damaged_checkpoints_are_skipped_with_a_note(damage: object, tmp_path: Path) -> None:
    """Catches resuming from damaged data, and a fallback to an older checkpoint without a note."""
    assert callable(damage)
    for step in (1, 2):
        save_checkpoint(tmp_path, step, {"a": torch.rand(100)}, {})
    path = checkpoint_path(tmp_path, 2)
    path.write_bytes(damage(path.read_bytes()))
    found, note = latest_checkpoint(tmp_path)
    assert found == checkpoint_path(tmp_path, 1)
    assert str(path) in note
    assert "resuming from 00000001.safetensors" in note
    assert "\n" not in note
    with pytest.raises(UserError, match=path.name):
        load_checkpoint(path)
    save_checkpoint(tmp_path, 1, {"a": torch.rand(100)}, {})
    assert names(tmp_path) == ["00000001.safetensors"], "a damaged later checkpoint must not count as one of the two"


def test_a_folder_of_damaged_checkpoints_has_none(tmp_path: Path) -> None:
    checkpoint_path(tmp_path, 3).write_bytes(b"rubbish")
    found, note = latest_checkpoint(tmp_path)
    assert found is None
    assert "there is no other checkpoint" in note


def test_other_safetensors_files_are_refused(tmp_path: Path) -> None:
    """Catches other safetensors files that are accepted as checkpoints."""
    save_file({"a": torch.zeros(1)}, tmp_path / "00000001.safetensors")
    with pytest.raises(UserError, match="expected a checkpoint of format"):
        load_checkpoint(tmp_path / "00000001.safetensors")
    with pytest.raises(UserError, match="cannot be read"):
        load_checkpoint(tmp_path / "absent.safetensors")


def save_to_full_disk(*_: object, **__: object) -> None:
    raise SafetensorError("Error while serializing: I/O error: No space left on device (os error 28)")


def save_half(tensors: object, path: Path, metadata: object) -> None:
    path.write_bytes(b"half")
    raise OSError(errno.ENOSPC, "No space left on device")


def raise_disk_full(*_: object) -> None:
    raise OSError(errno.ENOSPC, "No space left on device")


@pytest.mark.parametrize(
    ("target", "fault"),
    [
        ("fourd.reconstruction.training.checkpoints.save_file", save_to_full_disk),
        ("fourd.reconstruction.training.checkpoints.save_file", save_half),
        ("os.fsync", raise_disk_full),
        ("os.replace", raise_disk_full),
    ],
)
def test_a_full_disk_leaves_previous_checkpoints_intact(
    target: str, fault: object, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Catches an old checkpoint that is deleted before the new checkpoint is complete. Also catches leftover files and
    tracebacks."""
    for step in (1, 2):
        save_checkpoint(tmp_path, step, {"a": torch.full((3,), float(step))}, {})
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    monkeypatch.setattr(target, fault)
    with pytest.raises(UserError) as caught:
        save_checkpoint(tmp_path, 3, {"a": torch.zeros(3)}, {})
    monkeypatch.undo()
    message = str(caught.value)
    assert str(tmp_path) in message
    assert "got a full disk" in message
    assert "00000002.safetensors, is intact" in message
    assert "\n" not in message
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before


def test_an_unwritable_folder_is_not_reported_as_a_full_disk(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(UserError, match="there is no previous checkpoint") as caught:
        save_checkpoint(tmp_path / "file", 1, {"a": torch.zeros(1)}, {})
    assert "full disk" not in str(caught.value)


KILLED = """
import itertools, sys, torch
from pathlib import Path
from fourd.reconstruction.training.checkpoints import save_checkpoint
for step in itertools.count(1):
    save_checkpoint(Path(sys.argv[1]), step, {"a": torch.full((200_000,), float(step))}, {"step": step})
    print(step, flush=True)
"""


def test_a_kill_at_any_time_leaves_an_intact_checkpoint(tmp_path: Path, rng: np.random.Generator) -> None:
    """Catches checkpoints that are not written atomically. After kill -9, the last reported checkpoint must be
    intact."""
    for delay in rng.uniform(0, 0.05, 3):
        folder = tmp_path / f"{delay:.9f}"
        with subprocess.Popen(
            [sys.executable, "-c", KILLED, str(folder)], stdout=subprocess.PIPE, text=True
        ) as process:
            assert process.stdout is not None
            reported = [process.stdout.readline() for _ in range(2)]
            time.sleep(delay)
            os.kill(process.pid, signal.SIGKILL)
            reported += process.stdout.read().splitlines()
        found, note = latest_checkpoint(folder)
        assert note == ""
        assert found is not None
        step, tensors, state = load_checkpoint(found)
        assert step >= int(reported[-1])
        assert state == {"step": step}
        assert bool((tensors["a"] == step).all())


def small_model(width: int = 4) -> nn.Module:
    return nn.Sequential(nn.Linear(3, width), nn.ReLU(), nn.Linear(width, 2))


def test_restore_loads_the_tensors_of_its_prefix() -> None:
    torch.manual_seed(0)
    source, target = small_model(), small_model()
    tensors = {f"model.{name}": value for name, value in source.state_dict().items()}
    restore(target, {**tensors, "optimizer.0.step": torch.tensor(1.0)}, "model.", "F.safetensors")
    for name, value in target.state_dict().items():
        assert torch.equal(value, source.state_dict()[name])


def test_restore_refuses_tensors_of_another_model() -> None:
    """Catches a checkpoint of another model that is loaded in part, with tensors of other shapes, or with missing or
    additional tensors."""
    target = small_model()
    before = {name: value.clone() for name, value in target.state_dict().items()}
    tensors = {f"model.{name}": value for name, value in small_model(width=8).state_dict().items()}
    with pytest.raises(UserError) as caught:
        restore(target, tensors, "model.", Path("runs/F.safetensors"))
    message = str(caught.value)
    assert message.startswith("runs/F.safetensors: expected a checkpoint of this model")
    assert "'0.weight' has shape (4, 3) in the model and (8, 3) in the checkpoint" in message
    assert "use the config with which the checkpoint was trained" in message
    tensors = {f"model.{name}": value for name, value in small_model().state_dict().items()}
    surplus = {**tensors, "model.9.bias": torch.zeros(1)}
    missing = {name: value for name, value in tensors.items() if name != "model.2.bias"}
    double = {**tensors, "model.0.bias": tensors["model.0.bias"].double()}
    cases = (
        (surplus, "'9.bias' is not in the model"),
        (missing, "'2.bias' is not in the checkpoint"),
        (double, "float64 in the checkpoint"),
    )
    for given, message in cases:
        with pytest.raises(UserError, match=message):
            restore(target, given, "model.", "F")
    for name, value in target.state_dict().items():
        assert torch.equal(value, before[name])


def train(model: nn.Module, optimizer: torch.optim.Optimizer, steps: int, generator: torch.Generator) -> None:
    for _ in range(steps):
        optimizer.zero_grad()
        model(torch.rand(5, 3, generator=generator)).square().sum().backward()
        optimizer.step()


def new_optimizer(model: nn.Module, fused: bool) -> torch.optim.Optimizer:
    first, *rest = model.parameters()
    groups = [{"params": rest, "lr": 1e-2}, {"params": [first], "lr": 1e-3}]
    return torch.optim.Adam(groups, betas=(0.9, 0.99), fused=fused)


@pytest.mark.parametrize("fused", [False, True])
def test_resumed_training_is_bit_exact(fused: bool, tmp_path: Path) -> None:
    """Catches Adam moments or step counts that are lost or assigned to another parameter."""
    torch.manual_seed(2)
    uninterrupted = small_model()
    optimizer, generator = new_optimizer(uninterrupted, fused), torch.Generator().manual_seed(3)
    train(uninterrupted, optimizer, 5, generator)
    tensors = {f"model.{name}": value for name, value in uninterrupted.state_dict().items()}
    tensors |= pack_optimizer(optimizer, "optimizer.") | {"rng": generator.get_state()}
    path = save_checkpoint(tmp_path, 5, tensors, {})
    train(uninterrupted, optimizer, 5, generator)

    resumed = small_model()
    second, other = new_optimizer(resumed, fused), torch.Generator()
    _, loaded, _ = load_checkpoint(path)
    restore(resumed, loaded, "model.", path)
    unpack_optimizer(second, loaded, "optimizer.", path)
    other.set_state(loaded["rng"].clone())
    train(resumed, second, 5, other)
    for name, value in resumed.state_dict().items():
        assert bits(value) == bits(uninterrupted.state_dict()[name]), name
    packed, expected = pack_optimizer(second, "o."), pack_optimizer(optimizer, "o.")
    assert packed.keys() == expected.keys()
    assert all(bits(packed[name]) == bits(expected[name]) for name in packed)
    # The optimizer trains on copies of the loaded tensors.
    _, again, _ = load_checkpoint(path)
    assert all(bits(loaded[name]) == bits(again[name]) for name in again)


def test_optimizer_state_of_another_model_is_refused() -> None:
    model, other = small_model(), small_model(width=8)
    optimizer = new_optimizer(model, fused=False)
    train(model, optimizer, 1, torch.Generator())
    packed = pack_optimizer(optimizer, "optimizer.")
    with pytest.raises(UserError, match=r"F.safetensors: expected the optimizer's state of this model"):
        unpack_optimizer(new_optimizer(other, fused=False), packed, "optimizer.", "F.safetensors")
    with pytest.raises(UserError, match=r"'optimizer\.4\.step'"):
        unpack_optimizer(optimizer, {**packed, "optimizer.4.step": torch.tensor(1.0)}, "optimizer.")


def test_an_optimizer_without_steps_has_no_state() -> None:
    optimizer = new_optimizer(small_model(), fused=False)
    assert pack_optimizer(optimizer, "optimizer.") == {}
    unpack_optimizer(optimizer, {}, "optimizer.")
    assert optimizer.state_dict()["state"] == {}


def test_checkpoints_use_no_pickle() -> None:
    """Catches loading that executes code from an untrusted file."""
    source = Path(checkpoints.__file__).read_text()
    assert not [word for word in itertools.chain(("import pickle", "torch.load", "torch.save")) if word in source]
