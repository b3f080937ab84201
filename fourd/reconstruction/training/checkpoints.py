"""Checkpoints as safetensors files. Checkpoints are written atomically and verified when read. Loading a checkpoint
executes no code."""

from __future__ import annotations

import errno
import hashlib
import json
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import torch
from msgspec import Meta
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import Tensor, nn

from fourd.base.errors import UserError, one_line
from fourd.base.files import UNFINISHED, atomic_path
from fourd.base.json_file import Finite, decode_json
from fourd.base.limits import open_regular, require_regular
from fourd.reconstruction.training.run_layout import checkpoint_files, points_folder

FORMAT = "fourd-checkpoint-1"
KEPT = 2
"""Number of checkpoints that are kept on disk."""
DIGEST_BYTES = 16
MAX_SHOWN_MISMATCHES = 3


@dataclass(frozen=True)
class SavedProgress:
    """The numbers that a checkpoint stores beside the tensors.

    Attributes:
        seconds: training time, 0 or more.
        psnr: smoothed PSNR of the training steps in dB.
    """

    seconds: Annotated[float, Meta(ge=0, lt=1e30)]
    psnr: Finite

    def to_json(self) -> dict[str, float]:
        """Return the numbers as JSON data, for the argument ``state`` of :func:`save_checkpoint`."""
        return {"seconds": self.seconds, "psnr": self.psnr}

    @classmethod
    def from_json(cls, state: object, source: Path | str) -> SavedProgress:
        """Read the data that :meth:`to_json` returned. Raises UserError, with a message that names ``source``, if
        ``state`` has other content."""
        try:
            return decode_json(state, cls)
        except ValueError as error:
            raise UserError(f"{source}: {error}; delete the file to resume from the previous checkpoint") from error


def checkpoint_path(folder: Path, step: int) -> Path:
    """Return the path of a step's checkpoint in ``folder``."""
    return folder / f"{step:08d}.safetensors"


def save_checkpoint(folder: Path, step: int, tensors: Mapping[str, Tensor], state: Mapping[str, Any]) -> Path:
    """Write a checkpoint atomically, then delete all checkpoints except the two newest.

    Args:
        folder: the folder of checkpoints; created if missing.
        step: number of completed optimizer steps, 0 or more. The checkpoint file is named after the step number.
        tensors: name -> dense tensor, stored bit for bit.
        state: JSON data that is stored in the file's header. Floats are stored exactly.

    The points of each frame are in separate points files, in a folder next to the checkpoint; :func:`points_folder`
    returns its path. The checkpoint also contains BLAKE2b digests of its own contents and of these points files, so
    write the points files before calling this function.

    Returns:
        The file's path.

    Raises:
        UserError: the folder is not writable, for instance because the disk is full. If writing fails, older
            checkpoints are unchanged, and no file of the new checkpoint remains.
        ValueError: ``state`` is not JSON data, for example because it contains NaN.
    """
    plain = {name: value.detach().cpu().contiguous() for name, value in tensors.items()}
    path = checkpoint_path(folder, step)
    header = {"format": FORMAT, "step": str(step), "state": json.dumps(dict(state), allow_nan=False)}
    try:
        header["points"] = json.dumps(_points_digests(points_folder(path)))
        header["digest"] = _digest(header, plain)
        with atomic_path(path) as temporary:
            save_file(plain, temporary, metadata=header)
    except (OSError, SafetensorError) as error:
        raise _cannot_write(folder, error) from error
    _drop_old(folder, step)
    return path


def latest_checkpoint(folder: Path) -> tuple[Path | None, str]:
    """Find the newest intact checkpoint in ``folder``. A checkpoint is intact if its own file and all its points files
    are undamaged.

    Returns:
        The pair (path, note). The path is None if the folder is missing or contains no intact checkpoint. The note is
        one line about newer checkpoints that were skipped because they are damaged, or an empty string if none was
        skipped.
    """
    damaged: list[str] = []
    found = None
    for path in reversed(checkpoint_files(folder)):
        try:
            verify_checkpoint(path)
        except UserError as error:
            damaged.append(str(error).split(";")[0])
            continue
        found = path
        break
    if not damaged:
        return found, ""
    ending = f"resuming from {found.name}" if found else "there is no other checkpoint"
    return found, f"skipped: {'; '.join(damaged)}; {ending}"


def load_checkpoint(path: Path) -> tuple[int, dict[str, Tensor], dict[str, Any]]:
    """Read a checkpoint, and return its step, its tensors (on the CPU) and its state.

    Raises UserError if the file is missing, truncated, altered, or not a checkpoint.
    """
    header, tensors = _read(path)
    try:
        return int(header["step"]), tensors, json.loads(header["state"])
    except (KeyError, ValueError, RecursionError) as error:
        raise _altered(path) from error


def verify_checkpoint(path: Path) -> int:
    """Verify a checkpoint file and its points files, and return the number of verified files.

    Checkpoints of older versions of fourd contain no digests of points files, so only the checkpoint file is verified.

    Raises UserError if a file is missing, truncated or altered. The message names the file.
    """
    header, _ = _read(path)
    if "points" not in header:
        return 1
    try:
        known = dict(json.loads(header["points"]))
    except (ValueError, TypeError, RecursionError) as error:
        raise _altered(path) from error
    folder = points_folder(path)
    found = _points_digests(folder)
    for name, digest in known.items():
        if found.get(name) != digest:
            got = "an altered or truncated file" if name in found else "no such file"
            raise UserError(
                f"{folder / name}: expected the points of checkpoint {path.name}, got {got}; "
                "delete that checkpoint to resume from the previous one"
            )
    return 1 + len(known)


def _read(path: Path) -> tuple[dict[str, str], dict[str, Tensor]]:
    """Read and verify the header and the tensors of a checkpoint file."""
    try:
        require_regular(path)
        with safe_open(path, framework="pt") as stream:
            header = stream.metadata() or {}
            # ``stream`` has a method keys() but is not iterable.
            tensors = {name: stream.get_tensor(name) for name in stream.keys()}  # noqa: SIM118
    except (OSError, SafetensorError) as error:
        raise UserError(
            f"{path}: expected a complete checkpoint, got a file that cannot be read ({one_line(error)}); "
            f"delete the file to resume from the previous checkpoint"
        ) from error
    if header.get("format") != FORMAT:
        raise UserError(
            f"{path}: expected a checkpoint of format {FORMAT}, got a safetensors file of another format; "
            f"use a checkpoint written by fourd train"
        )
    if "digest" in header:
        is_intact = header["digest"] == _digest(header, tensors)
    else:  # the file was written by an older version of fourd
        is_intact = header.get("crc32") == str(_checksum(tensors))
    if not is_intact:
        raise _altered(path)
    return header, tensors


def restore(module: nn.Module, tensors: Mapping[str, Tensor], prefix: str, source: Path | str) -> None:
    """Load the tensors whose names start with ``prefix`` into ``module``.

    Raises UserError and loads nothing if names, shapes or dtypes differ. The error message names ``source`` and the
    first differences.
    """
    given = _strip_prefix(prefix, tensors)
    wanted = module.state_dict()
    differences = [
        _difference(name, wanted.get(name), given.get(name)) for name in sorted(wanted.keys() | given.keys())
    ]
    found = [difference for difference in differences if difference is not None]
    if found:
        shown = ", ".join(found[:MAX_SHOWN_MISMATCHES])
        rest = f" and {len(found) - MAX_SHOWN_MISMATCHES} more" if len(found) > MAX_SHOWN_MISMATCHES else ""
        raise UserError(
            f"{source}: expected a checkpoint of this model, got one of another model: {shown}{rest}; "
            f"use the config with which the checkpoint was trained, or train in a new folder"
        )
    module.load_state_dict(given)


def pack_optimizer(optimizer: torch.optim.Optimizer, prefix: str) -> dict[str, Tensor]:
    """Return an optimizer's state as tensors named ``PREFIX + INDEX.NAME``, such as ``optimizer.3.exp_avg``.

    INDEX is the parameter's number in the order of the optimizer's groups. Learning rates and other settings are not
    included, because they come from the config. Parameters without a gradient have no state.

    Raises ValueError if a state is not a tensor. All states of Adam and AdamW are tensors.
    """
    packed: dict[str, Tensor] = {}
    for index, entries in optimizer.state_dict()["state"].items():
        for name, value in entries.items():
            if not isinstance(value, Tensor):
                raise ValueError(f"optimizer: expected a tensor as state '{name}', got {type(value).__name__}")
            packed[f"{prefix}{index}.{name}"] = value
    return packed


def unpack_optimizer(
    optimizer: torch.optim.Optimizer, tensors: Mapping[str, Tensor], prefix: str, source: Path | str = "checkpoint"
) -> None:
    """Restore an optimizer's state bit for bit from the tensors that :func:`pack_optimizer` returned. Learning rates
    and other settings of the optimizer are unchanged.

    Raises UserError if the tensors do not belong to this optimizer's parameters. The error message names ``source``.
    """
    parameters = [parameter for group in optimizer.param_groups for parameter in group["params"]]
    state: dict[int, dict[str, Tensor]] = {}
    for key, value in _strip_prefix(prefix, tensors).items():
        index, _, name = key.partition(".")
        fits = index.isdecimal() and int(index) < len(parameters) and bool(name)
        if not fits or (value.ndim > 0 and value.shape != parameters[int(index)].shape):
            raise UserError(
                f"{source}: expected the optimizer's state of this model, got '{prefix}{key}' of shape "
                f"{tuple(value.shape)}; use the config with which the checkpoint was trained, or train in a new folder"
            )
        state.setdefault(int(index), {})[name] = value.clone()
    optimizer.load_state_dict({"state": state, "param_groups": optimizer.state_dict()["param_groups"]})


def _drop_old(folder: Path, step: int) -> None:
    """Of the checkpoints up to ``step``, delete all except the two newest. Of the checkpoints of later steps, delete
    the damaged ones.

    Checkpoints of later steps exist if the run was resumed from an older checkpoint because the newest was damaged.
    """
    files = checkpoint_files(folder)
    for path in [path for path in files if int(path.stem) <= step][:-KEPT]:
        path.unlink(missing_ok=True)
    for path in [path for path in files if int(path.stem) > step]:
        try:
            load_checkpoint(path)
        except UserError:
            path.unlink(missing_ok=True)


def _cannot_write(folder: Path, error: Exception) -> UserError:
    # safetensors raises its own exception type, which contains the system's error number only in its message.
    is_full = getattr(error, "errno", None) == errno.ENOSPC or f"os error {errno.ENOSPC})" in str(error)
    before = checkpoint_files(folder)
    kept = f"the previous checkpoint, {before[-1].name}, is intact" if before else "there is no previous checkpoint"
    got = "a full disk" if is_full else one_line(error)
    fix = "free some space" if is_full else "make the folder writable"
    return UserError(f"{folder}: expected free disk space for a checkpoint, got {got}; {kept}; {fix} and add --resume")


def _altered(path: Path) -> UserError:
    return UserError(
        f"{path}: expected unaltered contents, got contents with another checksum; "
        f"delete the file to resume from the previous checkpoint"
    )


def _points_digests(folder: Path) -> dict[str, str]:
    """Compute a digest of each points file in ``folder``, by file name. If the folder is missing, the result is
    empty."""
    digests = {}
    for path in sorted(folder.glob("*.safetensors")):
        if not path.name.startswith(UNFINISHED):
            with open_regular(path) as stream:
                digests[path.name] = hashlib.file_digest(stream, _new_hash).hexdigest()
    return digests


def _digest(header: Mapping[str, str], tensors: Mapping[str, Tensor]) -> str:
    """Compute a digest of the header and of the tensors, including their names, dtypes and shapes."""
    digest = _new_hash()
    for name in ("format", "step", "state", "points"):
        digest.update(json.dumps([name, header.get(name)]).encode())
    for name in sorted(tensors):
        tensor = tensors[name]
        digest.update(json.dumps([name, str(tensor.dtype), list(tensor.shape)]).encode())
        if tensor.numel() > 0:
            digest.update(tensor.reshape(-1).view(torch.uint8).numpy().data)
    return digest.hexdigest()


def _new_hash() -> hashlib.blake2b:
    return hashlib.blake2b(digest_size=DIGEST_BYTES)


def _checksum(tensors: Mapping[str, Tensor]) -> int:
    """Compute the CRC-32 of the tensors' names and bytes. Older versions of fourd stored it in checkpoints instead of a
    digest."""
    value = 0
    for name in sorted(tensors):
        value = zlib.crc32(name.encode(), value)
        tensor = tensors[name]
        if tensor.numel() > 0:
            value = zlib.crc32(tensor.reshape(-1).view(torch.uint8).numpy().data, value)
    return value


def _difference(name: str, wanted: Tensor | None, given: Tensor | None) -> str | None:
    if wanted is None:
        return f"'{name}' is not in the model"
    if given is None:
        return f"'{name}' is not in the checkpoint"
    if wanted.shape != given.shape:
        return f"'{name}' has shape {tuple(wanted.shape)} in the model and {tuple(given.shape)} in the checkpoint"
    if wanted.dtype != given.dtype:
        return f"'{name}' has dtype {wanted.dtype} in the model and {given.dtype} in the checkpoint"
    return None


def _strip_prefix(prefix: str, tensors: Mapping[str, Tensor]) -> dict[str, Tensor]:
    return {name.removeprefix(prefix): value for name, value in tensors.items() if name.startswith(prefix)}
