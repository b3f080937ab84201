"""Serves local folders and opens their pages in Chromium, for the programs in this folder."""

from __future__ import annotations

import shutil
import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

from playwright.sync_api import sync_playwright

from fourd.viewer.publish.server import SiteServer

FLAGS = ("--headless", "--no-sandbox", "--ignore-gpu-blocklist", "--use-gl=angle", "--use-angle=gl-egl")
DEFAULT_FLAGS = ("--enable-unsafe-swiftshader", "--use-angle=swiftshader-webgl")
"""Playwright's default flags that are not passed to Chromium, because they would select another graphics driver."""


@contextmanager
def open_browser() -> Iterator[Any]:
    """Yield a running Chromium, controlled by Playwright."""
    chromium = shutil.which("chromium") or shutil.which("google-chrome")
    with sync_playwright() as running:
        browser = running.chromium.launch(executable_path=chromium, args=FLAGS, ignore_default_args=DEFAULT_FLAGS)
        try:
            yield browser
        finally:
            browser.close()


@contextmanager
def serving(server: SiteServer) -> Iterator[SiteServer]:
    """Serve a folder until the ``with`` block ends."""
    with server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        try:
            yield server
        finally:
            server.shutdown()


@contextmanager
def open_pages(addresses: dict[str, tuple[Path, str]], size: int) -> Iterator[dict[str, Any]]:
    """Yield one Playwright page per name. An address consists of a folder to serve, and the path and query of a page in
    this folder."""
    with ExitStack() as stack:
        browser = stack.enter_context(open_browser())
        pages = {}
        for name, (folder, address) in addresses.items():
            server = stack.enter_context(serving(SiteServer(folder)))
            pages[name] = browser.new_page(viewport={"width": size, "height": size})
            pages[name].goto(server.url + address)
        yield pages
