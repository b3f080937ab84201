"""The choice of a style in a viewer session, and user errors."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fourd.base.configs import load_overlay, save_config
from fourd.scene import BakedFrame, SceneManifest, SceneWriter
from fourd.scene.styled.normals import add_normals
from fourd.scene.styles import PRESETS, Style, load_style
from fourd.viewer.display import DEFAULT_BACKGROUND, DisplaySettings
from fourd.viewer.loaded_scene import LoadedScene
from fourd.viewer.playback.sources import open_frame_source
from fourd.viewer.rendering.cpu import CPURenderer
from fourd.viewer.session import Session
from tests.baking.scenes import manifest
from tests.stylize.test_styles import write_map
from tests.viewer.scenes import shell_frame

SIZE = (64, 48)


def write_shell(path: Path, normals: bool) -> None:
    described: SceneManifest = manifest(frames=1)
    frame: BakedFrame = shell_frame(500, 0)
    with SceneWriter(path, described) as writer:
        writer.add_frame(0, add_normals(frame, described) if normals else frame)


def show(session: Session, path: Path) -> None:
    scene = LoadedScene(path, open_frame_source(path))
    session.show(scene, scene.initial_pose(SIZE))


@pytest.fixture
def session(tmp_path: Path) -> Iterator[Session]:
    write_shell(tmp_path / "ball.4dv", normals=True)
    opened = Session(DisplaySettings(12))
    show(opened, tmp_path / "ball.4dv")
    yield opened
    opened.close()


def test_presets_and_files_can_be_chosen(session: Session, tmp_path: Path) -> None:
    """Catches a preset that the session does not offer, and a file that cannot be chosen again."""
    assert session.style_names == (None, *PRESETS)
    for name in PRESETS:
        session.choose_style(name)
        assert (session.style_name, session.settings.style, session.message) == (name, load_style(name), "")
    path = tmp_path / "mine.yaml"
    path.write_text("lines: {thickness: 3}")
    session.choose_style(str(path))
    assert session.style_names[-1] == session.style_name == str(path)
    session.choose_style(None)
    assert session.settings.style is None
    assert session.style_names[-1] == str(path)
    path.write_text("lines: {thickness: 4}")
    session.choose_style(str(path))
    assert session.settings.style is not None
    assert session.settings.style.lines.thickness == 4


def test_a_chosen_background_replaces_the_paper(session: Session) -> None:
    """Catches --background that has no effect for a style with paper, a saved style without its paper, and paper that
    the user chooses in the panel and that is not drawn."""
    session.choose_style("toon")

    def drawn() -> tuple[object, object]:
        request = session.render_request(SIZE, wait=True)
        assert request is not None
        assert request.settings.style is not None
        return request.settings.style.paper, request.settings.background

    assert drawn()[0] == load_style("toon").paper is not None
    session.settings = session.settings.with_background((0.2, 0.3, 0.4))
    session.choose_style("ink")
    assert drawn() == (None, (0.2, 0.3, 0.4))
    assert session.settings.style == load_style("ink")
    session.set_style(replace(load_style("ink"), paper=(1.0, 0.9, 0.8)))
    assert drawn()[0] == (1.0, 0.9, 0.8)


def test_the_page_has_the_background_of_the_window() -> None:
    """Catches a page, or its image before the scene is loaded, with another background than windows and images."""
    web = Path(__file__).parents[3] / "viewer" / "web"
    found = re.search(r"DEFAULT_BACKGROUND = \[(.+?)\];", (web / "play" / "stage.js").read_text())
    assert found is not None
    assert tuple(float(value) for value in found[1].split(",")) == DEFAULT_BACKGROUND
    colour = "#" + "".join(f"{round(255 * value):02x}" for value in DEFAULT_BACKGROUND)
    for file in ("ui/style.js", "page.css"):
        assert f"background: {colour};" in (web / file).read_text()


def test_changes_can_be_saved_and_reset(session: Session, tmp_path: Path) -> None:
    """Catches a change of a style that also changes the preset, and a saved style that differs from the style in the
    session.
    """
    session.choose_style("toon")
    preset = session.settings.style
    assert preset is not None
    changed = replace(preset, lines=replace(preset.lines, thickness=3.0), paper=(1.0, 0.5, 0.0))
    session.set_style(changed)
    save_config(session.settings.style, tmp_path / "saved.yaml")
    assert load_style(str(tmp_path / "saved.yaml")) == changed
    session.choose_style(session.style_name)
    assert session.settings.style == preset


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("lines: {dept: 3}", "line 1: lines: expected a known key, got 'dept'; did you mean 'depth'?"),
        ("lines: {depth: .nan}", "lines.depth: expected a number, got '.nan'"),
        ("lines: {normal: .inf}", "lines.normal: expected 1e-06 to 10, got inf"),
        (
            "shading: toon\nramp: {map: map.png}",
            "map.png: expected a PNG of 1 row and 2 to 4096 columns, got 8 x 2 pixels",
        ),
        ("shading: toon\nramp: {map: none.png}", "none.png: expected a PNG, got 'No such file or directory'"),
    ],
)
def test_a_style_file_with_a_mistake_keeps_the_style(text: str, message: str, session: Session, tmp_path: Path) -> None:
    """Catches an error that ends the viewer, a message that does not name the mistake, and a lost style."""
    session.choose_style("gooch")
    before = session.settings
    write_map(tmp_path / "map.png", 2, 8)
    (tmp_path / "mine.yaml").write_text(text)
    session.choose_style(str(tmp_path / "mine.yaml"))
    assert message in session.message
    assert "\n" not in session.message
    assert (session.settings, session.style_name, session.style_file) == (before, "gooch", None)
    assert session.render_request(SIZE, wait=True) is not None
    session.choose_style("ink")
    assert session.message == ""


def test_shade_maps_can_be_chosen(session: Session, tmp_path: Path) -> None:
    """Catches a shade map of the wrong shape that is accepted, and a shade map that is accepted for a style without
    shade map.
    """
    for rows in (1, 3):
        write_map(tmp_path / f"{rows}.png", rows, 8)
    session.choose_shade_map(tmp_path / "1.png")
    assert "expected a style with a shade map, got no style; choose toon or xtoon first" in session.message
    session.choose_style("ink")
    session.choose_shade_map(tmp_path / "1.png")
    assert "got the shading none; choose toon or xtoon first" in session.message
    session.choose_style("xtoon")
    session.choose_shade_map(tmp_path / "3.png")
    style = session.settings.style
    assert style is not None
    assert (style.ramp.map, session.message) == (tmp_path / "3.png", "")
    session.set_style(replace(style, shading="toon"))
    assert session.settings.style == style
    assert "3.png: expected a PNG of 1 row and 2 to 4096 columns, got 8 x 3 pixels" in session.message
    session.choose_style("toon")
    session.choose_shade_map(tmp_path / "3.png")
    assert session.settings.style == load_style("toon")
    assert "expected a PNG of 1 row" in session.message


def test_saved_styles_keep_their_shade_map(session: Session, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Catches a saved style whose shade map cannot be found, because its path is relative to the wrong folder."""
    (tmp_path / "styles").mkdir()
    monkeypatch.chdir(tmp_path)
    write_map(tmp_path / "styles" / "map.png", 1, 8)
    (tmp_path / "styles" / "mine.yaml").write_text("shading: toon\nramp: {map: map.png}")
    session.choose_style("styles/mine.yaml")
    save_config(session.settings.style, Path("mine-001.yaml"))
    saved = load_style(str(tmp_path / "mine-001.yaml"))
    assert saved.ramp.map == tmp_path / "styles" / "map.png"
    assert load_overlay(Style(), Path("mine-001.yaml")) == session.settings.style


def test_a_scene_without_normals_is_drawn_and_announced_once(session: Session, tmp_path: Path) -> None:
    """Catches a viewer that does not tell the user why playback is slow, and a scene without normals
    that is not drawn.
    """
    session.choose_style("toon")
    assert session.message == ""
    write_shell(tmp_path / "old.4dv", normals=False)
    show(session, tmp_path / "old.4dv")
    assert session.message == (
        "old.4dv: expected normals for styles, got none; "
        "the normals of each frame are estimated when the frame is first drawn"
    )
    request = session.render_request(SIZE, wait=True)
    assert request is not None
    renderer = CPURenderer()
    assert (renderer.render(request)[..., 3] == 255).any()
    assert renderer.style_seconds > 0
    session.choose_style("gooch")
    assert session.message == ""
    session.choose_style(None)
    session.choose_style("ink")
    assert "got none" in session.message
    assert np.isfinite(renderer.line_strength).all()
