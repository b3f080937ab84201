"""A Chromium browser that all tests of the web player share, and the sites that the browser opens."""

from __future__ import annotations

import shutil
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from fourd.viewer.publish.server import SiteServer
from fourd.viewer.publish.site import write_site
from tests.baking.scenes import write_full_scene, write_scene
from tests.viewer.web.page import PlayerPage

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
FLAGS = (
    "--headless",
    "--no-sandbox",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--ignore-gpu-blocklist",
)
DRIVER_FLAGS = (
    # With EGL, Mesa's llvmpipe needs a third of SwiftShader's time to draw, but some machines lack Mesa's libraries.
    ("--use-gl=angle", "--use-angle=gl-egl"),
    ("--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"),
)
DEFAULT_FLAGS = ("--enable-unsafe-swiftshader", "--use-angle=swiftshader-webgl")
"""Default flags of Playwright that would select a driver. The tests remove these flags."""
HAS_WEBGL = "() => document.createElement('canvas').getContext('webgl2') !== null"


@pytest.fixture(scope="session")
def browser() -> Iterator[Any]:
    """A running Chromium."""
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    if CHROMIUM is None:
        pytest.skip("no Chromium here")
    with playwright.sync_playwright() as running:
        for driver in DRIVER_FLAGS:
            browser = running.chromium.launch(
                executable_path=CHROMIUM, args=[*FLAGS, *driver], ignore_default_args=list(DEFAULT_FLAGS)
            )
            page = browser.new_page()
            has_webgl = page.evaluate(HAS_WEBGL)
            page.close()
            if has_webgl:
                yield browser
                browser.close()
                return
            browser.close()
        pytest.skip("Chromium has no WebGL 2 here")


@pytest.fixture(scope="session")
def object_site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The site of an object scene. Most pixels of the subject have more than K layers of points. Tests must not change
    the site."""
    folder = tmp_path_factory.mktemp("object")
    write_scene(folder / "scene.4dv", frames=6, points=4000)
    write_site(folder / "scene.4dv", folder / "site", "full", 'A <scene> & "more"')
    return folder / "site"


@pytest.fixture(scope="session")
def full_site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The site of a scene with a background and shadows. Tests must not change the site."""
    folder = tmp_path_factory.mktemp("full")
    write_full_scene(folder / "scene.4dv", points=2000, background_points=5000)
    write_site(folder / "scene.4dv", folder / "site", "stream")
    return folder / "site"


@contextmanager
def serving(folder: Path, server_type: type[SiteServer] = SiteServer) -> Iterator[SiteServer]:
    """Serve a folder while the block runs."""
    with server_type(folder) as server:
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.02}, daemon=True)
        thread.start()
        yield server
        server.shutdown()
        thread.join()


@pytest.fixture(scope="session")
def shared_page(browser: Any) -> Any:
    """A page that one test after another uses. A page of its own costs a test more time than most tests need."""
    return browser.new_page()


@pytest.fixture
def open_page(browser: Any, shared_page: Any) -> Iterator[Callable[..., PlayerPage]]:
    """A function that opens a page of a site. Pages are closed after the test.

    The function takes the address, the size (width, height) in pixels, `is_new`, and options of a browser context. The
    first page of a test is a page of former tests, unless there are options or `is_new` is true. Tests that change more
    than what the page stores and shows need a new page.
    """
    contexts, reused = [], []

    def open_one(url: str, size: tuple[int, int] = (320, 240), is_new: bool = False, **options: Any) -> PlayerPage:
        viewport = {"width": size[0], "height": size[1]}
        if is_new or any(options.values()) or reused:
            context = browser.new_context(viewport=viewport, **options)
            contexts.append(context)
            return PlayerPage(context.new_page(), url)
        shared_page.set_viewport_size(viewport)
        reused.append(PlayerPage(shared_page, url))
        return reused[0]

    yield open_one
    for context in contexts:
        context.close()
    for page in reused:
        page.leave()


@pytest.fixture
def play(open_page: Callable[..., PlayerPage], object_site: Path) -> Iterator[PlayerPage]:
    """The page of the object scene, paused at frame 0."""
    with serving(object_site) as server:
        page = open_page(server.url)
        page.pause(0)
        yield page
