"""Makes file operations fail in tests. Every call of a file system function with a path below a folder is one
operation.

The replaced functions belong to Python's standard library and to libraries that write files without the standard
library. Writes are torn: half of the bytes are written before the fault.
"""

from __future__ import annotations

import builtins
import errno
import io
import os
import signal
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import safetensors.torch
from safetensors import SafetensorError

Mode = Literal["count", "full", "memory", "interrupt", "kill"]
"""The kind of fault: "full" is a full disk, "memory" a failed allocation, "interrupt" Ctrl-C, and "kill" SIGKILL. The
mode "count" only counts operations.
"""
MODES: tuple[Mode, ...] = ("full", "memory", "interrupt", "kill")
READING = ("open for reading",)
NAMES = ("mkdir", "rmdir", "unlink", "remove", "rename", "replace", "symlink", "chmod", "link", "utime", "truncate")
"""Functions of the module os that take a path as their first argument."""
WRITING_FLAGS = os.O_WRONLY | os.O_RDWR | os.O_CREAT


@dataclass
class Faults:
    """Counts operations on paths inside ``root``. The operation number ``at``, counted from 0, gets a fault of the kind
    ``mode``.
    """

    root: Path
    mode: Mode
    at: int
    operations: list[str] = field(default_factory=list)

    def install(self) -> None:
        """Replace the functions in this process. The functions cannot be restored, so call this method in a child
        process.
        """
        for name in NAMES:
            setattr(os, name, self._wrap(name, getattr(os, name)))
        os.fsync = self._wrap("fsync", os.fsync)  # type: ignore[assignment]
        os.open = self._wrap_os_open(os.open)  # type: ignore[assignment]
        io.open = builtins.open = self._wrap_open(io.open)  # type: ignore[assignment]
        os.sendfile = self._wrap("write", os.sendfile)
        safetensors.torch.serialize_file = self._wrap_serialize(safetensors.torch.serialize_file)

    def step(self, kind: str, target: object, tear: Callable[[], object] | None = None) -> None:
        """Count an operation. The operation with the index ``at`` fails. ``tear`` is called before the fault and writes
        half of the bytes.
        """
        path = self._path(target)
        if path is None:
            return
        number = len(self.operations)
        self.operations.append(f"{kind} {path.relative_to(self.root)}")
        if number != self.at or self.mode == "count":
            return
        if tear is not None:
            tear()
        if self.mode == "kill":
            os.kill(os.getpid(), signal.SIGKILL)
        if self.mode == "interrupt":
            signal.raise_signal(signal.SIGINT)
        elif self.mode == "memory":
            raise MemoryError
        else:
            code = errno.EIO if kind in READING or kind in ("unlink", "remove", "rmdir") else errno.ENOSPC
            raise OSError(code, os.strerror(code), str(path))

    def _path(self, target: object) -> Path | None:
        """The absolute path of an operation, or None if the path is outside ``root``."""
        try:
            if isinstance(target, int):
                path = Path(os.readlink(f"/proc/self/fd/{target}"))
            else:
                path = Path(os.path.abspath(os.fsdecode(target)))  # type: ignore[arg-type]
        except (OSError, TypeError, ValueError):
            return None
        return path if path.is_relative_to(self.root) else None

    def _wrap(self, kind: str, function: Callable[..., Any]) -> Callable[..., Any]:
        def wrapped(target: Any, *rest: Any, **named: Any) -> Any:
            parent = named.get("dir_fd")
            self.step(kind, target if parent is None else os.path.join(os.readlink(f"/proc/self/fd/{parent}"), target))
            return function(target, *rest, **named)

        return wrapped

    def _wrap_os_open(self, function: Callable[..., int]) -> Callable[..., int]:
        def wrapped(path: Any, flags: int, *rest: Any, **named: Any) -> int:
            if named.get("dir_fd") is None:
                self.step("open for writing" if flags & WRITING_FLAGS else "open for reading", path)
            return function(path, flags, *rest, **named)

        return wrapped

    def _wrap_open(self, function: Callable[..., Any]) -> Callable[..., Any]:
        def wrapped(file: Any, mode: str = "r", buffering: int = -1, *rest: Any, **named: Any) -> Any:
            writes = any(letter in mode for letter in "wax+")
            if not isinstance(file, int):  # os.open has already counted the opening of a file descriptor
                self.step("open for writing" if writes else "open for reading", file)
            if self._path(file) is None or not writes:
                return function(file, mode, buffering, *rest, **named)
            raw = _TornFile(file, mode.replace("b", "").replace("t", ""), self)
            stream: Any = io.BufferedRandom(raw) if "+" in mode else io.BufferedWriter(raw)
            return stream if "b" in mode else io.TextIOWrapper(stream, *rest, **named)

        return wrapped

    def _wrap_serialize(self, function: Callable[..., None]) -> Callable[..., None]:
        def wrapped(tensors: Any, name: Any, *rest: Any, **named: Any) -> None:
            try:
                self.step("write", name, lambda: os.truncate(name, 5))
            except OSError as error:
                raise SafetensorError(f"I/O error: No space left on device (os error {errno.ENOSPC})") from error
            function(tensors, name, *rest, **named)

        return wrapped


class _TornFile(io.FileIO):
    """A file that counts each write as an operation."""

    def __init__(self, file: Any, mode: str, faults: Faults) -> None:
        super().__init__(file, mode)
        self._faults = faults
        self._target = file

    def write(self, content: Any) -> int:
        half = bytes(content)[: len(content) // 2]
        self._faults.step("write", self._target, lambda: super(_TornFile, self).write(half))
        return super().write(content)
