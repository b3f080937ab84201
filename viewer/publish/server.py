"""Serves one folder over HTTP, with range requests. By default, only this machine can connect."""

from __future__ import annotations

import errno
import os
import posixpath
import re
from collections.abc import Mapping
from dataclasses import dataclass
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any, BinaryIO
from urllib.parse import unquote, urlsplit

from fourd.base.errors import UserError

CONTENT_TYPES = {
    ".html": "text/html; charset=utf-8",
    ".css": "text/css; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".mjs": "text/javascript; charset=utf-8",
    ".json": "application/json",
    ".jpg": "image/jpeg",
    ".png": "image/png",
    ".4dv": "application/octet-stream",
}
_RANGE = re.compile(r"bytes=(\d{0,19})-(\d{0,19})$")
_CHUNK = 1 << 18
_SECONDS_PER_CONNECTION = 60


class PortInUse(UserError):
    """Another program listens on the port."""


@dataclass(frozen=True)
class Part:
    """The range of a file that a response sends: ``length`` bytes, starting at byte ``start``."""

    start: int
    length: int


class SiteHandler(BaseHTTPRequestHandler):
    """Answers GET and HEAD requests."""

    protocol_version = "HTTP/1.1"
    server_version = "fourd"
    sys_version = ""
    timeout = _SECONDS_PER_CONNECTION
    server: SiteServer

    def do_GET(self) -> None:
        self._answer(send_content=True)

    def do_HEAD(self) -> None:
        self._answer(send_content=False)

    def log_message(self, format: str, *args: Any) -> None:
        """Print no log line for a request."""

    def _answer(self, send_content: bool) -> None:
        path = find_file(self.server.folder, self.path)
        if path is None:
            self._refuse(HTTPStatus.NOT_FOUND)
            return
        try:
            stream = path.open("rb")
        except OSError:
            self._refuse(HTTPStatus.NOT_FOUND)
            return
        with stream:
            status = os.fstat(stream.fileno())
            part = self._part(status.st_size)
            if part is None:
                self._refuse(HTTPStatus.REQUESTED_RANGE_NOT_SATISFIABLE, {"Content-Range": f"bytes */{status.st_size}"})
                return
            etag = f'"{status.st_mtime_ns:x}-{status.st_size:x}-{status.st_ino:x}"'
            self._send_headers(path, part, status.st_size, etag)
            if send_content:
                self._send_content(stream, part)

    def _part(self, size: int) -> Part | None:
        """Return the requested part of a file of ``size`` bytes, or None if the file has no such part."""
        match = _RANGE.match(self.headers.get("Range", ""))
        if match is None or match.groups() == ("", ""):
            return Part(0, size)
        first, last = match.groups()
        if first == "":
            length = min(int(last), size)
            return Part(size - length, length) if length > 0 else None
        start, end = int(first), min(int(last) if last else size - 1, size - 1)
        return Part(start, end - start + 1) if start <= end else None

    def _send_headers(self, path: Path, part: Part, size: int, etag: str) -> None:
        is_partial = _RANGE.match(self.headers.get("Range", "")) is not None
        self.send_response(HTTPStatus.PARTIAL_CONTENT if is_partial else HTTPStatus.OK)
        if is_partial:
            self.send_header("Content-Range", f"bytes {part.start}-{part.start + part.length - 1}/{size}")
        self.send_header("Content-Type", CONTENT_TYPES.get(path.suffix.lower(), "application/octet-stream"))
        self.send_header("Content-Length", str(part.length))
        self.send_header("Accept-Ranges", "bytes")
        self.send_header("ETag", etag)
        self.send_header("Cache-Control", "no-cache")
        self.send_header("X-Content-Type-Options", "nosniff")
        self.end_headers()

    def _send_content(self, stream: BinaryIO, part: Part) -> None:
        stream.seek(part.start)
        left = part.length
        while left > 0:
            content = stream.read(min(left, _CHUNK))
            if not content:
                # The file has become shorter since the request. To let the client detect the missing bytes, the server
                # closes the connection.
                self.close_connection = True
                return
            try:
                self.wfile.write(content)
            except OSError:
                self.close_connection = True
                return
            left -= len(content)

    def _refuse(self, status: HTTPStatus, headers: dict[str, str] | None = None) -> None:
        content = f"{status.value} {status.phrase}\n".encode()
        self._send_whole(status, {**(headers or {}), "Content-Type": "text/plain; charset=utf-8"}, content)

    def _send_whole(self, status: HTTPStatus, headers: Mapping[str, str], content: bytes) -> None:
        """Send a response whose content is in memory."""
        self.send_response(status)
        for name, value in headers.items():
            self.send_header(name, value)
        if status is not HTTPStatus.NOT_MODIFIED:
            self.send_header("Content-Length", str(len(content)))
        self.end_headers()
        if self.command != "HEAD":
            try:
                self.wfile.write(content)
            except OSError:
                self.close_connection = True


class SiteServer(ThreadingHTTPServer):
    """Serves the files of a folder. Folders are not listed, and files outside the folder are not found.

    Args:
        folder: the folder to serve.
        host: address to listen on.
        port: port to listen on; 0 selects a free port.

    Raises:
        UserError: if the server cannot listen on the host and port.
    """

    handler: type[BaseHTTPRequestHandler] = SiteHandler
    daemon_threads = True
    allow_reuse_address = os.name != "nt"

    def __init__(self, folder: Path, host: str = "127.0.0.1", port: int = 0) -> None:
        self.folder = folder.resolve()
        try:
            super().__init__((host, port), self.handler)
        except OSError as error:
            if error.errno == errno.EADDRINUSE:
                raise PortInUse(f"--port {port}: expected a free port, got one in use; choose another one") from error
            raise UserError(f"--host {host} --port {port}: cannot listen ({error.strerror or error})") from error
        # If the host is not a valid name, for example because it contains a control character, the socket raises
        # TypeError or UnicodeError, which is a ValueError.
        except (OverflowError, TypeError, ValueError) as error:
            raise UserError(f"--host {host} --port {port}: expected an address and a port, got '{error}'") from error

    @property
    def url(self) -> str:
        """Address of the page."""
        host, port = self.server_address[:2]
        name = host.decode() if isinstance(host, bytes | bytearray) else str(host)
        return f"http://{'127.0.0.1' if name in ('0.0.0.0', '') else name}:{port}/"

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Ignore connections that browsers close early."""


def find_file(folder: Path, target: str) -> Path | None:
    """Return the file that a request names, or None if the folder has no such file.

    Args:
        folder: resolved path of the served folder.
        target: target of the request, such as "/scene.4dv?x=1".
    """
    path = unquote(urlsplit(target).path, errors="replace")
    if "\\" in path or "\0" in path or ":" in path:
        return None
    relative = posixpath.normpath("/" + path).lstrip("/")
    name = posixpath.join(relative, "index.html") if path.endswith("/") else relative
    try:
        found = (folder / name).resolve()
        return found if found.is_file() and found.is_relative_to(folder) else None
    except (OSError, ValueError):
        return None
