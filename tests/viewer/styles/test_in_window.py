"""Styles in the viewer window, chosen by keys, dropped files and the panel."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from fourd.scene.styles import Style, load_style
from tests.stylize.test_styles import write_map
from tests.viewer.scenes import write_shells
from tests.viewer.screen import Screen, Viewer, screen
from tests.viewer.test_window import (
    BAR_HEIGHT,
    BLACK,
    SIZE,
    close,
    hide_panel,
    pause_at,
    shows_scene,
    stable_image,
    window_image,
)

NOTICE = slice(SIZE[1] - BAR_HEIGHT - 60, SIZE[1] - BAR_HEIGHT - 5)
SAVE, RESET, LIGHT = (37, 314), (93, 314), (60, 363)
"""Positions of widgets of the panel for the style toon."""


@pytest.fixture(scope="module")
def display() -> Iterator[Screen]:
    with screen() as made:
        yield made


@pytest.fixture
def viewer(display: Screen, tmp_path: Path) -> Iterator[Viewer]:
    """A paused viewer without its panel."""
    write_shells(tmp_path / "ball.4dv", frames=2)
    opened = Viewer(display, tmp_path, "ball.4dv", "--size", str(SIZE[0]), str(SIZE[1]), *BLACK)
    opened.until(lambda: "ball.4dv" in opened.title and shows_scene(opened), "the scene in its window")
    hide_panel(opened)
    pause_at(opened, "Home", 1)
    yield opened
    assert opened.close() == 0, opened.log
    assert "Traceback" not in opened.log


def picture(viewer: Viewer) -> NDArray[np.uint8]:
    """The stable image of the window above the notice."""
    return stable_image(viewer)[: SIZE[1] - 150]


def has_notice(viewer: Viewer) -> bool:
    """Whether the light text of a notice is visible above the time bar, where the scene is black."""
    return bool((window_image(viewer)[NOTICE].min(axis=2) > 190).any())


def drop_style(viewer: Viewer, path: Path, text: str) -> None:
    path.write_text(text)
    viewer.drop(path)


def test_keys_and_dropped_files_choose_styles(viewer: Viewer, tmp_path: Path) -> None:
    """Catches a style that has no effect in the window, and a missing notice. Also catches errors in a style file that
    end the viewer or remove the picture.
    """
    plain = picture(viewer)
    viewer.key("t")
    viewer.until(lambda: has_notice(viewer), "the notice that the scene has no normals")
    toon = picture(viewer)
    assert not close(toon, plain)
    drop_style(viewer, tmp_path / "mine.yaml", "shading: gooch\nlines: {thickness: 4}")
    viewer.until(lambda: not has_notice(viewer), "no notice for a valid style")
    gooch = picture(viewer)
    assert not close(gooch, toon)
    for name, text in (("typo", "lines: {dept: 1}"), ("nan", "lines: {normal: .nan}")):
        drop_style(viewer, tmp_path / f"{name}.yaml", text)
        viewer.until(lambda: has_notice(viewer), f"a notice for {name}.yaml")
        viewer.keep(name)
        assert close(picture(viewer), gooch)
        viewer.drop(tmp_path / "mine.yaml")
        viewer.until(lambda: not has_notice(viewer), "no notice for a valid style")
    for rows, is_accepted in ((2, False), (1, True)):
        drop_style(viewer, tmp_path / "toon.yaml", "shading: toon")
        toon = picture(viewer)
        write_map(tmp_path / f"{rows}.png", rows, 8)
        viewer.drop(tmp_path / f"{rows}.png")
        viewer.until(lambda wanted=is_accepted: has_notice(viewer) != wanted, f"a notice only for {rows} rows")
        assert close(picture(viewer), toon) != is_accepted


@pytest.mark.parametrize("name", ["cpu", "sorted"])
def test_a_shade_map_that_vanishes_switches_the_style_off(name: str, viewer: Viewer, tmp_path: Path) -> None:
    """Catches a viewer that ends, or that reports an error of the renderer, when a new renderer cannot read the shade
    map.
    """
    plain = picture(viewer)
    write_map(tmp_path / "map.png", 1, 8)
    drop_style(viewer, tmp_path / "mine.yaml", "shading: toon\nramp: {map: map.png}")
    viewer.until(lambda: not close(picture(viewer), plain), "the style")
    if name == "cpu":
        for _ in range(3):
            viewer.key("r")
        viewer.until(lambda: viewer.title.endswith("- dual"), "another renderer")
    (tmp_path / "map.png").unlink()
    viewer.key("r")
    viewer.until(lambda: viewer.title.endswith(f"- {name}"), f"renderer {name}")
    viewer.until(lambda: has_notice(viewer), "a notice")
    viewer.until(lambda: close(picture(viewer), plain), "the captured colours")
    assert viewer.title.endswith(f"- {name}")


def test_lines_have_their_strength_when_playback_is_paused(viewer: Viewer, tmp_path: Path) -> None:
    """Catches lines that stay faint, because a paused frame is drawn only once."""
    drop_style(
        viewer, tmp_path / "mine.yaml", "lines: {depth: 0.004, normal: 0.2, colour: [1, 0, 0]}\npersistence: 0.9"
    )
    picture(viewer)
    viewer.key("Right")
    viewer.until(lambda: "frame 2/" in viewer.title, "frame 2")
    settled = picture(viewer)
    drop_style(viewer, tmp_path / "same.yaml", (tmp_path / "mine.yaml").read_text() + "\nhysteresis: 0.19")
    viewer.until(lambda: not np.array_equal(window_image(viewer)[: SIZE[1] - 150], settled), "another picture")
    assert np.abs(picture(viewer)[..., 0].astype(float) - settled[..., 0]).mean() < 0.5


def test_the_panel_changes_saves_and_resets_a_style(display: Screen, tmp_path: Path) -> None:
    """Catches widgets of the panel that have no effect on the picture, and saved files that differ from the style in
    the window.
    """
    write_shells(tmp_path / "ball.4dv", frames=2)
    viewer = Viewer(display, tmp_path, "ball.4dv", "--style", "toon", "--size", str(SIZE[0]), str(SIZE[1]), *BLACK)
    viewer.until(lambda: "ball.4dv" in viewer.title and shows_scene(viewer), "the scene in its window")
    pause_at(viewer, "Home", 1)

    def saved(number: int) -> Style:
        path = tmp_path / f"toon-{number:03d}.yaml"
        viewer.click(*SAVE)
        viewer.until(path.exists, str(path))
        return load_style(str(path))

    toon = load_style("toon")
    assert saved(1) == toon
    scene = np.s_[:550, 350:]
    before = stable_image(viewer)[scene]
    viewer.click(*LIGHT)
    viewer.drag((50, 390), (90, 390))
    viewer.keep("panel")
    viewer.until(lambda: not close(window_image(viewer)[scene], before), "another light")
    changed = saved(2)
    assert changed.light.direction[0] > 0.8
    assert replace(changed, light=toon.light) == toon
    viewer.click(*RESET)
    viewer.until(lambda: close(window_image(viewer)[scene], before), "the preset")
    assert saved(3) == toon
    assert viewer.close() == 0, viewer.log
