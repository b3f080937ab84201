"""The page in which tests show widgets."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from tests.viewer.web.conftest import serving
from tests.viewer.web.page import PlayerPage

PAGE = """<!doctype html>
<meta charset="utf-8" />
<style>body { margin: 0; font: 16px sans-serif } .output { margin: 8px }</style>
<p>In [1]: fourd.show(scene)</p>
<div class="output"></div>
<p style="height: 200px">In [2]:</p>
"""


@pytest.fixture
def open_host(open_page: Callable[..., PlayerPage], tmp_path: Path) -> Iterator[Callable[[], PlayerPage]]:
    """A function that opens a page without a widget."""
    folder = tmp_path / "host"
    folder.mkdir()
    (folder / "index.html").write_text(PAGE, encoding="utf-8")
    with serving(folder) as server:
        yield lambda: open_page(server.url, (480, 640), is_new=True)
