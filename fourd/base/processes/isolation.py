"""Runs third-party parsers in a child process, so that a crash, a hang or a lack of memory leads to an error message.

The child process runs :mod:`fourd.base.processes.worker`. Requests and replies are JSON, followed by plain bytes.
Replies are not pickled, because a malicious file could take over the child process, and unpickling a reply of that
process could then run any code in this process.
"""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import threading
import weakref
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

from fourd.base.errors import UserError
from fourd.base.limits import printable
from fourd.base.processes.worker import CRASHED, MAX_REPLY_BYTES, read_message, write_message

SECONDS = 8.0
"""Base value of the CPU time limit of a call, in seconds. SECONDS_PER_MB increases the limit with the size of the
file."""
SECONDS_PER_MB = 10.0
"""Seconds that are added to the CPU time limit for each MiB of the file. Decoding one keyframe interval of a strongly
compressed video takes a few seconds per MiB."""
MAX_BYTES = 2 << 30
"""Memory in bytes that the child process may use."""
START = (
    "import json, sys; sys.path[:] = json.loads(sys.argv.pop()); from fourd.base.processes.worker import main; main()"
)
"""Program of the child process. It runs in Python's isolated mode, so that no module is imported from the working
directory."""
ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
"""Environment variables that limit libraries to 1 thread. With more threads, the buffers of idle threads would also
count towards MAX_BYTES."""
WAIT_FACTOR = 20.0
"""The child process is killed if the wall-clock time of a call exceeds this factor times its CPU time limit. The factor
is large because other programs may use the CPU, and disks may be slow."""


@dataclass(frozen=True)
class Reply:
    """The result of a call.

    Attributes:
        value: JSON value, which the caller must check, because the child process has read untrusted files.
        content: bytes, such as an encoded image.
    """

    value: Any
    content: bytes


class ParserProcess:
    """A child process that parses untrusted files. It is started by the first call, and again after a crash.

    Use the object as a context manager, or call :meth:`close`. The child process also ends when the object is deleted
    or this process ends. The object is not thread-safe.
    """

    def __init__(self) -> None:
        self._process: subprocess.Popen[bytes] | None = None
        self._stop: weakref.finalize[..., ParserProcess] | None = None

    def __enter__(self) -> ParserProcess:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def __reduce__(self) -> tuple[type[ParserProcess], tuple[()]]:
        """Pickle the object without its child process. After unpickling, the next call starts a new one."""
        return ParserProcess, ()

    def close(self) -> None:
        """End the child process. The next call starts a new one."""
        if self._stop is not None:
            self._stop()
        self._process = self._stop = None

    def call(self, function: str, path: Path, *arguments: object, more_seconds: float = 0.0) -> Reply:
        """Call ``function`` of the child process with a file and further arguments.

        Args:
            function: the function as "module:name". The function returns a JSON value, or a JSON value and bytes.
            path: the file or folder that the function reads.
            arguments: further arguments, which must be JSON values.
            more_seconds: seconds that are added to the limit of the CPU time, for work that does not depend on the
                size of the file.

        Raises:
            UserError: if the function raises UserError, or if the child process crashes, needs more than
                :data:`MAX_BYTES` of memory, or needs too much time.
        """
        seconds = SECONDS + SECONDS_PER_MB * _size(path) / 2**20 + more_seconds
        process = self._start()
        assert process.stdin is not None
        assert process.stdout is not None
        request = {"function": function, "arguments": [str(path), *arguments], "seconds": seconds}
        timer = threading.Timer(WAIT_FACTOR * seconds, process.kill)
        timer.daemon = True
        timer.start()
        try:
            write_message(process.stdin, request)
            message, content = read_message(process.stdout, MAX_REPLY_BYTES)
        except (OSError, EOFError, ValueError) as error:
            raise self._crashed(path) from error
        except BaseException:
            self.close()
            raise
        finally:
            timer.cancel()
        if "error" in message:
            raise UserError(printable(str(message["error"])))
        return Reply(message.get("value"), content)

    def _start(self) -> subprocess.Popen[bytes]:
        if self._process is None or self._process.poll() is not None:
            self.close()
            self._process = subprocess.Popen(
                [sys.executable, "-I", "-c", START, str(os.getpid()), str(MAX_BYTES), json.dumps(sys.path)],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                env=os.environ | dict.fromkeys(ONE_THREAD, "1"),
            )
            self._stop = weakref.finalize(self, _stop, self._process)
        return self._process

    def _crashed(self, path: Path) -> UserError:
        """End the child process, and return an error that says why it did not reply."""
        process = self._process
        assert process is not None
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(1.0)
        code = process.poll()
        self.close()
        if code == CRASHED:
            got = f"one that needs more than {MAX_BYTES / 2**30:g} GB"
        elif code is not None and -code in (signal.SIGXCPU, signal.SIGKILL):
            got = "one whose reading does not end"
        elif code is not None and code < 0:
            got = f"one on which the reader crashes ({signal.Signals(-code).name})"
        else:
            got = "one on which the reader fails"
        return UserError(f"{path}: expected a file that can be read, got {got}; copy or export the file again")


def _size(path: Path) -> int:
    """Return the size in bytes of a file, or of all files directly in a folder."""
    try:
        files = path.iterdir() if path.is_dir() else [path]
        return sum(file.stat().st_size for file in files if file.is_file())
    except OSError:
        return 0


def _stop(process: subprocess.Popen[bytes]) -> None:
    process.kill()
    process.wait()
    streams: tuple[IO[bytes] | None, ...] = (process.stdin, process.stdout)
    for stream in streams:
        if stream is not None:
            with contextlib.suppress(OSError):
                stream.close()
