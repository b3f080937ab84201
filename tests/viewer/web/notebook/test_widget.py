"""The widget of fourd.show in a page, with a real kernel."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fourd.viewer.publish.site import SCENE_NAME
from tests.viewer.web.conftest import serving
from tests.viewer.web.page import PlayerPage
from tests.viewer.web.test_pixels import MIN_PSNR, SIZE, images, psnr

pytest.importorskip("anywidget", reason="anywidget is not installed")
pytest.importorskip("ipykernel", reason="ipykernel is not installed")
nbclient = pytest.importorskip("nbclient", reason="nbclient is not installed")

import nbformat  # noqa: E402

from tests.viewer.web.notebook.host import Kernel, show_widget, write_page  # noqa: E402


@contextmanager
def executed(*cells: str) -> Iterator[tuple[nbformat.NotebookNode, Kernel]]:
    """A notebook with these cells, which a kernel has executed, and the kernel, which runs until the block ends."""
    notebook = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell(each) for each in cells])
    client = nbclient.NotebookClient(notebook, timeout=120, store_widget_state=True)
    with client.setup_kernel():
        for index, cell in enumerate(notebook.cells):
            client.execute_cell(cell, index)
        client.set_widgets_metadata()
        kernel = Kernel(client.km.get_connection_info())
        try:
            yield notebook, kernel
        finally:
            kernel.close()


@pytest.fixture
def open_host(open_page: Callable[..., PlayerPage], tmp_path: Path) -> Iterator[Callable[..., PlayerPage]]:
    """A function that opens the page of a host without a widget."""
    write_page(tmp_path / "host")
    with serving(tmp_path / "host") as server:
        yield lambda size=(480, 640): open_page(server.url, size, is_new=True)


def pixels_of(page: PlayerPage) -> np.ndarray[Any, Any]:
    """The image on the canvas, as the user sees it."""
    import io

    from PIL import Image

    return np.asarray(Image.open(io.BytesIO(page.page.locator("fourd-player").screenshot())).convert("RGB"), np.int16)


def test_a_scene_streams_from_the_kernel(open_host: Callable[..., PlayerPage], object_site: Path) -> None:
    """Catches a module that is missing in the bundle, ranges of the wrong bytes, and a page that fetches the whole
    scene."""
    scene = object_site / SCENE_NAME
    with executed("import fourd", f"fourd.show({str(scene)!r}, height=240, autoplay=False)") as (notebook, kernel):
        page = open_host()
        show_widget(page, notebook, kernel)
        page.ready()
        page.run("await player.settled();")
        assert page.run("return bytesReceived;") < 0.7 * scene.stat().st_size
        before = pixels_of(page)
        page.run(
            "player.panel.bar.hidden = true; player.style.width = argument; player.style.height = argument;",
            f"{SIZE}px",
        )
        page.wait(f"player.panel.canvas.width === {SIZE}")
        got, expected = images(page, scene, 3, "sorted")
        assert psnr(got, expected) >= MIN_PSNR["sorted"]
        assert before.std() > 20
        page.run("stage.fixedCamera = null; player.moveToInitialView(); player.togglePlay();")
        page.wait("stage.clock.frame !== 3 && stage.images > 5")
        assert page.problems == []
    assert all(request["size"] <= 1 << 20 for request in kernel.requests)
