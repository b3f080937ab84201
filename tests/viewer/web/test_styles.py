"""Styles in the web player compared with the CPU."""

from __future__ import annotations

import json
import shutil
import struct
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from fourd.scene import SceneReader
from fourd.scene.styled.player import StyledPlayer
from fourd.scene.styles import PRESETS, view_style
from fourd.scene.styles.tables import make_table
from fourd.viewer.publish.site import PLAYER_FOLDER, SCENE_NAME, write_site
from fourd.viewer.publish.styles import STYLES_NAME, load_styles
from tests.baking.scenes import ring
from tests.viewer.scenes import write_shells
from tests.viewer.web.conftest import serving
from tests.viewer.web.page import PlayerPage

SIZE = 128
MIXED = """
shading: xtoon
albedo: 0.5
light: {direction: [0.2, 0.4, 1], frame: world}
detail: {by: depth, fade: 0.8, fade_colour: [1, 0.5, 0.2]}
angle: {threshold: 0.3, strength: 0.7}
lines: {filter: cross, normal: 0.9, thickness: 8}
hatching: {width: 0.5, spacing: 12}
paper: [0.9, 0.9, 0.8]
"""
CHOOSE = "await player.styleMenu.choose(argument); await player.settled();"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a site of shells, and with the style that the page offers in addition to the presets. Tests must
    not change this folder.
    """
    folder = tmp_path_factory.mktemp("styled")
    write_shells(folder / "scene.4dv", frames=2)
    (folder / "mixed.yaml").write_text(MIXED)
    write_site(folder / "scene.4dv", folder / "site", "full", styles=load_styles([folder / "mixed.yaml"]))
    return folder


def draw_on_cpu(scene: Path, frame: int, name: str, style_file: Path) -> NDArray[np.uint8]:
    reader, player = SceneReader(scene), StyledPlayer()
    camera = reader.manifest.cameras[-1].resize(SIZE, SIZE)
    style = load_styles([style_file])[name]
    content = reader.read(frame)
    assert content.normals is not None
    for _ in range(20):  # The page draws a paused frame until its lines have their full strength.
        picture = player.draw(content, camera, reader.manifest, style)
    reader.close()
    return picture[..., :3]


def picture_of(page: PlayerPage, scene: Path) -> NDArray[np.uint8]:
    reader = SceneReader(scene)
    reader.close()
    return page.pixels(reader.manifest.cameras[-1].resize(SIZE, SIZE))


@pytest.mark.parametrize("name", [*PRESETS, "mixed"])
def test_pictures_resemble_those_of_the_cpu(name: str, folder: Path, open_page: Callable[..., PlayerPage]) -> None:
    """Catches shaders that differ from the shaders of the window, and normals in world axes. Also catches stylizer
    parameters of another camera, and lines of a paused frame that stay faint.
    """
    scene = folder / "site" / SCENE_NAME
    with serving(folder / "site") as server:
        page = open_page(server.url, (SIZE, SIZE))
        page.pause(0)
        page.run(CHOOSE, name)
        assert page.run("return player.panel.styles.value;") == name
        picture_of(page, scene)
        page.run("player.seek(1); await player.settled();")
        found = picture_of(page, scene)
    expected = draw_on_cpu(scene, 1, name, folder / "mixed.yaml")
    assert expected.std() > 15
    assert (np.abs(found.astype(int) - expected).max(2) > 24).mean() < 0.03
    assert page.problems == []


def test_numbers_equal_those_of_the_viewer(folder: Path, open_page: Callable[..., PlayerPage]) -> None:
    """Catches lengths, lights and rays that differ between the page and the viewer's window."""
    script = """
        const { loadStyles } = await import("/player/stylize/style_file.js");
        const { viewStyle } = await import("/player/stylize/view_style.js");
        const { styles } = await loadStyles(new URL("/player/stylize.json", location.href));
        return styles.map((style) => viewStyle(style, argument.camera, argument.focus, [0.1, 0.2, 0.3]));
    """
    focus = (0.3, -0.2, 0.1)
    styles = load_styles([folder / "mixed.yaml"])
    with serving(folder / "site") as server:
        page = open_page(server.url)
        page.ready()
        for rows in (97, 1080, 4000):
            camera = ring(5)[2].resize(2 * rows, rows)
            described = {
                "intrinsics": camera.intrinsics.ravel().tolist(),
                "rotation": camera.rotation.ravel().tolist(),
                "translation": camera.translation.tolist(),
                "height": rows,
            }
            found = page.run(script, {"camera": described, "focus": focus})
            for style, got in zip(styles.values(), found, strict=True):
                wanted = view_style(style, make_table(style), camera, focus, (0.1, 0.2, 0.3))
                for key, value in asdict(wanted.numbers).items():
                    if key != "persistence":
                        np.testing.assert_allclose(got["floats"][key], value, atol=1e-9, err_msg=key)
                assert got["integers"]["thickness"] == wanted.thickness


def test_the_list_and_the_attribute_select_a_style(folder: Path, open_page: Callable[..., PlayerPage]) -> None:
    """Catches a list of styles without effect, and a style that is still drawn after it is switched off."""
    scene = folder / "site" / SCENE_NAME
    with serving(folder / "site") as server:
        page = open_page(server.url, (SIZE, SIZE))
        page.pause(0)
        plain = picture_of(page, scene)
        page.wait("!player.panel.styles.hidden")
        names = page.run("return [...player.panel.styles.options].map((option) => option.value);")
        assert names == ["none", *PRESETS, "mixed"]
        page.page.get_by_role("button", name="More controls").click()
        page.page.locator("fourd-player select[title=Style]").select_option("ink")
        page.wait("stage.style?.style.name === 'ink'")
        ink = picture_of(page, scene)
        assert (ink != plain).any(2).mean() > 0.5
        page.run("player.setAttribute('stylize', 'gooch');")
        page.wait("stage.style?.style.name === 'gooch'")
        assert (picture_of(page, scene) != ink).any(2).mean() > 0.2
        page.run("player.setAttribute('stylize', 'none');")
        page.wait("stage.style === null")
        np.testing.assert_array_equal(picture_of(page, scene), plain)
        page.run("player.setAttribute('stylize', 'tooon');")
        assert page.error() == (
            "stylize: expected none, toon, xtoon, gooch, ink, mixed, got 'tooon'; correct the attribute"
        )
    assert page.problems == []


def test_the_attribute_in_the_page(folder: Path, tmp_path: Path, open_page: Callable[..., PlayerPage]) -> None:
    """Catches an attribute that is ignored when the scene is opened, and a style that is lost when the WebGL context is
    lost.
    """
    shutil.copytree(folder / "site", tmp_path / "site")
    text = (tmp_path / "site" / "index.html").read_text()
    (tmp_path / "site" / "index.html").write_text(text.replace(" autoplay", ' autoplay stylize="toon"'))
    with serving(tmp_path / "site") as server:
        page = open_page(server.url, (SIZE, SIZE))
        page.pause(0)
        page.wait("stage.style?.style.name === 'toon'")
        toon = picture_of(page, folder / "site" / SCENE_NAME)
        page.run("window.lose = stage.renderer.gl.getExtension('WEBGL_lose_context'); window.lose.loseContext();")
        page.wait("!player.panel.message.hidden")
        page.run("window.lose.restoreContext();")
        page.wait("player.panel.message.hidden")
        again = picture_of(page, folder / "site" / SCENE_NAME)
        assert (np.abs(again.astype(int) - toon).max(2) > 24).mean() < 0.01


@pytest.mark.parametrize("kind", ["object", "full"])
def test_scenes_without_and_with_background(
    kind: str, request: pytest.FixtureRequest, open_page: Callable[..., PlayerPage]
) -> None:
    """Catches normals of the background that are not loaded, and a style that stops playback."""
    with serving(request.getfixturevalue(f"{kind}_site")) as server:
        page = open_page(server.url, (SIZE, SIZE))
        page.ready()
        page.run("await player.styleMenu.choose('ink');")
        page.wait("stage.renderer.styled !== null")
        page.run("window.first = stage.clock.frame;")
        page.wait("stage.clock.frame !== window.first")
        page.pause(1)
        assert page.run("return stage.playback.picture(stage.camera(1), {}).clouds.every((c) => !c || c.normals);")
    assert page.problems == []


def test_scenes_without_normals(tmp_path: Path, open_page: Callable[..., PlayerPage]) -> None:
    """Catches a scene that is not shown, or a style that is drawn without normals."""
    write_shells(tmp_path / "scene.4dv", frames=1, points=300)
    write_site(tmp_path / "scene.4dv", tmp_path / "site", "stream", has_normals=False)
    with serving(tmp_path / "site") as server:
        page = open_page(server.url, (SIZE, SIZE))
        page.pause(0)
        plain = picture_of(page, tmp_path / "site" / SCENE_NAME)
        page.run(CHOOSE, "toon")
        assert page.message() == "The scene has no normals, which styles need; write the page again with fourd web"
        np.testing.assert_array_equal(picture_of(page, tmp_path / "site" / SCENE_NAME), plain)
        assert page.run("return player.panel.styles.value;") == "none"


def test_files_of_styles_that_are_missing_or_damaged(
    folder: Path, tmp_path: Path, open_page: Callable[..., PlayerPage]
) -> None:
    """Catches a player that shows nothing because its styles cannot be read."""
    shutil.copytree(folder / "site", tmp_path / "site")
    styles = tmp_path / "site" / PLAYER_FOLDER / STYLES_NAME
    content = json.loads(styles.read_text())
    content["styles"][0]["rows"] = "x"
    for text, expected in ((json.dumps(content), "got other content; write the site again"), (None, "got status 404")):
        styles.unlink() if text is None else styles.write_text(text)
        with serving(tmp_path / "site") as server:
            page = open_page(server.url, (SIZE, SIZE))
            page.pause(0)
            assert page.run("return player.panel.styles.hidden;")
            page.run(CHOOSE, "toon")
            assert expected in page.message()
            assert "\n" not in page.message()


def test_damaged_normals(folder: Path, tmp_path: Path, open_page: Callable[..., PlayerPage]) -> None:
    """Catches damaged normals that are drawn, and a scene that vanishes because its normals are damaged."""
    shutil.copytree(folder / "site", tmp_path / "site")
    scene = tmp_path / "site" / SCENE_NAME
    content = bytearray(scene.read_bytes())
    manifest = json.loads(content[43 : 43 + struct.unpack_from("<L", content, 22)[0]])
    offset, size = manifest["members"]["frames/000000/optional/normals"]
    content[offset + size // 2] ^= 0xFF
    scene.write_bytes(content)
    with serving(tmp_path / "site") as server:
        page = open_page(server.url, (SIZE, SIZE))
        page.pause(0)
        page.run("await player.styleMenu.choose('toon');")
        assert page.error().startswith("frames/000000/optional/normals: expected ")
        page.run("stage.redraw(); window.pixels = stage.renderer.readPixels();")
        assert page.run("return window.pixels.some((value, index) => index % 4 < 3 && value > 50);")
