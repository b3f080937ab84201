"""The web server: ranges, files outside the folder, ports."""

from __future__ import annotations

import http.client
import os
import threading
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from fourd.base.errors import UserError
from fourd.viewer.publish.server import SiteServer, find_file


@pytest.fixture
def server(tmp_path: Path, rng: np.random.Generator) -> Iterator[SiteServer]:
    folder = tmp_path / "site"
    (folder / "player").mkdir(parents=True)
    (folder / "index.html").write_text("page")
    (folder / "scene.4dv").write_bytes(rng.bytes(1000))
    (tmp_path / "secret").write_text("secret")
    os.symlink(tmp_path / "secret", folder / "link")
    with SiteServer(folder) as server:
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.02}, daemon=True)
        thread.start()
        yield server
        server.shutdown()
        thread.join()


def get(server: SiteServer, path: str, headers: dict[str, str] | None = None, method: str = "GET") -> tuple:
    """Status, headers and content of a response. The path is sent unchanged."""
    connection = http.client.HTTPConnection("127.0.0.1", server.server_address[1], timeout=10)
    connection.request(method, path, headers=headers or {})
    response = connection.getresponse()
    content = response.read()
    connection.close()
    return response.status, dict(response.getheaders()), content


@pytest.mark.parametrize(
    ("asked", "start", "end"),
    [("0-0", 0, 1), ("10-19", 10, 20), ("990-2000", 990, 1000), ("500-", 500, 1000), ("-7", 993, 1000)],
)
def test_ranges(server: SiteServer, asked: str, start: int, end: int) -> None:
    """Catches a range that is off by one, and a wrong total size."""
    expected = (server.folder / "scene.4dv").read_bytes()
    status, headers, content = get(server, "/scene.4dv", {"Range": f"bytes={asked}"})
    assert status == 206
    assert content == expected[start:end]
    assert headers["Content-Range"] == f"bytes {start}-{end - 1}/1000"


def test_whole_files(server: SiteServer) -> None:
    """Catches wrong MIME types, which prevent browsers from loading modules, and HEAD requests that send content."""
    status, headers, content = get(server, "/")
    assert (status, content, headers["Content-Type"]) == (200, b"page", "text/html; charset=utf-8")
    status, headers, content = get(server, "/scene.4dv", method="HEAD")
    assert (status, content, headers["Content-Length"]) == (200, b"", "1000")
    assert get(server, "/scene.4dv", {"Range": "bytes=1000-"})[0] == 416
    assert get(server, "/scene.4dv", {"Range": "lines=1-2"})[0] == 200


@pytest.mark.parametrize(
    "path",
    [
        "/../secret",
        "/%2e%2e/secret",
        "/player/../../secret",
        "/..%5csecret",
        "//etc/passwd",
        "/%00",
        "/link",
        "/player",
        "/player/",
        "/missing",
        "/" + "a" * 5000,
        "/C:/secret",
    ],
)
def test_other_paths_are_not_found(server: SiteServer, path: str) -> None:
    """Catches files outside the folder, and listings of folders."""
    status, _, content = get(server, path)
    assert status == 404
    assert b"secret" not in content


def test_paths_are_normalised(server: SiteServer) -> None:
    """Catches a check of paths that also rejects valid paths."""
    assert find_file(server.folder, "/player/../index.html?x=1") == server.folder / "index.html"


def test_a_changed_file_has_another_tag(server: SiteServer) -> None:
    """Catches a changed file that has the ETag of the old file, so that clients do not detect the change."""
    before = get(server, "/scene.4dv")[1]["ETag"]
    assert get(server, "/scene.4dv")[1]["ETag"] == before
    (server.folder / "new").write_bytes(bytes(1000))
    os.replace(server.folder / "new", server.folder / "scene.4dv")
    assert get(server, "/scene.4dv")[1]["ETag"] != before


def test_a_port_in_use(server: SiteServer, tmp_path: Path) -> None:
    """Catches a traceback for a port that another program uses."""
    port = server.server_address[1]
    with pytest.raises(UserError, match=f"--port {port}: expected a free port, got one in use; choose another one"):
        SiteServer(tmp_path, port=port)
    with pytest.raises(UserError, match="cannot listen"):
        SiteServer(tmp_path, host="203.0.113.7")


@pytest.mark.parametrize("host", ["\u202e", "a\0b", "a..b", "\udcff", "a" * 300])
def test_a_host_that_is_no_name(tmp_path: Path, host: str) -> None:
    """Catches a traceback for a host that the socket refuses with an error of another type than OSError."""
    with pytest.raises(UserError, match=r"--host .*--port 0: (expected an address and a port|cannot listen)"):
        SiteServer(tmp_path, host=host)
