"""Serves the page of a run. The server sends the page and the run's data to browsers, and forwards their requests to
the training."""

from __future__ import annotations

import hashlib
import json
import re
from http import HTTPStatus
from pathlib import Path
from urllib.parse import parse_qs, urlencode, urlsplit

from fourd.viewer.publish.runs.access import Access
from fourd.viewer.publish.runs.site import Refused, RunSite
from fourd.viewer.publish.server import SiteHandler, SiteServer

MAX_REQUEST_BYTES = 1024
_PICTURE = re.compile(r"/run/pictures/(\d{1,12})\.jpg")
_SEGMENT = re.compile(r"[1-9]\d{0,3}")
_JSON = "application/json"


class RunHandler(SiteHandler):
    """Answers the requests of a web page that shows and controls a training run."""

    server: RunServer

    def do_POST(self) -> None:
        # After a refusal, the server closes the connection, because the content of the request may still be unread.
        refusal = self._refusal(None) or self.server.access.refusal_of_control(self.headers)
        if refusal is not None:
            self._send_text(HTTPStatus.FORBIDDEN, refusal)
            return
        if urlsplit(self.path).path != "/run/control":
            self._send_text(HTTPStatus.NOT_FOUND, "This address does not exist on the server.")
            return
        length = self.headers.get("Content-Length", "")
        if not length.isdecimal() or len(length) > 4 or int(length) > MAX_REQUEST_BYTES:
            self._send_text(HTTPStatus.BAD_REQUEST, f"Expected a request of at most {MAX_REQUEST_BYTES} bytes.")
            return
        request = _parse_request(self.rfile.read(int(length)))
        if request is None or self.server.site is None:
            self._send_text(HTTPStatus.BAD_REQUEST, "Expected a JSON object with the texts session and action.")
            return
        try:
            self.server.site.control(*request)
        except Refused as refused:
            self._send_text(HTTPStatus.CONFLICT, str(refused))
            return
        self._send(HTTPStatus.ACCEPTED, _JSON, b"{}")

    def end_headers(self) -> None:
        # Pages of other sites must not show this page in a frame, because they could trick the user into clicking on
        # hidden buttons.
        self.send_header("X-Frame-Options", "DENY")
        self.send_header("Referrer-Policy", "no-referrer")
        super().end_headers()

    def _answer(self, send_content: bool) -> None:
        target = urlsplit(self.path)
        query = _parse_query(target.query)
        given = query.pop("token", [None])[0]
        refusal = self._refusal(given)
        if refusal is not None:
            self._send_text(HTTPStatus.FORBIDDEN, refusal)
        elif given is not None:
            self._keep_token(target.path, query)
        elif target.path.startswith("/run/"):
            self._answer_data(target.path, query)
        else:
            super()._answer(send_content)

    def _answer_data(self, path: str, query: dict[str, list[str]]) -> None:
        site = self.server.site
        picture = _PICTURE.fullmatch(path)
        content, kind = None, _JSON
        if site is None:
            pass  # The site does not exist yet, because it is still being written.
        elif path == "/run/status.json":
            content = site.status()
        elif path == "/run/curves.json":
            content = site.curves()
        elif path == "/run/scene.json":
            content = site.scene()
        elif picture is not None:
            segment = query.get("segment", [""])[0]
            is_segment = _SEGMENT.fullmatch(segment) is not None
            content, kind = site.picture(int(picture[1]), int(segment) if is_segment else None), "image/jpeg"
        if content is None:
            self._refuse(HTTPStatus.NOT_FOUND)
            return
        etag = f'"{hashlib.blake2b(content, digest_size=12).hexdigest()}"'
        if self.headers.get("If-None-Match") == etag:
            self._send(HTTPStatus.NOT_MODIFIED, kind, b"", etag)
        else:
            self._send(HTTPStatus.OK, kind, content, etag)

    def _refusal(self, given: str | None) -> str | None:
        return self.server.access.refusal(self.headers, self.server.cookie, given)

    def _keep_token(self, path: str, query: dict[str, list[str]]) -> None:
        """Store the token in a cookie, and redirect to the same page without the token. This keeps the token out of the
        browser's history and out of copied addresses."""
        rest = urlencode(query, doseq=True)
        self.send_response(HTTPStatus.SEE_OTHER)
        # A target with two leading slashes would redirect to another server.
        self.send_header("Location", f"/{path.lstrip('/')}" + (f"?{rest}" if rest else ""))
        cookie = f"{self.server.cookie}={self.server.access.token}; Path=/; HttpOnly; SameSite=Lax"
        self.send_header("Set-Cookie", cookie)
        self.send_header("Content-Length", "0")
        self.send_header("Cache-Control", "no-store")
        self.end_headers()

    def _send_text(self, status: HTTPStatus, sentence: str) -> None:
        self.close_connection = True
        self._send(status, "text/plain; charset=utf-8", f"{sentence}\n".encode())

    def _send(self, status: HTTPStatus, kind: str, content: bytes, etag: str = "") -> None:
        headers = {
            "Content-Type": kind,
            "X-Content-Type-Options": "nosniff",
            "Cache-Control": "no-cache" if etag else "no-store",
        }
        if self.close_connection:
            headers["Connection"] = "close"
        if etag:
            headers["ETag"] = etag
        self._send_whole(status, headers, content)


class RunServer(SiteServer):
    """Serves a web page that shows and controls a training run.

    Args:
        folder: the folder of the site.
        access: the address to listen on, and the token.
        port: port to listen on; 0 selects a free port.

    Attributes:
        site: answers the requests of the page, or None until the page is written.

    Raises:
        UserError: if the server cannot listen on the host and port.
    """

    handler = RunHandler

    def __init__(self, folder: Path, access: Access, port: int = 0) -> None:
        self.access = access
        self.site: RunSite | None = None
        super().__init__(folder, access.host, port)

    @property
    def cookie(self) -> str:
        """Name of the cookie that stores the token. It contains the port, because browsers share cookies between all
        ports of a machine."""
        return f"fourd-{self.server_address[1]}"

    @property
    def page(self) -> str:
        """Address of the page on this machine, with the token."""
        return self.url + self._query

    def page_at(self, name: str) -> str:
        """Return the address of the page, with the token, for the host name or IP address ``name`` of this machine."""
        return f"http://{name}:{self.server_address[1]}/{self._query}"

    @property
    def _query(self) -> str:
        return f"?token={self.access.token}" if self.access.token else ""


def _parse_query(query: str) -> dict[str, list[str]]:
    """Return the query fields of an address, or an empty dict if it has too many fields."""
    try:
        return parse_qs(query, max_num_fields=8)
    except ValueError:
        return {}


def _parse_request(content: bytes) -> tuple[str, str] | None:
    """Return the training session (an id) and the action that a request contains, or None if its content is not
    valid."""
    try:
        found = json.loads(content)
    except (ValueError, RecursionError):
        return None
    if not isinstance(found, dict):
        return None
    session, action = found.get("session"), found.get("action")
    return (session, action) if isinstance(session, str) and isinstance(action, str) else None
