"""Checkpoints in safetensors: whole or absent, never half, and no code runs on loading one."""

from __future__ import annotations

import errno
import json
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import Tensor, nn

from fourd.errors import UserError
from fourd.files import atomic_path

FORMAT = "fourd-checkpoint-1"
KEPT = 2
SHOWN_MISMATCHES = 3


def checkpoint_path(folder: Path, step: int) -> Path:
    """The file of a step's checkpoint in ``folder``."""
    return folder / f"{step:08d}.safetensors"


def save_checkpoint(folder: Path, step: int, tensors: Mapping[str, Tensor], state: Mapping[str, Any]) -> Path:
    """Write a checkpoint in one indivisible step, then drop all but the two newest.

    Args:
        folder: the folder of checkpoints; made when absent.
        step: optimiser steps done, 0 or more; names the file.
        tensors: any dense tensors by name, copied bit for bit.
        state: whatever JSON can hold, floats exactly; lies in the file's header.

    Returns:
        The file's path.

    Raises:
        UserError: the folder cannot be written to, for instance because the disk is full. Older
            checkpoints are untouched then and no part of the new one is left.
        ValueError: ``state`` has what JSON lacks (NaN too).
    """
    plain = {name: value.detach().cpu().contiguous() for name, value in tensors.items()}
    header = {
        "format": FORMAT,
        "step": str(step),
        "state": json.dumps(dict(state), allow_nan=False),
        "crc32": str(_checksum(plain)),
    }
    path = checkpoint_path(folder, step)
    try:
        with atomic_path(path) as temporary:
            save_file(plain, temporary, metadata=header)
    except (OSError, SafetensorError) as error:
        raise _cannot_write(folder, error) from error
    _drop_old(folder, step)
    return path


def latest_checkpoint(folder: Path) -> tuple[Path | None, str]:
    """The newest good checkpoint in ``folder``, read through to be sure.

    Returns:
        (path, note): path is None when there is none (or no folder); note is one line about newer
        files that were passed over because they are damaged, and empty when there were none.
    """
    damaged: list[str] = []
    found = None
    for path in reversed(_files(folder)):
        try:
            load_checkpoint(path)
        except UserError as error:
            damaged.append(str(error).split(";")[0])
            continue
        found = path
        break
    if not damaged:
        return found, ""
    ending = f"going on from {found.name}" if found else "there is no other checkpoint"
    return found, f"passed over: {'; '.join(damaged)}; {ending}"


def load_checkpoint(path: Path) -> tuple[int, dict[str, Tensor], dict[str, Any]]:
    """Read (step, tensors, state) as they were saved; tensors on the CPU.

    Raises UserError when the file is missing, cut short, altered, or of another kind.
    """
    try:
        with safe_open(path, framework="pt") as stream:
            header = stream.metadata() or {}
            # keys() in place of iteration: safe_open is no mapping.
            tensors = {name: stream.get_tensor(name) for name in stream.keys()}  # noqa: SIM118
    except (OSError, SafetensorError) as error:
        raise UserError(
            f"{path}: expected a whole checkpoint, got a file that cannot be read ({_one_line(error)}); "
            f"delete it to go on from the one before it"
        ) from error
    if header.get("format") != FORMAT:
        raise UserError(
            f"{path}: expected a checkpoint of format {FORMAT}, got another safetensors file; "
            f"name a file that fourd train wrote"
        )
    if header.get("crc32") != str(_checksum(tensors)):
        raise UserError(
            f"{path}: expected the contents that were written, got altered ones (the checksum differs); "
            f"delete it to go on from the one before it"
        )
    return int(header["step"]), tensors, json.loads(header["state"])


def restore(module: nn.Module, tensors: Mapping[str, Tensor], prefix: str, source: Path | str) -> None:
    """Load the tensors whose names begin with ``prefix`` into ``module``, all or none.

    Raises UserError naming ``source`` and the first differences when names, shapes or dtypes differ.
    """
    given = _below(prefix, tensors)
    wanted = module.state_dict()
    differences = [
        _difference(name, wanted.get(name), given.get(name)) for name in sorted(wanted.keys() | given.keys())
    ]
    found = [difference for difference in differences if difference is not None]
    if found:
        rest = f" and {len(found) - SHOWN_MISMATCHES} more" if len(found) > SHOWN_MISMATCHES else ""
        raise UserError(
            f"{source}: expected a checkpoint of this model, got one of another: "
            f"{', '.join(found[:SHOWN_MISMATCHES])}{rest}; use the config it was trained with, or train in a new folder"
        )
    module.load_state_dict(given)


def pack_optimizer(optimizer: torch.optim.Optimizer, prefix: str) -> dict[str, Tensor]:
    """An optimiser's state as flat tensors ``PREFIX + INDEX.NAME``, such as ``optimizer.3.exp_avg``.

    Indices count parameters in the order of the optimiser's groups. Rates and other settings are
    not included: they are the config's. Parameters that never had a gradient have no state.

    Raises ValueError for a state that is no tensor (Adam and AdamW have none).
    """
    packed: dict[str, Tensor] = {}
    for index, entries in optimizer.state_dict()["state"].items():
        for name, value in entries.items():
            if not isinstance(value, Tensor):
                raise ValueError(f"optimizer: expected tensors as state, got {type(value).__name__} for '{name}'")
            packed[f"{prefix}{index}.{name}"] = value
    return packed


def unpack_optimizer(
    optimizer: torch.optim.Optimizer, tensors: Mapping[str, Tensor], prefix: str, source: Path | str = "checkpoint"
) -> None:
    """Set an optimiser's state from :func:`pack_optimizer`'s tensors, bit for bit; settings stay as they are.

    Raises UserError naming ``source`` when the tensors belong to other parameters.
    """
    parameters = [parameter for group in optimizer.param_groups for parameter in group["params"]]
    state: dict[int, dict[str, Tensor]] = {}
    for key, value in _below(prefix, tensors).items():
        index, _, name = key.partition(".")
        fits = index.isdecimal() and int(index) < len(parameters) and bool(name)
        if not fits or (value.ndim > 0 and value.shape != parameters[int(index)].shape):
            raise UserError(
                f"{source}: expected the optimiser's state of this model, got '{prefix}{key}' of shape "
                f"{tuple(value.shape)}; use the config it was trained with, or train in a new folder"
            )
        state.setdefault(int(index), {})[name] = value.clone()
    optimizer.load_state_dict({"state": state, "param_groups": optimizer.state_dict()["param_groups"]})


def pack_torch_rng(generator: torch.Generator | None = None) -> Tensor:
    """The state of a torch CPU generator (the default one when None) as a uint8 tensor."""
    return torch.get_rng_state() if generator is None else generator.get_state()


def unpack_torch_rng(state: Tensor, generator: torch.Generator | None = None) -> None:
    """Set a torch CPU generator (the default one when None) to :func:`pack_torch_rng`'s state."""
    if generator is None:
        torch.set_rng_state(state.clone())
    else:
        generator.set_state(state.clone())


def pack_numpy_rng(generator: np.random.Generator) -> dict[str, Any]:
    """The state of a NumPy generator as JSON data; PCG64's 128-bit integers stay exact."""
    return json.loads(json.dumps(generator.bit_generator.state, default=_array_as_list))


def unpack_numpy_rng(state: Mapping[str, Any]) -> np.random.Generator:
    """A NumPy generator that goes on where :func:`pack_numpy_rng` was called.

    Raises ValueError for a state of an unknown kind.
    """
    kinds = {
        "PCG64": np.random.PCG64,
        "PCG64DXSM": np.random.PCG64DXSM,
        "MT19937": np.random.MT19937,
        "Philox": np.random.Philox,
        "SFC64": np.random.SFC64,
    }
    kind = kinds.get(state.get("bit_generator", ""))
    if kind is None:
        raise ValueError(f"state: expected one of {', '.join(kinds)}, got {state.get('bit_generator')!r}")
    bits = kind()
    bits.state = dict(state)
    return np.random.Generator(bits)


def _files(folder: Path) -> list[Path]:
    """Checkpoint files in order of their steps; temporary files begin with a dot and do not count."""
    named = [path for path in folder.glob("*.safetensors") if path.stem.isdecimal()]
    return sorted(named, key=lambda path: int(path.stem))


def _drop_old(folder: Path, step: int) -> None:
    """Keep the two newest up to ``step``; of later ones (from before a resume) only the good ones."""
    files = _files(folder)
    for path in [path for path in files if int(path.stem) <= step][:-KEPT]:
        path.unlink(missing_ok=True)
    for path in [path for path in files if int(path.stem) > step]:
        try:
            load_checkpoint(path)
        except UserError:
            path.unlink(missing_ok=True)


def _cannot_write(folder: Path, error: Exception) -> UserError:
    # safetensors wraps the system's error in its own type and keeps only its number in the text.
    full = getattr(error, "errno", None) == errno.ENOSPC or f"os error {errno.ENOSPC})" in str(error)
    before = _files(folder)
    kept = f"the checkpoint before it, {before[-1].name}, is good" if before else "there is none before it"
    got = "a full disk" if full else _one_line(error)
    mend = "free some space" if full else "make the folder writable"
    return UserError(f"{folder}: expected room for a checkpoint, got {got}; {kept}; {mend} and add --resume")


def _checksum(tensors: Mapping[str, Tensor]) -> int:
    """CRC-32 of names and bytes: safetensors notices a cut file, but not a changed one."""
    value = 0
    for name in sorted(tensors):
        value = zlib.crc32(name.encode(), value)
        tensor = tensors[name]
        if tensor.numel() > 0:
            value = zlib.crc32(tensor.reshape(-1).view(torch.uint8).numpy().data, value)
    return value


def _difference(name: str, wanted: Tensor | None, given: Tensor | None) -> str | None:
    if wanted is None:
        return f"'{name}' is unknown here"
    if given is None:
        return f"'{name}' is missing there"
    if wanted.shape != given.shape:
        return f"'{name}' is {tuple(wanted.shape)} here and {tuple(given.shape)} there"
    if wanted.dtype != given.dtype:
        return f"'{name}' is {wanted.dtype} here and {given.dtype} there"
    return None


def _below(prefix: str, tensors: Mapping[str, Tensor]) -> dict[str, Tensor]:
    return {name.removeprefix(prefix): value for name, value in tensors.items() if name.startswith(prefix)}


def _array_as_list(value: object) -> object:
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, np.integer):
        return int(value)
    raise TypeError(f"expected arrays and numbers, got {type(value).__name__}")


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())
