"""The notebooks in examples/, executed, and their last players in a page."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.viewer.web.page import PlayerPage

pytest.importorskip("anywidget", reason="anywidget is not installed")
pytest.importorskip("ipykernel", reason="ipykernel is not installed")
pytest.importorskip("nbclient", reason="nbclient is not installed")

import nbformat

from tests.viewer.web.notebook.executing import executed, pixels_of
from tests.viewer.web.notebook.host import show_widget

EXAMPLES = Path(__file__).parents[4] / "examples"
NOTEBOOKS = sorted(path.name for path in EXAMPLES.glob("*.ipynb"))


@pytest.mark.parametrize("name", NOTEBOOKS)
def test_notebooks_are_stored_without_outputs(name: str) -> None:
    """Catches a notebook that was saved after it was run: its pictures make the repository large."""
    notebook = json.loads((EXAMPLES / name).read_text(encoding="utf-8"))
    nbformat.validate(nbformat.from_dict(notebook))
    code = [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]
    assert [cell for cell in code if cell["outputs"] or cell["execution_count"] is not None] == []
    assert "widgets" not in notebook["metadata"]


def test_readme_lists_every_notebook() -> None:
    """Catches a notebook without an entry in examples/README.md."""
    text = (EXAMPLES / "README.md").read_text(encoding="utf-8")
    assert [name for name in NOTEBOOKS if f"({name})" not in text] == []


def test_points_are_fitted_to_pictures(open_host: Callable[..., PlayerPage]) -> None:
    """Catches a fit that no longer improves the view that was left out, and a scene that the page does not show."""
    with executed(EXAMPLES / "fit_points_to_pictures.ipynb") as (notebook, kernel):
        scores = [float(line.split()[2]) for line in printed(notebook) if line.startswith("step")]
        assert scores[-1] > scores[0] + 10
        page = open_host()
        show_widget(page, notebook, kernel)
        page.ready()
        page.run("await player.settled(); player.panel.bar.hidden = true;")
        before = pixels_of(page)
        assert before.std() > 20
        drag(page)
        page.run("await player.settled();")
        assert abs(pixels_of(page) - before).mean() > 2


@pytest.mark.slow
def test_a_capture_becomes_a_scene(open_host: Callable[..., PlayerPage]) -> None:
    """Catches a notebook whose cells fail, training that does not improve, and a player that shows no motion."""
    with executed(EXAMPLES / "from_a_capture_to_a_scene.ipynb") as (notebook, kernel):
        scores = [float(line.split()[2]) for line in printed(notebook) if line.startswith("step")]
        assert scores[-1] > scores[0]
        page = open_host()
        show_widget(page, notebook, kernel)
        page.ready()
        page.run("player.panel.bar.hidden = true; player.seek(0); await player.settled();")
        before = pixels_of(page)
        assert before.std() > 15
        page.run("player.seek(2); await player.settled();")
        assert abs(pixels_of(page) - before).mean() > 0.5
        assert page.problems == []


def drag(page: PlayerPage) -> None:
    """Drag the mouse across the player, which orbits the view."""
    box = page.page.locator("fourd-player").bounding_box()
    assert box is not None
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    page.page.mouse.move(x, y)
    page.page.mouse.down()
    page.page.mouse.move(x + 120, y + 20, steps=5)
    page.page.mouse.up()


def printed(notebook: nbformat.NotebookNode) -> list[str]:
    """The lines that the cells have printed."""
    outputs = [output for cell in notebook.cells for output in cell.get("outputs", [])]
    return [line for output in outputs if output.output_type == "stream" for line in output.text.splitlines()]
