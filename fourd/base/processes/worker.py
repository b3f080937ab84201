"""The child process of :class:`fourd.base.processes.isolation.ParserProcess`, which answers requests until its input
ends."""

from __future__ import annotations

import importlib
import json
import os
import signal
import struct
import sys
import time
from typing import Any, BinaryIO

from fourd.base.errors import UserError

LENGTHS = struct.Struct("<QQ")
MAX_REPLY_BYTES = 1 << 30
"""Maximum size in bytes of a reply. Large replies are encoded images."""
CRASHED = 77
"""Exit code of the child process after a failed memory allocation."""


def write_message(stream: BinaryIO | Any, message: dict[str, Any], content: bytes = b"") -> None:
    """Write a JSON message and bytes."""
    text = json.dumps(message, allow_nan=True).encode()
    stream.write(LENGTHS.pack(len(text), len(content)))
    stream.write(text)
    stream.write(content)
    stream.flush()


def read_message(stream: BinaryIO | Any, max_bytes: int) -> tuple[dict[str, Any], bytes]:
    """Read a JSON message and bytes.

    Raises EOFError if the stream ends, and ValueError if the message is not valid or larger than ``max_bytes``.
    """
    lengths = LENGTHS.unpack(_read_exactly(stream, LENGTHS.size))
    if sum(lengths) > max_bytes:
        raise ValueError("expected a shorter message")
    message = json.loads(_read_exactly(stream, lengths[0]))
    if not isinstance(message, dict):
        raise ValueError("expected a JSON object")
    return message, _read_exactly(stream, lengths[1])


def _read_exactly(stream: BinaryIO | Any, count: int) -> bytes:
    content = stream.read(count)
    if len(content) < count:
        raise EOFError
    return bytes(content)


def main() -> None:
    """Answer requests. The command-line arguments are the parent's process ID and the memory limit in bytes."""
    parent, max_bytes = (int(word) for word in sys.argv[1:3])
    requests, replies = os.fdopen(os.dup(0), "rb"), os.fdopen(os.dup(1), "wb")
    # The standard streams are redirected, because text that libraries print must not become part of a reply.
    null = os.open(os.devnull, os.O_RDWR)
    for descriptor in (0, 1, 2):
        os.dup2(null, descriptor)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent process handles Ctrl-C
    _end_with_parent(parent)
    _limit_memory(max_bytes)
    while True:
        try:
            request, _ = read_message(requests, MAX_REPLY_BYTES)
        except EOFError:
            return
        try:
            message, content = _answer(request)
        except MemoryError:
            os._exit(CRASHED)
        write_message(replies, message, content)


def _answer(request: dict[str, Any]) -> tuple[dict[str, Any], bytes]:
    _limit_time(float(request["seconds"]))
    module, _, name = request["function"].partition(":")
    try:
        result = getattr(importlib.import_module(module), name)(*request["arguments"])
    except UserError as error:
        return {"error": str(error)}, b""
    value, content = result if isinstance(result, tuple) else (result, b"")
    return {"value": value}, content


def _limit_memory(max_bytes: int) -> None:
    if sys.platform == "win32":
        return
    import resource

    # On Linux, the limit is RLIMIT_DATA. RLIMIT_AS would also count files that are mapped for reading, and addresses
    # that libraries and their threads reserve but do not use.
    limit = resource.RLIMIT_DATA if sys.platform == "linux" else resource.RLIMIT_AS
    resource.setrlimit(limit, (max_bytes, max_bytes))


def _limit_time(seconds: float) -> None:
    """Let the system end this process after another ``seconds`` seconds of CPU time."""
    if sys.platform == "win32":
        return
    import resource

    _, most = resource.getrlimit(resource.RLIMIT_CPU)
    soft = int(time.process_time() + seconds) + 1
    resource.setrlimit(resource.RLIMIT_CPU, (soft if most == resource.RLIM_INFINITY else min(soft, most), most))


def _end_with_parent(parent: int) -> None:
    """Let Linux end this process when its parent process ends. On other systems, this process ends when the pipe from
    which it reads requests is closed."""
    if sys.platform == "linux":
        import ctypes

        PR_SET_PDEATHSIG = 1
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
        if os.getppid() != parent:
            os._exit(1)
