"""The npm package of the web player, installed outside the repository."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

from fourd.viewer.publish.site import SCENE_NAME
from tests.viewer.web.conftest import serving
from tests.viewer.web.npm import TIMEOUT_SECONDS, WEB, require_npm
from tests.viewer.web.page import PlayerPage
from tests.viewer.web.test_pixels import MIN_PSNR, SIZE, images, psnr

PAGE = """<!doctype html>
<style>body { margin: 0 } fourd-player { width: 100vw; height: 100vh; display: block }</style>
<script type="module" src="node_modules/fourd-player/fourd-player.js"></script>
<fourd-player src="scene.4dv"></fourd-player>
"""
IMPORT_SCENE = "return typeof (await import('/node_modules/fourd-player/fourd-scene.js')).FourdScene.open;"


def run_npm(*words: str | Path) -> str:
    done = subprocess.run(["npm", *words], capture_output=True, text=True, timeout=TIMEOUT_SECONDS)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.fixture
def application(object_site: Path, tmp_path: Path) -> Path:
    """The folder of a web application in which the packed player is installed, with a page and a scene."""
    require_npm()
    folder = tmp_path / "application"
    folder.mkdir()
    packed = run_npm("pack", WEB, "--silent", "--pack-destination", tmp_path).strip()
    run_npm("install", "--prefix", folder, "--offline", "--no-audit", "--no-fund", tmp_path / packed)
    (folder / "index.html").write_text(PAGE)
    shutil.copyfile(object_site / SCENE_NAME, folder / SCENE_NAME)
    return folder


def test_the_package_plays_a_scene(application: Path, open_page: Callable[..., PlayerPage]) -> None:
    """Catches a package without one of the modules or shaders that the player loads."""
    with serving(application) as server:
        page = open_page(server.url, (SIZE, SIZE))
        got, expected = images(page, application / SCENE_NAME, 0, "sorted")
        assert page.run(IMPORT_SCENE) == "function"
    assert expected.std() > 20
    assert psnr(got, expected) >= MIN_PSNR["sorted"]
    assert page.problems == []


def test_the_package_has_no_pages(application: Path) -> None:
    """Catches a package with the pages of fourd, which are templates, and with its examples and their packages."""
    package = application / "node_modules" / "fourd-player"
    names = {path.name for path in package.iterdir()}
    assert names.isdisjoint({"examples", "training", "index.html", "page.css", "tsconfig.json", "node_modules"})
