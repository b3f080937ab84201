"""Fixtures of the tests with object stores."""

from __future__ import annotations

import secrets
from collections.abc import Iterator

import pytest

from tests.storage.s3_server import ENVIRONMENT, Bucket, S3Server


@pytest.fixture(scope="session")
def s3_server() -> Iterator[S3Server]:
    """A local S3 server for all tests, and a file system that accesses the server. Without s3fs and moto, the tests
    that use the server are skipped.
    """
    pytest.importorskip("s3fs", reason="needs s3fs (pip install 'fourd[storage]')")
    pytest.importorskip("moto.server", reason="needs moto (pip install 'fourd[dev]')")
    started = S3Server.start()
    yield started
    started.server.stop()


@pytest.fixture
def bucket(s3_server: S3Server, monkeypatch: pytest.MonkeyPatch) -> Bucket:
    """An empty bucket. The server's address and credentials are in environment variables, as in a user's shell."""
    for name, value in ENVIRONMENT.items():
        monkeypatch.setenv(name, value)
    monkeypatch.setenv("AWS_ENDPOINT_URL", s3_server.endpoint)
    name = f"bucket-{secrets.token_hex(6)}"
    s3_server.files.mkdir(name)
    return Bucket(name, s3_server.files)


@pytest.fixture
def new_connections() -> Iterator[None]:
    """Let the test make new connections, which read the environment variables again. Without this fixture, a test
    reuses the connections of earlier tests."""
    clear = pytest.importorskip("s3fs").S3FileSystem.clear_instance_cache
    clear()
    yield
    clear()
