"""The widget of fourd.show in a page, with a real kernel."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from fourd.viewer.publish.site import SCENE_NAME
from tests.viewer.web.page import PlayerPage
from tests.viewer.web.test_pixels import MIN_PSNR, SIZE, images, psnr

pytest.importorskip("anywidget", reason="anywidget is not installed")
pytest.importorskip("ipykernel", reason="ipykernel is not installed")
pytest.importorskip("nbclient", reason="nbclient is not installed")

from tests.viewer.web.notebook.executing import executed, pixels_of
from tests.viewer.web.notebook.host import show_widget, widget_views

SQUARE = "player.panel.bar.hidden = true; player.style.width = player.style.height = argument;"


def matches_the_renderer(page: PlayerPage, scene: Path, frame: int) -> bool:
    """Whether the canvas shows what the CPU renders, from a camera of the scene."""
    page.run(SQUARE, f"{SIZE}px")
    page.wait(f"player.panel.canvas.width === {SIZE}")
    got, expected = images(page, scene, frame, "sorted")
    return expected.std() > 20 and psnr(got, expected) >= MIN_PSNR["sorted"]


def test_a_scene_streams_from_the_kernel(open_host: Callable[[], PlayerPage], object_site: Path) -> None:
    """Catches a module that is missing in the bundle, ranges of the wrong bytes, and a page that fetches the whole
    scene."""
    scene = object_site / SCENE_NAME
    with executed("import fourd", f"fourd.show({str(scene)!r}, height=240, autoplay=False)") as (notebook, kernel):
        page = open_host()
        show_widget(page, notebook, kernel)
        page.ready()
        page.run("await player.settled();")
        assert page.run("return bytesReceived;") < 0.7 * scene.stat().st_size
        assert pixels_of(page).std() > 20
        assert matches_the_renderer(page, scene, 3)
        page.run("stage.fixedCamera = null; player.moveToInitialView(); player.togglePlay();")
        page.wait("stage.clock.frame !== 3 && stage.images > 5")
        assert page.problems == []
        assert all(request["size"] <= 1 << 19 for request in kernel.requests)


def test_an_embedded_scene_needs_no_kernel(open_host: Callable[[], PlayerPage], object_site: Path) -> None:
    """Catches a saved notebook that waits for a kernel although the scene is a part of it."""
    scene = object_site / SCENE_NAME
    with executed("import fourd", f"fourd.show({str(scene)!r}, embed=True)") as (notebook, _):
        pass
    page = open_host()
    show_widget(page, notebook, None)
    page.ready()
    page.wait("stage.clock.frame > 0 && stage.images > 5")
    page.run("player.togglePlay();")
    assert matches_the_renderer(page, scene, 2)
    assert page.problems == []


def test_the_kernel_controls_the_player(open_host: Callable[[], PlayerPage], object_site: Path) -> None:
    """Catches traits that the page ignores, and a page that still listens after the widget was removed."""
    with executed("import fourd", f"fourd.show({str(object_site / SCENE_NAME)!r}, height=200)") as (notebook, kernel):
        page = open_host()
        show_widget(page, notebook, kernel)
        page.ready()
        page.run("model.set('frame', 4); model.set('background', '#ff0000'); model.set('height', 123);")
        page.run("await player.settled();")
        page.wait("stage.clock.frame === 4 && !stage.clock.isPlaying && player.clientHeight === 123")
        page.run("player.panel.bar.hidden = true;")
        corner = pixels_of(page)[3, 3]
        page.run("removeWidget();")
        left = page.page.evaluate("() => [...listeners.values()].flat().length")
    assert page.page.locator("fourd-player").count() == 0
    assert left == 0
    assert corner.tolist() == [255, 0, 0]


def test_a_changed_file_is_an_error_in_the_page(
    open_host: Callable[[], PlayerPage], object_site: Path, tmp_path: Path
) -> None:
    """Catches a page that mixes the ranges of two versions of a file."""
    scene = tmp_path / "own.4dv"
    scene.write_bytes((object_site / SCENE_NAME).read_bytes())
    with executed("import fourd", f"fourd.show({str(scene)!r})") as (notebook, kernel):
        scene.write_bytes(scene.read_bytes() + b"more")
        page = open_host()
        show_widget(page, notebook, kernel)
        assert page.error() == "own.4dv: expected an unchanged file, got a newer one; call fourd.show again"


def test_scenes_are_shown_as_values_of_cells(object_site: Path) -> None:
    """Catches an extension that registers a wrong class, and a notebook without a picture where scripts are off."""
    opened = f"import fourd\nscene = fourd.open_scene({str(object_site / SCENE_NAME)!r})"
    with executed(opened, "scene", "%load_ext fourd", "scene", "%unload_ext fourd", "scene") as (notebook, _):
        formats = [set(notebook.cells[index].outputs[0].data) for index in (1, 3, 5)]
    assert len(widget_views(notebook)) == 1
    assert "image/png" in formats[0] & formats[1] & formats[2]
    assert "text/html" in formats[1]


def test_errors_are_one_line(tmp_path: Path) -> None:
    """Catches a traceback through the package in place of the message."""
    from nbclient.exceptions import CellExecutionError

    with pytest.raises(CellExecutionError) as caught, executed("import fourd", "fourd.show('nothing.4dv')"):
        pass
    message = "nothing.4dv: expected a .4dv file or a run's folder, got nothing there; check the path"
    assert f"UserError: {message}" in str(caught.value)
    assert "serve" not in str(caught.value)
