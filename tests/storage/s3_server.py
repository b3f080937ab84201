"""A local S3 server for tests: moto's server in a thread of this process."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.request import Request, urlopen

ENVIRONMENT = {
    "AWS_ACCESS_KEY_ID": "test",
    "AWS_SECRET_ACCESS_KEY": "test",
    "AWS_DEFAULT_REGION": "us-east-1",
    "AWS_EC2_METADATA_DISABLED": "true",
    "AWS_CONFIG_FILE": "/nonexistent",
    "AWS_SHARED_CREDENTIALS_FILE": "/nonexistent",
}
"""Credentials for the server. With these variables, the credential files of the user are not read."""


@dataclass(frozen=True)
class S3Server:
    """A running server, the address of its endpoint, and an uncached file system that accesses the server."""

    server: Any
    endpoint: str
    files: Any

    @classmethod
    def start(cls) -> S3Server:
        """Start a server on a free port."""
        import fsspec
        from moto.server import ThreadedMotoServer

        server = ThreadedMotoServer(ip_address="127.0.0.1", port=0, verbose=False)
        server.start()
        host, port = server.get_host_and_port()
        endpoint = f"http://{host}:{port}"
        options = {"key": "test", "secret": "test", "endpoint_url": endpoint}
        files = fsspec.filesystem("s3", skip_instance_cache=True, use_listings_cache=False, **options)
        return cls(server, endpoint, files)

    @contextmanager
    def refusing(self) -> Iterator[None]:
        """Let the server refuse all requests in the block: the server checks permissions, and the credentials of the
        tests have no permissions."""
        self._count_open_requests("0")
        try:
            yield
        finally:
            self._count_open_requests("inf")

    def _count_open_requests(self, count: str) -> None:
        address = f"{self.endpoint}/moto-api/reset-auth"
        request = Request(address, count.encode(), {"Content-Type": "text/plain"}, method="POST")
        with urlopen(request) as answer:
            assert answer.status == 200


@dataclass(frozen=True)
class Bucket:
    """A new bucket of the local server, and the file system that reads and writes it."""

    name: str
    files: Any

    @property
    def url(self) -> str:
        return f"s3://{self.name}"


def put_folder(files: Any, folder: Path, prefix: str) -> None:
    """Upload all files of a folder."""
    for path in folder.rglob("*"):
        if path.is_file():
            files.pipe_file(f"{prefix}/{path.relative_to(folder).as_posix()}", path.read_bytes())


def unfinished_uploads(files: Any, bucket: str) -> list[str]:
    """Keys of the multipart uploads that were neither completed nor aborted."""
    found = files.call_s3("list_multipart_uploads", Bucket=bucket)
    return [item["Key"] for item in found.get("Uploads", [])]
