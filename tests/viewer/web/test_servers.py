"""The web player on servers that ignore ranges, stall, cut the file or change it."""

from __future__ import annotations

import shutil
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import BinaryIO

from rich.console import Console

from fourd.viewer.publish.live import LiveSite
from fourd.viewer.publish.server import Part, SiteHandler, SiteServer
from fourd.viewer.publish.site import SCENE_NAME, write_scene
from tests.baking.scenes import write_scene as write_random_scene
from tests.viewer.web.conftest import serving
from tests.viewer.web.page import PlayerPage


class WholeFileHandler(SiteHandler):
    """Sends the whole file for every requested range."""

    def do_GET(self) -> None:
        del self.headers["Range"]
        super().do_GET()


class StallingHandler(SiteHandler):
    """Sends the start of the scene, and no content for other ranges."""

    def _send_content(self, stream: BinaryIO, part: Part) -> None:
        if part.start > 0:
            self.wfile.flush()
            self.rfile.read(1)  # until the client closes the connection
            self.close_connection = True
            return
        super()._send_content(stream, part)


class ViewlessHandler(SiteHandler):
    """Sends no colours of source views."""

    def _send_content(self, stream: BinaryIO, part: Part) -> None:
        if part.start in self.server.stalled:  # type: ignore[attr-defined]
            self.rfile.read(1)
            self.close_connection = True
            return
        super()._send_content(stream, part)


class CuttingHandler(SiteHandler):
    """Ends connections after half of the content, except for the start of the scene."""

    def _send_content(self, stream: BinaryIO, part: Part) -> None:
        if part.start > 0:
            self.close_connection = True
            part = Part(part.start, part.length // 2)
        super()._send_content(stream, part)


class WholeFileServer(SiteServer):
    handler = WholeFileHandler


class StallingServer(SiteServer):
    handler = StallingHandler


class ViewlessServer(SiteServer):
    handler = ViewlessHandler

    def __init__(self, folder: Path) -> None:
        super().__init__(folder)
        with zipfile.ZipFile(folder / SCENE_NAME) as archive:
            infos = [info for info in archive.infolist() if "/views/" in info.filename]
        self.stalled = {info.header_offset + 30 + len(info.filename) for info in infos}


class CuttingServer(SiteServer):
    handler = CuttingHandler


def test_a_server_without_ranges(open_page: Callable[..., PlayerPage], object_site: Path) -> None:
    """Catches a player that reads the start of the file as the requested range."""
    with serving(object_site, WholeFileServer) as server:
        page = open_page(server.url)
        page.pause(4)
        size = (object_site / SCENE_NAME).stat().st_size
        page.wait(f"stage.store.file.source.bytesReceived === {size}")
    assert page.problems == []


def test_the_first_image_needs_no_source_views(open_page: Callable[..., PlayerPage], object_site: Path) -> None:
    """Catches a player that shows nothing until the colours of all source views have arrived."""
    with serving(object_site, ViewlessServer) as server:
        page = open_page(server.url)
        page.ready()
        bright = "stage.redraw(); return stage.renderer.readPixels().some((value, i) => i % 4 < 3 && value > 50);"
        assert page.run(bright)
        assert page.run("return stage.store.get(0).views.size;") == 0


def test_a_server_that_stalls(open_page: Callable[..., PlayerPage], object_site: Path) -> None:
    """Catches a player that waits forever for a server that sends no data."""
    with serving(object_site, StallingServer) as server:
        page = open_page(server.url + "index.html")
        page.run("player.setAttribute('timeout', '0.2'); player.setAttribute('src', 'scene.4dv');")
        assert page.error().endswith("the server sends no data; reload the page")


def test_a_connection_that_ends_early(open_page: Callable[..., PlayerPage], object_site: Path) -> None:
    """Catches a player that draws a partly received frame."""
    with serving(object_site, CuttingServer) as server:
        page = open_page(server.url)
        assert page.error().startswith(server.url + SCENE_NAME)
        assert "reload the page" in page.message()


def test_a_scene_that_changes(open_page: Callable[..., PlayerPage], object_site: Path, tmp_path: Path) -> None:
    """Catches a player that mixes frames of the old and the new scene."""
    site = tmp_path / "site"
    shutil.copytree(object_site, site)
    with serving(site) as server:
        page = open_page(server.url)
        page.pause(0)
        write_random_scene(tmp_path / "other.4dv", frames=6, points=100)
        write_scene(tmp_path / "other.4dv", site / SCENE_NAME, "full")
        page.run("stage.store.entries.clear(); stage.store.downloads.members.clear(); player.seek(5);")
        assert page.error() == "The scene has changed on the server. Reload the page."


def test_a_missing_scene(open_page: Callable[..., PlayerPage], object_site: Path, tmp_path: Path) -> None:
    """Catches an empty page without a message."""
    site = tmp_path / "site"
    shutil.copytree(object_site, site)
    (site / SCENE_NAME).unlink()
    with serving(site) as server:
        page = open_page(server.url)
        assert page.error() == f"{server.url}{SCENE_NAME}: expected a scene, got HTTP status 404; check the address"


def test_a_live_page_shows_changes(open_page: Callable[..., PlayerPage], tmp_path: Path) -> None:
    """Catches a page that keeps the old scene, or that resets the view or the time when it opens the new scene."""
    scene = tmp_path / "scene.4dv"
    write_random_scene(scene, frames=3, points=50)
    live = LiveSite(scene, tmp_path / "site", "light", Console(quiet=True))
    with serving(tmp_path / "site") as server:
        page = open_page(server.url)
        page.pause(2)
        page.run("player.moveToCamera(3);")
        pose = page.run("return stage.pose;")
        assert not live.update()
        write_random_scene(scene, frames=4, points=70)
        assert live.update()
        page.wait("stage && stage.manifest.points[0] === 70 && stage.isSettled")
        assert page.run("return [stage.pose, stage.clock.frame, stage.clock.isPlaying];") == [pose, 2, False]
        scene.write_bytes(b"not a scene")
        assert not live.update()
        assert page.message() == ""
    assert page.problems == []
